//! Load cell, LVDT and their amplifiers: noise, hum, a lag that both share, steps of the converter, sampling times.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{Hidden, Programme, TruthSpecimen, between, normal, one_of};
use crate::recording::Recording;

/// Step of a 16-bit converter over 10 kN, and over 50 mm.
const FORCE_STEP_N: f64 = 10_000.0 / 65_536.0;
const DISPLACEMENT_STEP_MM: f64 = 50.0 / 65_536.0;
/// About as many samples as the measure of time has in a recording.
const WANTED_SAMPLES: f64 = 3000.0;
/// Hum against noise: it must stay below what can be detected.
const LARGEST_HUM: f64 = 0.3;

/// The measuring chain of one case.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sensors {
    /// Standard deviation of the load cell, N.
    pub noise_n: f64,
    /// Standard deviation of the LVDT, mm.
    pub noise_mm: f64,
    /// Amplitude of the 50 Hz hum on the force, N.
    pub hum_n: f64,
    /// Lag of both channels alike, s.
    pub lag_s: f64,
    /// Samples a second in fast motions.
    pub rate_hz: f64,
    /// Sampled at irregular times?
    pub uneven: bool,
}

impl Sensors {
    /// Draws a chain for a range of force; `noisy` makes it ten times worse than usual.
    pub(crate) fn draw(random: &mut ChaCha8Rng, range_n: f64, noisy: bool) -> Sensors {
        let noise_n = range_n * 10f64.powf(between(random, -3.7, -2.9)) * if noisy { 10.0 } else { 1.0 };
        let usual = [50.0, 100.0, 200.0, 250.0, 500.0, 1000.0];
        let rate_hz = match between(random, 0.0, 1.0) {
            u if u < 0.06 => 20.0,
            u if u < 0.90 => one_of(random, &usual),
            u if u < 0.97 => 2000.0,
            _ => 10_000.0,
        };
        Sensors {
            noise_n,
            noise_mm: between(random, 3e-4, 3e-3),
            hum_n: noise_n * between(random, 0.0, LARGEST_HUM),
            lag_s: between(random, 0.0, 2e-3),
            rate_hz,
            uneven: random.random_bool(0.15),
        }
    }

    /// Standard deviation of what a displacement-driven model cannot follow, N.
    pub(crate) fn sigma_n(&self, rate_n_per_mm: f64) -> f64 {
        let force = self.noise_n.powi(2) + 0.5 * self.hum_n.powi(2) + FORCE_STEP_N.powi(2) / 12.0;
        let displacement = self.noise_mm.powi(2) + DISPLACEMENT_STEP_MM.powi(2) / 12.0;
        (force + rate_n_per_mm.powi(2) * displacement).sqrt()
    }

    /// When a motion is sampled, in s.
    pub(crate) fn times_s(&self, random: &mut ChaCha8Rng, motion: &Programme) -> Vec<f64> {
        let duration_s = motion.duration_s();
        let rate_hz = match motion {
            Programme::Ramp { .. } => self.rate_hz.min((WANTED_SAMPLES / duration_s).max(20.0)),
            // Fast and slow parts in one file, at most as many samples as a bench of 1 kHz takes.
            Programme::Path(_) => self.rate_hz.min(1000.0),
            _ => self.rate_hz,
        };
        let count = (duration_s * rate_hz) as usize;
        (0..count)
            .map(|k| {
                let shift = if self.uneven {
                    between(random, -0.35, 0.35)
                } else {
                    0.0
                };
                (k as f64 + 0.5 + shift) / rate_hz
            })
            .collect()
    }

    /// What is recorded of a motion; time starts at the first sample of the file as the logger has it.
    pub(crate) fn record(
        &self,
        random: &mut ChaCha8Rng,
        specimen: &TruthSpecimen,
        hidden: &[Hidden],
        motion: &Programme,
        name: &str,
    ) -> Recording {
        let times_s = self.times_s(random, motion);
        let seen_s: Vec<f64> = times_s.iter().map(|t| t - self.lag_s).collect();
        // The amplifier clips what it gets, noise included: deep in the clip it shows its rail and nothing else.
        let unclipped: Vec<Hidden> = hidden
            .iter()
            .filter(|h| h.code != "sensor_saturation")
            .copied()
            .collect();
        let clean = specimen.forces(&unclipped, motion, &seen_s);
        let rail_n = hidden
            .iter()
            .find(|h| h.code == "sensor_saturation")
            .map_or(f64::INFINITY, |h| h.limit_n(specimen.top_n()));
        let phase = between(random, 0.0, TAU);
        let force_n = times_s
            .iter()
            .zip(&clean)
            .map(|(t, f)| {
                let seen = f + self.noise_n * normal(random) + self.hum_n * (TAU * 50.0 * t + phase).sin();
                stepped(seen.min(rail_n), FORCE_STEP_N)
            })
            .collect();
        let displacement_mm = seen_s
            .iter()
            .map(|&t| {
                stepped(
                    motion.at_mm(t) + self.noise_mm * normal(random),
                    DISPLACEMENT_STEP_MM,
                )
            })
            .collect();
        Recording {
            name: name.to_owned(),
            time_s: times_s,
            displacement_mm,
            force_n,
            ..Recording::default()
        }
    }
}

fn stepped(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

/// A recording as the CSV of contracts.md.
pub(crate) fn csv(recording: &Recording) -> String {
    let mut text = String::from("time_s,displacement_mm,force_n\r\n");
    for k in 0..recording.len() {
        text += &format!(
            "{:.6},{:.5},{:.3}\r\n",
            recording.time_s[k], recording.displacement_mm[k], recording.force_n[k]
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::specimen::tests::{plain, sine};
    use super::*;
    use rand::SeedableRng;

    fn chain() -> Sensors {
        Sensors {
            noise_n: 2.0,
            noise_mm: 1e-3,
            hum_n: 0.0,
            lag_s: 0.0,
            rate_hz: 200.0,
            uneven: false,
        }
    }

    #[test]
    fn noise_has_the_size_that_sigma_says() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let sensors = chain();
        let r = sensors.record(&mut random, &plain(), &[], &sine(1.0, 20.0), "a");
        let clean = plain().forces(&[], &sine(1.0, 20.0), &r.time_s);
        let n = clean.len() as f64;
        let rms = (r
            .force_n
            .iter()
            .zip(&clean)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            / n)
            .sqrt();
        // 4000 samples: the spread of an RMS is 1.1 %; four of them.
        assert!((rms / 2.0 - 1.0).abs() < 0.05, "{rms}");
        assert!((sensors.sigma_n(100.0) - (4.0f64 + 0.01 + 0.0019 + 4.9e-4).sqrt()).abs() < 1e-3);
    }

    #[test]
    fn uneven_times_still_rise() {
        let sensors = Sensors {
            uneven: true,
            ..chain()
        };
        let times = sensors.times_s(&mut ChaCha8Rng::seed_from_u64(4), &sine(1.0, 5.0));
        assert!(times.windows(2).all(|w| w[1] > w[0]));
        assert!(times.windows(3).any(|w| (w[2] - 2.0 * w[1] + w[0]).abs() > 1e-4));
    }

    #[test]
    fn the_csv_is_read_back_as_a_recording() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let recording = chain().record(&mut random, &plain(), &[], &sine(1.0, 3.0), "case.csv");
        let read = crate::recording::csv::read("case.csv", csv(&recording).as_bytes()).expect("valid");
        assert_eq!(read.len(), recording.len());
        assert!((read.force_n[77] - recording.force_n[77]).abs() < 1e-3);
    }
}
