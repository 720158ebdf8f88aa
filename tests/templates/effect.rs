//! Template of an effect: a fixture that carries a part of the load, parallel to the specimen.
//!
//! ```text
//! F = F_in + k x             k fixture_rate_n_per_mm, N/mm; x displacement, mm
//! ```
//! Source: put author, year and equation here. Range: small deflections, where the fixture is linear.

use crate::effect::{Effect, LookAlike, Stage, Wrap, always, everywhere, unchanged, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`EFFECTS`](crate::effect::EFFECTS).
pub(crate) const EFFECT: Effect = Effect {
    code: "fixture_stiffness",
    stage: Stage::Frame,
    follows_path: true,
    only_rival: false,
    parameters: &[Parameter {
        name: "fixture_rate_n_per_mm",
        unit: "N/mm",
        start: 0.0,
        bounds: [-100.0, 100.0],
        belief: [0.0, 20.0],
        what: "rate of the fixture",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![1.0]],
    statement: |v| format!("The fixture carries {:.2} N for each mm of travel.", v[0]),
    attach: |v, inside| wrapped(FixtureStiffness { rate_n_per_mm: v[0] }, inside),
    if_known: unchanged,
    place: everywhere,
    plausible: always,
    confusable_with: &[LookAlike {
        code: "progressive_stiffness",
        why: "over a short travel both only raise the rate",
        test: "a ramp over the whole travel: the rate of a fixture does not change",
    }],
};

#[derive(Clone)]
struct FixtureStiffness {
    rate_n_per_mm: f64,
}

impl Wrap for FixtureStiffness {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        inside.step(displacement_mm, dt_s) + self.rate_n_per_mm * displacement_mm
    }
}

#[cfg(test)]
mod tests {
    use super::EFFECT;
    use crate::effect::testing::*;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        // The spring of these tests: 100 N + 80 N/mm * 5 mm. The fixture adds 2 N/mm * 5 mm.
        let mut plant = (EFFECT.attach)(&[2.0], spring());
        assert!((plant.step(5.0, 0.1) - 510.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[3.0]);
    }
}
