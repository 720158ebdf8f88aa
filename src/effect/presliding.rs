//! Gradual reversal of the friction, where the friction of the model reverses at once.
//!
//! ```text
//! F = F_in + (c E + T) (r(x) - d(x))
//! ```
//! c: `friction_ratio`; T: `friction_n`, N: the friction that reverses gradually. E: load that the contacts carry, N (F_in if
//! the plant has none). r: drag over `presliding_mm` with `shape`, -1 to 1 (see [`Drag`]). d: the same with a
//! transition of 5 um, that is the direction of travel. F_in: force of the plant inside, N.
//! Sources: P. R. Dahl (1968); W. D. Iwan (1966); Chula thesis, eqs. 5-1 to 5-4 and Fig. 5-12, where the reversal takes
//! millimetres.
//! Range: it acts only near reversals. It reduces the loop area; the force far along a branch stays the same.

use super::motion::Drag;
use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "presliding",
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
            what: "friction in proportion to the load that reverses gradually, divided by the load",
        },
        Parameter {
            name: "friction_n",
            unit: "N",
            start: 0.0,
            bounds: [0.0, 5000.0],
            belief: [0.0, 300.0],
            what: "friction independent of the load that reverses gradually",
        },
        Parameter {
            name: "presliding_mm",
            unit: "mm",
            start: 0.5,
            bounds: [0.01, 20.0],
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
    neutral: &[0.0, 0.0, 0.5, 1.0],
    amplitudes: &[0, 1],
    kinks: &[],
    shapes: &[],
    starts: |_| {
        vec![
            vec![0.01, 1.0, 0.1, 1.0],
            vec![0.01, 1.0, 0.5, 1.0],
            vec![0.01, 1.0, 2.0, 0.7],
        ]
    },
    statement: |v| {
        format!(
            "After each reversal of the motion the friction reverses gradually, over about {:.2} mm, not at once.",
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
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "backlash",
            why: "both reduce the force change just after each reversal",
            test: "nested reversals of 0.2 to 2 mm: backlash ends at a fixed travel, presliding needs a travel that depends on the friction force",
        },
        LookAlike {
            code: "channel_delay",
            why: "at one frequency, a channel delay rounds the corners of the loop as presliding does",
            test: "the same amplitude at a tenth of the frequency: the effect of a delay shrinks with the frequency, presliding does not",
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
        let difference = self.drag.step(displacement_mm) - self.direction.step(displacement_mm);
        force_n + (self.ratio * pressing_n(&**inside, force_n) + self.friction_n) * difference
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
        // One length after a full reversal the drag is 2/e - 1; the final value is -1, so the difference is 2/e.
        let mut plant = (EFFECT.attach)(&[0.1, 10.0, 0.5, 1.0], spring());
        plant.step(50.0, 0.1);
        let x = 49.5;
        let (spring_n, difference) = (100.0 + 80.0 * x, 2.0 * (-1.0f64).exp());
        let force_n = 0.1 * spring_n + 10.0;
        // 32 elements approximate the exponential by a polygon of 32 corners.
        assert!((plant.step(x, 0.1) - (spring_n + force_n * difference)).abs() < 2e-3 * force_n);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.06, 8.0, 0.6, 0.8]);
    }
}
