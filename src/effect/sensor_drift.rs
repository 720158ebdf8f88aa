//! Zero of the load cell that moves with time.
//!
//! ```text
//! F = F_in + d (1 - exp(-r t)) / r + sum c_k g(t - t_k),   g(s) = s^2 / (s + w) for s > 0, else 0
//! ```
//! d: `drift_n_per_min`, at the start. r: `settling_per_min`; at 0 the drift is d t. c_k: change of the rate after t_k = [`CHANGES_S`],
//! which comes about over w = [`ONSET_S`]. t: time since the start of the recording, min. F_in: force of the plant inside, N.
//! Source: thermal drift of an amplifier that warms up, a first-order thermal system. For a room that warms and cools there is no law: the
//! changes follow any slow course. Range: a course that turns at most once within 15 s. Each recording starts from its own zero.

use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Parameter, Plant};

/// Times after which the rate may change, s: denser at the start, where an amplifier warms up.
const CHANGES_S: [f64; 4] = [15.0, 35.0, 65.0, 110.0];
/// Time over which such a change comes about, s.
const ONSET_S: f64 = 10.0;

/// A parameter: by how much the rate changes after one of [`CHANGES_S`].
const fn change(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "N/min",
        start: 0.0,
        bounds: [-10000.0, 10000.0],
        belief: [-200.0, 200.0],
        what: "change of the drift's rate from this time on",
    }
}

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
        change("change_after_15_s_n_per_min"),
        change("change_after_35_s_n_per_min"),
        change("change_after_65_s_n_per_min"),
        change("change_after_110_s_n_per_min"),
    ],
    neutral: &[0.0; 6],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[1, 2, 3, 4, 5],
    starts: |_| {
        vec![
            vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            vec![1.0, 5.0, 0.0, 0.0, 0.0, 0.0],
        ]
    },
    statement,
    attach: |v, inside| {
        wrapped(
            SensorDrift {
                course: ZeroCourse::of(v),
                time_s: 0.0,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
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

/// A drift whose rate changes is told up to the last change: what comes after a change was recorded, or it would be zero.
fn statement(v: &[f64]) -> String {
    let course = ZeroCourse::of(v);
    let Some(last) = course.changes_n_per_s.iter().rposition(|c| *c != 0.0) else {
        return format!(
            "The zero of the force channel drifts by {:+.2} N per minute.",
            v[0]
        );
    };
    let until_s = CHANGES_S[last];
    let later_n_per_s = course.drift_n_per_s * (-course.settling_per_s * until_s).exp()
        + course.changes_n_per_s.iter().sum::<f64>();
    format!(
        "The zero of the force channel drifts by {:+.2} N in the first {until_s} s, then by {:+.2} N per minute.",
        course.zero_n(until_s),
        60.0 * later_n_per_s
    )
}

/// The zero over time.
#[derive(Clone)]
struct ZeroCourse {
    drift_n_per_s: f64,
    settling_per_s: f64,
    changes_n_per_s: [f64; CHANGES_S.len()],
}

impl ZeroCourse {
    /// From the values of the parameters.
    fn of(v: &[f64]) -> ZeroCourse {
        ZeroCourse {
            drift_n_per_s: v[0] / 60.0,
            settling_per_s: v[1] / 60.0,
            changes_n_per_s: std::array::from_fn(|k| v[2 + k] / 60.0),
        }
    }

    fn zero_n(&self, time_s: f64) -> f64 {
        let settled = self.settling_per_s * time_s;
        let effective_s = if settled > 1e-9 {
            -(-settled).exp_m1() / self.settling_per_s
        } else {
            time_s
        };
        let changes = self.changes_n_per_s.iter().zip(CHANGES_S);
        let changed = changes.map(|(change, from_s)| {
            let since_s = (time_s - from_s).max(0.0);
            change * since_s * since_s / (since_s + ONSET_S)
        });
        self.drift_n_per_s * effective_s + changed.sum::<f64>()
    }
}

#[derive(Clone)]
struct SensorDrift {
    course: ZeroCourse,
    time_s: f64,
}

impl Wrap for SensorDrift {
    fn reset(&mut self) {
        self.time_s = 0.0;
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.time_s += dt_s;
        inside.step(displacement_mm, dt_s) + self.course.zero_n(self.time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::{EFFECT, ZeroCourse, statement};

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn a_rate_that_changes_is_told_up_to_its_last_change() {
        let even = statement(&[12.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(
            even,
            "The zero of the force channel drifts by +12.00 N per minute."
        );
        let uneven = statement(&[12.0, 0.0, 0.0, -15.0, 0.0, 0.0]);
        assert_eq!(
            uneven,
            "The zero of the force channel drifts by +7.00 N in the first 35 s, then by -3.00 N per minute."
        );
    }

    #[test]
    fn force_by_hand() {
        // 30 s at 12 N/min; with a settling of 2/min it is 6 (1 - 1/e) N.
        let mut plant = (EFFECT.attach)(&[12.0, 0.0, 0.0, 0.0, 0.0, 0.0], spring());
        assert!((plant.step(5.0, 30.0) - 506.0).abs() < 1e-9);
        let mut plant = (EFFECT.attach)(&[12.0, 2.0, 0.0, 0.0, 0.0, 0.0], spring());
        assert!((plant.step(5.0, 30.0) - 500.0 - 6.0 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
        // -12 N/min more after 15 s, over 10 s: after 30 s it is -0.2 N/s for 15^2 / 25 s.
        let mut plant = (EFFECT.attach)(&[12.0, 0.0, -12.0, 0.0, 0.0, 60.0], spring());
        assert!((plant.step(5.0, 30.0) - 506.0 + 1.8).abs() < 1e-9);
    }

    /// The courses of a room and of an amplifier, for which the effect has no formula.
    #[test]
    fn any_slow_course_is_followed() {
        type Slow = fn(f64) -> f64;
        let courses: [(&str, Slow); 3] = [
            ("square root", |t| (60.0 * t).sqrt()),
            ("turns once", |t| t * (80.0 - t) / 40.0),
            ("turns slowly back", |t| 40.0 * (t / 30.0).sin()),
        ];
        for (name, course) in courses {
            let times: Vec<f64> = (0..=240).map(|k| 0.5 * f64::from(k)).collect();
            let unit = |k: usize| {
                let mut v = [0.0; 6];
                v[k] = 60.0;
                ZeroCourse::of(&v)
            };
            // The zero of a recording is free, too.
            let columns = [0, 2, 3, 4, 5].map(unit);
            let matrix = nalgebra::DMatrix::from_fn(times.len(), 6, |i, k| {
                columns.get(k).map_or(1.0, |c| c.zero_n(times[i]))
            });
            let wanted = nalgebra::DVector::from_iterator(times.len(), times.iter().map(|t| course(*t)));
            let solved = matrix
                .clone()
                .svd(true, true)
                .solve(&wanted, 1e-12)
                .expect("solved");
            let left = (&wanted - matrix * solved).norm() / (wanted.add_scalar(-wanted.mean())).norm();
            assert!(left < 0.05, "{name}: {left}");
        }
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[-20.0, 1.5, 0.0, 0.0, 0.0, 0.0]);
    }
}
