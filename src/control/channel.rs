//! Conversion between counts and newtons or millimetres, and the stillness of the rig for a tare.

use crate::protocol::message::{COUNTS_INVALID, COUNTS_MAX, SAMPLE_RATE_HZ};
use crate::recording::{ChannelScale, Flags};
use crate::units::{Command, Mode};

/// Scaling of both channels of the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Channels {
    /// Scaling of the load cell, N.
    pub force: ChannelScale,
    /// Scaling of the LVDT, mm.
    pub displacement: ChannelScale,
}

/// One reading in physical units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reading {
    /// Force in N.
    pub force_n: f64,
    /// Displacement in mm.
    pub displacement_mm: f64,
    /// `FORCE_INVALID` and `DISPLACEMENT_INVALID` if the rig sent "no valid reading".
    pub flags: Flags,
}

impl Channels {
    /// The physical values of a sample's counts. An invalid reading is converted all the same and flagged.
    pub(crate) fn reading(&self, force_counts: i32, displacement_counts: i32) -> Reading {
        let mut flags = Flags::default();
        if force_counts == COUNTS_INVALID {
            flags.insert(Flags::FORCE_INVALID);
        }
        if displacement_counts == COUNTS_INVALID {
            flags.insert(Flags::DISPLACEMENT_INVALID);
        }
        Reading {
            force_n: self.force.value(force_counts),
            displacement_mm: self.displacement.value(displacement_counts),
            flags,
        }
    }

    /// Counts of a command on its own channel, limited to the channel's range.
    pub(crate) fn command_counts(&self, command: Command) -> i32 {
        let counts = match command {
            Command::Force(n) => self.force.counts(n),
            Command::Displacement(mm) => self.displacement.counts(mm),
        };
        counts.clamp(-COUNTS_MAX, COUNTS_MAX)
    }

    /// The feedback of `mode` in a reading.
    pub(crate) fn feedback(mode: Mode, reading: &Reading) -> f64 {
        match mode {
            Mode::Force => reading.force_n,
            Mode::Displacement => reading.displacement_mm,
        }
    }
}

/// The newest readings: a tare takes their mean, and needs a small standard deviation.
#[derive(Debug, Clone)]
pub(crate) struct Stillness {
    force_n: [f64; Self::SAMPLES],
    displacement_mm: [f64; Self::SAMPLES],
    count: usize,
}

/// Mean and standard deviation of both channels over the window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Still {
    /// Mean force in N.
    pub force_n: f64,
    /// Standard deviation of force in N.
    pub force_sigma_n: f64,
    /// Mean displacement in mm.
    pub displacement_mm: f64,
    /// Standard deviation of displacement in mm.
    pub displacement_sigma_mm: f64,
}

impl Default for Stillness {
    fn default() -> Self {
        Stillness {
            force_n: [0.0; Self::SAMPLES],
            displacement_mm: [0.0; Self::SAMPLES],
            count: 0,
        }
    }
}

impl Stillness {
    /// Samples of the window: 0.5 s.
    const SAMPLES: usize = SAMPLE_RATE_HZ as usize / 2;

    /// Takes one valid reading.
    pub(crate) fn push(&mut self, reading: &Reading) {
        let at = self.count % Self::SAMPLES;
        self.force_n[at] = reading.force_n;
        self.displacement_mm[at] = reading.displacement_mm;
        self.count += 1;
    }

    /// Empties the window (after a tare, a gap or an invalid reading).
    pub(crate) fn clear(&mut self) {
        self.count = 0;
    }

    /// Mean and standard deviation, once the window is full.
    pub(crate) fn measure(&self) -> Option<Still> {
        (self.count >= Self::SAMPLES).then(|| {
            let (force_n, force_sigma_n) = mean_and_sigma(&self.force_n);
            let (displacement_mm, displacement_sigma_mm) = mean_and_sigma(&self.displacement_mm);
            Still {
                force_n,
                force_sigma_n,
                displacement_mm,
                displacement_sigma_mm,
            }
        })
    }
}

fn mean_and_sigma(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::physical_limits::PhysicalLimits;

    fn channels() -> Channels {
        Channels {
            force: ChannelScale {
                scale_per_count: 0.1,
                offset: 1.0,
                tare: 2.0,
                curve: [0.0; 2],
            },
            displacement: ChannelScale {
                scale_per_count: -0.0005,
                offset: 0.0,
                tare: 0.25,
                curve: [0.0; 2],
            },
        }
    }

    #[test]
    fn counts_become_values_and_back() {
        let c = channels();
        let r = c.reading(1000, -2000);
        assert!((r.force_n - 97.0).abs() < 1e-9);
        assert!((r.displacement_mm - 0.75).abs() < 1e-9);
        assert_eq!(c.command_counts(Command::Force(97.0)), 1000);
        assert_eq!(c.command_counts(Command::Displacement(0.75)), -2000);
    }

    /// A curved load cell: limits keep their place, and a speed is never allowed more counts than the steepest part has.
    #[test]
    fn a_curved_channel_commands_what_it_reads_and_keeps_its_limits() {
        let mut c = channels();
        c.force.curve = [5e-6, -1e-10];
        for n in [-150.0, 0.0, 97.0, 3200.0] {
            let counts = c.command_counts(Command::Force(n));
            // Half a count, with the slope there.
            assert!((c.reading(counts, 0).force_n - n).abs() < 0.052, "{n}");
        }
        let limits = PhysicalLimits::EXAMPLE.in_counts(&c);
        assert_eq!(limits.force_max_counts, c.command_counts(Command::Force(4000.0)));
        let straight = PhysicalLimits::EXAMPLE.in_counts(&channels());
        assert!(limits.following_error_force_counts < straight.following_error_force_counts);
    }

    #[test]
    fn an_open_sensor_is_flagged_and_a_command_out_of_range_is_limited() {
        let r = channels().reading(COUNTS_INVALID, 5);
        assert!(r.flags.contains(Flags::FORCE_INVALID) && !r.flags.contains(Flags::DISPLACEMENT_INVALID));
        assert_eq!(channels().command_counts(Command::Force(1e9)), COUNTS_MAX);
    }

    #[test]
    fn stillness_needs_its_whole_window() {
        let mut still = Stillness::default();
        for i in 0..Stillness::SAMPLES {
            assert!(still.measure().is_none());
            let force_n = if i % 2 == 0 { 1.0 } else { 3.0 };
            still.push(&Reading {
                force_n,
                displacement_mm: 4.0,
                flags: Flags::default(),
            });
        }
        let m = still.measure().expect("window is full");
        assert!((m.force_n - 2.0).abs() < 1e-12 && (m.force_sigma_n - 1.001).abs() < 1e-3);
        assert_eq!((m.displacement_mm, m.displacement_sigma_mm), (4.0, 0.0));
    }
}
