//! Effects: physics that a model may leave out, each one a wrapper around a plant.
//!
//! Each code of physics in `docs/formats.md` has one file here. Fit, diagnosis, twin, simulator and mock rig all use it.
//! Which effect is missing is decided in `diagnose`. A new effect needs one file, one line in [`EFFECTS`] and one row in
//! `docs/formats.md`.

use crate::model::{BuildError, Knows, Parameter, Plant};
use crate::nearest;

pub(crate) mod backlash;
pub(crate) mod channel_delay;
pub(crate) mod coulomb_friction;
pub(crate) mod friction_form;
pub(crate) mod friction_state;
pub(crate) mod geometric_stiffness;
pub(crate) mod inertia;
pub(crate) mod law;
pub(crate) mod lift_off;
pub(crate) mod load_dependent_friction;
pub(crate) mod motion;
mod power;
pub(crate) mod presliding;
pub(crate) mod progressive_stiffness;
pub(crate) mod rate_independent_friction;
pub(crate) mod relaxation;
pub(crate) mod run_in;
pub(crate) mod sensor_curvature;
pub(crate) mod sensor_drift;
pub(crate) mod sensor_saturation;
pub(crate) mod series_compliance;
pub(crate) mod stribeck;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod viscous_damping;
pub(crate) mod warming;
mod wording;
mod wrap;

pub(crate) use wrap::{Wrap, load_n, pressing_n, with_more_load, with_zero, wrapped};

/// Place of an effect between the leaves and the recorded number. Effects are attached in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Stage {
    Specimen,
    Interleaf,
    /// Eyes, shackle and seat.
    Mounting,
    /// Pusher and its board.
    Pusher,
    /// Load frame and fixture.
    Frame,
    /// Load cell, LVDT and their channels.
    Sensor,
}

/// Axis on which a difference between model and recording is located; names as in `docs/formats.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    DisplacementMm,
    ForceN,
    /// Magnitude of the speed, mm/s.
    VelocityMmS,
    /// Magnitude of the acceleration, mm/s2.
    #[serde(rename = "acceleration_mm_s2")]
    AccelerationMmS2,
    /// Time since the start of the recording.
    TimeS,
    /// Number of the cycle; the first cycle is 1.
    Cycle,
    /// Travel since the last reversal.
    DistanceFromReversalMm,
    /// Frequency of the motion.
    FrequencyHz,
}

/// Branch of the force-displacement loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Branch {
    /// The branch with rising displacement.
    Loading,
    /// The branch with falling displacement.
    Unloading,
    Both,
}

/// Interval of an axis in which an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Place {
    pub axis: Axis,
    /// Lower end, in the unit of the axis.
    pub from: f64,
    /// Upper end, in the unit of the axis.
    pub to: f64,
    pub branch: Branch,
}

/// Ranges that the recordings cover. An effect chooses the starts of its search within them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    /// Smallest and largest displacement in mm.
    pub displacement_mm: [f64; 2],
    /// Smallest and largest force in N.
    pub force_n: [f64; 2],
    /// Largest speed in mm/s.
    pub speed_mm_s: f64,
    /// Duration of the longest recording in s.
    pub duration_s: f64,
    /// Largest number of cycles in one recording.
    pub cycles: f64,
}

impl Span {
    /// Length of the displacement range in mm.
    pub(crate) fn travel_mm(&self) -> f64 {
        self.displacement_mm[1] - self.displacement_mm[0]
    }

    /// Range of the force in N, or of the displacement in mm for any other axis.
    fn range(&self, axis: Axis) -> [f64; 2] {
        match axis {
            Axis::ForceN => self.force_n,
            _ => self.displacement_mm,
        }
    }

    /// Length of the force range in N, or of the displacement range in mm for any other axis.
    pub(crate) fn width(&self, axis: Axis) -> f64 {
        let [low, high] = self.range(axis);
        high - low
    }

    /// Displacement in mm at a share of the range, 0 to 1.
    pub(crate) fn displacement_at(&self, share: f64) -> f64 {
        self.displacement_mm[0] + share * self.travel_mm()
    }
}

/// Another effect that changes a recording in nearly the same way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LookAlike {
    pub code: &'static str,
    /// Why the two look alike: a phrase without a capital and without a full stop, because it is put into a sentence.
    pub why: &'static str,
    /// The measurement that separates them.
    pub test: &'static str,
}

/// Wraps a plant in an effect that has these parameter values.
pub(crate) type Attach = fn(values: &[f64], inside: Box<dyn Plant>) -> Box<dyn Plant>;

/// Gives the parameters for [`Effect::if_known`] from the effect and the known codes.
pub(crate) type IfKnown = fn(&Effect, &Knows<'_>) -> Option<Vec<Parameter>>;

/// A kink of the force of an effect.
pub(crate) struct Kink {
    /// Index of the parameter that gives its position.
    pub position: usize,
    pub axis: Axis,
    /// Distance from a corner at which it is over, on its axis; `None` where the force goes on as a curve.
    pub reach: fn(&[f64]) -> Option<f64>,
}

impl Kink {
    /// One that is no corner.
    pub(crate) const fn of(position: usize, axis: Axis) -> Kink {
        Kink {
            position,
            axis,
            reach: |_| None,
        }
    }
}

/// For effects that a baseline gets with their usual bounds.
pub(crate) fn unchanged(effect: &Effect, _knows: &Knows<'_>) -> Option<Vec<Parameter>> {
    Some(effect.parameters.to_vec())
}

/// What recordings show without a model, for [`Effect::plausible`].
pub(crate) struct Recorded<'a> {
    pub span: Span,
    /// Noise of the force, N.
    pub noise_n: f64,
    /// Median force in N at displacements in a range in mm; `None` where there are none.
    pub force_n: &'a dyn Fn([f64; 2]) -> Option<f64>,
    /// Median force in N, from the zero of its channel, at displacements below one in mm; `None` where there are none.
    pub force_below_n: &'a dyn Fn(f64) -> Option<f64>,
}

/// For effects whose bounds are all that is known of their values.
pub(crate) fn always(_values: &[f64], _recorded: &Recorded<'_>) -> bool {
    true
}

/// One entry of [`EFFECTS`].
pub(crate) struct Effect {
    /// Code of physics, as in `docs/formats.md`.
    pub code: &'static str,
    pub stage: Stage,
    /// True if its force follows from the path of the displacement alone, not from speed, time or the number of cycles.
    pub follows_path: bool,
    /// True if no search begins with it, because hardly anything in a recording tells it from the specimen: it is tried in the place of a
    /// named effect ([`RIVAL_LAWS`]).
    pub only_rival: bool,
    /// Parameters of the effect, in the order that `attach` takes.
    pub parameters: &'static [Parameter],
    /// Values at which the effect changes nothing.
    pub neutral: &'static [f64],
    /// Indices of the parameters that the force is proportional to. At zero, their part of the effect is off.
    pub amplitudes: &'static [usize],
    /// Kinks of the force. A gradient cannot find the position of one, so a search tries several.
    pub kinks: &'static [Kink],
    /// Indices of the parameters that only bend the law: at their neutral values it has its simplest form.
    pub shapes: &'static [usize],
    /// Starting points of a search, within the ranges that the recordings cover.
    pub starts: fn(&Span) -> Vec<Vec<f64>>,
    /// Describes the effect with these values in one or two sentences for a technician.
    pub statement: fn(values: &[f64]) -> String,
    /// Wraps a plant; takes one checked value for each parameter.
    pub attach: Attach,
    /// Parameters of the effect in a baseline that already has this physics; `None` if the model itself provides it.
    pub if_known: IfKnown,
    /// Where on the loop the effect acts; `None` if it acts everywhere.
    pub place: fn(values: &[f64], span: &Span) -> Option<Place>,
    /// False for values that no specimen or rig has that these recordings are of.
    pub plausible: fn(values: &[f64], recorded: &Recorded<'_>) -> bool,
    pub confusable_with: &'static [LookAlike],
}

/// All effects, sorted by code.
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
    sensor_curvature::EFFECT,
    sensor_drift::EFFECT,
    sensor_saturation::EFFECT,
    series_compliance::EFFECT,
    stribeck::EFFECT,
    viscous_damping::EFFECT,
    warming::EFFECT,
];

/// Laws that are only tried in the place of a named effect that looks alike ([`Effect::confusable_with`]), because with a law so free nearly
/// every curve could be named. One that fits better is named instead.
pub(crate) static RIVAL_LAWS: &[Effect] = &[
    lift_off::EFFECT,
    sensor_curvature::OF_DISPLACEMENT,
    sensor_curvature::OF_FORCE,
    series_compliance::EFFECT,
];

/// The laws that a search begins with, where the entry of [`EFFECTS`] is one of [`RIVAL_LAWS`] or [`GROWN_LAWS`].
static SIMPLEST_LAWS: &[Effect] = &[
    lift_off::AT_ONCE,
    progressive_stiffness::ONE_KNEE,
    series_compliance::LINEAR,
];

/// Laws that a simpler one of the same code may become during a search, the simpler first. Its parameters begin with those of the one
/// before it.
pub(crate) static GROWN_LAWS: &[Effect] = &[
    progressive_stiffness::ONE_LEAF,
    progressive_stiffness::TWO_LEAVES,
    progressive_stiffness::THREE_LEAVES,
];

/// The parts that a grown law adds to the one before it. A part is fitted as an effect of its own beside the simpler law, which gives the
/// values that the grown law starts from.
pub(crate) static PARTS: &[Effect] = &[progressive_stiffness::FURTHER_KNEE];

/// General forms of physics that a model already has. They are attached like effects but are never reported as missing.
pub(crate) static FORMS: &[Effect] = &[friction_form::FORM, friction_state::FORM];

/// Errors of attaching effects.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum EffectError {
    #[error(
        "no effect has the code \"{code}\"{}: use one of {known}",
        nearest::question_in(code, known)
    )]
    UnknownCode { code: String, known: String },
    #[error("effect {code} takes {wanted} values, {given} were given: enter one value for each of {names}")]
    Count {
        code: &'static str,
        /// Number of parameters of the effect.
        wanted: usize,
        /// Number of values given.
        given: usize,
        /// Names of the parameters.
        names: String,
    },
    /// A value is not finite or is outside its bounds.
    #[error(transparent)]
    Value(#[from] BuildError),
}

/// Codes of physics that a model may lack (docs/formats.md), sorted.
pub fn codes() -> Vec<&'static str> {
    EFFECTS.iter().map(|effect| effect.code).collect()
}

/// The effect or form with this code.
pub(crate) fn find(code: &str) -> Result<&'static Effect, EffectError> {
    EFFECTS
        .iter()
        .chain(FORMS)
        .find(|e| e.code == code)
        .ok_or_else(|| EffectError::UnknownCode {
            code: code.to_owned(),
            known: codes().join(", "),
        })
}

impl Effect {
    /// The law that a search begins with.
    pub(crate) fn simplest(&'static self) -> &'static Effect {
        let simplest = SIMPLEST_LAWS.iter().find(|law| law.code == self.code);
        simplest.unwrap_or(self)
    }

    /// True if an effect is one of [`Effect::confusable_with`].
    pub(crate) fn looks_like(&self, other: &Effect) -> bool {
        self.confusable_with.iter().any(|l| l.code == other.code)
    }

    /// Wraps `inside` after the check that there is one value for each parameter, finite and within its bounds.
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

    /// Values of a weaker effect: a share of 0 is no effect, 1 is `values`. Only its amplitudes are scaled; without amplitudes, all values
    /// move towards the neutral ones. Where a kink's neutral value is far outside the recordings (a contact that is never lost), the end
    /// of the recorded range is taken for it.
    pub(crate) fn at_share(&self, values: &[f64], share: f64, span: &Span) -> Vec<f64> {
        let off = |i: usize| {
            let neutral = self.neutral[i];
            let axis = self
                .kinks
                .iter()
                .find(|kink| kink.position == i)
                .map(|kink| kink.axis);
            match axis.filter(|axis| (neutral - values[i]).abs() > span.width(*axis)) {
                Some(axis) => neutral.clamp(span.range(axis)[0], span.range(axis)[1]),
                None => neutral,
            }
        };
        let moves = |i: &usize| self.amplitudes.is_empty() || self.amplitudes.contains(i);
        let mut there = values.to_vec();
        for i in (0..values.len()).filter(moves) {
            there[i] = (1.0 - share) * off(i) + share * values[i];
        }
        there
    }
}

/// Attaches several effects and the zero of the force channel in N, sorted by stage and then by code. The zero comes before the
/// faults of the channels. The order of `effects` has no influence.
pub(crate) fn attach_all(
    effects: &[(&'static Effect, Vec<f64>)],
    zero_n: f64,
    plant: Box<dyn Plant>,
) -> Result<Box<dyn Plant>, EffectError> {
    let mut order: Vec<&(&'static Effect, Vec<f64>)> = effects.iter().collect();
    order.sort_by_key(|(effect, _)| (effect.stage, effect.code));
    let faults = order.partition_point(|(effect, _)| effect.stage < Stage::Sensor);
    let attached = |plant, list: &[&(&'static Effect, Vec<f64>)]| {
        let mut list = list.iter();
        list.try_fold(plant, |inside, (effect, values)| effect.attached(values, inside))
    };
    let physics = attached(plant, &order[..faults])?;
    attached(with_zero(zero_n, physics), &order[faults..])
}

/// [`Effect::place`] of effects that act everywhere on the loop.
pub(crate) fn everywhere(_values: &[f64], _span: &Span) -> Option<Place> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_an_effect_is_between_none_and_all_of_it() {
        let span = testing::span();
        let share = |effect: &Effect, values: &[f64]| effect.at_share(values, 0.25, &span);
        assert_eq!(share(&viscous_damping::EFFECT, &[2.0, 1.4]), [0.5, 1.4]);
        assert_eq!(share(&backlash::EFFECT, &[0.4]), [0.1]);
        // The contact is never lost below the recorded range, and the channel never clips above it.
        let [low_mm, high_n] = [span.displacement_mm[0], span.force_n[1]];
        assert_eq!(share(&lift_off::AT_ONCE, &[low_mm + 4.0]), [low_mm + 1.0]);
        assert_eq!(
            share(&sensor_saturation::EFFECT, &[high_n - 40.0]),
            [high_n - 10.0]
        );
        for effect in EFFECTS {
            for start in (effect.starts)(&span) {
                assert_eq!(effect.at_share(&start, 1.0, &span), start, "{}", effect.code);
            }
        }
    }

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
                assert_eq!(start.len(), n, "{}", effect.code);
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
            for look_alike in effect.confusable_with {
                assert!(
                    find(look_alike.code).is_ok() && look_alike.code != effect.code,
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
    fn errors_name_the_code_and_the_parameter() {
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
    fn effects_are_attached_in_the_order_of_their_stages() {
        let pair = |swap: bool| {
            let mut effects = vec![
                (find("sensor_saturation").expect("listed"), vec![400.0]),
                (find("coulomb_friction").expect("listed"), vec![50.0, 0.05, 1.0]),
            ];
            if swap {
                effects.reverse();
            }
            let mut plant = attach_all(&effects, 0.0, testing::spring()).expect("valid");
            testing::drive(&mut plant)
        };
        assert_eq!(pair(false), pair(true));
        // The friction is attached before the clipping, so no force is above the limit.
        assert_eq!(pair(false).into_iter().fold(0.0, f64::max), 400.0);
    }

    #[test]
    fn the_zero_is_added_after_the_physics_and_before_the_clipping() {
        let clipping = [(find("sensor_saturation").expect("listed"), vec![400.0])];
        let friction = [(
            find("load_dependent_friction").expect("listed"),
            vec![0.1, 0.05, 1.0],
        )];
        let forces = |effects: &[(&'static Effect, Vec<f64>)], zero_n: f64| {
            testing::drive(&mut attach_all(effects, zero_n, testing::spring()).expect("valid"))
        };
        assert_eq!(forces(&clipping, 50.0).into_iter().fold(0.0, f64::max), 400.0);
        for (with, without) in forces(&friction, 50.0).iter().zip(forces(&friction, 0.0)) {
            assert!((with - without - 50.0).abs() < 1e-9, "{with} and {without}");
        }
    }
}
