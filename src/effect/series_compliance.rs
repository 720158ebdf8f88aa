//! Compliance of load frame, board or fixture between specimen and LVDT.
//!
//! ```text
//! F = F_in(x - C F)
//! ```
//! C: `compliance_mm_per_kn` / 1000, mm/N. x: displacement, mm. F_in: force of the plant inside, N. Each step solves this
//! equation by the secant method on copies of the plant inside.
//! Source: two springs in series. Range: linear, massless fixture. With a linear spring inside, the effect only lowers the
//! rate and no recording can show it.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "series_compliance",
    stage: Stage::Frame,
    parameters: &[Parameter {
        name: "compliance_mm_per_kn",
        unit: "mm/kN",
        start: 0.1,
        bounds: [0.0, 50.0],
        belief: [0.0, 5.0],
        what: "deformation of the fixture for each kN",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| vec![vec![0.05]],
    statement: |v| {
        format!(
            "A part between specimen and LVDT deforms by {:.3} mm for each kN. Possible causes: load frame, board or fixture.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            SeriesCompliance {
                mm_per_n: 1e-3 * v[0],
                force_n: 0.0,
                specimen_mm: 0.0,
                rate_n_per_mm: 100.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[LookAlike {
        code: "geometric_stiffness",
        why: "a seat that deforms curves the characteristic as geometry does",
        test: "a second LVDT between board and frame: it measures the deformation of the seat",
    }],
};

#[derive(Clone)]
struct SeriesCompliance {
    mm_per_n: f64,
    force_n: f64,
    specimen_mm: f64,
    rate_n_per_mm: f64,
}

impl Wrap for SeriesCompliance {
    fn reset(&mut self) {
        self.force_n = 0.0;
        self.specimen_mm = 0.0;
        self.rate_n_per_mm = 100.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let at = |x: f64| inside.boxed_clone().step(x, dt_s);
        // Share of the displacement step that reaches the specimen, from the last known rate.
        let share = 1.0 / (1.0 + self.mm_per_n * self.rate_n_per_mm);
        let mut x =
            self.specimen_mm + share * (displacement_mm - self.mm_per_n * self.force_n - self.specimen_mm);
        if self.mm_per_n > 0.0 {
            let mut force_n = at(x);
            // A fixed number of iterations: a convergence test would make the derivatives of a fit discontinuous.
            for _ in 0..2 {
                let short_mm = displacement_mm - self.mm_per_n * force_n - x;
                let next = x + short_mm / (1.0 + self.mm_per_n * self.rate_n_per_mm);
                let next_n = at(next);
                let rate = (next_n - force_n) / (next - x);
                if rate.is_finite() && rate > 0.0 && (next - x).abs() > 1e-7 {
                    self.rate_n_per_mm = rate;
                }
                (x, force_n) = (next, next_n);
            }
        } else {
            x = displacement_mm;
        }
        self.force_n = inside.step(x, dt_s);
        self.specimen_mm = x;
        self.force_n
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
        // 80 N/mm behind 2 mm/kN: x_s = (5 - 0.002 * 100) / 1.16, F = 100 + 80 x_s.
        let mut plant = (EFFECT.attach)(&[2.0], spring());
        // The secant method ends within 1e-9 mm.
        assert!((plant.step(5.0, 0.1) - (100.0 + 80.0 * 4.8 / 1.16)).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[1.3]);
    }
}
