//! Force that decays at constant displacement: three Maxwell arms in parallel with the spring.
//!
//! ```text
//! F = F_in + sum q_i,  dq_i/dt = (k / 3) dx/dt - q_i / tau_i,  tau_i = tau 10^(s (i - 1)),  i = 0, 1, 2
//! q_i(0) = (k / 3) (x(0) - x_h)
//! ```
//! q_i: force of an arm, N. k: `arm_rate_n_per_mm`, of all arms. tau: `time_constant_s`. s: `spread_decades`; at 0 the arms are
//! one. x_h: `held_at_mm`, where the specimen was held before the recording until the arms had relaxed. x: displacement, mm.
//! F_in: force of the plant inside, N. Each step is exact for constant speed within the step.
//! Source: standard linear solid, C. Zener, Elasticity and Anelasticity of Metals (1948); arms in parallel, E. Wiechert (1893).
//! Range: small strain, a spectrum of up to three decades. Friction cannot produce this decay, because it does not change at rest.

use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// Number of arms: with three, any spectrum over two decades is met to some percent.
const ARMS: usize = 3;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "relaxation",
    stage: Stage::Specimen,
    follows_path: false,
    only_rival: false,
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
        Parameter {
            name: "spread_decades",
            unit: "",
            start: 0.0,
            bounds: [0.0, 1.5],
            belief: [0.0, 1.5],
            what: "decades from one arm's time constant to the next: 0 for a single time constant",
        },
        Parameter {
            name: "held_at_mm",
            unit: "mm",
            start: 0.0,
            bounds: [-1000.0, 1000.0],
            belief: [-10.0, 100.0],
            what: "displacement at which the specimen was held before the recording",
        },
    ],
    neutral: &[0.0, 10.0, 0.0, 0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[2, 3],
    starts: |s| {
        [0.1, 1.0, 0.05 * s.duration_s, 0.3 * s.duration_s]
            .map(|tau| vec![0.5, tau.clamp(0.3, 1e4), 0.3, s.displacement_at(0.2)])
            .to_vec()
    },
    statement: |v| {
        format!(
            "The force relaxes at constant displacement: a part of {} N/mm of the rate decays with a time constant of {:.2} s.",
            shown(v[0], 2),
            v[1]
        )
    },
    attach: |v, inside| {
        wrapped(
            Relaxation {
                rate_n_per_mm: v[0] / ARMS as f64,
                times_s: std::array::from_fn(|i| v[1] * 10f64.powf(v[2] * (i as f64 - 1.0))),
                displacement_mm: v[3],
                held_at_mm: v[3],
                arms_n: [0.0; ARMS],
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
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
    /// Rate of one arm.
    rate_n_per_mm: f64,
    times_s: [f64; ARMS],
    held_at_mm: f64,
    /// Displacement of the last step, or where the specimen was held before the first.
    displacement_mm: f64,
    arms_n: [f64; ARMS],
}

impl Wrap for Relaxation {
    fn reset(&mut self) {
        self.displacement_mm = self.held_at_mm;
        self.arms_n = [0.0; ARMS];
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let travel_mm = displacement_mm - self.displacement_mm;
        self.displacement_mm = displacement_mm;
        let loaded_n = self.rate_n_per_mm * travel_mm;
        for (arm_n, time_s) in self.arms_n.iter_mut().zip(&self.times_s) {
            let times = dt_s / time_s;
            let faded = -(-times).exp_m1();
            // Mean of exp(-t / tau) over the step: the share of the force added in this step that is left at its end.
            let kept = if times > 1e-9 { faded / times } else { 1.0 };
            *arm_n = *arm_n * (1.0 - faded) + loaded_n * kept;
        }
        inside.step(displacement_mm, dt_s) + self.arms_n.iter().sum::<f64>()
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
        let mut plant = (EFFECT.attach)(&[4.0, 10.0, 0.0, 0.0], spring());
        assert!((plant.step(5.0, 0.0) - 520.0).abs() < 1e-9);
        assert!((plant.step(5.0, 10.0) - (500.0 + 20.0 * (-1.0f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn arms_had_relaxed_where_the_specimen_was_held() {
        let first_n =
            |held_at_mm, x_mm| (EFFECT.attach)(&[4.0, 10.0, 1.0, held_at_mm], spring()).step(x_mm, 0.0);
        assert!((first_n(5.0, 5.0) - 500.0).abs() < 1e-9);
        // Unloaded just before the recording, the arms still pull.
        assert!((first_n(5.0, 0.0) - 80.0).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[4.0, 8.0, 0.3, 6.0]);
    }
}
