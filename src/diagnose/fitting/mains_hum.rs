//! Mains hum: a steady sinusoid of 50 or 60 Hz on the force.
//!
//! The mean over a bin does not remove it. Where the period of the motion is a whole number of mains periods it repeats in every
//! cycle, like physics. Hum is detected only in channels that are sampled fast enough: slower sampling folds it onto the
//! frequencies of the motion, where nothing may be removed.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Vector2};

use crate::diagnose::conditioning::Track;

/// Mains frequencies, and how far they deviate, Hz.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
const DEVIATION_HZ: f64 = 0.1;
/// Sampling rate from which 60 Hz is not folded, with a margin.
const LEAST_SAMPLE_HZ: f64 = 150.0;
/// Step of the frequencies tried, in reciprocals of the duration: a fifth of the resolution.
const FREQUENCY_STEP: f64 = 0.2;
/// Fall of the sum of squares, in variances, from which it is hum. Noise reaches it in one of 3 million trials (chi-square, two
/// degrees of freedom).
const LEAST_FALL: f64 = 30.0;

/// Hum in one recording, as cosine and sine amplitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hum {
    pub frequency_hz: f64,
    cosine_n: f64,
    sine_n: f64,
}

impl Hum {
    pub(super) fn amplitude_n(&self) -> f64 {
        self.cosine_n.hypot(self.sine_n)
    }

    /// Its mean in N over `width_s` around `time_s`.
    pub(super) fn mean_n(&self, time_s: f64, width_s: f64) -> f64 {
        let [cosine, sine] = columns(self.frequency_hz, time_s, width_s);
        self.cosine_n * cosine + self.sine_n * sine
    }
}

/// Mean of cosine and sine over `width_s` around `time_s`.
fn columns(frequency_hz: f64, time_s: f64, width_s: f64) -> [f64; 2] {
    let half = PI * frequency_hz * width_s;
    let left = if half > 1e-6 { half.sin() / half } else { 1.0 };
    let (sine, cosine) = (TAU * frequency_hz * time_s).sin_cos();
    [left * cosine, left * sine]
}

/// The hum in a track's `residuals_n`, if there is any; only points with a weight count.
pub(super) fn detect(track: &Track, weight: &[f64], residuals_n: &[f64]) -> Option<Hum> {
    if track.sample_hz < LEAST_SAMPLE_HZ {
        return None;
    }
    let points: Vec<usize> = (0..track.len()).filter(|&i| weight[i] > 0.0).collect();
    let sum: f64 = points.iter().map(|&i| (weight[i] * residuals_n[i]).powi(2)).sum();
    let duration_s = track.time_s[track.len() - 1] - track.time_s[0];
    let step_hz = (FREQUENCY_STEP / duration_s).min(DEVIATION_HZ);
    let steps = (DEVIATION_HZ / step_hz) as i32;
    let tried = MAINS_HZ
        .iter()
        .flat_map(|mains| (-steps..=steps).map(move |k| mains + f64::from(k) * step_hz));
    let fitted = tried.filter_map(|frequency_hz| {
        let (mut normal, mut right) = (Matrix2::<f64>::zeros(), Vector2::<f64>::zeros());
        for &i in &points {
            let row = Vector2::from(columns(frequency_hz, track.time_s[i], track.width_s[i])) * weight[i];
            normal += row * row.transpose();
            right += row * (weight[i] * residuals_n[i]);
        }
        let solved = normal.cholesky()?.solve(&right);
        let hum = Hum {
            frequency_hz,
            cosine_n: solved[0],
            sine_n: solved[1],
        };
        Some((right.dot(&solved), hum))
    });
    let (fall, hum) = fitted.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let variance = (sum - fall).max(0.0) / points.len().max(1) as f64;
    (fall > LEAST_FALL * variance).then_some(hum)
}

#[cfg(test)]
mod tests {
    use super::super::data::tests::sampled;
    use super::*;

    /// 1 kHz for 20 s at 1 Hz, so that 50 Hz repeats in every cycle; hum of amplitude 0.5 and noise of 1.
    #[test]
    fn hum_is_detected_and_noise_is_not() {
        let (data, noise) = sampled(1e-3, 20.0, |_, _| 0.0);
        let track = &data.tracks[0];
        assert_eq!(detect(track, &data.weight, &noise), None);
        let truth = Hum {
            frequency_hz: 50.03,
            cosine_n: 0.3,
            sine_n: -0.4,
        };
        let hummed: Vec<f64> = (0..track.len())
            .map(|i| noise[i] + truth.mean_n(track.time_s[i], track.width_s[i]))
            .collect();
        let hum = detect(track, &data.weight, &hummed).expect("half the noise");
        assert!((hum.frequency_hz - truth.frequency_hz).abs() < 0.01, "{hum:?}");
        // 2500 points: a standard deviation of 0.03; four of them.
        assert!((hum.amplitude_n() - 0.5).abs() < 0.12, "{hum:?}");
        assert!(
            (hum.cosine_n - 0.3).abs() < 0.15 && (hum.sine_n + 0.4).abs() < 0.15,
            "{hum:?}"
        );
    }

    #[test]
    fn folded_hum_is_not_removed() {
        let (data, noise) = sampled(0.01, 20.0, |_, _| 0.0);
        let track = &data.tracks[0];
        let hummed: Vec<f64> = (0..track.len())
            .map(|i| noise[i] + 2.0 * (TAU * 50.0 * track.time_s[i]).cos())
            .collect();
        assert_eq!(detect(track, &data.weight, &hummed), None);
    }
}
