//! Load cell, LVDT and their amplifiers: noise, hum, a common lag, quantisation and sampling times.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::nuisance::Nuisance;
use super::{Hidden, Programme, TruthSpecimen, between, normal, one_of};
use crate::recording::Recording;

/// Resolution of a 16-bit converter over 10 kN.
const FORCE_STEP_N: f64 = 10_000.0 / 65_536.0;
/// Resolution of a 16-bit converter over 50 mm.
const DISPLACEMENT_STEP_MM: f64 = 50.0 / 65_536.0;
/// Approximate number of samples of a ramp.
const WANTED_SAMPLES: f64 = 3000.0;
/// Largest amplitude of the hum divided by the noise, so that the hum cannot be detected.
const LARGEST_HUM: f64 = 0.3;

/// Both measuring channels of one case.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sensors {
    /// Standard deviation of the noise of the load cell, N.
    pub noise_n: f64,
    /// Standard deviation of the noise of the LVDT, mm.
    pub noise_mm: f64,
    /// Amplitude of the 50 Hz hum of the force, N.
    pub hum_n: f64,
    /// Common lag of both channels, s.
    pub lag_s: f64,
    /// Sampling rate of fast motions, Hz.
    pub rate_hz: f64,
    /// True if the sampling times are irregular.
    pub uneven: bool,
    pub(super) nuisance: Option<Nuisance>,
}

impl Sensors {
    /// Draws the channels for a largest force in N; `noisy` makes the force ten times noisier.
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
            nuisance: None,
        }
    }

    /// Standard deviation in N of the difference to a displacement-driven model: noise, hum and resolution of both channels.
    pub(crate) fn sigma_n(&self, rate_n_per_mm: f64) -> f64 {
        let force = self.noise_n.powi(2) + 0.5 * self.hum_n.powi(2) + FORCE_STEP_N.powi(2) / 12.0;
        let displacement = self.noise_mm.powi(2) + DISPLACEMENT_STEP_MM.powi(2) / 12.0;
        (force + rate_n_per_mm.powi(2) * displacement).sqrt()
    }

    /// Sampling times of a motion, s.
    pub(crate) fn times_s(&self, random: &mut ChaCha8Rng, motion: &Programme) -> Vec<f64> {
        let duration_s = motion.duration_s();
        let rate_hz = match motion {
            Programme::Ramp { .. } => self.rate_hz.min((WANTED_SAMPLES / duration_s).max(20.0)),
            // A path has fast and slow parts; a bench samples at 1 kHz at most.
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

    /// Records a motion of a specimen with hidden effects; `name` is the name of the recording.
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
        // The amplifier also clips the noise: a clipped sample shows the limit exactly.
        let unclipped: Vec<Hidden> = hidden
            .iter()
            .filter(|h| h.code != "sensor_saturation")
            .copied()
            .collect();
        let skew_s = self.nuisance.map_or(0.0, |n| n.skew_s(random));
        let skewed_s: Vec<f64> = seen_s.iter().map(|t| t - skew_s).collect();
        let clean = specimen.forces(&unclipped, motion, &skewed_s);
        let phase = between(random, 0.0, TAU);
        let force_n = times_s
            .iter()
            .zip(&clean)
            .map(|(t, f)| {
                let seen = f + self.noise_n * normal(random) + self.hum_n * (TAU * 50.0 * t + phase).sin();
                quantised(specimen.clipped_n(hidden, seen), FORCE_STEP_N)
            })
            .collect();
        let displacement_mm = specimen
            .seen_mm(hidden, motion, &seen_s)
            .into_iter()
            .map(|x| quantised(x + self.noise_mm * normal(random), DISPLACEMENT_STEP_MM))
            .collect();
        let mut recording = Recording {
            name: name.to_owned(),
            time_s: times_s,
            displacement_mm,
            force_n,
            ..Recording::default()
        };
        if let Some(nuisance) = self.nuisance {
            let cyclic = !matches!(motion, Programme::Ramp { .. });
            nuisance.spoil(random, &mut recording, self.noise_n, cyclic);
        }
        recording
    }
}

/// Rounds to the resolution of a converter.
fn quantised(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

/// A recording as CSV, see `docs/formats.md`.
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
            nuisance: None,
        }
    }

    #[test]
    fn noise_has_the_standard_deviation_of_sigma_n() {
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
        // The standard error of the RMS of 4000 samples is 1.1 %; the tolerance is four of them.
        assert!((rms / 2.0 - 1.0).abs() < 0.05, "{rms}");
        assert!((sensors.sigma_n(100.0) - (4.0f64 + 0.01 + 0.0019 + 4.9e-4).sqrt()).abs() < 1e-3);
    }

    #[test]
    fn irregular_times_still_rise() {
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
