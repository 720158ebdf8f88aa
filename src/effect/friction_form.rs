//! The model's own load-proportional friction in another form: how it turns round after a reversal, free of any one law.
//!
//! ```text
//! F = F_in (1 + sum c_i r_i),  dr_i = dx / l_i held within [-1, 1],  l_i = 0.03 mm * 1.7^i,  i = 0..9
//! ```
//! Elastic-plastic elements (Jenkins) in parallel, a Prandtl-Ishlinskii model; Iwan (1966). Any friction that turns round
//! over 0.03 to 7 mm is a sum of them with non-negative strengths, to 1 % of its size. It names no missing physics:
//! a model that has presliding friction may have another law of it than the spring.

use super::motion::Steady;
use super::{Effect, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// Elements.
const COUNT: usize = 10;
/// Shortest length in mm, and the ratio of neighbours.
const SHORTEST_MM: f64 = 0.03;
const RATIO: f64 = 1.7;

const fn strength(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "",
        start: 0.0,
        bounds: [0.0, 0.9],
        belief: [0.0, 0.2],
        what: "friction over load of the element with this number; its length is 0.03 mm times 1.7 to that power",
    }
}

/// One of [`super::FORMS`].
pub const FORM: Effect = Effect {
    code: "friction_form",
    stage: Stage::Interleaf,
    what: "the model's own friction with another way of turning round",
    parameters: &[
        strength("ratio_0"),
        strength("ratio_1"),
        strength("ratio_2"),
        strength("ratio_3"),
        strength("ratio_4"),
        strength("ratio_5"),
        strength("ratio_6"),
        strength("ratio_7"),
        strength("ratio_8"),
        strength("ratio_9"),
    ],
    neutral: &[0.0; COUNT],
    amplitudes: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
    starts: |_| {
        let mut starts = vec![vec![0.002; COUNT]];
        starts.extend([1, 3, 5, 7, 9].map(|i| {
            let mut one = vec![0.0; COUNT];
            one[i] = 0.01;
            one
        }));
        starts
    },
    statement: |v| {
        format!(
            "The model's own friction turns round in another form: {:.1} % of the load in elements of 0.03 to 3.6 mm.",
            100.0 * v.iter().sum::<f64>()
        )
    },
    attach: |v, inside| {
        let mut strengths = [0.0; COUNT];
        strengths.copy_from_slice(&v[..COUNT]);
        wrapped(
            FrictionForm {
                strengths,
                steady: Steady::default(),
                drags: [0.0; COUNT],
            },
            inside,
        )
    },
    place: everywhere,
    confusable_with: &[],
};

#[derive(Clone)]
struct FrictionForm {
    strengths: [f64; COUNT],
    steady: Steady,
    drags: [f64; COUNT],
}

impl Wrap for FrictionForm {
    fn reset(&mut self) {
        self.steady = Steady::default();
        self.drags = [0.0; COUNT];
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let mut lengths = self.steady.travel(displacement_mm) / SHORTEST_MM;
        let mut ratio = 0.0;
        for (drag, strength) in self.drags.iter_mut().zip(&self.strengths) {
            *drag = (*drag + lengths).clamp(-1.0, 1.0);
            ratio += strength * *drag;
            lengths /= RATIO;
        }
        inside.step(displacement_mm, dt_s) * (1.0 + ratio)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::*;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&FORM);
    }

    #[test]
    fn force_by_hand() {
        // Slid far up, then back by half the last element's length of 3.5576 mm: it is at rest, the others are turned.
        let mut strengths = [0.0; COUNT];
        (strengths[0], strengths[9]) = (0.02, 0.04);
        let mut plant = (FORM.attach)(&strengths, spring());
        plant.step(50.0, 0.1);
        let x = 50.0 - SHORTEST_MM * RATIO.powi(9);
        assert!((plant.step(x, 0.1) - (100.0 + 80.0 * x) * 0.98).abs() < 1e-6);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&FORM, &[0.0, 0.0, 0.01, 0.0, 0.03, 0.02, 0.0, 0.01, 0.0, 0.0]);
    }
}
