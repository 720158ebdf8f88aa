//! A channel that clips.
//!
//! ```text
//! F = min(F_in, limit_n)     limit_n: force at the amplifier's rail
//! ```
//! Source: any amplifier. A displacement channel that clips cannot be put right behind the recording: conditioning masks
//! and names it.

use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "sensor_saturation",
    stage: Stage::Sensor,
    what: "force channel that clips",
    parameters: &[Parameter {
        name: "limit_n",
        unit: "N",
        start: 1000000.0,
        bounds: [-1000000.0, 1000000.0],
        belief: [0.0, 1000000.0],
        what: "force above which the channel shows no more",
    }],
    neutral: &[1e6],
    amplitudes: &[],
    kinks: &[(0, Axis::ForceN)],
    starts: |s| {
        [0.998, 0.99, 0.975, 0.95, 0.91, 0.85]
            .map(|p| vec![s.force_n[0] + p * (s.force_n[1] - s.force_n[0])])
            .to_vec()
    },
    statement: |v| {
        format!(
            "The force channel clips at {:.0} N: peaks above it are not in the recording.",
            v[0]
        )
    },
    attach: |v, inside| wrapped(SensorSaturation { limit_n: v[0] }, inside),
    if_known: super::unchanged,
    place: |v, s| {
        Some(Place {
            axis: Axis::ForceN,
            from: v[0],
            to: s.force_n[1].max(v[0]),
            branch: Branch::Both,
        })
    },
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "a peak cut off looks like a spring that softens",
        test: "the same profile with the amplifier's next range",
    }],
};

#[derive(Clone)]
struct SensorSaturation {
    limit_n: f64,
}

impl Wrap for SensorSaturation {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        inside.step(displacement_mm, dt_s).min(self.limit_n)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::EFFECT;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        let mut plant = (EFFECT.attach)(&[450.0], spring());
        assert_eq!(plant.step(5.0, 0.1), 450.0);
        assert_eq!(plant.step(4.0, 0.1), 420.0);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[1000.0]);
    }
}
