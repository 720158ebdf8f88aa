//! Mains hum: a sinusoid of 50 or 60 Hz on the force, as steady as the grid.
//!
//! Averaging over a bin does not take it out, and where the motion's period is a whole number of the grid's it comes again in
//! every cycle like physics. A channel that is sampled fast enough shows it as what it is; slower ones fold it onto the
//! motion's own frequencies, where nothing may be taken away.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Vector2};

use super::condition::Track;

/// The grids of the world, and how far they stray, Hz.
const GRIDS_HZ: [f64; 2] = [50.0, 60.0];
const STRAYS_HZ: f64 = 0.1;
/// Samples a second from which hum is not folded.
const LEAST_SAMPLE_HZ: f64 = 150.0;
/// Fall of the sum of squares, in variances, that chance does not make.
const SURE: f64 = 30.0;

/// Hum in one recording.
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

    /// Its mean over a time around another, N.
    pub(super) fn mean_n(&self, time_s: f64, width_s: f64) -> f64 {
        let [cosine, sine] = columns(self.frequency_hz, time_s, width_s);
        self.cosine_n * cosine + self.sine_n * sine
    }
}

fn columns(frequency_hz: f64, time_s: f64, width_s: f64) -> [f64; 2] {
    let half = PI * frequency_hz * width_s;
    let left = if half > 1e-6 { half.sin() / half } else { 1.0 };
    let (sine, cosine) = (TAU * frequency_hz * time_s).sin_cos();
    [left * cosine, left * sine]
}

/// The hum in a track's `residuals_n`, where there is one; only points with a weight count.
pub(super) fn found(track: &Track, weight: &[f64], residuals_n: &[f64]) -> Option<Hum> {
    if track.sample_hz < LEAST_SAMPLE_HZ {
        return None;
    }
    let points: Vec<usize> = (0..track.len()).filter(|&i| weight[i] > 0.0).collect();
    let sum: f64 = points.iter().map(|&i| (weight[i] * residuals_n[i]).powi(2)).sum();
    let duration_s = track.time_s[track.len() - 1] - track.time_s[0];
    let step_hz = (0.2 / duration_s).min(STRAYS_HZ);
    let steps = (STRAYS_HZ / step_hz) as i32;
    let tried = GRIDS_HZ
        .iter()
        .flat_map(|grid| (-steps..=steps).map(move |k| grid + f64::from(k) * step_hz));
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
    let (falls, hum) = fitted.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let variance = (sum - falls).max(0.0) / points.len().max(1) as f64;
    (falls > SURE * variance).then_some(hum)
}

#[cfg(test)]
mod tests {
    use super::super::residual::tests::sampled;
    use super::*;

    /// 1 kHz for 20 s at 1 Hz, so that 50 Hz comes again in every cycle; 0.5 of hum beside noise of 1.
    #[test]
    fn hum_is_found_for_what_it_is_and_noise_is_none() {
        let (data, noise) = sampled(1e-3, 20.0, |_, _| 0.0);
        let track = &data.tracks[0];
        assert_eq!(found(track, &data.weight, &noise), None);
        let told = Hum {
            frequency_hz: 50.03,
            cosine_n: 0.3,
            sine_n: -0.4,
        };
        let hummed: Vec<f64> = (0..track.len())
            .map(|i| noise[i] + told.mean_n(track.time_s[i], track.width_s[i]))
            .collect();
        let hum = found(track, &data.weight, &hummed).expect("half the noise");
        assert!((hum.frequency_hz - told.frequency_hz).abs() < 0.01, "{hum:?}");
        // Some 2500 points: 0.03 of the noise, four of them.
        assert!((hum.amplitude_n() - 0.5).abs() < 0.12, "{hum:?}");
        assert!(
            (hum.cosine_n - 0.3).abs() < 0.15 && (hum.sine_n + 0.4).abs() < 0.15,
            "{hum:?}"
        );
    }

    #[test]
    fn a_channel_that_folds_it_is_left_alone() {
        let (data, noise) = sampled(0.01, 20.0, |_, _| 0.0);
        let track = &data.tracks[0];
        let hummed: Vec<f64> = (0..track.len())
            .map(|i| noise[i] + 2.0 * (TAU * 50.0 * track.time_s[i]).cos())
            .collect();
        assert_eq!(found(track, &data.weight, &hummed), None);
    }
}
