//! Friction that is higher near zero speed.
//!
//! ```text
//! F = F_in + c E r(x) exp(-(|v| / v_s)^n)
//! ```
//! c: `extra_ratio`, friction divided by load that is added at rest. v_s: `fading_velocity_mm_s`. n: `fading_exponent`.
//! v: speed, mm/s. E: load that the contacts carry, N (F_in if the plant has none). r: drag over 0.1 mm, -1 to 1 (see
//! [`Drag`]). F_in: force of the plant inside, N.
//! Sources: R. Stribeck (1902); exponential form: L. C. Bo and D. Pavelescu (1982), where n is 0.5 to 1; n = 2 is Gaussian.
//! Range: sliding; stick-slip is not included, because it depends on the compliance of the rig.

use super::motion::{Drag, Rates};
use super::power::power_of;
use super::wording::shown;
use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "stribeck",
    stage: Stage::Interleaf,
    follows_path: false,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "extra_ratio",
            unit: "",
            start: 0.03,
            bounds: [0.0, 0.5],
            belief: [0.0, 0.15],
            what: "friction divided by load that is added at rest",
        },
        Parameter {
            name: "fading_velocity_mm_s",
            unit: "mm/s",
            start: 5.0,
            bounds: [0.05, 200.0],
            belief: [0.1, 100.0],
            what: "speed at which 37 % of the addition is left",
        },
        Parameter {
            name: "fading_exponent",
            unit: "",
            start: 1.5,
            bounds: [0.5, 2.5],
            belief: [0.5, 2.0],
            what: "shape of the decrease: 1 is exponential, 2 is Gaussian",
        },
    ],
    neutral: &[0.0, 5.0, 1.5],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.01, 1.0, 1.5], vec![0.01, 5.0, 1.5], vec![0.01, 30.0, 1.5]],
    statement: |v| {
        format!(
            "Friction is higher near zero speed: by {} % of the load at rest. The addition fades over {:.1} mm/s.",
            shown(100.0 * v[0], 1),
            v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            Stribeck {
                ratio: v[0],
                fading_mm_s: v[1],
                exponent: v[2],
                drag: Drag::new(0.1, 1.0),
                rates: Rates::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: |v, _| {
        Some(Place {
            axis: Axis::VelocityMmS,
            from: 0.0,
            to: 2.0 * v[1],
            branch: Branch::Both,
        })
    },
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "rate_independent_friction",
            why: "both add friction in the slow ramp and none at high speed",
            test: "ramps of 2 s, 20 s and 120 s: a smoothed friction fades to zero at low speed, Stribeck friction rises",
        },
        LookAlike {
            code: "relaxation",
            why: "with both, slow branches differ from fast branches",
            test: "a hold of 60 s after loading and one after unloading: relaxation changes the force at rest, friction does not",
        },
    ],
};

#[derive(Clone)]
struct Stribeck {
    ratio: f64,
    fading_mm_s: f64,
    exponent: f64,
    drag: Drag,
    rates: Rates,
}

impl Wrap for Stribeck {
    fn reset(&mut self) {
        self.drag.reset();
        self.rates = Rates::default();
    }

    fn told(&mut self, motion: &Motion) {
        self.rates.tell(motion);
        self.drag.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        self.rates.step(displacement_mm, dt_s);
        let fading = (-power_of(self.rates.velocity_mm_s.abs() / self.fading_mm_s, self.exponent)).exp();
        force_n + pressing_n(&**inside, force_n) * self.ratio * self.drag.step(displacement_mm) * fading
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
        // Constant 1 mm/s: 500 N times 1 + 0.1 exp(-0.2).
        let mut plant = (EFFECT.attach)(&[0.1, 5.0, 1.0], spring());
        let force_n = (0..=5).map(|i| plant.step(f64::from(i), 1.0)).fold(0.0, |_, f| f);
        assert!((force_n - 500.0 * (1.0 + 0.1 * (-0.2f64).exp())).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.08, 12.0, 1.5]);
    }
}
