//! Brings the amplitude and the mean of a cyclic motion to their targets, cycle by cycle. Pure: measured cycles in,
//! corrections out; the player blends them into the command, control measures the cycles.
//!
//! Each cycle says how the rig answered the command that was in force then: `gain = amplitude measured / amplitude
//! commanded`, `shift = mean measured - mean commanded`. The next command is the target through the inverse of that answer.
//! Because the answer is taken against the command of the same cycle, it does not matter that a correction acts one or two
//! cycles later.

use super::player::CycleTarget;

/// Change of a cycle's command: `mean + mean_offset + amplitude * amplitude_factor * wave`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Times the profile's amplitude.
    pub amplitude_factor: f64,
    /// Added to the profile's mean, in the mode's unit.
    pub mean_offset: f64,
}

impl Correction {
    /// The command as the profile has it.
    pub const NONE: Correction = Correction {
        amplitude_factor: 1.0,
        mean_offset: 0.0,
    };

    /// Between this (0) and `other` (1).
    pub(super) fn blend(self, other: Correction, share: f64) -> Correction {
        Correction {
            amplitude_factor: self.amplitude_factor
                + (other.amplitude_factor - self.amplitude_factor) * share,
            mean_offset: self.mean_offset + (other.mean_offset - self.mean_offset) * share,
        }
    }
}

/// Highest and lowest values of feedback and command over the samples of one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleMeasurement {
    /// Highest feedback.
    pub peak: f64,
    /// Lowest feedback.
    pub valley: f64,
    /// Highest command.
    pub command_peak: f64,
    /// Lowest command.
    pub command_valley: f64,
}

impl CycleMeasurement {
    /// Half of peak minus valley.
    pub fn amplitude(&self) -> f64 {
        0.5 * (self.peak - self.valley)
    }

    /// Middle between peak and valley.
    pub fn mean(&self) -> f64 {
        0.5 * (self.peak + self.valley)
    }
}

/// The factor stays within these: a rig that needs more has a fault (H5), not an error to be corrected.
const FACTOR_RANGE: [f64; 2] = [0.8, 1.5];
/// Largest change of the factor from one correction to the next.
const FACTOR_STEP: f64 = 0.1;
/// Largest offset, in amplitudes.
const OFFSET_RANGE: f64 = 0.5;
/// Largest change of the offset from one correction to the next, in amplitudes.
const OFFSET_STEP: f64 = 0.1;
/// Weight of a new cycle after the first ones: noise of a peak is averaged, a drift is still followed.
const STEADY_WEIGHT: f64 = 0.4;
/// Cycles that are taken at more than the steady weight.
const QUICK_CYCLES: u32 = 3;
/// A cycle below this share of the target's amplitude says too little.
const LEAST_AMPLITUDE: f64 = 0.2;

/// The controller of one sine or triangle segment.
#[derive(Debug, Clone)]
pub struct CycleController {
    target: CycleTarget,
    gain: f64,
    shift: f64,
    seen: u32,
    correction: Correction,
}

impl CycleController {
    /// For a segment with this target.
    pub fn new(target: CycleTarget) -> Self {
        CycleController {
            target,
            gain: 1.0,
            shift: 0.0,
            seen: 0,
            correction: Correction::NONE,
        }
    }

    /// Takes one whole cycle, tapered or counted, and returns the correction for the next cycle that can still be changed.
    /// A cycle that says nothing (too small, not finite) leaves the correction as it is.
    pub fn cycle(&mut self, measured: &CycleMeasurement) -> Correction {
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

    /// The correction asked for last.
    pub fn correction(&self) -> Correction {
        self.correction
    }

    fn learn(&mut self, gain: f64, shift: f64) {
        self.seen = self.seen.saturating_add(1);
        // 1, 1, 2/3, then steady: the taper's answers are soon outvoted by those of full cycles.
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
