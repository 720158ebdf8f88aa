//! Stiffness that rises beyond a deflection: a helper leaf takes up contact.
//!
//! ```text
//! F = F_in + k (u + sqrt(u^2 + w^2)) / 2      u = x - knee_mm; k extra_rate_n_per_mm; w width_mm of the knee
//! ```
//! Bilinear with a hyperbolic knee: for w = 0 it is k max(0, u). Source: helper leaves, Kadziela et al. (2015, section 2).

use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, with_more_load, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "progressive_stiffness",
    stage: Stage::Specimen,
    what: "stiffness that rises beyond a deflection",
    parameters: &[
        Parameter {
            name: "extra_rate_n_per_mm",
            unit: "N/mm",
            start: 5.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 150.0],
            what: "rate added beyond the knee",
        },
        Parameter {
            name: "knee_mm",
            unit: "mm",
            start: 5.0,
            bounds: [-1000.0, 1000.0],
            belief: [-100.0, 100.0],
            what: "displacement at which the helper leaf takes up contact",
        },
        Parameter {
            name: "width_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 5.0],
            belief: [0.001, 3.0],
            what: "width over which it does",
        },
    ],
    neutral: &[0.0, 5.0, 0.3],
    amplitudes: &[0],
    kinks: &[(1, Axis::DisplacementMm)],
    starts: |s| {
        [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
            .map(|p| vec![1.0, s.displacement_at(p), 0.2])
            .to_vec()
    },
    statement: |v| {
        format!(
            "Beyond {:.2} mm the spring is stiffer by {:.1} N/mm: a helper leaf takes up contact there.",
            v[1], v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            ProgressiveStiffness {
                extra_n_per_mm: v[0],
                knee_mm: v[1],
                width_mm: v[2],
                extra_n: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: |v, s| {
        (v[1] < s.displacement_mm[1]).then(|| Place {
            axis: Axis::DisplacementMm,
            from: v[1].max(s.displacement_mm[0]),
            to: s.displacement_mm[1],
            branch: Branch::Both,
        })
    },
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "within a short range a knee and a smooth bend are alike",
        test: "a slow ramp over the whole travel: a knee stays at its place, a bend goes on",
    }],
};

#[derive(Clone)]
struct ProgressiveStiffness {
    extra_n_per_mm: f64,
    knee_mm: f64,
    width_mm: f64,
    extra_n: f64,
}

impl Wrap for ProgressiveStiffness {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let past_mm = displacement_mm - self.knee_mm;
        let taken_up_mm = 0.5 * (past_mm + past_mm.hypot(self.width_mm));
        self.extra_n = self.extra_n_per_mm * taken_up_mm;
        let force_n = inside.step(displacement_mm, dt_s);
        with_more_load(&**inside, force_n, self.extra_n)
    }

    fn carried_n(&self, inside_n: f64) -> f64 {
        inside_n + self.extra_n
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
        // 3 mm past a knee of 4 mm width, 10 N/mm: 10 * (3 + 5) / 2 = 40 N over the spring.
        let mut plant = (EFFECT.attach)(&[10.0, 2.0, 4.0], spring());
        assert!((plant.step(5.0, 0.1) - 540.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[12.0, 7.0, 0.4]);
    }
}
