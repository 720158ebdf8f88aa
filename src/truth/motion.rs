//! Motions as formulas of time: ramp with hold, sine, rounded triangle and random multi-sine; any other motion as samples.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use rand_chacha::ChaCha8Rng;

use super::between;
use super::path::Path;

/// Half step in s of the central differences for speed and acceleration.
const DIFFERENCE_S: f64 = 2e-4;
/// Sharpness of the corners of a triangle; 1 is not rounded.
const CORNER: f64 = 0.99;

/// A displacement in mm over time in s. Every formula starts at rest at zero.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Programme {
    /// Up to `top_mm`, hold, and down again, at constant speed with rounded corners.
    Ramp {
        /// Displacement of the hold, mm.
        top_mm: f64,
        /// Duration of each branch, s.
        branch_s: f64,
        /// Duration of the hold, s.
        hold_s: f64,
    },
    /// A sine that starts at its valley.
    Sine {
        mean_mm: f64,
        /// Half of peak minus valley.
        amplitude_mm: f64,
        frequency_hz: f64,
        cycles: f64,
    },
    /// A triangle with rounded corners that starts at its valley.
    Triangle {
        mean_mm: f64,
        /// Half of peak minus valley.
        amplitude_mm: f64,
        frequency_hz: f64,
        cycles: f64,
    },
    /// A sum of sines that does not repeat within the recording.
    MultiSine {
        mean_mm: f64,
        /// Amplitude in mm, frequency in Hz and phase in rad of each sine.
        lines: Vec<[f64; 3]>,
        /// Duration after the approach, s.
        duration_s: f64,
    },
    Path(Path),
}

impl Programme {
    /// Duration in s of the approach from zero to the start of the motion.
    pub(crate) fn approach_s(&self) -> f64 {
        match *self {
            Programme::Ramp { .. } | Programme::Path(_) => 0.0,
            Programme::Sine { frequency_hz, .. } | Programme::Triangle { frequency_hz, .. } => {
                0.5 / frequency_hz
            }
            Programme::MultiSine { .. } => 1.0,
        }
    }

    /// Duration in s, with the approach.
    pub(crate) fn duration_s(&self) -> f64 {
        self.approach_s()
            + match *self {
                Programme::Ramp { branch_s, hold_s, .. } => 2.0 * branch_s + hold_s,
                Programme::Sine {
                    frequency_hz, cycles, ..
                }
                | Programme::Triangle {
                    frequency_hz, cycles, ..
                } => cycles / frequency_hz,
                Programme::MultiSine { duration_s, .. } => duration_s,
                Programme::Path(ref path) => path.duration_s(),
            }
    }

    /// Approximate number of branches between turning points.
    pub(crate) fn branches(&self) -> f64 {
        match *self {
            Programme::Ramp { .. } => 2.0,
            Programme::Path(ref path) => 1.0 + path.turns() as f64,
            Programme::Sine { cycles, .. } | Programme::Triangle { cycles, .. } => 2.0 * cycles,
            Programme::MultiSine {
                ref lines,
                duration_s,
                ..
            } => {
                let power: f64 = lines.iter().map(|l| l[0] * l[0]).sum();
                let speed: f64 = lines.iter().map(|l| (l[0] * l[1]).powi(2)).sum();
                2.0 * duration_s * (speed / power).sqrt()
            }
        }
    }

    /// Displacement in mm at a time in s; constant before the start and after the end.
    pub(crate) fn at_mm(&self, time_s: f64) -> f64 {
        let t = time_s.clamp(0.0, self.duration_s());
        let lead = self.approach_s();
        let after = t - lead;
        let approached = |level: f64| level * smooth(t / lead);
        match *self {
            Programme::Ramp {
                top_mm,
                branch_s,
                hold_s,
            } => {
                top_mm
                    * if t < branch_s {
                        rounded(t / branch_s)
                    } else if t < branch_s + hold_s {
                        1.0
                    } else {
                        rounded((2.0 * branch_s + hold_s - t) / branch_s)
                    }
            }
            Programme::Sine {
                mean_mm,
                amplitude_mm,
                frequency_hz,
                ..
            } => {
                if after < 0.0 {
                    approached(mean_mm - amplitude_mm)
                } else {
                    mean_mm - amplitude_mm * (TAU * frequency_hz * after).cos()
                }
            }
            Programme::Triangle {
                mean_mm,
                amplitude_mm,
                frequency_hz,
                ..
            } => {
                if after < 0.0 {
                    approached(mean_mm - amplitude_mm)
                } else {
                    let wave = (CORNER * (TAU * frequency_hz * after).cos()).asin() / CORNER.asin();
                    mean_mm - amplitude_mm * wave
                }
            }
            Programme::MultiSine {
                mean_mm, ref lines, ..
            } => {
                let sum: f64 = lines
                    .iter()
                    .map(|l| l[0] * (TAU * l[1] * after + l[2]).sin())
                    .sum();
                approached(mean_mm) + sum * smooth(after)
            }
            Programme::Path(ref path) => path.at_mm(t),
        }
    }

    /// Speed in mm/s at a time in s.
    pub(crate) fn speed_mm_s(&self, time_s: f64) -> f64 {
        (self.at_mm(time_s + DIFFERENCE_S) - self.at_mm(time_s - DIFFERENCE_S)) / (2.0 * DIFFERENCE_S)
    }

    /// Acceleration in mm/s2 at a time in s.
    pub(crate) fn acceleration_mm_s2(&self, time_s: f64) -> f64 {
        (self.at_mm(time_s + DIFFERENCE_S) - 2.0 * self.at_mm(time_s) + self.at_mm(time_s - DIFFERENCE_S))
            / (DIFFERENCE_S * DIFFERENCE_S)
    }

    /// Time in s between `from_s` and `to_s` at which the direction changes, by bisection.
    pub(super) fn turning_point_s(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let (mut low, mut high) = (from_s, to_s);
        let first = self.speed_mm_s(low);
        if first * self.speed_mm_s(high) >= 0.0 {
            return None;
        }
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.speed_mm_s(middle) * first > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(low)
    }

    /// A multi-sine of five to nine sines between 0.3 and 3 Hz that stays within `reach_mm` of the mean.
    pub(crate) fn random(random: &mut ChaCha8Rng, mean_mm: f64, reach_mm: f64, duration_s: f64) -> Programme {
        let count = 5 + (between(random, 0.0, 4.99) as usize);
        let mut lines: Vec<[f64; 3]> = (0..count)
            .map(|_| {
                [
                    between(random, 0.3, 1.0),
                    0.3 * 10f64.powf(between(random, 0.0, 1.0)),
                    between(random, -PI, PI),
                ]
            })
            .collect();
        let sum: f64 = lines.iter().map(|l| l[0]).sum();
        lines.iter_mut().for_each(|l| l[0] *= reach_mm / sum);
        Programme::MultiSine {
            mean_mm,
            lines,
            duration_s,
        }
    }
}

/// Rises from 0 to 1 without a step in speed or acceleration.
fn smooth(part: f64) -> f64 {
    let p = part.clamp(0.0, 1.0);
    p * p * p * (10.0 + p * (6.0 * p - 15.0))
}

/// Rises from 0 to 1 at constant speed, with 1 % of the duration rounded at each end.
fn rounded(part: f64) -> f64 {
    const R: f64 = 0.01;
    let p = part.clamp(0.0, 1.0);
    let scale = 1.0 - R * (1.0 - 2.0 / PI) * 2.0;
    // The speed rises as a quarter sine over R, so the acceleration is finite.
    let foot = |p: f64| R * (2.0 / PI) * (1.0 - (FRAC_PI_2 * p / R).cos());
    let raw = if p < R {
        foot(p)
    } else if p > 1.0 - R {
        scale - foot(1.0 - p)
    } else {
        R * 2.0 / PI + p - R
    };
    raw / scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn all() -> Vec<Programme> {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        vec![
            Programme::Ramp {
                top_mm: 20.0,
                branch_s: 30.0,
                hold_s: 5.0,
            },
            Programme::Sine {
                mean_mm: 9.0,
                amplitude_mm: 6.0,
                frequency_hz: 2.5,
                cycles: 8.0,
            },
            Programme::Triangle {
                mean_mm: 9.0,
                amplitude_mm: 6.0,
                frequency_hz: 1.0,
                cycles: 5.0,
            },
            Programme::random(&mut random, 10.0, 8.0, 12.0),
        ]
    }

    #[test]
    fn every_motion_starts_at_zero_stays_positive_and_has_no_steps() {
        for motion in all() {
            assert!(motion.at_mm(0.0).abs() < 1e-9, "{motion:?}");
            let steps = (motion.duration_s() / 1e-3) as usize;
            for k in 0..steps {
                let t = 1e-3 * k as f64;
                let step = motion.at_mm(t + 1e-3) - motion.at_mm(t);
                // The approach is the fastest part: under 200 mm/s.
                assert!(
                    step.abs() < 0.3 && motion.at_mm(t) > -1e-9,
                    "{motion:?} at {t} s: {step}"
                );
            }
        }
    }

    #[test]
    fn rates_of_a_sine_by_hand() {
        let sine = Programme::Sine {
            mean_mm: 9.0,
            amplitude_mm: 6.0,
            frequency_hz: 1.0,
            cycles: 8.0,
        };
        let w = TAU;
        // A quarter cycle after the valley: full speed. At the peak: full acceleration. Error of the differences: (w h)^2 / 6.
        assert!((sine.speed_mm_s(0.75) - 6.0 * w).abs() < 1e-4);
        assert!((sine.acceleration_mm_s2(1.0) + 6.0 * w * w).abs() < 1e-2);
    }

    #[test]
    fn a_ramp_reaches_its_top_at_constant_speed() {
        let ramp = Programme::Ramp {
            top_mm: 20.0,
            branch_s: 50.0,
            hold_s: 2.0,
        };
        assert_eq!(ramp.at_mm(51.0), 20.0);
        assert!((ramp.speed_mm_s(10.0) - ramp.speed_mm_s(40.0)).abs() < 1e-6);
        assert!((ramp.at_mm(25.0) - 10.0).abs() < 1e-9);
    }
}
