//! Zero of the load cell that moves with time.
//!
//! ```text
//! F = F_in + d (1 - exp(-r t)) / r
//! ```
//! d: `drift_n_per_min`, at the start. r: `settling_per_min`; at 0 the drift is d t. t: time since the start of the recording,
//! min. F_in: force of the plant inside, N.
//! Source: thermal drift of an amplifier that warms up, a first-order thermal system. Range: one time constant. Each recording starts from its own zero.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "sensor_drift",
    stage: Stage::Sensor,
    follows_path: false,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "drift_n_per_min",
            unit: "N/min",
            start: 0.0,
            bounds: [-10000.0, 10000.0],
            belief: [-100.0, 100.0],
            what: "change of the zero with time at the start",
        },
        Parameter {
            name: "settling_per_min",
            unit: "1/min",
            start: 0.0,
            bounds: [0.0, 60.0],
            belief: [0.0, 20.0],
            what: "share of the drift that settles in a minute: 0 for a drift that goes on",
        },
    ],
    neutral: &[0.0, 0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[1],
    starts: |_| vec![vec![1.0, 0.0], vec![1.0, 5.0]],
    statement: |v| {
        format!(
            "The zero of the force channel drifts by {:+.2} N per minute.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            SensorDrift {
                drift_n_per_s: v[0] / 60.0,
                settling_per_s: v[1] / 60.0,
                time_s: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[
        LookAlike {
            code: "relaxation",
            why: "within one ramp, relaxation and drift both change the force slowly with time",
            test: "a hold of 60 s loaded, then a hold of 60 s unloaded: relaxation reverses, drift continues",
        },
        LookAlike {
            code: "run_in",
            why: "in one recording, a slow change with time is also a slow change with cycles",
            test: "two blocks of cycles with a pause of some minutes between them: drift continues in the pause, run-in does not",
        },
    ],
};

#[derive(Clone)]
struct SensorDrift {
    drift_n_per_s: f64,
    settling_per_s: f64,
    time_s: f64,
}

impl Wrap for SensorDrift {
    fn reset(&mut self) {
        self.time_s = 0.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.time_s += dt_s;
        let settled = self.settling_per_s * self.time_s;
        let effective_s = if settled > 1e-9 {
            -(-settled).exp_m1() / self.settling_per_s
        } else {
            self.time_s
        };
        inside.step(displacement_mm, dt_s) + self.drift_n_per_s * effective_s
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
        // 30 s at 12 N/min; with a settling of 2/min it is 6 (1 - 1/e) N.
        let mut plant = (EFFECT.attach)(&[12.0, 0.0], spring());
        assert!((plant.step(5.0, 30.0) - 506.0).abs() < 1e-9);
        let mut plant = (EFFECT.attach)(&[12.0, 2.0], spring());
        assert!((plant.step(5.0, 30.0) - 500.0 - 6.0 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[-20.0, 1.5]);
    }
}
