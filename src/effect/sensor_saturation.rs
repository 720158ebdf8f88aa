//! Force channel that clips.
//!
//! ```text
//! F = min(F_in, L)
//! ```
//! L: `limit_n`, largest force that the amplifier can show, N. F_in: force of the plant inside, N.
//! Source: output range of any amplifier. Range: clipping at the upper end. A displacement channel that clips cannot be
//! corrected after the recording; `diagnose` masks and reports those samples.

use super::{Axis, Branch, Effect, Kink, LookAlike, Place, Stage, Wrap, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "sensor_saturation",
    stage: Stage::Sensor,
    follows_path: true,
    only_rival: false,
    parameters: &[Parameter {
        name: "limit_n",
        unit: "N",
        start: 1000000.0,
        bounds: [-1000000.0, 1000000.0],
        belief: [0.0, 1000000.0],
        what: "largest force that the channel shows",
    }],
    neutral: &[1e6],
    amplitudes: &[],
    kinks: &[Kink::of(0, Axis::ForceN)],
    shapes: &[],
    starts: |s| {
        [0.998, 0.99, 0.975, 0.95, 0.91, 0.85]
            .map(|p| vec![s.force_n[0] + p * (s.force_n[1] - s.force_n[0])])
            .to_vec()
    },
    statement: |v| {
        format!(
            "The force channel clips at {:.0} N. Peaks above this force are not in the recording.",
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
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "a clipped peak looks like a spring that softens",
        test: "the same profile with the next larger range of the amplifier",
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
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[1000.0]);
    }
}
