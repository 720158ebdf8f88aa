//! Force that decays at constant displacement: one Maxwell element in parallel with the spring.
//!
//! ```text
//! F = F_in + q,  dq/dt = k dx/dt - q / tau
//! ```
//! q: force of the Maxwell element, N. k: `arm_rate_n_per_mm`. tau: `time_constant_s`. x: displacement, mm. F_in: force of
//! the plant inside, N. Each step is exact for constant speed within the step.
//! Source: standard linear solid, C. Zener, Elasticity and Anelasticity of Metals (1948).
//! Range: small strain, one time constant. Friction cannot produce this decay, because it does not change at rest.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "relaxation",
    stage: Stage::Specimen,
    parameters: &[
        Parameter {
            name: "arm_rate_n_per_mm",
            unit: "N/mm",
            start: 2.0,
            bounds: [0.0, 1000.0],
            belief: [0.0, 50.0],
            what: "rate of the spring that relaxes",
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
            "The force relaxes at constant displacement: a part of {:.2} N/mm of the rate decays with a time constant of {:.2} s.",
            v[0], v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            Relaxation {
                arm_rate_n_per_mm: v[0],
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
            why: "within one ramp, relaxation and drift both change the force slowly with time",
            test: "a hold of 60 s loaded, then a hold of 60 s unloaded: relaxation reverses, drift continues",
        },
        LookAlike {
            code: "stribeck",
            why: "with both, slow branches differ from fast branches",
            test: "a hold of 60 s after loading and one after unloading: relaxation changes the force at rest, friction does not",
        },
    ],
};

#[derive(Clone)]
struct Relaxation {
    arm_rate_n_per_mm: f64,
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
        let loaded_n = self.arm_rate_n_per_mm * (displacement_mm - self.displacement_mm);
        self.displacement_mm = displacement_mm;
        let times = dt_s / self.time_constant_s;
        // Mean of exp(-t / tau) over the step: the share of the force added in this step that is left at its end.
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
        // A step of 5 mm at 4 N/mm adds 20 N; after one time constant 20/e N are left.
        let mut plant = (EFFECT.attach)(&[4.0, 10.0], spring());
        assert!((plant.step(5.0, 0.0) - 520.0).abs() < 1e-9);
        assert!((plant.step(5.0, 10.0) - (500.0 + 20.0 * (-1.0f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[4.0, 8.0]);
    }
}
