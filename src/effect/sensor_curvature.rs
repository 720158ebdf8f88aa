//! Channel that is not straight.
//!
//! ```text
//! F = G + f G^2 / 2,  G = F_in(x + c x^2 / 2 + d x^3 / 6)
//! ```
//! c: `displacement_bow_per_mm`, change of the gain of the LVDT with its reading x, mm; d: `displacement_skew_per_mm2`, change of that. f: `force_bow_per_n`, change of the gain of
//! the load cell with the force. F_in: force of the plant inside at the true displacement, N. G: true force, N. Over a range R the
//! reading is off by c R^2 / 8 + d R^3 / 16 in the middle, from the line through its ends.
//! Source: calibration polynomial (ISO 376 fits one to a load cell). Range: a few tenths of a percent of the range.
//! An LVDT whose gain changes and a spring that stiffens make nearly the same recording. So no search begins with this effect: it is
//! compared with a curved characteristic that was named, and named itself where it fits better.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

const DISPLACEMENT: Parameter = Parameter {
    name: "displacement_bow_per_mm",
    unit: "1/mm",
    start: 0.0,
    bounds: [-0.02, 0.02],
    belief: [-0.005, 0.005],
    what: "change of the gain of the displacement channel with its reading",
};
const SKEW: Parameter = Parameter {
    name: "displacement_skew_per_mm2",
    unit: "1/mm2",
    start: 0.0,
    bounds: [-0.002, 0.002],
    belief: [-0.0005, 0.0005],
    what: "change of that bow with the reading",
};
const FORCE: Parameter = Parameter {
    name: "force_bow_per_n",
    unit: "1/N",
    start: 0.0,
    bounds: [-0.0001, 0.0001],
    belief: [-0.00002, 0.00002],
    what: "change of the gain of the force channel with the force",
};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "sensor_curvature",
    stage: Stage::Sensor,
    follows_path: true,
    only_rival: true,
    parameters: &[DISPLACEMENT, SKEW, FORCE],
    neutral: &[0.0; 3],
    amplitudes: &[0, 1, 2],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.0001, 0.0, 0.0], vec![0.0, 0.0, 0.000001]],
    statement: |v| {
        let (channel, unit, range, off) = match v[0] == 0.0 && v[1] == 0.0 {
            true => ("force", "N", 1000.0, 1e6 * v[2] / 8.0),
            false => (
                "displacement",
                "mm",
                10.0,
                100.0 * v[0] / 8.0 + 1000.0 * v[1] / 16.0,
            ),
        };
        format!(
            "The {channel} channel is not straight: over {range} {unit} it is off by {:.3} {unit} in the middle, from the line through its ends.",
            off
        )
    },
    attach: |v, inside| {
        wrapped(
            SensorCurvature {
                displacement_bow_per_mm: v[0],
                displacement_skew_per_mm2: v[1],
                force_bow_per_n: v[2],
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "a channel that is not straight curves the characteristic as geometry does",
        test: "a calibration of both channels at five points or more: it shows whether one of them is curved",
    }],
};

/// The displacement channel alone ([`super::RIVAL_LAWS`]).
pub(super) const OF_DISPLACEMENT: Effect = Effect {
    parameters: &[DISPLACEMENT, SKEW, held_at_zero(FORCE)],
    amplitudes: &[0, 1],
    starts: |_| vec![vec![0.0001, 0.0, 0.0]],
    ..EFFECT
};

/// The force channel alone ([`super::RIVAL_LAWS`]).
pub(super) const OF_FORCE: Effect = Effect {
    parameters: &[held_at_zero(DISPLACEMENT), held_at_zero(SKEW), FORCE],
    amplitudes: &[2],
    starts: |_| vec![vec![0.0, 0.0, 0.000001]],
    ..EFFECT
};

const fn held_at_zero(parameter: Parameter) -> Parameter {
    Parameter {
        bounds: [0.0, 0.0],
        ..parameter
    }
}

#[derive(Clone)]
struct SensorCurvature {
    displacement_bow_per_mm: f64,
    displacement_skew_per_mm2: f64,
    force_bow_per_n: f64,
}

impl Wrap for SensorCurvature {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let bow = 0.5 * self.displacement_bow_per_mm + self.displacement_skew_per_mm2 * displacement_mm / 6.0;
        let true_mm = displacement_mm * (1.0 + bow * displacement_mm);
        let true_n = inside.step(true_mm, dt_s);
        true_n * (1.0 + 0.5 * self.force_bow_per_n * true_n)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::{EFFECT, OF_DISPLACEMENT, OF_FORCE};

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        // 5 mm: 5 + 0.001 * 25 / 2 = 5.0125 mm, so 100 + 80 * 5.0125 = 501 N.
        let mut plant = (EFFECT.attach)(&[0.001, 0.0, 0.0], spring());
        assert!((plant.step(5.0, 0.1) - 501.0).abs() < 1e-9);
        // 5 + 0.0012 * 125 / 6 = 5.025 mm.
        let mut plant = (EFFECT.attach)(&[0.0, 0.0012, 0.0], spring());
        assert!((plant.step(5.0, 0.1) - 502.0).abs() < 1e-9);
        // 500 + 1e-5 * 500^2 / 2 = 501.25 N.
        let mut plant = (EFFECT.attach)(&[0.0, 0.0, 1e-5], spring());
        assert!((plant.step(5.0, 0.1) - 501.25).abs() < 1e-9);
    }

    #[test]
    fn a_sentence_for_each_channel() {
        let said = |values: &[f64]| (EFFECT.statement)(values);
        assert!(
            said(&[0.001, 0.0, 0.0])
                .contains("displacement channel is not straight: over 10 mm it is off by 0.013 mm"),
            "{}",
            said(&[0.001, 0.0, 0.0])
        );
        assert!(
            said(&[0.0, 0.0, 1e-5])
                .contains("force channel is not straight: over 1000 N it is off by 1.250 N"),
            "{}",
            said(&[0.0, 0.0, 1e-5])
        );
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&OF_DISPLACEMENT, &[0.001, 0.0001, 0.0]);
        parameters_are_recovered(&OF_FORCE, &[0.0, 0.0, 0.000008]);
    }
}
