//! Friction that is higher near zero speed.
//!
//! ```text
//! F = F_in (1 + c r(x) exp(-|v| / v_s))       c extra_ratio: what is added at rest; v_s fading speed, mm/s; r drag over 0.1 mm
//! ```
//! Source: R. Stribeck (1902); exponential form of Bo and Pavelescu (1982), exponent 1. Here in proportion to the load,
//! as the interleaf friction it belongs to. Stick-slip is not in it: it needs the rig's own compliance.

use super::motion::{Drag, Rates};
use super::{Axis, Branch, Effect, LookAlike, Place, Stage, Wrap, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "stribeck",
    stage: Stage::Interleaf,
    what: "friction that is higher near zero speed",
    parameters: &[
        Parameter {
            name: "extra_ratio",
            unit: "",
            start: 0.03,
            bounds: [0.0, 0.5],
            belief: [0.0, 0.15],
            what: "friction over load that is added at rest",
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
            what: "1 fades exponentially, 2 like a bell (Bo and Pavelescu 1982)",
        },
    ],
    neutral: &[0.0, 5.0, 1.5],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| vec![vec![0.01, 1.0, 1.5], vec![0.01, 5.0, 1.5], vec![0.01, 30.0, 1.5]],
    statement: |v| {
        format!(
            "Friction is higher near rest: {:.1} % of the load more than at speed, fading over {:.1} mm/s.",
            100.0 * v[0],
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
    confusable_with: &[
        LookAlike {
            code: "rate_independent_friction",
            why: "both add friction in the slow ramp and none at speed",
            test: "ramps of 2 s, 20 s and 120 s",
        },
        LookAlike {
            code: "relaxation",
            why: "a slow branch that lies lower and higher than the fast ones looks like decay",
            test: "a hold of 60 s after loading and one after unloading: friction does not move while nothing moves",
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
        let fading = (-(self.rates.velocity_mm_s.abs() / self.fading_mm_s).powf(self.exponent)).exp();
        force_n + load_n(&**inside, force_n) * self.ratio * self.drag.step(displacement_mm) * fading
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
        // 1 mm/s, steady: 500 N times 1 + 0.1 exp(-0.2).
        let mut plant = (EFFECT.attach)(&[0.1, 5.0, 1.0], spring());
        let force_n = (0..=5).map(|i| plant.step(f64::from(i), 1.0)).fold(0.0, |_, f| f);
        assert!((force_n - 500.0 * (1.0 + 0.1 * (-0.2f64).exp())).abs() < 1e-6);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[0.08, 12.0, 1.5]);
    }
}
