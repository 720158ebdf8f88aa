//! The limits of a bench in physical units, and the same limits in the counts that the firmware holds. A tare moves the
//! counts, so that each limit stays where people see it.

use super::channel::Channels;
use crate::protocol::message::{COUNTS_MAX, Limits};
use crate::recording::ChannelScale;
use crate::units::Command;

/// Limits in N, mm and ms, of tared readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PhysicalLimits {
    /// Upper force limit, N.
    pub force_max_n: f64,
    /// Lower force limit, N.
    pub force_min_n: f64,
    /// Upper displacement limit, mm.
    pub displacement_max_mm: f64,
    /// Lower displacement limit, mm.
    pub displacement_min_mm: f64,
    /// Largest speed of the LVDT, mm/s.
    pub velocity_max_mm_s: f64,
    /// Allowed following error in displacement control, mm.
    pub following_error_mm: f64,
    /// Allowed following error in force control, N.
    pub following_error_n: f64,
    /// The rig unloads without a lease after this time, ms.
    pub lease_ms: i32,
    /// A hold becomes an unload after this time, ms.
    pub hold_timeout_ms: i32,
    /// Speed of the unload ramp, mm/s.
    pub unload_velocity_mm_s: f64,
    /// The rig holds if its queue has less than this left, ms.
    pub queue_low_ms: i32,
    /// The specimen counts as unloaded at or below this force, N.
    pub unloaded_force_n: f64,
    /// The unload ramp ends at this displacement at the latest, mm.
    pub retract_mm: f64,
}

impl PhysicalLimits {
    /// The command, or the limit that it is beyond: a correction of the amplitude on a channel that reads wrong may ask for more than
    /// the profile does.
    pub(super) fn within(&self, command: Command) -> Command {
        match command {
            Command::Force(n) => Command::Force(n.clamp(self.force_min_n, self.force_max_n)),
            Command::Displacement(mm) => {
                Command::Displacement(mm.clamp(self.displacement_min_mm, self.displacement_max_mm))
            }
        }
    }

    /// The limits as the firmware holds them, for these scalings, tare included.
    pub(crate) fn in_counts(&self, channels: &Channels) -> Limits {
        let (force, displacement) = (&channels.force, &channels.displacement);
        // A negative sign turns the upper limit into the lower one.
        let range = |scale: &ChannelScale, low: f64, high: f64| {
            let (a, b) = (scale.counts(low), scale.counts(high));
            (a.min(b), a.max(b))
        };
        let (force_min_counts, force_max_counts) = range(force, self.force_min_n, self.force_max_n);
        let (displacement_min_counts, displacement_max_counts) =
            range(displacement, self.displacement_min_mm, self.displacement_max_mm);
        // Where a curved calibration is steepest, a width has the fewest counts: the limit holds over the whole range.
        let steepest = |scale: &ChannelScale, low: f64, high: f64| {
            let slope = |value: f64| scale.slope_per_count(value).abs();
            slope(low).max(slope(high))
        };
        let force_slope = steepest(force, self.force_min_n, self.force_max_n);
        let displacement_slope = steepest(displacement, self.displacement_min_mm, self.displacement_max_mm);
        let width = |value: f64, slope_per_count: f64| (value / slope_per_count).round() as i32;
        Limits {
            force_max_counts,
            force_min_counts,
            displacement_max_counts,
            displacement_min_counts,
            velocity_max_counts_s: width(self.velocity_max_mm_s, displacement_slope),
            following_error_displacement_counts: width(self.following_error_mm, displacement_slope),
            following_error_force_counts: width(self.following_error_n, force_slope),
            lease_ms: self.lease_ms,
            hold_timeout_ms: self.hold_timeout_ms,
            unload_velocity_counts_s: width(self.unload_velocity_mm_s, displacement_slope),
            queue_low_ms: self.queue_low_ms,
            unloaded_force_counts: force.counts(self.unloaded_force_n),
            retract_counts: displacement.counts(self.retract_mm),
        }
    }
}

/// The channel whose counts cannot carry these limits, by name.
pub(super) fn channel_beyond_its_counts(limits: &Limits) -> Option<&'static str> {
    let beyond = |counts: &[i32]| counts.iter().any(|c| c.abs() > COUNTS_MAX);
    if beyond(&[
        limits.force_max_counts,
        limits.force_min_counts,
        limits.unloaded_force_counts,
    ]) {
        return Some("load cell");
    }
    beyond(&[
        limits.displacement_max_counts,
        limits.displacement_min_counts,
        limits.retract_counts,
    ])
    .then_some("LVDT")
}

#[cfg(test)]
impl PhysicalLimits {
    /// Limits of a bench of 4000 N and 45 mm.
    pub(crate) const EXAMPLE: PhysicalLimits = PhysicalLimits {
        force_max_n: 4000.0,
        force_min_n: -200.0,
        displacement_max_mm: 45.0,
        displacement_min_mm: -5.0,
        velocity_max_mm_s: 500.0,
        following_error_mm: 2.0,
        following_error_n: 500.0,
        lease_ms: 50,
        hold_timeout_ms: 30_000,
        unload_velocity_mm_s: 5.0,
        queue_low_ms: 30,
        unloaded_force_n: 20.0,
        retract_mm: 0.0,
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_beyond_a_limit_becomes_the_limit() {
        let within = |command| PhysicalLimits::EXAMPLE.within(command);
        assert_eq!(within(Command::Displacement(47.8)), Command::Displacement(45.0));
        assert_eq!(within(Command::Displacement(-6.0)), Command::Displacement(-5.0));
        assert_eq!(within(Command::Force(4100.0)), Command::Force(4000.0));
        assert_eq!(within(Command::Force(12.5)), Command::Force(12.5));
    }

    fn channels(tare_n: f64, tare_mm: f64, sign: f64) -> Channels {
        let scale = |per_count: f64, tare| ChannelScale {
            scale_per_count: sign * per_count,
            offset: 0.0,
            tare,
            curve: [0.0; 2],
        };
        Channels {
            force: scale(0.1, tare_n),
            displacement: scale(0.0005, tare_mm),
        }
    }

    #[test]
    fn a_tare_moves_every_limit_of_place_and_no_width() {
        let limits = PhysicalLimits::EXAMPLE;
        let plain = limits.in_counts(&channels(0.0, 0.0, 1.0));
        let tared = limits.in_counts(&channels(150.0, 1.0, 1.0));
        assert_eq!(tared.force_max_counts - plain.force_max_counts, 1500);
        assert_eq!(tared.force_min_counts - plain.force_min_counts, 1500);
        assert_eq!(tared.unloaded_force_counts - plain.unloaded_force_counts, 1500);
        assert_eq!(
            tared.displacement_max_counts - plain.displacement_max_counts,
            2000
        );
        assert_eq!(
            tared.displacement_min_counts - plain.displacement_min_counts,
            2000
        );
        assert_eq!(tared.retract_counts - plain.retract_counts, 2000);
        let widths = |l: &Limits| {
            [
                l.velocity_max_counts_s,
                l.following_error_force_counts,
                l.unload_velocity_counts_s,
            ]
        };
        assert_eq!(widths(&tared), widths(&plain));
    }

    #[test]
    fn a_negative_sign_exchanges_the_limits() {
        let turned = PhysicalLimits::EXAMPLE.in_counts(&channels(0.0, 0.0, -1.0));
        assert_eq!(
            (turned.force_min_counts, turned.force_max_counts),
            (-40_000, 2_000)
        );
    }

    #[test]
    fn limits_beyond_the_counts_are_named() {
        let beyond = |channels| channel_beyond_its_counts(&PhysicalLimits::EXAMPLE.in_counts(&channels));
        assert_eq!(beyond(channels(0.0, 0.0, 1.0)), None);
        assert_eq!(beyond(channels(9500.0, 0.0, 1.0)), Some("load cell"));
        assert_eq!(beyond(channels(0.0, 30.0, 1.0)), Some("LVDT"));
    }
}
