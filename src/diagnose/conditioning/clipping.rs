//! Channels that stand at an end of their range while the other channel goes on. It uses no recordings and no models: input and
//! output are columns of numbers.

use std::ops::Range;

use super::smoothing::range;

/// Samples that must stand at an end, and share of the other channel's range that must pass meanwhile.
const CLIPPED_SAMPLES: usize = 4;
const CLIPPED_SHARE: f64 = 0.05;
/// A channel stands at its end within this share of its range: rounding of the file.
const EXACT: f64 = 1e-7;

/// Where a channel clips.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Clipping {
    /// True for every sample at an end of the range.
    pub mask: Vec<bool>,
    /// Smallest and largest value of the channel.
    pub ends: [f64; 2],
}

impl Clipping {
    pub(super) fn count(&self) -> usize {
        self.mask.iter().filter(|m| **m).count()
    }
}

/// A clipped LVDT: the displacement stays at an end of its range while the force goes on. `None` if it does not clip.
pub(super) fn clipped_displacement(x: &[f64], force_n: &[f64], noise_mm: f64) -> Option<Clipping> {
    let tolerance = (0.5 * noise_mm).max(EXACT * range(x));
    found(x, force_n, tolerance, [true, true])
}

/// A clipped load cell: the force stands exactly at an end of its range while the displacement goes on. A spring that has lost its
/// contact gives a force near zero, with the noise of the channel: that is no clipping.
pub(super) fn clipped_force(force_n: &[f64], x: &[f64]) -> Option<Clipping> {
    let lowest_n = force_n.iter().copied().fold(f64::INFINITY, f64::min);
    let at_zero = lowest_n.abs() <= EXACT * range(force_n);
    found(force_n, x, EXACT * range(force_n), [!at_zero, true])
}

/// Runs of samples at the lower and upper end, each where it `may` clip.
fn found(values: &[f64], other: &[f64], tolerance: f64, may: [bool; 2]) -> Option<Clipping> {
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    let mut mask = vec![false; values.len()];
    let passes = CLIPPED_SHARE * range(other);
    for (end, _) in [low, high].into_iter().zip(may).filter(|(_, may)| *may) {
        for run in runs(values, |v| (v - end).abs() <= tolerance) {
            if run.len() > CLIPPED_SAMPLES && range(&other[run.clone()]) > passes {
                mask[run].fill(true);
            }
        }
    }
    mask.contains(&true).then_some(Clipping {
        mask,
        ends: [low, high],
    })
}

/// Ranges of successive samples for which `at_end` is true.
fn runs(values: &[f64], at_end: impl Fn(f64) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (i, value) in values.iter().enumerate().filter(|(_, v)| at_end(**v)) {
        debug_assert!(value.is_finite());
        match runs.last_mut().filter(|run| run.end == i) {
            Some(run) => run.end = i + 1,
            None => runs.push(i..i + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_at_its_rail_is_clipped_and_a_lost_contact_is_not() {
        let x: Vec<f64> = (0..400).map(|i| 5.0 * (0.05 * f64::from(i)).sin()).collect();
        let force = |low_n: f64, high_n: f64| -> Vec<f64> {
            x.iter().map(|x| (80.0 * x).max(low_n).min(high_n)).collect()
        };
        assert_eq!(clipped_force(&force(-1e3, 1e3), &x), None);
        assert_eq!(clipped_force(&force(0.0, 1e3), &x), None);
        let low = clipped_force(&force(20.0, 1e3), &x).expect("clips below");
        assert_eq!(low.ends[0], 20.0);
        let high = clipped_force(&force(0.0, 300.0), &x).expect("clips above");
        assert!(high.mask.iter().zip(&x).all(|(m, x)| *m == (80.0 * x >= 300.0)));
    }
}
