//! Leaves a profile smoothly: from any command, at any speed, to a level at rest, with bounded speed and acceleration.
//! When to stop is `control`'s business.

use super::player::Slot;
use crate::units::{Command, Mode};

/// Constant acceleration for some time.
#[derive(Debug, Clone, Copy)]
struct Phase {
    duration_s: f64,
    acceleration: f64,
}

/// A stop: brake, cruise at the allowed speed, come to rest at the return level. One slot a tick; all in the mode's unit.
#[derive(Debug, Clone)]
pub(crate) struct StopMotion {
    mode: Mode,
    from: f64,
    from_velocity: f64,
    to: f64,
    phases: [Phase; 3],
    sample_rate_hz: f64,
    tick: u64,
    ticks: u64,
}

impl StopMotion {
    /// From `from`, moving at `from_velocity`, to rest at `to`. `velocity_max` and `acceleration_max` are positive and per
    /// second; a faster start brakes at `acceleration_max`.
    pub(crate) fn new(
        from: Command,
        from_velocity: f64,
        to: f64,
        velocity_max: f64,
        acceleration_max: f64,
        sample_rate_hz: f64,
    ) -> Self {
        let phases = trapezoid(to - from.value(), from_velocity, velocity_max, acceleration_max);
        let duration_s: f64 = phases.iter().map(|p| p.duration_s).sum();
        StopMotion {
            mode: from.mode(),
            from: from.value(),
            from_velocity,
            to,
            phases,
            sample_rate_hz,
            tick: 0,
            ticks: ((duration_s * sample_rate_hz).ceil() as u64).max(1),
        }
    }

    /// Next slot, `None` after the last.
    #[allow(clippy::should_implement_trait, reason = "the same word as Player::next")]
    pub(crate) fn next(&mut self) -> Option<Slot> {
        if self.tick == self.ticks {
            return None;
        }
        self.tick += 1;
        let last = self.tick == self.ticks;
        let value = if last {
            self.to
        } else {
            self.value_at(self.tick as f64 / self.sample_rate_hz)
        };
        Some(Slot {
            command: Command::new(self.mode, value),
            cycle: 0,
            segment: 0,
            phase: 0.0,
            last,
            taper: false,
        })
    }

    /// Ticks from start to rest.
    pub(crate) fn total_ticks(&self) -> u64 {
        self.ticks
    }

    fn value_at(&self, time_s: f64) -> f64 {
        let (mut value, mut velocity, mut rest_s) = (self.from, self.from_velocity, time_s);
        for phase in &self.phases {
            let t = rest_s.min(phase.duration_s);
            value += velocity * t + 0.5 * phase.acceleration * t * t;
            velocity += phase.acceleration * t;
            rest_s -= t;
        }
        value
    }
}

/// The quickest three phases that cover `distance` from speed `v0` to rest.
fn trapezoid(distance: f64, v0: f64, velocity_max: f64, acceleration_max: f64) -> [Phase; 3] {
    let a = acceleration_max;
    // Where an immediate brake would end decides the direction of the cruise.
    let brake = v0 * v0.abs() / (2.0 * a);
    let direction = if distance >= brake { 1.0 } else { -1.0 };
    let cover = |cruise: f64| {
        let t1 = (cruise - v0).abs() / a;
        let t3 = cruise.abs() / a;
        (t1, t3, distance - 0.5 * (v0 + cruise) * t1 - 0.5 * cruise * t3)
    };
    let mut cruise = direction * velocity_max;
    let (mut t1, mut t3, rest) = cover(cruise);
    let mut t2 = if cruise == 0.0 { 0.0 } else { rest / cruise };
    if t2 < 0.0 {
        cruise = direction * (a * direction * distance + 0.5 * v0 * v0).max(0.0).sqrt();
        (t1, t3, _) = cover(cruise);
        t2 = 0.0;
    }
    [
        Phase {
            duration_s: t1,
            acceleration: if t1 > 0.0 { (cruise - v0) / t1 } else { 0.0 },
        },
        Phase {
            duration_s: t2,
            acceleration: 0.0,
        },
        Phase {
            duration_s: t3,
            acceleration: if t3 > 0.0 { -cruise / t3 } else { 0.0 },
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Highest speed and acceleration of a motion by differences, from its first two values on.
    fn extremes(values: &[f64], rate_hz: f64) -> (f64, f64) {
        let v: Vec<f64> = values.windows(2).map(|w| (w[1] - w[0]) * rate_hz).collect();
        let speed = v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let acceleration = v
            .windows(2)
            .fold(0.0, |m: f64, w| m.max((w[1] - w[0]).abs() * rate_hz));
        (speed, acceleration)
    }

    #[test]
    fn stops_from_every_phase_of_a_sine_within_its_bounds() {
        let (amplitude, omega, rate) = (6.0, std::f64::consts::TAU * 2.5, 1000.0);
        for step in 0..1000 {
            let phase = f64::from(step) / 1000.0 * std::f64::consts::TAU;
            let (x0, v0) = (20.0 + amplitude * phase.sin(), amplitude * omega * phase.cos());
            let mut stop = StopMotion::new(Command::Displacement(x0), v0, 0.0, 10.0, 2000.0, rate);
            let mut values = vec![x0 - v0 / rate, x0];
            while let Some(slot) = stop.next() {
                values.push(slot.command.value());
                assert_eq!(slot.last, values.len() as u64 == stop.total_ticks() + 2);
            }
            assert_eq!(values.last(), Some(&0.0), "phase {step}");
            let (speed, acceleration) = extremes(&values, rate);
            assert!(speed <= v0.abs().max(10.0) * 1.001, "phase {step}: speed {speed}");
            // A difference over two ticks of a bounded acceleration stays bounded; the last tick is a snap of less than
            // one tick's travel at rest.
            assert!(
                acceleration <= 2000.0 * 1.01,
                "phase {step}: acceleration {acceleration}"
            );
        }
    }

    #[test]
    fn a_stop_at_the_return_level_is_one_slot() {
        let mut stop = StopMotion::new(Command::Force(5.0), 0.0, 5.0, 100.0, 100.0, 1000.0);
        let slot = stop.next();
        assert_eq!(
            slot.map(|s| (s.command, s.last)),
            Some((Command::Force(5.0), true))
        );
        assert_eq!(stop.next(), None);
    }
}
