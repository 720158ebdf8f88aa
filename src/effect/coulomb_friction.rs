//! Dry friction that does not depend on the load.
//!
//! ```text
//! F = F_in + T r(x)
//! ```
//! T: `friction_n`, N. r: drag of the contact, -1 to 1; after a reversal it changes sign over `transition_mm` with the form
//! `shape` (see [`Drag`]): 1 is exponential, 0 a single elastic-plastic element. F_in: force of the plant inside, N.
//! Sources: C. A. de Coulomb (1785); transition after a reversal: P. R. Dahl, A solid friction model (1968).
//! Range: any motion; the friction is independent of load and speed. The loop width at a second mean load separates it
//! from friction in proportion to the load.

use super::motion::Drag;
use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "coulomb_friction",
    stage: Stage::Pusher,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "friction_n",
            unit: "N",
            start: 10.0,
            bounds: [0.0, 5000.0],
            belief: [0.0, 300.0],
            what: "friction force, the same at any load",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.05,
            bounds: [0.001, 5.0],
            belief: [0.001, 1.0],
            what: "travel after a reversal over which the friction reverses",
        },
        Parameter {
            name: "shape",
            unit: "",
            start: 1.0,
            bounds: [0.0, 1.5],
            belief: [0.0, 1.5],
            what: "form of the reversal: 1 is exponential, 0 is linear up to sliding",
        },
    ],
    neutral: &[0.0, 0.05, 1.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[2],
    starts: |_| vec![vec![10.0, 0.02, 0.8], vec![10.0, 0.1, 0.8], vec![10.0, 0.5, 0.8]],
    statement: |v| {
        format!(
            "A dry friction of {} N acts against every motion and does not depend on the load. Possible causes: bushings, pusher on its board, guides or seals.",
            shown(v[0], 1)
        )
    },
    attach: |v, inside| {
        wrapped(
            CoulombFriction {
                friction_n: v[0],
                drag: Drag::new(v[1], v[2]),
            },
            inside,
        )
    },
    if_known: |effect, knows| {
        let mut parameters = effect.parameters.to_vec();
        if !knows("presliding") {
            // A gradual transition is missing physics then: 0.06 mm is too short to stand for it.
            parameters[1].bounds = [1e-3, 0.06];
        }
        Some(parameters)
    },
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "load_dependent_friction",
            why: "at one mean load and a small amplitude, both widen the loop by the same force",
            test: "a sine of the same amplitude at half the mean load: friction that does not depend on the load keeps the loop width",
        },
        LookAlike {
            code: "stribeck",
            why: "Stribeck friction adds a nearly constant force in a slow ramp",
            test: "the same ramp ten times faster: Stribeck friction decreases, Coulomb friction does not",
        },
    ],
};

#[derive(Clone)]
struct CoulombFriction {
    friction_n: f64,
    drag: Drag,
}

impl Wrap for CoulombFriction {
    fn reset(&mut self) {
        self.drag.reset();
    }

    fn told(&mut self, _motion: &Motion) {
        self.drag.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        force_n + self.friction_n * self.drag.step(displacement_mm)
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
        // Full sliding in both directions: 100 + 80 x, plus and minus 25 N.
        let mut plant = (EFFECT.attach)(&[25.0, 0.01, 1.0], spring());
        assert!((plant.step(5.0, 0.1) - 525.0).abs() < 1e-9);
        assert!((plant.step(4.0, 0.1) - 395.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[25.0, 0.12, 0.6]);
    }
}
