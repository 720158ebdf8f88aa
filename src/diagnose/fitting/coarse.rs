//! A thinned copy of the tracks. Sets of effects are first fitted to it, because that is faster, and from there to all points.
//!
//! One point in n stays and counts n times, so that sums of squares, priors and gains keep their size. The two points at each reversal
//! stay as well, without weight: a model with friction depends on where the motion turned.

use std::sync::Arc;

use super::data::Data;

/// Points of a track that are enough to screen on: of ten cycles, 50 each.
const ENOUGH: usize = 500;

impl Data {
    /// Fewer points of the same tracks; `None` where they have few already.
    pub(super) fn coarse(&self) -> Option<Data> {
        let strides: Vec<usize> = self.lengths.iter().map(|n| (n / ENOUGH).max(1)).collect();
        if strides.iter().all(|&stride| stride == 1) {
            return None;
        }
        let (mut points, mut factors) = (Vec::new(), Vec::new());
        let (mut tracks, mut lengths) = (Vec::new(), Vec::new());
        let mut from = 0;
        for (track, &stride) in self.tracks.iter().zip(&strides) {
            let kept: Vec<usize> = (0..track.len())
                .filter(|&i| i % stride == 0 || track.is_at_reversal(i))
                .collect();
            let times = (stride as f64).sqrt();
            factors.extend(kept.iter().map(|i| if i % stride == 0 { times } else { 0.0 }));
            points.extend(kept.iter().map(|i| from + i));
            lengths.push(kept.len());
            tracks.push(track.picked(&kept));
            from += track.len();
        }
        let split: Vec<_> = points.iter().map(|&i| self.split[i]).collect();
        let discrepancy = match &self.discrepancy {
            Some(discrepancy) => Some(Arc::new(discrepancy.picked(&points, &factors, &split)?)),
            None => None,
        };
        let weight = points
            .iter()
            .zip(&factors)
            .map(|(&i, factor)| self.weight[i] * factor);
        Some(Data {
            weight: weight.collect(),
            force_n: points.iter().map(|&i| self.force_n[i]).collect(),
            tracks,
            split,
            lengths,
            discrepancy,
            ..*self
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::data::tests::sampled;
    use crate::diagnose::course::Split;

    #[test]
    fn fewer_points_keep_the_sums_and_the_reversals() {
        let (data, residuals) = sampled(0.004, 12.0, |x, _| 0.2 * (x - 6.0));
        let coarse = data.coarse().expect("many points");
        assert!(
            coarse.len() < data.len() / 2,
            "{} of {}",
            coarse.len(),
            data.len()
        );
        let track = &coarse.tracks[0];
        let reached = |of: &crate::diagnose::conditioning::Track| {
            let turns = of.turns();
            turns.map(|i| of.displacement_mm[i - 1]).collect::<Vec<f64>>()
        };
        assert_eq!(reached(track), reached(&data.tracks[0]));
        // The same residuals at the points that stay: the sum of squares is within what a third of the points can tell.
        let at = |time_s: f64| data.tracks[0].time_s.iter().position(|t| *t == time_s);
        let same: Vec<f64> = (0..coarse.len())
            .map(|i| {
                at(track.time_s[i]).map_or(0.0, |at| {
                    residuals[at] * coarse.weight[i] / data.weight[at].max(1e-9)
                })
            })
            .collect();
        let (few, all) = (coarse.sum(&same, Split::Fit), data.sum(&residuals, Split::Fit));
        assert!((few / all - 1.0).abs() < 0.15, "{few} and {all}");
        assert!(coarse.coarse().is_none());
    }
}
