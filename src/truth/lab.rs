//! A laboratory whose truth is known: benches with errors, families and batches of specimens, and what happens to them over months.
//!
//! It proves the pooling of many runs: what no single run can show is in the lab, with its size in [`Lab`]. `lab_run` takes the
//! recordings of the test in `lab_test`. Sizes are those of a good laboratory: class 1 load cells differ by 1 %, springs of one
//! drawing by 2 % in rate and 5 % in friction, a new mounting by 0.2 and 1 %.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{Form, Hidden, TruthSpecimen, World, between, catalogue, lab_test, normal, one_of};

/// Standard deviation of rate, friction, preload and presliding between specimens of a family, as shares.
const SPECIMEN_SPREAD: [f64; 4] = [0.02, 0.05, 0.05, 0.05];
/// The same of rate and friction between two mountings of one specimen.
pub(super) const MOUNTING_SPREAD: [f64; 2] = [0.002, 0.01];
/// Rate of the first outlier and friction of the second, as factors of their family.
const OUTLIERS: [f64; 2] = [1.10, 1.35];
/// Gain of the load cell of the second bench, and lag of the force channel of the third in s.
const WRONG_GAIN: f64 = 1.01;
const WRONG_LAG_S: f64 = 3e-3;
/// Growth of the friction over 1000 cycles, as a share: 5 % over the ten runs of a specimen.
const GROWTH: f64 = 0.5;
/// Play of the loose clamp in mm.
const CLAMP_PLAY_MM: f64 = 0.01;
/// Family and batch with the loose clamp.
const LOOSE: (usize, usize) = (0, 1);
/// Batches of each family.
const BATCHES: usize = 2;
const OPERATORS: [&str; 4] = ["A. Okafor", "B. Lindqvist", "C. Moreau", "D. Tanaka"];
/// Sampling rates of the benches, samples/s.
const RATES_HZ: [f64; 3] = [500.0, 250.0, 200.0];
/// Duration of the campaign in days, and the hours of a working day.
const DAYS: f64 = 180.0;
const HOURS: [f64; 2] = [7.0, 17.0];
/// Random stream of the plan. The runs have the streams from 0 on.
const PLAN_STREAM: u64 = 1 << 60;

/// What a lab is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LabRequest {
    pub seed: u64,
    /// Number of specimens, 8 or more: two batches of four families.
    pub specimens: usize,
    /// Number of runs; each specimen has about the same number.
    pub runs: usize,
    /// True for a lab without bench errors, loose clamp, outliers and growth with age.
    pub nothing: bool,
}

/// A bench with the errors of its channels.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct LabBench {
    pub name: String,
    /// Force that it reads divided by the true force.
    pub force_gain: f64,
    /// Lag of the force channel behind the displacement channel, s.
    pub force_lag_s: f64,
    pub sample_rate_hz: f64,
}

/// A family: specimens of one drawing, in the equations of one world.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct LabFamily {
    pub name: String,
    pub world: World,
    pub preload_n: f64,
    pub rate_n_per_mm: f64,
    pub friction_ratio: f64,
    pub presliding_mm: f64,
    /// Shape of its friction operator, see `World::shapes`.
    pub shape: f64,
    /// Largest displacement of its test, mm.
    pub top_mm: f64,
}

/// A specimen as it was before its first run.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct LabSpecimen {
    pub name: String,
    /// Index of its family.
    #[serde(skip)]
    pub family_index: usize,
    pub family: String,
    pub batch: String,
    pub preload_n: f64,
    pub rate_n_per_mm: f64,
    pub friction_ratio: f64,
    pub presliding_mm: f64,
    /// The loose clamp of its batch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hidden: Option<Hidden>,
    /// What makes it an outlier: the name of a quantity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outlier: Option<&'static str>,
}

/// One run of the campaign.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct LabRun {
    pub specimen: usize,
    pub bench: usize,
    pub operator: &'static str,
    /// Start after the first day's midnight, s; the runs are sorted by it, and no two are equal.
    pub start_s: f64,
    /// Cycles that the specimen had seen before.
    pub age_cycles: u32,
}

/// A lab with everything that is true of it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Lab {
    pub seed: u64,
    pub benches: Vec<LabBench>,
    pub families: Vec<LabFamily>,
    pub specimens: Vec<LabSpecimen>,
    /// Growth of the friction over 1000 cycles as a share; linear from the first cycle.
    pub friction_growth_per_1000_cycles: f64,
    #[serde(skip)]
    pub runs: Vec<LabRun>,
}

impl Lab {
    /// Draws a lab; the same request gives the same lab.
    pub(crate) fn draw(request: &LabRequest) -> Lab {
        let mut random = ChaCha8Rng::seed_from_u64(request.seed);
        random.set_stream(PLAN_STREAM);
        let families = families(&mut random);
        let mut specimens: Vec<LabSpecimen> = (0..request.specimens)
            .map(|k| specimen(&mut random, &families, k))
            .collect();
        if !request.nothing {
            hide(&mut random, &families, &mut specimens);
        }
        let mut runs = runs(&mut random, request);
        let mut seen = vec![0; request.specimens];
        for run in &mut runs {
            run.age_cycles = seen[run.specimen];
            seen[run.specimen] += lab_test::CYCLES;
        }
        Lab {
            seed: request.seed,
            benches: benches(request.nothing),
            families,
            specimens,
            friction_growth_per_1000_cycles: if request.nothing { 0.0 } else { GROWTH },
            runs,
        }
    }

    /// The specimen of a run as it is mounted then: `mounting` are factors of rate and friction.
    pub(super) fn mounted(&self, run: &LabRun, mounting: [f64; 2]) -> TruthSpecimen {
        let specimen = &self.specimens[run.specimen];
        let family = &self.families[specimen.family_index];
        let growth = 1.0 + 1e-3 * f64::from(run.age_cycles) * self.friction_growth_per_1000_cycles;
        let rate_n_per_mm = specimen.rate_n_per_mm * mounting[0];
        TruthSpecimen {
            preload_n: specimen.preload_n,
            rate_n_per_mm,
            friction_ratio: specimen.friction_ratio * growth * mounting[1],
            presliding_mm: specimen.presliding_mm,
            power: family.shape,
            form: Form::Gradual,
            bushing_n: 0.0,
            range_n: specimen.preload_n + rate_n_per_mm * family.top_mm,
            world: family.world,
            build: 0.0,
        }
    }
}

fn benches(nothing: bool) -> Vec<LabBench> {
    let bench = |k: usize, force_gain, force_lag_s| LabBench {
        name: format!("lab-{}", k + 1),
        force_gain: if nothing { 1.0 } else { force_gain },
        force_lag_s: if nothing { 0.0 } else { force_lag_s },
        sample_rate_hz: RATES_HZ[k],
    };
    vec![
        bench(0, 1.0, 0.0),
        bench(1, WRONG_GAIN, 0.0),
        bench(2, 1.0, WRONG_LAG_S),
    ]
}

/// Four families, each in a world of its own.
fn families(random: &mut ChaCha8Rng) -> Vec<LabFamily> {
    let worlds = [World::Own, World::PrandtlIshlinskii, World::BoucWen, World::Lugre];
    let rates_n_per_mm = [55.0, 75.0, 95.0, 120.0];
    let family = |(k, world): (usize, World)| {
        let [low, high] = world.shapes();
        let rate_n_per_mm = rates_n_per_mm[k];
        LabFamily {
            name: format!("F{}", k + 1),
            world,
            preload_n: between(random, 60.0, 120.0),
            rate_n_per_mm,
            friction_ratio: between(random, 0.06, 0.12),
            presliding_mm: between(random, 0.3, 0.8),
            shape: between(random, low, high),
            top_mm: 2000.0 / rate_n_per_mm,
        }
    };
    worlds.into_iter().enumerate().map(family).collect()
}

/// Specimen `k`: families take turns, and so do the batches within each.
fn specimen(random: &mut ChaCha8Rng, families: &[LabFamily], k: usize) -> LabSpecimen {
    let family_index = k % families.len();
    let family = &families[family_index];
    let batch = k / families.len() % BATCHES;
    let [preload, rate, friction, presliding] = {
        let [rate, friction, preload, presliding] =
            SPECIMEN_SPREAD.map(|spread| 1.0 + spread * normal(random));
        [preload, rate, friction, presliding]
    };
    LabSpecimen {
        name: format!("{}-{:02}", family.name, k / families.len() + 1),
        family_index,
        family: family.name.clone(),
        batch: format!("{}-{}", family.name, ["A", "B"][batch]),
        preload_n: family.preload_n * preload,
        rate_n_per_mm: family.rate_n_per_mm * rate,
        friction_ratio: family.friction_ratio * friction,
        presliding_mm: family.presliding_mm * presliding,
        hidden: None,
        outlier: None,
    }
}

/// Loosens the clamp of one batch, and makes two specimens of other families outliers.
fn hide(random: &mut ChaCha8Rng, families: &[LabFamily], specimens: &mut [LabSpecimen]) {
    let (loose_family, loose_batch) = LOOSE;
    let mut clamp = None;
    for (k, specimen) in specimens.iter_mut().enumerate() {
        let batch = k / families.len() % BATCHES;
        if (specimen.family_index, batch) != (loose_family, loose_batch) {
            continue;
        }
        // One clamp, one law: the batch was mounted with the same fixture.
        let hidden = clamp.get_or_insert_with(|| play(random, &families[loose_family]));
        specimen.hidden = *hidden;
    }
    let last = specimens.len() / families.len() - 1;
    let outliers = [
        (0, "rate_n_per_mm"),
        (families.len() * last + 3, "friction_ratio"),
    ];
    for (k, quantity) in outliers {
        let specimen = &mut specimens[k];
        specimen.outlier = Some(quantity);
        match quantity {
            "rate_n_per_mm" => specimen.rate_n_per_mm = families[0].rate_n_per_mm * OUTLIERS[0],
            _ => specimen.friction_ratio = families[3].friction_ratio * OUTLIERS[1],
        }
    }
}

/// The play of the loose clamp, with the law of its family's world.
fn play(random: &mut ChaCha8Rng, family: &LabFamily) -> Option<Hidden> {
    let physics = catalogue::find("backlash")?;
    let specimen = TruthSpecimen {
        preload_n: family.preload_n,
        rate_n_per_mm: family.rate_n_per_mm,
        friction_ratio: family.friction_ratio,
        presliding_mm: family.presliding_mm,
        power: family.shape,
        form: Form::Gradual,
        bushing_n: 0.0,
        range_n: family.preload_n + family.rate_n_per_mm * family.top_mm,
        world: family.world,
        build: 0.0,
    };
    Some(Hidden {
        size: CLAMP_PLAY_MM,
        ..physics.draw(random, &specimen)
    })
}

/// The runs, sorted by their start. Half of the specimens stay on one bench, the others are tested on two or three.
fn runs(random: &mut ChaCha8Rng, request: &LabRequest) -> Vec<LabRun> {
    let benches = RATES_HZ.len();
    let home: Vec<usize> = (0..request.specimens).map(|k| k / 4 % benches).collect();
    let mut runs: Vec<LabRun> = (0..request.runs)
        .map(|k| {
            let specimen = k % request.specimens;
            let travels = (specimen / 2).is_multiple_of(2);
            let bench = if travels {
                one_of(random, &[0, 1, 2])
            } else {
                home[specimen]
            };
            let day = between(random, 0.0, DAYS).floor();
            LabRun {
                specimen,
                bench,
                operator: one_of(random, &OPERATORS),
                start_s: 86_400.0 * day + 3600.0 * between(random, HOURS[0], HOURS[1]),
                age_cycles: 0,
            }
        })
        .collect();
    runs.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lab(seed: u64, nothing: bool) -> Lab {
        Lab::draw(&LabRequest {
            seed,
            specimens: 40,
            runs: 400,
            nothing,
        })
    }

    #[test]
    fn the_same_seed_draws_the_same_lab() {
        assert_eq!(lab(3, false), lab(3, false));
        assert_ne!(lab(3, false).specimens, lab(4, false).specimens);
    }

    #[test]
    fn half_of_the_specimens_are_tested_on_several_benches_and_all_benches_are_connected() {
        let lab = lab(5, false);
        let benches = |specimen: usize| {
            let mut used: Vec<usize> = (lab.runs.iter())
                .filter(|r| r.specimen == specimen)
                .map(|r| r.bench)
                .collect();
            used.sort_unstable();
            used.dedup();
            used
        };
        let several = (0..40).filter(|&k| benches(k).len() > 1).count();
        // Each of 20 travelling specimens has ten runs on three benches: one bench only has a chance of 5e-5.
        assert_eq!(several, 20);
        for family in 0..4 {
            let at: Vec<usize> = (0..40).filter(|k| k % 4 == family).flat_map(&benches).collect();
            assert!((0..3).all(|bench| at.contains(&bench)), "family {family}");
        }
    }

    #[test]
    fn age_is_the_sum_of_the_cycles_before() {
        let lab = lab(6, false);
        let ages: Vec<u32> = lab
            .runs
            .iter()
            .filter(|r| r.specimen == 7)
            .map(|r| r.age_cycles)
            .collect();
        let expected: Vec<u32> = (0..10).map(|k| k * lab_test::CYCLES).collect();
        assert_eq!(ages, expected);
    }

    #[test]
    fn a_lab_with_nothing_has_nothing() {
        let (all, none) = (lab(7, false), lab(7, true));
        let hidden = |lab: &Lab| lab.specimens.iter().filter(|s| s.hidden.is_some()).count();
        let outliers = |lab: &Lab| lab.specimens.iter().filter(|s| s.outlier.is_some()).count();
        assert_eq!((hidden(&all), outliers(&all)), (5, 2));
        assert_eq!((hidden(&none), outliers(&none)), (0, 0));
        assert!(
            none.benches
                .iter()
                .all(|b| b.force_gain == 1.0 && b.force_lag_s == 0.0)
        );
        assert_eq!(none.friction_growth_per_1000_cycles, 0.0);
        assert_eq!(all.benches[1].force_gain, 1.01);
    }
}
