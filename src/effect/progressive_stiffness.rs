//! Stiffness that rises beyond a deflection, as when a helper leaf touches.
//!
//! ```text
//! F = F_in + k u_0 (e / u_0)^p,  e = (u + sqrt(u^2 + w^2)) / 2,  u = x - x_k,  u_0 = 5 mm
//! ```
//! k: `extra_rate_n_per_mm`. x_k: `knee_mm`. w: `width_mm`, width of the knee. p: `exponent`. x: displacement, mm. F_in: force of the plant
//! inside, N. For w = 0 and p = 1 this is k max(0, u).
//! Source: bilinear stiffness of Polach and Hajzman, eq. 1, here as a force over displacement and with a hyperbolic knee.
//! A power above 1 is a contact that grows, as of a leaf that rolls onto the next or a rubber stop. Range: one knee.

use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, with_more_load, wrapped};
use crate::model::{Parameter, Plant};

/// Travel past the knee at which the added force is `extra_rate_n_per_mm` times the travel for every exponent, mm.
const REFERENCE_MM: f64 = 5.0;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "progressive_stiffness",
    stage: Stage::Specimen,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "extra_rate_n_per_mm",
            unit: "N/mm",
            start: 5.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 150.0],
            what: "rate that is added beyond the knee",
        },
        Parameter {
            name: "knee_mm",
            unit: "mm",
            start: 5.0,
            bounds: [-1000.0, 1000.0],
            belief: [-100.0, 100.0],
            what: "displacement at which the helper leaf touches",
        },
        Parameter {
            name: "width_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 5.0],
            belief: [0.001, 3.0],
            what: "width of the transition at the knee",
        },
        Parameter {
            name: "exponent",
            unit: "",
            start: 1.0,
            bounds: [1.0, 3.0],
            belief: [1.0, 3.0],
            what: "power of the travel beyond the knee: 1 for a constant added rate",
        },
    ],
    neutral: &[0.0, 5.0, 0.3, 1.0],
    amplitudes: &[0],
    kinks: &[(1, Axis::DisplacementMm)],
    shapes: &[3],
    starts: |s| {
        [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
            .map(|p| vec![1.0, s.displacement_at(p), 0.2, 1.1])
            .to_vec()
    },
    statement: |v| {
        format!(
            "Beyond {:.2} mm the spring is stiffer by {:.1} N/mm. Possible cause: a helper leaf touches there.",
            v[1], v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            ProgressiveStiffness {
                extra_rate_n_per_mm: v[0],
                knee_mm: v[1],
                width_mm: v[2],
                exponent: v[3],
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
    confusable_with: &[
        LookAlike {
            code: "geometric_stiffness",
            why: "within a short travel, a knee and a smooth curve look the same",
            test: "a slow ramp over the whole travel: a knee has a fixed position, a smooth curve continues",
        },
        LookAlike {
            code: "series_compliance",
            why: "a seat that closes under load stiffens the characteristic as a helper leaf does",
            test: "a second LVDT between board and frame: it measures the deformation of the seat",
        },
        LookAlike {
            code: "lift_off",
            why: "a contact that closes over a travel stiffens the characteristic as a helper leaf does",
            test: "a slow ramp that starts 1 mm above the free height",
        },
    ],
};

#[derive(Clone)]
struct ProgressiveStiffness {
    extra_rate_n_per_mm: f64,
    knee_mm: f64,
    width_mm: f64,
    exponent: f64,
    extra_n: f64,
}

impl Wrap for ProgressiveStiffness {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let past_mm = displacement_mm - self.knee_mm;
        let engaged_mm = 0.5 * (past_mm + (past_mm * past_mm + self.width_mm * self.width_mm).sqrt());
        self.extra_n =
            self.extra_rate_n_per_mm * REFERENCE_MM * (engaged_mm / REFERENCE_MM).powf(self.exponent);
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
        let mut plant = (EFFECT.attach)(&[10.0, 2.0, 4.0, 1.0], spring());
        assert!((plant.step(5.0, 0.1) - 540.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[12.0, 7.0, 0.4, 1.3]);
    }
}
