//! Brings amplitude and mean of a cyclic motion to their targets, cycle by cycle, from measured cycles. `control` measures the
//! cycles, `player` blends the correction into the command.
//!
//! Each cycle is compared with its own command: `gain = measured amplitude / commanded amplitude`, `shift = measured mean -
//! commanded mean`. The next command is the target, divided by the gain and moved by minus the shift. Since a cycle is compared
//! with its own command, it does not matter that a correction acts one or two cycles later.

/// Target of the cycles of one segment, in the unit of the profile's mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CycleTarget {
    /// Absolute mean level.
    pub mean: f64,
    /// Half of peak minus valley.
    pub amplitude: f64,
    /// True if amplitude and mean are corrected from cycle to cycle.
    pub corrected: bool,
}

/// Change of a cycle's command: `mean + mean_offset + amplitude * amplitude_factor * wave`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Correction {
    /// Factor on the amplitude of the profile.
    pub amplitude_factor: f64,
    /// Offset added to the mean of the profile, in the unit of its mode.
    pub mean_offset: f64,
}

impl Correction {
    /// No correction: the command of the profile.
    pub(crate) const NONE: Correction = Correction {
        amplitude_factor: 1.0,
        mean_offset: 0.0,
    };

    /// Linear interpolation between `self` (share 0) and `other` (share 1).
    pub(super) fn blend(self, other: Correction, share: f64) -> Correction {
        Correction {
            amplitude_factor: self.amplitude_factor
                + (other.amplitude_factor - self.amplitude_factor) * share,
            mean_offset: self.mean_offset + (other.mean_offset - self.mean_offset) * share,
        }
    }
}

/// Highest and lowest values of feedback and command in one cycle, in the unit of the profile's mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CycleMeasurement {
    /// Highest value of the feedback.
    pub peak: f64,
    /// Lowest value of the feedback.
    pub valley: f64,
    /// Highest value of the command.
    pub command_peak: f64,
    /// Lowest value of the command.
    pub command_valley: f64,
}

impl CycleMeasurement {
    /// Half of peak minus valley.
    pub(crate) fn amplitude(&self) -> f64 {
        0.5 * (self.peak - self.valley)
    }

    /// Half of peak plus valley.
    pub(crate) fn mean(&self) -> f64 {
        0.5 * (self.peak + self.valley)
    }
}

/// Range of the factor. A rig that needs more has a fault (H5), which is not to be corrected.
const FACTOR_RANGE: [f64; 2] = [0.8, 1.5];
/// Largest change of the factor from one correction to the next.
const FACTOR_STEP: f64 = 0.1;
/// Largest offset, divided by the amplitude.
const OFFSET_RANGE: f64 = 0.5;
/// Largest change of the offset from one correction to the next, divided by the amplitude.
const OFFSET_STEP: f64 = 0.1;
/// Weight of a new cycle after the first ones: averages the noise of a peak and still follows a drift.
const STEADY_WEIGHT: f64 = 0.4;
/// Number of first cycles with more than the steady weight.
const QUICK_CYCLES: u32 = 3;
/// A cycle is not used if its commanded amplitude is below this share of the target.
const LEAST_AMPLITUDE: f64 = 0.2;

/// Corrects one sine or triangle segment.
#[derive(Debug, Clone)]
pub(crate) struct CycleController {
    target: CycleTarget,
    gain: f64,
    shift: f64,
    seen: u32,
    correction: Correction,
}

impl CycleController {
    /// A controller without any correction yet.
    pub(crate) fn new(target: CycleTarget) -> Self {
        CycleController {
            target,
            gain: 1.0,
            shift: 0.0,
            seen: 0,
            correction: Correction::NONE,
        }
    }

    /// Takes one whole cycle, tapered or counted, and returns the correction for the next cycle that can still be changed.
    /// A cycle that is too small or not finite leaves the correction unchanged.
    pub(crate) fn cycle(&mut self, measured: &CycleMeasurement) -> Correction {
        let commanded = 0.5 * (measured.command_peak - measured.command_valley);
        let gain = measured.amplitude() / commanded;
        let shift = measured.mean() - 0.5 * (measured.command_peak + measured.command_valley);
        let usable = commanded >= LEAST_AMPLITUDE * self.target.amplitude
            && gain.is_finite()
            && gain > 0.0
            && shift.is_finite();
        if self.target.corrected && usable {
            self.learn(gain, shift);
            self.correction = self.limited(Correction {
                amplitude_factor: 1.0 / self.gain,
                mean_offset: -self.shift,
            });
        }
        self.correction
    }

    /// The last correction.
    pub(crate) fn correction(&self) -> Correction {
        self.correction
    }

    fn learn(&mut self, gain: f64, shift: f64) {
        self.seen = self.seen.saturating_add(1);
        // 1, 1, 2/3, then steady: full cycles soon have more weight than tapered ones.
        let weight = match self.seen {
            0..=2 => 1.0,
            QUICK_CYCLES => 2.0 / 3.0,
            _ => STEADY_WEIGHT,
        };
        self.gain += weight * (gain - self.gain);
        self.shift += weight * (shift - self.shift);
    }

    fn limited(&self, wanted: Correction) -> Correction {
        let (now, amplitude) = (self.correction, self.target.amplitude);
        let step = |from: f64, to: f64, most: f64| from + (to - from).clamp(-most, most);
        Correction {
            amplitude_factor: step(now.amplitude_factor, wanted.amplitude_factor, FACTOR_STEP)
                .clamp(FACTOR_RANGE[0], FACTOR_RANGE[1]),
            mean_offset: step(now.mean_offset, wanted.mean_offset, OFFSET_STEP * amplitude)
                .clamp(-OFFSET_RANGE * amplitude, OFFSET_RANGE * amplitude),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Block, CycleSegment, Level, Player, Profile, Segment, Wave};
    use crate::units::Mode;
    use rand::{RngExt, SeedableRng};

    const RATE_HZ: f64 = 1000.0;
    /// Number of ticks by which a command is queued ahead of the sample that answers it.
    const AHEAD: usize = 100;

    /// A rig with first-order lag, gain, offset and measuring noise.
    struct Lag {
        gain: f64,
        offset: f64,
        time_constant_s: f64,
        noise: f64,
        value: f64,
        random: rand_chacha::ChaCha8Rng,
    }

    impl Lag {
        fn step(&mut self, command: f64) -> f64 {
            let target = 20.0 + (command - 20.0) * self.gain + self.offset;
            self.value += (target - self.value) / (RATE_HZ * self.time_constant_s);
            let sum: f64 = (0..12).map(|_| self.random.random_range(-0.5..0.5)).sum();
            self.value + self.noise * sum
        }
    }

    /// Runs a corrected sine on the rig and returns measured amplitude and mean of each counted cycle.
    fn run(amplitude: f64, frequency_hz: f64, mut plant: Lag) -> Vec<(f64, f64)> {
        let mean = Level::Absolute(20.0);
        let sine = Segment::Cycles(CycleSegment {
            wave: Wave::Sine,
            mean,
            amplitude,
            frequency_hz,
            cycles: 12,
            taper_cycles: 2,
            correct: true,
        });
        let blocks = vec![Block {
            repeat: 1,
            segments: vec![sine],
        }];
        let profile = Profile {
            name: "t".into(),
            description: String::new(),
            mode: Mode::Displacement,
            blocks,
            accept: Vec::new(),
        };
        let mut player = Player::new(&profile, 20.0, RATE_HZ).unwrap();
        let mut controller = CycleController::new(player.target_of(1).unwrap());
        let mut queue = std::collections::VecDeque::new();
        let mut cycles: Vec<(f64, f64)> = Vec::new();
        let empty = CycleMeasurement {
            peak: f64::MIN,
            valley: f64::MAX,
            command_peak: f64::MIN,
            command_valley: f64::MAX,
        };
        let (mut now, mut last_phase, mut last_cycle, mut done) = (empty, 0.0, 0, 0);
        while !queue.is_empty() || done == 0 {
            while queue.len() < AHEAD
                && let Some(slot) = player.next()
            {
                queue.push_back(slot);
                done += 1;
            }
            let Some(slot) = queue.pop_front() else { break };
            if slot.phase < last_phase {
                let correction = controller.cycle(&now);
                player.set_correction(correction);
                if last_cycle > 0 {
                    cycles.push((now.amplitude(), now.mean()));
                }
                now = empty;
            }
            (last_phase, last_cycle) = (slot.phase, slot.cycle);
            let (command, value) = (slot.command.value(), plant.step(slot.command.value()));
            now.peak = now.peak.max(value);
            now.valley = now.valley.min(value);
            now.command_peak = now.command_peak.max(command);
            now.command_valley = now.command_valley.min(command);
        }
        cycles
    }

    #[test]
    fn amplitude_and_mean_are_within_one_percent_by_the_fifth_cycle() {
        for (amplitude, frequency_hz) in [(6.0, 1.0), (10.0, 1.0), (15.0, 1.0), (6.0, 2.5)] {
            for (gain, offset, seed) in [(0.92, 0.3, 1), (1.08, -0.3, 2), (1.0, 0.0, 3), (0.95, -0.3, 4)] {
                let random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
                let plant = Lag {
                    gain,
                    offset,
                    time_constant_s: 0.01,
                    noise: 0.005,
                    value: 20.0,
                    random,
                };
                let cycles = run(amplitude, frequency_hz, plant);
                assert_eq!(cycles.len(), 12);
                for (i, (a, m)) in cycles.iter().enumerate().skip(4) {
                    let (da, dm) = ((a / amplitude - 1.0).abs(), (m - 20.0).abs() / amplitude);
                    let case = format!("{amplitude} mm {frequency_hz} Hz gain {gain} cycle {}", i + 1);
                    // The requirement on the bench.
                    assert!(da < 0.01 && dm < 0.01, "{case}: amplitude {da:.4}, mean {dm:.4}");
                }
            }
        }
    }

    #[test]
    fn the_correction_of_a_rig_that_does_not_follow_stays_in_range() {
        let target = CycleTarget {
            mean: 20.0,
            amplitude: 6.0,
            corrected: true,
        };
        let mut controller = CycleController::new(target);
        let dead = CycleMeasurement {
            peak: 21.0,
            valley: 19.0,
            command_peak: 26.0,
            command_valley: 14.0,
        };
        let first = controller.cycle(&dead);
        assert!((first.amplitude_factor - 1.1).abs() < 1e-12, "one step at a time");
        for _ in 0..20 {
            controller.cycle(&dead);
        }
        assert_eq!(controller.correction().amplitude_factor, FACTOR_RANGE[1]);
        let nothing = CycleMeasurement {
            peak: f64::NAN,
            ..dead
        };
        assert_eq!(controller.cycle(&nothing).amplitude_factor, FACTOR_RANGE[1]);
    }
}
