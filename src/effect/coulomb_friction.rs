//! Friction that does not depend on the load: bushings, pusher on board, guides, seals.
//!
//! ```text
//! F = F_in + T r(x)          T friction_n, N; r in [-1, 1]: drag of the contact, Dahl (1968), over transition_mm
//! ```
//! Source: C. A. de Coulomb (1785); the drag as in Dahl, A solid friction model (1968), because no bushing turns round
//! within a sample. Told from load-proportional friction by the loop's width at a second load; always dissipates.

use super::motion::Drag;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "coulomb_friction",
    stage: Stage::Pusher,
    what: "dry friction that does not depend on the load",
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
            what: "travel over which it turns round after a reversal",
        },
    ],
    neutral: &[0.0, 0.05],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| vec![vec![10.0, 0.02], vec![10.0, 0.1], vec![10.0, 0.5]],
    statement: |v| {
        format!(
            "A dry friction of {:.1} N that does not depend on the load acts against every motion: bushings, pusher on its board, guides or seals.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            CoulombFriction {
                friction_n: v[0],
                drag: Drag::new(v[1], 1.0),
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
    confusable_with: &[
        LookAlike {
            code: "load_dependent_friction",
            why: "at one mean load and a small amplitude both widen the loop by the same force",
            test: "a sine of the same amplitude at half the mean load: only this friction keeps its width",
        },
        LookAlike {
            code: "stribeck",
            why: "friction that is higher in a slow ramp adds a nearly constant force there",
            test: "the same ramp ten times faster",
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
        // Slid far either way: 100 + 80 x, plus and minus 25 N.
        let mut plant = (EFFECT.attach)(&[25.0, 0.01], spring());
        assert!((plant.step(5.0, 0.1) - 525.0).abs() < 1e-9);
        assert!((plant.step(4.0, 0.1) - 395.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[25.0, 0.12]);
    }
}
