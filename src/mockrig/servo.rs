//! The firmware's servo loop, once per tick: PI on the error, feed-forward from the commands ahead, one valve. The set point
//! comes from `firmware`; the hydraulics are in `actuator`.

use serde::{Deserialize, Serialize};

use super::{OutOfRange, first_out_of_range};
use crate::protocol::tick::{TICK_S, ticks_in_ms};
use crate::units::Mode;

/// Gains of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ServoConfig {
    /// Speed per mm of error in displacement control, 1/s.
    pub displacement_gain_per_s: f64,
    /// Integral gain in displacement control, 1/s2.
    pub displacement_integral_per_s2: f64,
    /// Force rate per N of error in force control, 1/s; divided by the specimen's stiffness it is a speed.
    pub force_gain_per_s: f64,
    /// Integral gain in force control, 1/s2.
    pub force_integral_per_s2: f64,
    /// Fraction of the commands' rate that is fed forward to the valve, 0 to 1.
    pub feed_forward: f64,
    /// Lead of the feed-forward in the queue, ms: the lag of valve and sample-and-hold.
    pub lead_ms: u32,
    /// Lag of the feedback (anti-alias filter) in ms.
    pub feedback_lag_ms: f64,
    /// Stiffness of the specimen at the start of force control, N/mm; it is then estimated while the rig moves.
    pub specimen_rate_n_per_mm: f64,
    /// Speed limit in force control before the pusher touches the specimen, mm/s.
    pub approach_mm_s: f64,
    /// Speed at full valve without load that the loop assumes, mm/s.
    pub full_speed_mm_s: f64,
    /// Force at which the valve has no flow left, N.
    pub stall_force_n: f64,
}

impl Default for ServoConfig {
    fn default() -> Self {
        ServoConfig {
            displacement_gain_per_s: 50.0,
            displacement_integral_per_s2: 150.0,
            force_gain_per_s: 25.0,
            force_integral_per_s2: 120.0,
            feed_forward: 0.9,
            lead_ms: 4,
            feedback_lag_ms: 0.75,
            specimen_rate_n_per_mm: 100.0,
            approach_mm_s: 5.0,
            full_speed_mm_s: 350.0,
            stall_force_n: 25_000.0,
        }
    }
}

impl ServoConfig {
    /// The first field that is out of range, with its range.
    pub(super) fn fault(&self) -> Option<OutOfRange> {
        first_out_of_range([
            (
                "displacement_gain_per_s",
                self.displacement_gain_per_s,
                0.1..=1e3,
                "0.1 to 1000",
            ),
            (
                "displacement_integral_per_s2",
                self.displacement_integral_per_s2,
                0.0..=1e5,
                "0 to 1e5",
            ),
            (
                "force_gain_per_s",
                self.force_gain_per_s,
                0.1..=1e3,
                "0.1 to 1000",
            ),
            (
                "force_integral_per_s2",
                self.force_integral_per_s2,
                0.0..=1e5,
                "0 to 1e5",
            ),
            ("feed_forward", self.feed_forward, 0.0..=1.0, "0 to 1"),
            ("lead_ms", f64::from(self.lead_ms), 0.0..=50.0, "0 to 50"),
            ("feedback_lag_ms", self.feedback_lag_ms, 0.0..=50.0, "0 to 50"),
            (
                "specimen_rate_n_per_mm",
                self.specimen_rate_n_per_mm,
                0.1..=1e5,
                "0.1 to 1e5",
            ),
            ("approach_mm_s", self.approach_mm_s, 0.1..=100.0, "0.1 to 100"),
            ("full_speed_mm_s", self.full_speed_mm_s, 1.0..=5e3, "1 to 5000"),
            ("stall_force_n", self.stall_force_n, 100.0..=1e6, "100 to 1e6"),
        ])
    }
}

/// Seconds in a millisecond.
const S_PER_MS: f64 = 1e-3;
/// Limit of the integral part, mm/s: it corrects offsets and does not move the rig.
const INTEGRAL_MAX_MM_S: f64 = 20.0;
/// Below this force the pusher does not touch the specimen, N.
const TOUCH_N: f64 = 5.0;

/// The target of one tick, in mm or N and their rates per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ServoTarget {
    /// Channel under control.
    pub mode: Mode,
    /// Set point at this tick, mm or N.
    pub value: f64,
    /// Rate of the set point at this tick, per second.
    pub rate: f64,
    /// Rate of the set point one lead later, where known, per second.
    pub rate_ahead: f64,
}

/// The servo loop with its state.
#[derive(Debug, Clone)]
pub(crate) struct Servo {
    config: ServoConfig,
    mode: Mode,
    integral_mm_s: f64,
    specimen: StiffnessEstimate,
    force_rate_sign: f64,
    speed_mm_s: f64,
}

impl Servo {
    /// A loop at rest.
    pub(crate) fn new(config: &ServoConfig) -> Self {
        Servo {
            mode: Mode::Displacement,
            integral_mm_s: 0.0,
            specimen: StiffnessEstimate::new(config.specimen_rate_n_per_mm),
            force_rate_sign: 0.0,
            speed_mm_s: 0.0,
            config: config.clone(),
        }
    }

    /// Resets the loop when the pressure is switched on.
    pub(crate) fn engage(&mut self) {
        *self = Servo::new(&self.config);
    }

    /// Lead of [`ServoTarget::rate_ahead`] in ticks.
    pub(crate) fn lead_ticks(&self) -> u64 {
        ticks_in_ms(u64::from(self.config.lead_ms))
    }

    /// Speed that the loop demanded of the valve in the last tick, mm/s.
    pub(crate) fn speed_mm_s(&self) -> f64 {
        self.speed_mm_s
    }

    /// One tick: feedback in, valve command (-1 to 1) out.
    pub(crate) fn step(&mut self, target: ServoTarget, displacement_mm: f64, force_n: f64) -> f64 {
        self.specimen.observe(displacement_mm, force_n);
        if target.mode != self.mode {
            // Bumpless: the integral part is a speed offset and valid for both channels.
            self.mode = target.mode;
            self.specimen.anchor(displacement_mm, force_n);
        }
        let lagging = target.value - target.rate * self.config.feedback_lag_ms * S_PER_MS;
        let speed_mm_s = match target.mode {
            Mode::Displacement => self.regulate(
                target.rate_ahead,
                lagging - displacement_mm,
                self.config.displacement_gain_per_s,
                self.config.displacement_integral_per_s2,
            ),
            Mode::Force => self.force_speed(target, lagging - force_n, force_n),
        };
        // The valve passes less oil against the load, more with it.
        let load = (force_n / self.config.stall_force_n).clamp(-0.9, 0.9) * speed_mm_s.signum();
        let valve = speed_mm_s / (self.config.full_speed_mm_s * (1.0 - load).sqrt());
        self.speed_mm_s = speed_mm_s;
        valve.clamp(-1.0, 1.0)
    }

    fn force_speed(&mut self, target: ServoTarget, error_n: f64, force_n: f64) -> f64 {
        if target.rate_ahead != 0.0 && target.rate_ahead.signum() != self.force_rate_sign {
            // After a reversal a spring with friction is several times as stiff until it slides again.
            if self.force_rate_sign != 0.0 {
                self.specimen.reverse();
            }
            self.force_rate_sign = target.rate_ahead.signum();
        }
        let per_rate = 1.0 / self.specimen.n_per_mm;
        let speed = self.regulate(
            target.rate_ahead * per_rate,
            error_n * per_rate,
            self.config.force_gain_per_s,
            self.config.force_integral_per_s2,
        );
        if force_n < TOUCH_N {
            speed.clamp(-self.config.approach_mm_s, self.config.approach_mm_s)
        } else {
            speed
        }
    }

    fn regulate(&mut self, forward_mm_s: f64, error_mm: f64, gain: f64, integral: f64) -> f64 {
        let unsaturated = self.speed_mm_s.abs() < self.config.full_speed_mm_s;
        if unsaturated {
            let next = self.integral_mm_s + integral * error_mm * TICK_S;
            self.integral_mm_s = next.clamp(-INTEGRAL_MAX_MM_S, INTEGRAL_MAX_MM_S);
        }
        self.config.feed_forward * forward_mm_s + gain * error_mm + self.integral_mm_s
    }
}

/// Estimate of the specimen's tangent stiffness while the rig moves: the secant between two positions that are far apart
/// compared with the noise of both channels.
#[derive(Debug, Clone)]
struct StiffnessEstimate {
    n_per_mm: f64,
    nominal: f64,
    anchor_mm: f64,
    anchor_n: f64,
}

impl StiffnessEstimate {
    /// Distance between the two positions, mm: 20 counts of the LVDT.
    const BASE_MM: f64 = 0.01;
    /// Factor on the stiffness just after a reversal.
    const REVERSAL: f64 = 6.0;

    fn new(nominal: f64) -> Self {
        StiffnessEstimate {
            n_per_mm: nominal,
            nominal,
            anchor_mm: 0.0,
            anchor_n: 0.0,
        }
    }

    fn anchor(&mut self, displacement_mm: f64, force_n: f64) {
        (self.anchor_mm, self.anchor_n) = (displacement_mm, force_n);
    }

    fn observe(&mut self, displacement_mm: f64, force_n: f64) {
        let moved = displacement_mm - self.anchor_mm;
        if moved.abs() >= Self::BASE_MM {
            let seen = (force_n - self.anchor_n) / moved;
            // The mean of old and new value, limited so that the loop gets neither too fast nor too slow.
            let blend = 0.5 * (self.n_per_mm + seen);
            self.n_per_mm = blend.clamp(0.3 * self.nominal, 20.0 * self.nominal);
            self.anchor(displacement_mm, force_n);
        }
    }

    fn reverse(&mut self) {
        self.n_per_mm = (self.n_per_mm * Self::REVERSAL).min(20.0 * self.nominal);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn valve_command_by_hand() {
        let mut servo = Servo::new(&ServoConfig {
            displacement_integral_per_s2: 0.0,
            ..ServoConfig::default()
        });
        let target = ServoTarget {
            mode: Mode::Displacement,
            value: 1.0,
            rate: 20.0,
            rate_ahead: 30.0,
        };
        // Error 1 - 20 * 0.75 ms - 0.885 = 0.1 mm: 0.9 * 30 + 50 * 0.1 = 32 mm/s of 350, against a fifth of the stall force.
        let valve = servo.step(target, 0.885, 5000.0);
        assert!((valve - 32.0 / (350.0 * 0.8f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn the_stiffness_of_the_specimen_is_estimated_while_moving() {
        let mut estimate = StiffnessEstimate::new(100.0);
        for i in 0..200 {
            let x = 0.002 * f64::from(i);
            estimate.observe(x, 250.0 * x);
        }
        assert!((estimate.n_per_mm - 250.0).abs() < 1e-3);
    }
}
