//! Stiffness that changes smoothly with deflection, from the geometry of shackle and camber.
//!
//! ```text
//! F = F_in + a x^2 / 2 + b x^3 / 6
//! ```
//! a: `curvature_n_per_mm2`, change of the rate dk/dx at the datum. b: `cubic_n_per_mm3`, change of a with x.
//! x: displacement, mm. F_in: force of the plant inside, N.
//! Sources: Taylor series of a smooth linkage, such as the shackle linkage of the Chula thesis (eq. 5-6). The loading
//! branch measured there (Table 5-1) softens by about a third over its travel.
//! Range: travels in which the linkage angle changes smoothly; not beyond the recorded displacement.

use super::wording::signed;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, with_more_load, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "geometric_stiffness",
    stage: Stage::Mounting,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "curvature_n_per_mm2",
            unit: "N/mm2",
            start: 0.1,
            bounds: [-100.0, 100.0],
            belief: [-10.0, 10.0],
            what: "change of the rate with the deflection, at the datum",
        },
        Parameter {
            name: "cubic_n_per_mm3",
            unit: "N/mm3",
            start: 0.0,
            bounds: [-20.0, 20.0],
            belief: [-1.0, 1.0],
            what: "change of the curvature with the deflection",
        },
    ],
    neutral: &[0.0, 0.0],
    amplitudes: &[0, 1],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.1, 0.0]],
    statement: |v| {
        format!(
            "The rate changes smoothly with deflection, by {} N/mm for each mm at the datum. Possible causes: geometry of shackle or camber.",
            signed(v[0], 2)
        )
    },
    attach: |v, inside| {
        wrapped(
            GeometricStiffness {
                curvature_n_per_mm2: v[0],
                cubic_n_per_mm3: v[1],
                extra_n: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "progressive_stiffness",
            why: "within a short travel, a knee and a smooth curve look the same",
            test: "a slow ramp over the whole travel: a knee has a fixed position, a smooth curve continues",
        },
        LookAlike {
            code: "series_compliance",
            why: "a seat that stiffens under load curves the characteristic as geometry does",
            test: "a second LVDT between board and frame: it measures the deformation of the seat",
        },
        LookAlike {
            code: "lift_off",
            why: "near zero load, a contact that closes over a travel curves the characteristic as geometry does",
            test: "a slow ramp that starts 1 mm above the free height",
        },
        LookAlike {
            code: "sensor_curvature",
            why: "a channel that is not straight curves the characteristic as geometry does",
            test: "a calibration of both channels at five points or more: it shows whether one of them is curved",
        },
    ],
};

#[derive(Clone)]
struct GeometricStiffness {
    curvature_n_per_mm2: f64,
    cubic_n_per_mm3: f64,
    extra_n: f64,
}

impl Wrap for GeometricStiffness {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let x = displacement_mm;
        self.extra_n = x * x * (0.5 * self.curvature_n_per_mm2 + x * self.cubic_n_per_mm3 / 6.0);
        let force_n = inside.step(x, dt_s);
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
        // 5 mm: 500 + 0.8 * 12.5 + 0.06 * 125 / 6 = 511.25 N.
        let mut plant = (EFFECT.attach)(&[0.8, 0.06], spring());
        assert!((plant.step(5.0, 0.1) - 511.25).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.8, 0.03]);
    }
}
