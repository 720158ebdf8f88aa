//! Physics that a model may leave out: one file a code of contracts.md, attached around a plant.
//!
//! The same file serves fit, diagnosis, twin, simulator and mock rig. Which effect is missing is judged in `diagnose`.
//! A new effect is one file and one line in [`EFFECTS`]; a new code also gets its row in contracts.md.

use crate::model::{BuildError, Knows, Motion, Parameter, Plant};

pub(crate) mod backlash;
pub(crate) mod channel_delay;
pub(crate) mod coulomb_friction;
pub(crate) mod friction_form;
pub(crate) mod geometric_stiffness;
pub(crate) mod inertia;
pub(crate) mod lift_off;
pub(crate) mod load_dependent_friction;
pub(crate) mod motion;
pub(crate) mod presliding;
pub(crate) mod progressive_stiffness;
pub(crate) mod rate_independent_friction;
pub(crate) mod relaxation;
pub(crate) mod run_in;
pub(crate) mod sensor_drift;
pub(crate) mod sensor_saturation;
pub(crate) mod series_compliance;
pub(crate) mod stribeck;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod viscous_damping;

/// Where on the way from the specimen to the recorded number an effect sits. Effects are attached in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Stage {
    /// The leaves themselves.
    Specimen,
    /// Contacts between leaves.
    Interleaf,
    /// Eyes, shackle, seat.
    Mounting,
    /// Pusher and board.
    Pusher,
    /// Load frame and fixture.
    Frame,
    /// Load cell, LVDT and their channels.
    Sensor,
}

/// Axis that a difference between model and recording is located on; names as in contracts.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Axis {
    /// Displacement.
    DisplacementMm,
    /// Measured force.
    ForceN,
    /// Magnitude of the speed.
    VelocityMmS,
    /// Magnitude of the acceleration.
    #[serde(rename = "acceleration_mm_s2")]
    AccelerationMmS2,
    /// Time since the recording's start.
    TimeS,
    /// Cycle, from 1.
    Cycle,
    /// Travel since the last reversal.
    DistanceFromReversalMm,
    /// Cycles a second of the motion.
    FrequencyHz,
}

/// Branch of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Branch {
    /// Displacement rises.
    Loading,
    /// Displacement falls.
    Unloading,
    /// No difference.
    Both,
}

/// The part of an axis in which an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Place {
    /// The axis.
    pub axis: Axis,
    /// From, in the axis' unit.
    pub from: f64,
    /// To, in the axis' unit.
    pub to: f64,
    /// Branch it acts on.
    pub branch: Branch,
}

/// What the recordings cover: an effect chooses its starts by it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    /// Least and largest displacement in mm.
    pub displacement_mm: [f64; 2],
    /// Least and largest force in N.
    pub force_n: [f64; 2],
    /// Largest speed in mm/s.
    pub speed_mm_s: f64,
    /// Longest recording in s.
    pub duration_s: f64,
    /// Most cycles in one recording.
    pub cycles: f64,
}

impl Span {
    /// Length of the displacement range in mm.
    pub(crate) fn travel_mm(&self) -> f64 {
        self.displacement_mm[1] - self.displacement_mm[0]
    }

    /// What the recordings cover of an axis, in its unit; of any but force that of the displacement.
    pub(crate) fn width(&self, axis: Axis) -> f64 {
        match axis {
            Axis::ForceN => self.force_n[1] - self.force_n[0],
            _ => self.travel_mm(),
        }
    }

    /// Displacement at a share of the range.
    pub(crate) fn displacement_at(&self, share: f64) -> f64 {
        self.displacement_mm[0] + share * self.travel_mm()
    }
}

/// Another code that gives nearly the same recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LookAlike {
    /// Its code.
    pub code: &'static str,
    /// Why the two look alike.
    pub why: &'static str,
    /// The check that tells them apart.
    pub test: &'static str,
}

/// Wraps the plant inside in an effect with the values given.
pub(crate) type Attach = fn(values: &[f64], inside: Box<dyn Plant>) -> Box<dyn Plant>;

/// See [`Effect::if_known`].
pub(crate) type IfKnown = fn(&Effect, &Knows<'_>) -> Option<Vec<Parameter>>;

/// For effects that a baseline gets with their usual bounds.
pub(crate) fn unchanged(effect: &Effect, _knows: &Knows<'_>) -> Option<Vec<Parameter>> {
    Some(effect.parameters.to_vec())
}

/// One entry of [`EFFECTS`].
pub(crate) struct Effect {
    /// Code of contracts.md.
    pub code: &'static str,
    /// Where it is attached.
    pub stage: Stage,
    /// One sentence: what it is.
    pub what: &'static str,
    /// What a fit may move, in the order that `attach` takes.
    pub parameters: &'static [Parameter],
    /// Values at which the effect changes nothing.
    pub neutral: &'static [f64],
    /// Indices of the parameters that the force is proportional to (zero switches their part off).
    pub amplitudes: &'static [usize],
    /// Indices of parameters that say where the force has a kink, each with its axis: slopes do not lead there, trials do.
    pub kinks: &'static [(usize, Axis)],
    /// Points that a search begins from, within what the recordings cover.
    pub starts: fn(&Span) -> Vec<Vec<f64>>,
    /// A sentence that a technician understands.
    pub statement: fn(values: &[f64]) -> String,
    /// Wraps `inside`; one checked value a parameter.
    pub attach: Attach,
    /// Parameters that it gets in a baseline that already knows this physics; `None` where the model itself takes care of it.
    pub if_known: IfKnown,
    /// Where on the loop it acts, for effects that are local.
    pub place: fn(values: &[f64], span: &Span) -> Option<Place>,
    /// Look-alikes.
    pub confusable_with: &'static [LookAlike],
}

/// All effects, by code.
pub(crate) static EFFECTS: &[Effect] = &[
    backlash::EFFECT,
    channel_delay::EFFECT,
    coulomb_friction::EFFECT,
    geometric_stiffness::EFFECT,
    inertia::EFFECT,
    lift_off::EFFECT,
    load_dependent_friction::EFFECT,
    presliding::EFFECT,
    progressive_stiffness::EFFECT,
    rate_independent_friction::EFFECT,
    relaxation::EFFECT,
    run_in::EFFECT,
    sensor_drift::EFFECT,
    sensor_saturation::EFFECT,
    series_compliance::EFFECT,
    stribeck::EFFECT,
    viscous_damping::EFFECT,
];

/// Other forms of physics that a model already has: attached like effects, never named as missing.
pub(crate) static FORMS: &[Effect] = &[friction_form::FORM];

/// Why effects could not be attached.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum EffectError {
    /// No effect has this code.
    #[error("no effect has the code \"{code}\": use one of {known}")]
    UnknownCode {
        /// As asked for.
        code: String,
        /// What there is.
        known: String,
    },
    /// Not one value a parameter.
    #[error("effect {code} takes {wanted} values, {given} were given: give one each of {names}")]
    Count {
        /// The effect.
        code: &'static str,
        /// Parameters that it has.
        wanted: usize,
        /// Values given.
        given: usize,
        /// The parameters' names.
        names: String,
    },
    /// A value is not finite or out of its bounds.
    #[error(transparent)]
    Value(#[from] BuildError),
}

/// The effect or form with this code.
pub(crate) fn find(code: &str) -> Result<&'static Effect, EffectError> {
    EFFECTS
        .iter()
        .chain(FORMS)
        .find(|e| e.code == code)
        .ok_or_else(|| EffectError::UnknownCode {
            code: code.to_owned(),
            known: EFFECTS.iter().map(|e| e.code).collect::<Vec<_>>().join(", "),
        })
}

impl Effect {
    /// Attaches after checking that there is one finite value a parameter, within its bounds.
    pub(crate) fn attached(
        &self,
        values: &[f64],
        inside: Box<dyn Plant>,
    ) -> Result<Box<dyn Plant>, EffectError> {
        if values.len() != self.parameters.len() {
            return Err(EffectError::Count {
                code: self.code,
                wanted: self.parameters.len(),
                given: values.len(),
                names: self
                    .parameters
                    .iter()
                    .map(|p| p.name)
                    .collect::<Vec<_>>()
                    .join(", "),
            });
        }
        for (p, &value) in self.parameters.iter().zip(values) {
            let [low, high] = p.bounds;
            if !(value >= low && value <= high) {
                return Err(EffectError::Value(BuildError::OutOfBounds {
                    model: self.code,
                    name: p.name.to_owned(),
                    value,
                    low,
                    high,
                }));
            }
        }
        Ok((self.attach)(values, inside))
    }
}

/// Attaches several effects in the order of their stages (of one stage: by code), whatever order they are given in.
pub(crate) fn attach_all(
    effects: &[(&'static Effect, Vec<f64>)],
    plant: Box<dyn Plant>,
) -> Result<Box<dyn Plant>, EffectError> {
    let mut order: Vec<&(&'static Effect, Vec<f64>)> = effects.iter().collect();
    order.sort_by_key(|(effect, _)| (effect.stage, effect.code));
    order
        .into_iter()
        .try_fold(plant, |inside, (effect, values)| effect.attached(values, inside))
}

/// What an effect does in one step, around the plant inside.
pub(crate) trait Wrap: Clone + Send + 'static {
    /// Back to the virgin state.
    fn reset(&mut self);
    /// Steps the plant inside and returns the force.
    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64;
    /// See [`Plant::told`]; the plant inside is told as well.
    fn told(&mut self, _motion: &Motion) {}
    /// See [`Plant::carried_n`], from what the plant inside carried.
    fn carried_n(&self, inside_n: f64) -> f64 {
        inside_n
    }
}

/// Load that friction is proportional to: what the contacts inside carried, or all the force where that is not known.
pub(crate) fn load_n(inside: &dyn Plant, force_n: f64) -> f64 {
    inside.carried_n().unwrap_or(force_n)
}

/// Force of the plant inside with more load on its contacts: its friction grows in proportion.
pub(crate) fn with_more_load(inside: &dyn Plant, force_n: f64, extra_n: f64) -> f64 {
    match inside.carried_n() {
        Some(carried_n) if carried_n > extra_n.abs() * 1e-3 => force_n * (1.0 + extra_n / carried_n),
        _ => force_n + extra_n,
    }
}

/// A zero of the force channel: what the tare left, added before the channel's own faults.
#[derive(Clone)]
struct Offset(f64);

impl Wrap for Offset {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        inside.step(displacement_mm, dt_s) + self.0
    }
}

/// Puts a zero of the force channel around `inside`.
pub(crate) fn with_zero(zero_n: f64, inside: Box<dyn Plant>) -> Box<dyn Plant> {
    if zero_n == 0.0 {
        inside
    } else {
        wrapped(Offset(zero_n), inside)
    }
}

/// A plant with an effect around it.
#[derive(Clone)]
struct Wrapped<W: Wrap> {
    wrap: W,
    inside: Box<dyn Plant>,
}

impl<W: Wrap> Plant for Wrapped<W> {
    fn reset(&mut self) {
        self.wrap.reset();
        self.inside.reset();
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        self.wrap.step(&mut self.inside, displacement_mm, dt_s)
    }

    fn told(&mut self, motion: &Motion) {
        self.wrap.told(motion);
        self.inside.told(motion);
    }

    fn carried_n(&self) -> Option<f64> {
        self.inside.carried_n().map(|n| self.wrap.carried_n(n))
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

/// Puts `wrap` around `inside`.
pub(crate) fn wrapped<W: Wrap>(wrap: W, inside: Box<dyn Plant>) -> Box<dyn Plant> {
    Box::new(Wrapped { wrap, inside })
}

/// For effects that act everywhere on the loop.
pub(crate) fn everywhere(_values: &[f64], _span: &Span) -> Option<Place> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_sorted_complete_and_consistent() {
        assert!(EFFECTS.windows(2).all(|w| w[0].code < w[1].code));
        let span = testing::span();
        for effect in EFFECTS {
            let n = effect.parameters.len();
            assert_eq!(effect.neutral.len(), n, "{}", effect.code);
            assert!(
                effect
                    .amplitudes
                    .iter()
                    .all(|&a| a < n && effect.neutral[a] == 0.0)
            );
            assert!(!(effect.starts)(&span).is_empty());
            for start in (effect.starts)(&span) {
                for (p, v) in effect.parameters.iter().zip(&start) {
                    assert!(
                        *v >= p.bounds[0] && *v <= p.bounds[1],
                        "{} {}: {v}",
                        effect.code,
                        p.name
                    );
                }
                assert!((effect.statement)(&start).ends_with('.'), "{}", effect.code);
            }
            for rival in effect.confusable_with {
                assert!(
                    find(rival.code).is_ok() && rival.code != effect.code,
                    "{}",
                    effect.code
                );
            }
        }
    }

    #[test]
    fn every_effect_stays_finite_and_repeats_bit_for_bit_after_a_reset() {
        for effect in EFFECTS {
            for start in (effect.starts)(&testing::span()) {
                let mut plant = effect
                    .attached(&start, testing::spring())
                    .expect("starts are valid");
                let first = testing::drive(&mut plant);
                assert!(first.iter().all(|f| f.is_finite()), "{}", effect.code);
                plant.reset();
                assert_eq!(first, testing::drive(&mut plant), "{}", effect.code);
            }
        }
    }

    #[test]
    fn refusals_say_what_and_where() {
        let error = |code: &str, values: &[f64]| {
            find(code)
                .and_then(|e| e.attached(values, testing::spring()).map(|_| ()))
                .expect_err("refused")
                .to_string()
        };
        assert!(error("magnetism", &[]).contains("magnetism"));
        assert!(error("inertia", &[]).contains("mass_kg"));
        assert!(error("inertia", &[f64::NAN]).contains("mass_kg = NaN"));
    }

    #[test]
    fn order_of_attachment_follows_the_stage_not_the_caller() {
        let pair = |swap: bool| {
            let mut effects = vec![
                (find("sensor_saturation").expect("listed"), vec![400.0]),
                (find("coulomb_friction").expect("listed"), vec![50.0, 0.05]),
            ];
            if swap {
                effects.reverse();
            }
            let mut plant = attach_all(&effects, testing::spring()).expect("valid");
            testing::drive(&mut plant)
        };
        assert_eq!(pair(false), pair(true));
        // Friction is inside the load cell's range: nothing above the limit comes out.
        assert!(pair(false).iter().all(|&f| f <= 400.0));
    }
}
