//! Friction that does not vanish as the speed goes to zero, where the model's own is smoothed by speed.
//!
//! ```text
//! F = F_in (1 + c (r(x) - tanh(v / v_t)))     c friction_ratio; r drag over 0.05 mm; v_t the model's transition speed, mm/s
//! ```
//! It gives back what the smoothing takes away: nothing at speed, the whole friction in a slow ramp. Source: contact law
//! and static loop of Kadziela et al. (2015, sections 4 and 5): 0.19 J simulated against 8.91 J measured in the 120 s ramp.

use super::motion::{Drag, Rates};
use super::{Effect, LookAlike, Stage, Wrap, everywhere, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "rate_independent_friction",
    stage: Stage::Interleaf,
    what: "friction that stays in a slow ramp, where a law smoothed by speed loses it",
    parameters: &[
        Parameter {
            name: "friction_ratio",
            unit: "",
            start: 0.05,
            bounds: [0.0, 0.95],
            belief: [0.0, 0.3],
            what: "friction force over carried force",
        },
        Parameter {
            name: "transition_velocity_mm_s",
            unit: "mm/s",
            start: 5.0,
            bounds: [0.001, 1000.0],
            belief: [0.01, 100.0],
            what: "speed below which the smoothed friction fades",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.05,
            bounds: [0.001, 0.5],
            belief: [0.001, 0.3],
            what: "travel over which the friction that stays turns round after a reversal",
        },
    ],
    neutral: &[0.0, 5.0, 0.05],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| {
        vec![
            vec![0.01, 1.0, 0.05],
            vec![0.01, 10.0, 0.05],
            vec![0.01, 60.0, 0.05],
        ]
    },
    statement: |v| {
        format!(
            "A friction of {:.1} % of the load stays at low speed, where the model's friction fades below {:.2} mm/s: the fading is a numerical smoothing, not the spring.",
            100.0 * v[0],
            v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            RateIndependentFriction {
                ratio: v[0],
                transition_mm_s: v[1],
                drag: Drag::new(v[2], 1.0),
                rates: Rates::default(),
            },
            inside,
        )
    },
    if_known: |_, _| None,
    place: everywhere,
    confusable_with: &[LookAlike {
        code: "stribeck",
        why: "both add friction in the slow ramp and none at speed",
        test: "ramps of 2 s, 20 s and 120 s: a smoothed friction fades to nothing, one that is higher near rest does not",
    }],
};

#[derive(Clone)]
struct RateIndependentFriction {
    ratio: f64,
    transition_mm_s: f64,
    drag: Drag,
    rates: Rates,
}

impl Wrap for RateIndependentFriction {
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
        let smoothed = (self.rates.velocity_mm_s / self.transition_mm_s).tanh();
        let stays = self.ratio * (self.drag.step(displacement_mm) - smoothed);
        force_n + load_n(&**inside, force_n) * stays
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
        // At rest after sliding the smoothed friction is gone and the real one stays: 500 N times 1.1.
        let mut plant = (EFFECT.attach)(&[0.1, 5.0, 0.05], spring());
        plant.step(4.0, 1.0);
        plant.step(5.0, 1.0);
        for _ in 0..3 {
            plant.step(5.0, 1.0);
        }
        assert!((plant.step(5.0, 1.0) - 550.0).abs() < 1e-6);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[0.08, 12.0, 0.05]);
    }
}
