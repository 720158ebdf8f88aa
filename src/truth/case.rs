//! One case of a blind test: the recordings, the baseline for the diagnosis, and the label that the diagnosis must not see.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::catalogue::{self, PHYSICS, REDUCED};
use super::limit::VisibilityMeter;
use super::nuisance::Nuisance;
use super::sensors::Sensors;
use super::{Family, Form, Hidden, Programme, TruthSpecimen, World, between, one_of};
use crate::recording::Recording;

/// Strengths of drawn cases, in detection limits.
pub(crate) const STRENGTHS: [f64; 4] = [1.0, 2.0, 5.0, 10.0];
/// Largest cosine between the signatures of a pair; above it the two effects are confounded.
const LARGEST_COSINE: f64 = 0.8;
/// Largest number of draws for a family. A draw fails if no plausible size makes its effects visible.
const TRIES: usize = 60;
/// Effects and their look-alikes in a programme of a ramp and one sine.
const LOOK_ALIKES: [(&str, &str); 5] = [
    ("channel_delay", "viscous_damping"),
    ("viscous_damping", "channel_delay"),
    ("geometric_stiffness", "progressive_stiffness"),
    ("stribeck", "relaxation"),
    ("sensor_drift", "relaxation"),
];

/// The baseline for the diagnosis: settings of the model `equivalent`.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub(crate) struct BaselineSettings {
    /// Codes of physics for `--known`; `None` for the list of the model.
    pub known: Option<Vec<&'static str>>,
    /// Transition speed of a smoothed friction in the baseline, mm/s.
    pub smoothing_mm_s: Option<f64>,
    /// Preload in N, rate in N/mm, friction ratio and presliding in mm of a tuned baseline.
    pub tuned: Option<[f64; 4]>,
}

/// The truth of a case, opened after the diagnosis. Its JSON is hashed by `blind`, so the field names stay.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Label {
    /// Number of the case in its run.
    pub number: u64,
    /// Seed of the whole run.
    pub seed: u64,
    pub family: Family,
    pub hidden: Vec<Hidden>,
    /// Strength in detection limits; 0 if nothing is hidden.
    pub strength: f64,
    /// Code of the look-alike in a confounded case.
    pub look_alike: Option<&'static str>,
    /// Largest displacement in mm and largest force in N.
    pub top: [f64; 2],
    /// Noise of one sample for a displacement-driven model, N.
    pub sigma_n: f64,
    #[serde(skip_serializing_if = "is_own")]
    pub world: World,
    /// Imperfection of the instruments.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nuisance: Option<&'static str>,
    /// Codes that it is not wrong to name beside the hidden effects.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub also: Vec<&'static str>,
}

/// True for the world whose labels do not name it.
fn is_own(world: &World) -> bool {
    *world == World::Own
}

/// Specimen and sensors of one case.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TruthRig {
    pub specimen: TruthSpecimen,
    pub sensors: Sensors,
}

/// A case of a blind test.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Case {
    pub label: Label,
    pub baseline: BaselineSettings,
    pub recordings: Vec<Recording>,
    /// Takes further recordings.
    pub(super) rig: TruthRig,
}

impl Case {
    /// Case `number` of a world in the run with `seed`; a strength of `None` is drawn. The same arguments give the same bits.
    pub(crate) fn draw(world: World, seed: u64, number: u64, strength: Option<f64>) -> Case {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(world.stream(number));
        let family = Family::of(world, number);
        for _ in 0..TRIES {
            if let Some(case) = Case::of(world, family, seed, number, strength, &mut random) {
                return case;
            }
        }
        // No draw of this family was visible: a case without an effect takes its place.
        Case::of(world, Family::None, seed, number, strength, &mut random)
            .expect("a case without an effect needs no size")
    }

    /// One draw of a case; `None` if an effect is not visible or two effects cannot be a pair.
    fn of(
        world: World,
        family: Family,
        seed: u64,
        number: u64,
        strength: Option<f64>,
        random: &mut ChaCha8Rng,
    ) -> Option<Case> {
        let drawn = one_of(random, &STRENGTHS);
        let strength = strength.unwrap_or(drawn);
        let can_hide = |p: &&catalogue::Physics| p.is_in(world);
        let all: Vec<_> = PHYSICS.iter().filter(can_hide).collect();
        let inside: Vec<&str> = all.iter().filter(|p| p.in_library).map(|p| p.code).collect();
        let outside: Vec<&str> = all.iter().filter(|p| !p.in_library).map(|p| p.code).collect();
        let (codes, look_alike) = match family {
            Family::None | Family::NoneNoisy | Family::Nuisance => (vec![], None),
            Family::Single | Family::Concealed => (vec![one_of(random, &inside)], None),
            Family::Outside => (vec![one_of(random, &outside)], None),
            Family::Pair => (vec![one_of(random, &inside), one_of(random, &inside)], None),
            Family::Confounded => {
                let (code, other) = one_of(random, &LOOK_ALIKES);
                (vec![code], Some(other))
            }
        };
        let reduced = |c: &&str| REDUCED.contains(c);
        if matches!(family, Family::Pair | Family::Concealed) && codes.iter().any(reduced) {
            return None;
        }
        if codes.len() == 2 && codes[0] == codes[1] {
            return None;
        }
        let mut case = Draft::new(random, world, family, &codes, strength)?.finish(seed, number, random)?;
        case.label.look_alike = look_alike;
        Some(case)
    }
}

/// A case before its recordings.
#[derive(Clone)]
struct Draft {
    family: Family,
    specimen: TruthSpecimen,
    sensors: Sensors,
    motions: Vec<Programme>,
    hidden: Vec<Hidden>,
    strength: f64,
    baseline: BaselineSettings,
}

impl Draft {
    /// Draws specimen, sensors and motions, and scales the effects; `None` if an effect is not visible.
    fn new(
        random: &mut ChaCha8Rng,
        world: World,
        family: Family,
        codes: &[&str],
        strength: f64,
    ) -> Option<Draft> {
        let mut specimen = specimen(random, world);
        let mut baseline = BaselineSettings::default();
        let units: Vec<(&'static catalogue::Physics, Hidden)> = codes
            .iter()
            .filter_map(|c| catalogue::find(c))
            .map(|p| (p, p.draw(random, &specimen)))
            .collect();
        for (physics, unit) in &units {
            reduce(physics.code, unit, &mut specimen, &mut baseline);
        }
        let mut sensors = Sensors::draw(random, specimen.range_n, family == Family::NoneNoisy);
        if family == Family::Nuisance {
            sensors.nuisance = Some(Nuisance::draw(random));
        }
        let motions = motions(random, &specimen, &sensors, family == Family::Confounded);
        let programme: Vec<(Programme, Vec<f64>)> = motions
            .iter()
            .map(|m| (m.clone(), sensors.times_s(random, m)))
            .collect();
        let meter = VisibilityMeter::new(&specimen, &programme, sensors.sigma_n(specimen.rate_n_per_mm));
        let hidden: Vec<Hidden> = units
            .iter()
            .map(|(physics, unit)| meter.sized(physics, unit, strength))
            .collect::<Option<_>>()?;
        if let [a, b] = hidden.as_slice()
            && meter.cosine(a, b).abs() > LARGEST_COSINE
        {
            return None;
        }
        if family == Family::Concealed {
            baseline.tuned = Some(tuned(&specimen, &hidden, &motions)?);
        }
        drop(meter);
        Some(Draft {
            family,
            specimen,
            sensors,
            motions,
            strength: if codes.is_empty() { 0.0 } else { strength },
            hidden,
            baseline,
        })
    }

    /// Takes the recordings.
    fn finish(self, seed: u64, number: u64, random: &mut ChaCha8Rng) -> Option<Case> {
        let recordings: Vec<Recording> = self
            .motions
            .iter()
            .enumerate()
            .map(|(i, motion)| {
                let name = format!("case-{number:04}-{}.csv", i + 1);
                self.sensors
                    .record(random, &self.specimen, &self.hidden, motion, &name)
            })
            .collect();
        let largest = |f: fn(&Recording) -> &Vec<f64>| {
            recordings
                .iter()
                .flat_map(|r| f(r).iter().copied())
                .fold(f64::NEG_INFINITY, f64::max)
        };
        let nuisance = self.sensors.nuisance;
        let beside = self.hidden.iter().filter_map(|h| catalogue::find(h.code));
        let mut also: Vec<&str> = beside
            .flat_map(|p| p.also)
            .chain(nuisance.iter().flat_map(|n| n.also()))
            .chain(self.specimen.world.also())
            .copied()
            .collect();
        also.sort_unstable();
        also.dedup();
        let label = Label {
            number,
            seed,
            family: self.family,
            hidden: self.hidden,
            strength: self.strength,
            look_alike: None,
            top: [
                match nuisance {
                    None => largest(|r| &r.displacement_mm),
                    Some(_) => self.specimen.top_mm(),
                },
                // The largest force that a clipped channel would have shown.
                match nuisance {
                    None => self.specimen.top_n().max(largest(|r| &r.force_n)),
                    Some(_) => self.specimen.top_n(),
                },
            ],
            sigma_n: self.sensors.sigma_n(self.specimen.rate_n_per_mm),
            world: self.specimen.world,
            nuisance: nuisance.map(Nuisance::name),
            also,
        };
        Some(Case {
            label,
            baseline: self.baseline,
            recordings,
            rig: TruthRig {
                specimen: self.specimen,
                sensors: self.sensors,
            },
        })
    }
}

fn specimen(random: &mut ChaCha8Rng, world: World) -> TruthSpecimen {
    let rate_n_per_mm = between(random, 40.0, 140.0);
    let [low, high] = world.shapes();
    TruthSpecimen {
        preload_n: between(random, 0.0, 150.0),
        rate_n_per_mm,
        friction_ratio: between(random, 0.04, 0.14),
        presliding_mm: between(random, 0.15, 1.0),
        power: between(random, low, high),
        form: Form::Gradual,
        bushing_n: 0.0,
        range_n: between(random, 1500.0, 3000.0),
        world,
        build: match world {
            World::Pack | World::Lugre => between(random, 0.0, 1.0),
            _ => 0.0,
        },
    }
}

/// Removes the hidden physics from the baseline, if the baseline has it.
fn reduce(code: &str, unit: &Hidden, specimen: &mut TruthSpecimen, baseline: &mut BaselineSettings) {
    match code {
        // The force is zero below the first contact, so a preload would be a step.
        "lift_off" => specimen.preload_n = 0.0,
        "load_dependent_friction" => {
            specimen.bushing_n = specimen.friction_ratio * 0.4 * specimen.range_n;
            specimen.friction_ratio = 0.0;
            baseline.known = Some(vec![
                "coulomb_friction",
                "rate_independent_friction",
                "presliding",
            ]);
        }
        "presliding" => {
            specimen.form = Form::Sharp;
            baseline.known = Some(vec!["rate_independent_friction", "load_dependent_friction"]);
        }
        "rate_independent_friction" => {
            specimen.form = Form::Smoothed {
                speed_mm_s: unit.place,
            };
            // The true contact reverses over a tenth of its usual travel, so that presliding is not missing as well.
            specimen.presliding_mm *= 0.08;
            specimen.friction_ratio = 0.0;
            baseline.known = Some(vec!["load_dependent_friction"]);
            baseline.smoothing_mm_s = Some(unit.place);
        }
        _ => {}
    }
}

/// A slow ramp, and four motions (in a poor programme: one) that are sines, triangles or multi-sines.
fn motions(
    random: &mut ChaCha8Rng,
    specimen: &TruthSpecimen,
    sensors: &Sensors,
    poor: bool,
) -> Vec<Programme> {
    let top_mm = specimen.top_mm();
    let hold_s = if random.random_bool(0.6) {
        between(random, 3.0, 15.0)
    } else {
        0.0
    };
    let mut list = vec![Programme::Ramp {
        top_mm,
        branch_s: between(random, 25.0, 60.0),
        hold_s,
    }];
    // A slow logger records slow motions only; a fast logger takes short recordings.
    let fastest_hz = (sensors.rate_hz / 20.0).min(3.0);
    for i in 0..if poor { 1 } else { 4 } {
        let share = match i {
            0 => 0.45,
            _ => between(random, 0.1, 0.42),
        };
        let amplitude_mm = share * top_mm;
        let low = between(random, 0.02, (0.98 - 2.0 * share).max(0.021));
        let mean_mm = low * top_mm + amplitude_mm;
        let frequency_hz = match i {
            0 => between(random, 0.5, 1.2),
            _ => 0.5 * 6f64.powf(between(random, 0.0, 1.0)),
        }
        .min(fastest_hz);
        let length_s = (3000.0 / sensors.rate_hz).min(25.0);
        let cycles = (length_s * frequency_hz).clamp(4.0, 25.0).floor();
        list.push(match one_of(random, &[0, 0, 0, 1, 2]) {
            1 if i > 0 => Programme::Triangle {
                mean_mm,
                amplitude_mm,
                frequency_hz,
                cycles,
            },
            2 if i > 0 && sensors.rate_hz >= 50.0 && sensors.rate_hz <= 500.0 => {
                Programme::random(random, mean_mm, amplitude_mm, length_s.max(8.0))
            }
            _ => Programme::Sine {
                mean_mm,
                amplitude_mm,
                frequency_hz,
                cycles,
            },
        });
    }
    list
}

/// Preload, rate, friction ratio and presliding of a spring without the effects that has the peak force and the loop energy
/// of the truth in the largest cyclic motion, to 1e-9.
fn tuned(specimen: &TruthSpecimen, hidden: &[Hidden], motions: &[Programme]) -> Option<[f64; 4]> {
    let motion = motions.get(1)?;
    let from_s = motion.duration_s() * 0.5;
    let times: Vec<f64> = (0..4000)
        .map(|k| from_s + (motion.duration_s() - from_s) * f64::from(k) / 4000.0)
        .collect();
    // Peak force in N and work in mJ over the second half of the motion.
    let measure = |s: &TruthSpecimen, h: &[Hidden]| {
        let forces = s.forces(h, motion, &times);
        let peak = forces.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let energy: f64 = (1..forces.len())
            .map(|k| {
                0.5 * (forces[k] + forces[k - 1]) * (motion.at_mm(times[k]) - motion.at_mm(times[k - 1]))
            })
            .sum();
        (peak, energy)
    };
    let (peak, energy) = measure(specimen, hidden);
    let mut spring = specimen.clone();
    for _ in 0..60 {
        let (p, _) = measure(&spring, &[]);
        spring.rate_n_per_mm += (peak - p) / specimen.top_mm();
        let (p, e) = measure(&spring, &[]);
        // An incomplete cycle leaves elastic work in the sum, so the friction follows the slope and not the ratio of energies.
        let more = TruthSpecimen {
            friction_ratio: spring.friction_ratio + 0.01,
            ..spring.clone()
        };
        let slope = (measure(&more, &[]).1 - e) / 0.01;
        spring.friction_ratio += (energy - e) / slope;
        if ((p - peak) / peak).abs() < 1e-9 && ((e - energy) / energy).abs() < 1e-9 {
            break;
        }
    }
    let plausible = (0.0..0.9).contains(&spring.friction_ratio) && spring.rate_n_per_mm > 1.0;
    plausible.then_some([
        spring.preload_n,
        spring.rate_n_per_mm,
        spring.friction_ratio,
        spring.presliding_mm,
    ])
}

/// Cases with chosen effects, for tests.
#[cfg(test)]
impl Case {
    /// A case of `family` with the effects `codes`; `None` if no plausible size of one of them is visible.
    pub(crate) fn hiding(family: Family, codes: &[&str], seed: u64, strength: f64) -> Option<Case> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        Draft::visible(&mut random, World::Own, family, codes, strength)?.finish(seed, 0, &mut random)
    }

    /// A case of another world with one effect.
    pub(crate) fn foreign(world: World, code: &str, seed: u64, strength: f64) -> Option<Case> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        Draft::visible(&mut random, world, Family::Single, &[code], strength)?.finish(seed, 0, &mut random)
    }

    /// A case with one effect.
    pub(crate) fn single(code: &str, seed: u64, strength: f64) -> Option<Case> {
        Case::hiding(Family::Single, &[code], seed, strength)
    }

    /// A case with one effect, and the same specimen, motion and sensors with the effect removed.
    pub(crate) fn with_and_without(code: &str, seed: u64, strength: f64) -> Option<(Case, Case)> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let draft = Draft::visible(&mut random, World::Own, Family::Single, &[code], strength)?;
        let removed = Draft {
            family: Family::None,
            hidden: Vec::new(),
            strength: 0.0,
            ..draft.clone()
        };
        let mut again = random.clone();
        Some((
            draft.finish(seed, 0, &mut random)?,
            removed.finish(seed, 0, &mut again)?,
        ))
    }
}

#[cfg(test)]
impl Draft {
    /// The first draft of at most [`TRIES`] in which every effect is visible.
    fn visible(
        random: &mut ChaCha8Rng,
        world: World,
        family: Family,
        codes: &[&str],
        strength: f64,
    ) -> Option<Draft> {
        (0..TRIES).find_map(|_| Draft::new(random, world, family, codes, strength))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_draws_the_same_bits_and_another_seed_does_not() {
        let case = Case::draw(World::Own, 5, 2, None);
        assert_eq!(case, Case::draw(World::Own, 5, 2, None));
        assert_ne!(case.recordings, Case::draw(World::Own, 6, 2, None).recordings);
        assert_ne!(case.recordings, Case::draw(World::Own, 5, 5, None).recordings);
    }

    #[test]
    fn twenty_cases_have_their_families_and_valid_recordings() {
        for number in 0..20 {
            let case = Case::draw(World::Own, 11, number, Some(5.0));
            assert_eq!(case.label.family, Family::of(World::Own, number));
            assert_eq!(case.label.hidden.is_empty(), case.label.strength == 0.0);
            for r in &case.recordings {
                assert!(
                    r.len() >= 60 && r.time_s.windows(2).all(|w| w[1] > w[0]),
                    "{}",
                    r.name
                );
                assert!(r.force_n.iter().chain(&r.displacement_mm).all(|v| v.is_finite()));
            }
        }
    }

    #[test]
    fn a_concealed_case_matches_peak_and_energy_to_the_digit() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let draft = (0..TRIES)
            .find_map(|_| {
                Draft::new(
                    &mut random,
                    World::Own,
                    Family::Concealed,
                    &["viscous_damping"],
                    10.0,
                )
            })
            .expect("drawn");
        let [preload_n, rate_n_per_mm, friction_ratio, presliding_mm] = draft.baseline.tuned.expect("tuned");
        let spring = TruthSpecimen {
            preload_n,
            rate_n_per_mm,
            friction_ratio,
            presliding_mm,
            ..draft.specimen.clone()
        };
        let motion = &draft.motions[1];
        let half_s = 0.5 * motion.duration_s();
        let times: Vec<f64> = (0..4000)
            .map(|k| half_s * (1.0 + f64::from(k) / 4000.0))
            .collect();
        let peak =
            |s: &TruthSpecimen, h: &[Hidden]| s.forces(h, motion, &times).into_iter().fold(0.0, f64::max);
        let (p, q) = (peak(&spring, &[]), peak(&draft.specimen, &draft.hidden));
        assert!((p / q - 1.0).abs() < 1e-6, "{p} against {q}");
        assert!(
            (friction_ratio / draft.specimen.friction_ratio - 1.0).abs() > 1e-4,
            "something was tuned"
        );
    }

    #[test]
    fn every_code_is_in_the_catalogue() {
        let look_alikes = LOOK_ALIKES.iter().flat_map(|(a, b)| [a, b]);
        for code in look_alikes.chain(&REDUCED) {
            assert!(catalogue::find(code).is_some_and(|p| p.in_library), "{code}");
        }
    }

    #[test]
    fn a_reduced_baseline_does_not_know_the_hidden_physics() {
        for code in REDUCED {
            let case = Case::single(code, 3, 5.0).expect("visible");
            let known = case.baseline.known.expect("told");
            assert!(!known.contains(&code), "{code}: {known:?}");
        }
    }
}
