//! The test of every run of a lab.
//!
//! It is scaled to the travel of the family: three slow large cycles, six small quick ones, six at a middle speed. Different amplitudes
//! and speeds tell friction, rate and lag apart.

use std::f64::consts::TAU;

use super::Programme;
use super::path::Path;

/// Middle of all sines as a share of the largest displacement.
const MEAN: f64 = 0.5;
/// Amplitude as a share of the largest displacement, frequency in Hz and number of cycles of each sine.
pub(crate) const SINES: [(f64, f64, u32); 3] = [(0.42, 0.5, 3), (0.12, 2.0, 6), (0.3, 1.5, 6)];
/// Cycles of one run.
pub(crate) const CYCLES: u32 = SINES[0].2 + SINES[1].2 + SINES[2].2;
/// Duration of the ramp to the middle and back, s.
pub(crate) const RAMP_S: f64 = 1.0;
/// Samples per second of the path.
const PATH_HZ: f64 = 1000.0;

/// Largest displacement of a test to its middle displacement, mm.
pub(crate) fn mean_mm(top_mm: f64) -> f64 {
    MEAN * top_mm
}

/// Duration of the test, s.
pub(crate) fn duration_s() -> f64 {
    2.0 * RAMP_S + SINES.iter().map(|s| f64::from(s.2) / s.1).sum::<f64>()
}

/// Displacement in mm at a time in s, counted cycle from 1 (0 outside the sines) and segment from 1.
pub(crate) fn commanded(top_mm: f64, time_s: f64) -> (f64, u32, u32) {
    let mut left_s = time_s - RAMP_S;
    let mean_mm = mean_mm(top_mm);
    if left_s < 0.0 {
        return (mean_mm * time_s / RAMP_S, 0, 1);
    }
    let mut before = 0;
    for (k, (share, frequency_hz, cycles)) in SINES.into_iter().enumerate() {
        let passed = left_s * frequency_hz;
        if passed < f64::from(cycles) {
            let x_mm = mean_mm + share * top_mm * (TAU * passed).sin();
            return (x_mm, before + passed as u32 + 1, k as u32 + 2);
        }
        left_s -= f64::from(cycles) / frequency_hz;
        before += cycles;
    }
    (
        mean_mm * (1.0 - left_s / RAMP_S).max(0.0),
        0,
        SINES.len() as u32 + 2,
    )
}

/// The test as a motion.
pub(super) fn motion(top_mm: f64) -> Programme {
    let points: Vec<[f64; 2]> = (0..=(duration_s() * PATH_HZ) as usize)
        .map(|k| k as f64 / PATH_HZ)
        .map(|t| [t, commanded(top_mm, t).0])
        .collect();
    Programme::Path(Path::new(&points))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_and_segments_are_counted() {
        let at = |time_s| commanded(20.0, time_s);
        assert_eq!(at(0.5), (5.0, 0, 1));
        assert_eq!((at(1.0).1, at(2.9).1, at(3.1).1), (1, 1, 2));
        // The second sine begins after 1 s and three cycles of 2 s.
        assert_eq!((at(7.1).1, at(7.1).2), (4, 3));
        assert_eq!(
            (at(duration_s() - 1.001).1, at(duration_s() - 0.5).1),
            (CYCLES, 0)
        );
        assert!(at(duration_s()).0.abs() < 1e-9);
    }
}
