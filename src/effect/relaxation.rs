//! Force that decays at constant displacement: one Maxwell arm beside the spring.
//!
//! ```text
//! F = F_in + q,  dq/dt = k dx/dt - q / tau     k arm_rate_n_per_mm; tau time_constant_s; exact for a straight step
//! ```
//! Source: standard linear solid (Zener 1948); GRP leaves, Table 1 of paper 002. Friction cannot do it: it does not
//! move while nothing moves.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "relaxation",
    stage: Stage::Specimen,
    what: "force that decays while the displacement stands still",
    parameters: &[
        Parameter {
            name: "arm_rate_n_per_mm",
            unit: "N/mm",
            start: 2.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 50.0],
            what: "rate of the arm that relaxes",
        },
        Parameter {
            name: "time_constant_s",
            unit: "s",
            start: 10.0,
            bounds: [0.3, 10000.0],
            belief: [0.5, 1000.0],
            what: "time after which 37 % of its force is left",
        },
    ],
    neutral: &[0.0, 10.0],
    amplitudes: &[0],
    kinks: &[],
    starts: |s| {
        [0.1, 1.0, 0.05 * s.duration_s, 0.3 * s.duration_s]
            .map(|tau| vec![0.5, tau.clamp(0.3, 1e4)])
            .to_vec()
    },
    statement: |v| {
        format!(
            "The force relaxes: an arm of {:.2} N/mm loses its force with a time constant of {:.2} s.",
            v[0], v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            Relaxation {
                arm_n_per_mm: v[0],
                time_constant_s: v[1],
                displacement_mm: 0.0,
                arm_n: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[
        LookAlike {
            code: "sensor_drift",
            why: "within one ramp a decay and a drift are alike",
            test: "a hold of 60 s unloaded, after a hold of 60 s loaded: a zero that drifts goes on",
        },
        LookAlike {
            code: "stribeck",
            why: "slow and fast branches differ for both",
            test: "a hold of 60 s after loading and one after unloading",
        },
    ],
};

#[derive(Clone)]
struct Relaxation {
    arm_n_per_mm: f64,
    time_constant_s: f64,
    displacement_mm: f64,
    arm_n: f64,
}

impl Wrap for Relaxation {
    fn reset(&mut self) {
        self.displacement_mm = 0.0;
        self.arm_n = 0.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let loaded_n = self.arm_n_per_mm * (displacement_mm - self.displacement_mm);
        self.displacement_mm = displacement_mm;
        let times = dt_s / self.time_constant_s;
        // Mean of exp over the step: the share of a steady load that is left at its end.
        let kept = if times > 1e-9 {
            -(-times).exp_m1() / times
        } else {
            1.0
        };
        self.arm_n = self.arm_n * (-times).exp() + loaded_n * kept;
        inside.step(displacement_mm, dt_s) + self.arm_n
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
        // A leap of 5 mm with 4 N/mm leaves 20 N, after one time constant 20/e.
        let mut plant = (EFFECT.attach)(&[4.0, 10.0], spring());
        assert!((plant.step(5.0, 0.0) - 520.0).abs() < 1e-9);
        assert!((plant.step(5.0, 10.0) - (500.0 + 20.0 * (-1.0f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[4.0, 8.0]);
    }
}
