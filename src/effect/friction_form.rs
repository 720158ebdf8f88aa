//! The model's own load-proportional friction in another form: how it turns round after a reversal, free of any one law.
//!
//! ```text
//! F = F_in + E sum c_i r_i,   r_i: mean of three elements dr = dx / l held within [-1, 1],  l within band i
//! ```
//! E: load carried. Elastic-plastic elements (Jenkins) in parallel, a Prandtl-Ishlinskii model; Iwan (1966). Any friction that
//! turns round over 0.01 to 10 mm and returns to where it turned (Masing 1926) is such a sum. It names no missing physics:
//! a model that has presliding friction may have another law of it than the spring. The strengths are linear, so that a fit
//! needs no luck with its start.

use super::motion::Steady;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, load_n, wrapped};
use crate::model::friction::elements::Elements;
use crate::model::{Motion, Parameter, Plant};

/// Bands of length, mm: the first is what no sampling resolves, the others grow by about 1.5.
const BANDS_MM: [f64; COUNT + 1] = [
    0.004, 0.02, 0.035, 0.055, 0.08, 0.12, 0.18, 0.26, 0.38, 0.56, 0.82, 1.2, 1.8, 2.6, 3.8, 5.6, 8.0,
];
/// Bands, and elements in each.
const COUNT: usize = 16;
const EACH: usize = 3;

const fn strength(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "",
        start: 0.0,
        bounds: [0.0, 0.9],
        belief: [0.0, 0.2],
        what: "friction over load of the elements in the band with this number, shortest first",
    }
}

/// One of [`super::FORMS`].
pub(crate) const FORM: Effect = Effect {
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
        strength("ratio_10"),
        strength("ratio_11"),
        strength("ratio_12"),
        strength("ratio_13"),
        strength("ratio_14"),
        strength("ratio_15"),
    ],
    neutral: &[0.0; COUNT],
    amplitudes: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
    kinks: &[],
    starts: |_| vec![vec![0.002; COUNT]],
    statement: |v| {
        format!(
            "The model's own friction turns round in another form: {:.1} % of the load over travels of 0.01 to 10 mm.",
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
                elements: Elements::new(std::array::from_fn(|k| {
                    let (band, within) = (k / EACH, (k % EACH) as f64 + 0.5);
                    BANDS_MM[band] * (BANDS_MM[band + 1] / BANDS_MM[band]).powf(within / EACH as f64)
                })),
            },
            inside,
        )
    },
    if_known: |effect, knows| {
        let known = knows("load_dependent_friction") && knows("presliding");
        known.then(|| effect.parameters.to_vec())
    },
    place: everywhere,
    confusable_with: &[
        LookAlike {
            code: "presliding",
            why: "the baseline's friction turns round after a reversal in another way than the recorded one",
            test: "reversal nests of 0.2 to 2 mm: play is used up at a fixed travel, friction turns round over a travel that grows with its own strength",
        },
        LookAlike {
            code: "backlash",
            why: "play and presliding both take force away after each reversal",
            test: "reversal nests of 0.2 to 2 mm: play is used up at a fixed travel, friction turns round over a travel that grows with its own strength",
        },
    ],
};

#[derive(Clone)]
struct FrictionForm {
    strengths: [f64; COUNT],
    steady: Steady,
    elements: Elements<{ COUNT * EACH }>,
}

impl Wrap for FrictionForm {
    fn reset(&mut self) {
        self.steady = Steady::default();
        self.elements.reset();
    }

    fn told(&mut self, _motion: &Motion) {
        self.steady.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let drags = self.elements.advance(self.steady.travel(displacement_mm));
        let ratio: f64 = drags
            .chunks_exact(EACH)
            .zip(&self.strengths)
            .map(|(band, strength)| strength * band.iter().sum::<f64>())
            .sum::<f64>()
            / EACH as f64;
        let force_n = inside.step(displacement_mm, dt_s);
        force_n + load_n(&**inside, force_n) * ratio
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
        // Slid far up, then back by 1 mm: the first band is turned, of the last (5.6 to 8 mm) each element by 1 mm.
        let mut strengths = [0.0; COUNT];
        (strengths[0], strengths[15]) = (0.02, 0.04);
        let mut plant = (FORM.attach)(&strengths, spring());
        plant.step(50.0, 0.1);
        let lengths = [0.5, 1.5, 2.5].map(|k: f64| 5.6 * (8.0f64 / 5.6).powf(k / 3.0));
        let last = lengths.iter().map(|l| 1.0 - 1.0 / l).sum::<f64>() / 3.0;
        let expected = (100.0 + 80.0 * 49.0) * (1.0 - 0.02 + 0.04 * last);
        assert!((plant.step(49.0, 0.1) - expected).abs() < 1e-6);
    }

    #[test]
    fn strengths_are_linear() {
        let force = |strengths: &[f64]| drive(&mut (FORM.attach)(strengths, spring()));
        let (mut a, mut b, mut both) = ([0.0; COUNT], [0.0; COUNT], [0.0; COUNT]);
        (a[4], b[9]) = (0.01, 0.03);
        (both[4], both[9]) = (0.01, 0.03);
        let (a, b, both, none) = (force(&a), force(&b), force(&both), force(FORM.neutral));
        assert!(a != none && b != none);
        for k in 0..none.len() {
            assert!((both[k] + none[k] - a[k] - b[k]).abs() < 1e-9);
        }
    }
}
