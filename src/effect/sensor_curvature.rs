//! A measuring channel that is not straight.
//!
//! ```text
//! F = f + q f^2,   f = F_in(x + a x^2 + b x^3)
//! ```
//! a: `displacement_per_mm`, b: `displacement_per_mm2`, curvature of the displacement channel. q: `force_per_kn`, curvature of the force
//! channel. x: displacement that the channel shows, mm. F_in: force of the plant inside, N.
//! Source: error of linearity of transducers (ISO 9513 for extensometers, ISO 7500-1 for force), to second and third order.
//! Range: errors of a few percent of the travel. What a line absorbs is in the scale of the channel.
//! Nearly the same as a stiffness that changes with deflection: only the friction tells them apart, and it hardly does.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

const fn curvature(
    name: &'static str,
    unit: &'static str,
    most: f64,
    usual: f64,
    what: &'static str,
) -> Parameter {
    Parameter {
        name,
        unit,
        start: 0.0,
        bounds: [-most, most],
        belief: [-usual, usual],
        what,
    }
}

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "sensor_curvature",
    stage: Stage::Sensor,
    parameters: &[
        curvature(
            "displacement_per_mm",
            "1/mm",
            0.01,
            0.002,
            "curvature of the displacement channel",
        ),
        curvature(
            "displacement_per_mm2",
            "1/mm2",
            0.001,
            0.0002,
            "change of that curvature with the displacement",
        ),
        curvature(
            "force_per_kn",
            "1/kN",
            0.1,
            0.02,
            "curvature of the force channel",
        ),
    ],
    neutral: &[0.0; 3],
    amplitudes: &[0, 1, 2],
    kinks: &[],
    shapes: &[1, 2],
    starts: |_| vec![vec![0.0005, 0.0, 0.0]],
    statement: |v| {
        format!(
            "A measuring channel is not straight: the displacement by {:+.2} % of itself for each 10 mm, the force by {:+.2} % of itself \
             for each kN. Possible causes: an LVDT beyond its linear range, a calibration with two points.",
            1e3 * v[0],
            100.0 * v[2]
        )
    },
    attach: |v, inside| {
        wrapped(
            SensorCurvature {
                per_mm: v[0],
                per_mm2: v[1],
                per_n: 1e-3 * v[2],
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "a channel that is not straight bends the characteristic as geometry does",
        test: "a calibration of both channels with five points, or a straight spring in place of the specimen",
    }],
};

#[derive(Clone)]
struct SensorCurvature {
    per_mm: f64,
    per_mm2: f64,
    per_n: f64,
}

impl Wrap for SensorCurvature {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let x = displacement_mm;
        let force_n = inside.step(x * (1.0 + x * (self.per_mm + x * self.per_mm2)), dt_s);
        force_n * (1.0 + self.per_n * force_n)
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
        // 10 mm: 10 + 0.002 * 100 + 0.0001 * 1000 = 10.3 mm, 924 N; 924 + 0.01 * 0.924 * 924 = 932.5 N.
        let mut plant = (EFFECT.attach)(&[0.002, 0.0001, 0.01], spring());
        assert!((plant.step(10.0, 0.1) - (924.0 + 1e-5 * 924.0 * 924.0)).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.003, 0.00005, 0.01]);
    }
}
