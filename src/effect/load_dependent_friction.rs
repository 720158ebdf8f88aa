//! Dry friction in proportion to the load on the contact.
//!
//! ```text
//! F = F_in + c E r(x)
//! ```
//! c: `friction_ratio`, friction force divided by carried load. E: load that the contacts carry, N (F_in if the plant has
//! none). r: drag of the contacts, -1 to 1; after a reversal it changes sign over `transition_mm` with `shape` (see
//! [`Drag`]). F_in: force of the plant inside, N.
//! Sources: the loop energies of Kadziela et al. (2015, Tables 2 and 3) grow with the square of the peak force, as friction
//! in proportion to the load does; transition after a reversal: P. R. Dahl (1968), with his exponent as `shape`.
//! Range: compressive load, any speed.

use super::motion::Drag;
use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "load_dependent_friction",
    stage: Stage::Interleaf,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "friction_ratio",
            unit: "",
            start: 0.05,
            bounds: [0.0, 0.95],
            belief: [0.0, 0.3],
            what: "friction force divided by the carried load",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 20.0],
            belief: [0.01, 5.0],
            what: "travel after a reversal over which the friction reverses",
        },
        Parameter {
            name: "shape",
            unit: "",
            start: 1.0,
            bounds: [0.0, 2.5],
            belief: [0.0, 2.0],
            what: "below 1 the reversal is complete after a finite travel, above 1 it has a long tail",
        },
    ],
    neutral: &[0.0, 0.3, 1.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.01, 0.05, 1.0], vec![0.01, 0.5, 1.0], vec![0.01, 1.5, 0.7]],
    statement: |v| {
        format!(
            "A dry friction of {} % of the carried load acts against every motion. Possible causes: leaf on leaf, or a shackle under load.",
            shown(100.0 * v[0], 1)
        )
    },
    attach: |v, inside| {
        wrapped(
            LoadDependentFriction {
                ratio: v[0],
                drag: Drag::new(v[1], v[2]),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "coulomb_friction",
        why: "at one mean load and a small amplitude, both widen the loop by the same force",
        test: "a sine of the same amplitude at half the mean load: friction in proportion to the load halves the loop width",
    }],
};

#[derive(Clone)]
struct LoadDependentFriction {
    ratio: f64,
    drag: Drag,
}

impl Wrap for LoadDependentFriction {
    fn reset(&mut self) {
        self.drag.reset();
    }

    fn told(&mut self, _motion: &Motion) {
        self.drag.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        force_n + pressing_n(&**inside, force_n) * self.ratio * self.drag.step(displacement_mm)
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
        // Full sliding in both directions: 500 N times 1.1, 420 N times 0.9.
        let mut plant = (EFFECT.attach)(&[0.1, 0.01, 1.0], spring());
        assert!((plant.step(5.0, 0.1) - 550.0).abs() < 1e-9);
        assert!((plant.step(4.0, 0.1) - 378.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.08, 0.4, 0.8]);
    }
}
