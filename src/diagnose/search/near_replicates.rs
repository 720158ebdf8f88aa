//! Near replicates: every point is predicted by its nearest neighbours in displacement, on other cycles of the same recording and
//! in the same direction.
//!
//! A ripple that is finer than the distance of samples looks like noise to neighbours in time, but not to neighbours in
//! displacement. What these have in common is lack of fit, the rest is pure error (Draper and Smith 1998, chapter 2; without
//! exact replicates Daniel and Wood 1980).

use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::Data;

/// Number of neighbours that predict a point.
const NEIGHBOURS: usize = 6;

/// Points of a track with rising and with falling displacement, each in order of displacement.
fn branches(track: &Track, counts: impl Fn(usize) -> bool) -> [Vec<usize>; 2] {
    [1.0, -1.0].map(|direction| {
        let mut branch: Vec<usize> = (0..track.len())
            .filter(|&i| track.direction[i] == direction && counts(i))
            .collect();
        branch.sort_by(|&a, &b| track.displacement_mm[a].total_cmp(&track.displacement_mm[b]));
        branch
    })
}

/// The nearest points on other cycles for which `others` is true, nearest first; `at` is an index in `branch`.
fn nearest(track: &Track, branch: &[usize], at: usize, others: impl Fn(usize) -> bool) -> Vec<usize> {
    let here = branch[at];
    let fits = |&i: &usize| track.cycle[i] != track.cycle[here] && others(i);
    let mut below = branch[..at].iter().rev().copied().filter(fits).peekable();
    let mut above = branch[at + 1..].iter().copied().filter(fits).peekable();
    let far = |i: usize| (track.displacement_mm[i] - track.displacement_mm[here]).abs();
    let next = || match (below.peek(), above.peek()) {
        (Some(&b), Some(&a)) if far(b) <= far(a) => below.next(),
        (_, Some(_)) => above.next(),
        _ => below.next(),
    };
    std::iter::from_fn(next).take(NEIGHBOURS).collect()
}

/// Fall of the sum of squares on selecting cycles when the fitted cycles' residuals at the same displacement predict them.
pub(super) fn gain(data: &Data, residuals: &[f64]) -> f64 {
    // The neighbours' mean is shrunk by a factor from the fitted cycles alone.
    let (mut product, mut square) = (0.0, 0.0);
    let mut pairs = Vec::new();
    let mut from = 0;
    for (track, &length) in data.tracks.iter().zip(&data.lengths) {
        let counts = |i: usize| data.weight[from + i] > 0.0;
        let fitted = |i: usize| data.split[from + i] == Split::Fit;
        for branch in branches(track, counts) {
            for at in 0..branch.len() {
                let here = from + branch[at];
                let near = nearest(track, &branch, at, fitted);
                if near.is_empty() {
                    continue;
                }
                let mean = near.iter().map(|i| residuals[from + i]).sum::<f64>() / near.len() as f64;
                match data.split[here] {
                    Split::Fit => {
                        product += residuals[here] * mean;
                        square += mean * mean;
                    }
                    Split::Select => pairs.push((residuals[here], mean)),
                    Split::Report => {}
                }
            }
        }
        from += length;
    }
    let shrinkage = (product / square.max(1e-12)).clamp(0.0, 1.0);
    pairs
        .iter()
        .map(|(here, mean)| here.powi(2) - (here - shrinkage * mean).powi(2))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fitting::sampled;

    /// 20 samples per cycle over 10 mm: a ripple of 2 mm changes its sign between one sample and the next.
    #[test]
    fn a_ripple_finer_than_the_sampling_is_found() {
        let (data, noise) = sampled(0.0507, 40.0, |_, _| 0.0);
        let selecting = data.count(Split::Select) as f64;
        let none = gain(&data, &noise);
        assert!(none < 0.05 * selecting, "{none} of {selecting}");
        let (data, ripple) = sampled(0.0507, 40.0, |x, _| (std::f64::consts::PI * x).sin());
        let found = gain(&data, &ripple);
        // The ripple has a mean square of 0.5; six neighbours of unit noise predict most of it.
        assert!(found > 0.2 * selecting, "{found} of {selecting}");
    }
}
