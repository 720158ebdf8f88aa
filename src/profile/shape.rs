//! Shapes of motion as functions: S-curve, straight lines between points, waves. `player` puts them together.

use std::f64::consts::TAU;

use super::Wave;

/// From 0 to 1 with speed and acceleration zero at both ends (quintic).
pub(super) fn smoother(x: f64) -> f64 {
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

/// Level at time `t` on straight lines between points.
pub(super) fn interpolate(time_s: &[f64], level: &[f64], t: f64) -> f64 {
    let i = time_s
        .partition_point(|&x| x <= t)
        .clamp(1, time_s.len().max(2) - 1);
    match (time_s.get(i - 1..=i), level.get(i - 1..=i)) {
        (Some(&[t0, t1]), Some(&[a, b])) => a + (b - a) * ((t - t0) / (t1 - t0)).clamp(0.0, 1.0),
        // `pieces` refuses a table with fewer than two points.
        _ => 0.0,
    }
}

/// A wave of amplitude 1 that begins at 0 and rises; `phase` is 0 to 1 within a cycle.
pub(super) fn wave(wave: Wave, phase: f64) -> f64 {
    match wave {
        Wave::Sine => (TAU * phase).sin(),
        Wave::Triangle => 1.0 - 4.0 * (((phase + 0.25) % 1.0) - 0.5).abs(),
    }
}
