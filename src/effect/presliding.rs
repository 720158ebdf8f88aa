//! Gradual transition after a reversal, where the model's friction turns round at once.
//!
//! ```text
//! F = F_in + (c F_in + T) (r(x) - d(x))     c friction_ratio, T friction_n: the friction that turns round gradually
//!     r drag over presliding_mm with a shape, d the same contact with a transition of 5 um: the direction of travel
//! ```
//! Sources: Dahl (1968); Iwan (1966); Chula thesis, eqs. 5-1 to 5-6 and Fig. 5-12, where the transition takes millimetres.
//! Away from reversals it changes nothing, so that loop area goes but the force far along a branch stays.

use super::motion::Drag;
use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "presliding",
    stage: Stage::Interleaf,
    what: "friction that turns round gradually after a reversal",
    parameters: &[
        Parameter {
            name: "friction_ratio",
            unit: "",
            start: 0.05,
            bounds: [0.0, 0.95],
            belief: [0.0, 0.3],
            what: "share of the load whose friction turns round gradually",
        },
        Parameter {
            name: "friction_n",
            unit: "N",
            start: 0.0,
            bounds: [0.0, 5000.0],
            belief: [0.0, 300.0],
            what: "friction apart from the load that turns round gradually",
        },
        Parameter {
            name: "presliding_mm",
            unit: "mm",
            start: 0.5,
            bounds: [0.01, 20.0],
            belief: [0.01, 5.0],
            what: "travel after a reversal over which it turns round",
        },
        Parameter {
            name: "shape",
            unit: "",
            start: 1.0,
            bounds: [0.0, 2.5],
            belief: [0.0, 2.0],
            what: "below 1 complete after a finite travel, above 1 with a long tail",
        },
    ],
    neutral: &[0.0, 0.0, 0.5, 1.0],
    amplitudes: &[0, 1],
    kinks: &[],
    starts: |_| {
        vec![
            vec![0.01, 1.0, 0.1, 1.0],
            vec![0.01, 1.0, 0.5, 1.0],
            vec![0.01, 1.0, 2.0, 0.7],
        ]
    },
    statement: |v| {
        format!(
            "After each reversal the friction turns round gradually, over about {:.2} mm, not at once.",
            v[2]
        )
    },
    attach: |v, inside| {
        wrapped(
            Presliding {
                ratio: v[0],
                friction_n: v[1],
                drag: Drag::new(v[2], v[3]),
                direction: Drag::new(0.005, 1.0),
            },
            inside,
        )
    },
    if_known: |_, _| None,
    place: |v, _| {
        Some(Place {
            axis: Axis::DistanceFromReversalMm,
            from: 0.0,
            to: 2.0 * v[2],
            branch: Branch::Both,
        })
    },
    confusable_with: &[
        LookAlike {
            code: "backlash",
            why: "both take force away after each reversal",
            test: "reversal nests of 0.2 to 2 mm: play is used up at a fixed travel, friction turns round over a travel that grows with its own strength",
        },
        LookAlike {
            code: "channel_delay",
            why: "a lag of one channel rounds the reversals of one frequency",
            test: "the same amplitude at a tenth of the frequency: a lag shrinks with it, presliding does not",
        },
    ],
};

#[derive(Clone)]
struct Presliding {
    ratio: f64,
    friction_n: f64,
    drag: Drag,
    direction: Drag,
}

impl Wrap for Presliding {
    fn reset(&mut self) {
        self.drag.reset();
        self.direction.reset();
    }

    fn told(&mut self, _motion: &Motion) {
        self.drag.tell();
        self.direction.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        let lag = self.drag.step(displacement_mm) - self.direction.step(displacement_mm);
        force_n + (self.ratio * load_n(&**inside, force_n) + self.friction_n) * lag
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
        // One length after a full reversal: drag 2/e - 1 on the way to -1, so it still lacks 2/e.
        let mut plant = (EFFECT.attach)(&[0.1, 10.0, 0.5, 1.0], spring());
        plant.step(50.0, 0.1);
        let x = 49.5;
        let (spring_n, lag) = (100.0 + 80.0 * x, 2.0 * (-1.0f64).exp());
        let force_n = 0.1 * spring_n + 10.0;
        // A polygon of 32 corners in the place of the exponential.
        assert!((plant.step(x, 0.1) - (spring_n + force_n * lag)).abs() < 2e-3 * force_n);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[0.06, 8.0, 0.6, 0.8]);
    }
}
