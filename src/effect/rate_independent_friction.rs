//! Friction that remains at zero speed, where the friction of the model is smoothed by speed and fades.
//!
//! ```text
//! F = F_in + c E (r(x) - tanh(v / v_t))
//! ```
//! c: `friction_ratio`. E: load that the contacts carry, N (F_in if the plant has none). r: drag over `transition_mm`, -1
//! to 1 (see [`Drag`]). v: speed, mm/s. v_t: `transition_velocity_mm_s`. F_in: force of the plant inside, N.
//! It restores what the smoothing removes: nothing at high speed, the whole friction in a slow ramp.
//! Sources: Kadziela et al. (2015): section 7.5 describes the smoothed contact law, section 6 (Table 2) the static loop, with
//! 0.19 J simulated and 8.91 J measured in a ramp of over 2 minutes.
//! Range: baselines whose friction is multiplied by tanh(v / v_t).

use super::motion::{Drag, Rates};
use super::{Effect, LookAlike, Stage, Wrap, everywhere, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "rate_independent_friction",
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
            what: "friction force divided by the carried load",
        },
        Parameter {
            name: "transition_velocity_mm_s",
            unit: "mm/s",
            start: 5.0,
            bounds: [0.001, 1000.0],
            belief: [0.01, 100.0],
            what: "speed below which the smoothed friction of the model fades",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.05,
            bounds: [0.001, 0.5],
            belief: [0.001, 0.3],
            what: "travel after a reversal over which the remaining friction reverses",
        },
    ],
    neutral: &[0.0, 5.0, 0.05],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| {
        vec![
            vec![0.01, 1.0, 0.05],
            vec![0.01, 10.0, 0.05],
            vec![0.01, 60.0, 0.05],
        ]
    },
    statement: |v| {
        format!(
            "A friction of {:.1} % of the load remains at low speed. The friction of the model fades below {:.2} mm/s; this is a numerical smoothing and not a property of the spring.",
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
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "stribeck",
        why: "both add friction in the slow ramp and none at high speed",
        test: "ramps of 2 s, 20 s and 120 s: a smoothed friction fades to zero at low speed, Stribeck friction rises",
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
        let restored = self.ratio * (self.drag.step(displacement_mm) - smoothed);
        force_n + pressing_n(&**inside, force_n) * restored
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
        // At rest after sliding, the smoothed friction is zero and the added friction remains: 500 N times 1.1.
        let mut plant = (EFFECT.attach)(&[0.1, 5.0, 0.05], spring());
        plant.step(4.0, 1.0);
        plant.step(5.0, 1.0);
        for _ in 0..3 {
            plant.step(5.0, 1.0);
        }
        assert!((plant.step(5.0, 1.0) - 550.0).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.08, 12.0, 0.05]);
    }
}
