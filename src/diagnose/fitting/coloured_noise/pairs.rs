//! Differences of the residuals at one place in two cycles, half the recording apart, and what a change of the specimen explains of them.

use nalgebra::{DMatrix, DVector};

use super::same_place::is_same_place;
use crate::diagnose::conditioning::{Track, range};

/// Fewest cycles that are compared, and fewest pairs of points, for an estimate.
const LEAST_CYCLES: usize = 4;
const LEAST_PAIRS: usize = 60;
/// Decay of a run-in, in cycles.
const DECAYS: [f64; 3] = [1.5, 5.0, 20.0];
/// Columns of the regression for what changes smoothly: time, and four shapes for each decay and for a linear change.
const SHAPES: usize = 4;
const SMOOTH: usize = 1 + SHAPES * (DECAYS.len() + 1);
/// Ridge of the regression, as a share of the number of points: decays of few cycles are nearly the same.
const RIDGE: f64 = 1e-6;
/// Columns for what changes once: the change at each of some places of the travel, linear between them, on each branch. A leaf that
/// cracks is softer in a part of the travel only.
const PLACES: usize = 6;
const ONCE: usize = 2 * PLACES;
const CHANGES: usize = SMOOTH + ONCE;

/// Points with what they are compared with in another cycle.
pub(super) struct Pairs {
    /// Index of each point, in order of time.
    pub points: Vec<usize>,
    /// Number of the point's cycle among those that are compared.
    place: Vec<usize>,
    /// The two points around it in the other cycle, the share of the second, and the number of that cycle.
    others: Vec<([usize; 2], f64, usize)>,
    /// Difference of the residuals, with the variance of one.
    pub difference: Vec<f64>,
    /// Number of cycles that are compared.
    cycles: usize,
    /// Lowest displacement and stroke in mm.
    low_mm: f64,
    stroke_mm: f64,
}

/// A change of the specimen: from a cycle on, and on one branch of the cycle before, where that is the later one.
#[derive(Clone, Copy)]
struct Change {
    cycle: usize,
    early: Option<usize>,
}

impl Change {
    /// The changes with a cycle, and within the cycle before: with either of its branches.
    fn around(cycle: usize) -> [Change; 3] {
        [None, Some(0), Some(1)].map(|early| Change { cycle, early })
    }

    /// 1 after the change, 0 before it.
    fn is_done(self, cycle: usize, branch: usize) -> f64 {
        let is_early = cycle + 1 == self.cycle && self.early == Some(branch);
        f64::from(u8::from(cycle >= self.cycle || is_early))
    }
}

/// Lowest displacement and stroke in mm.
pub(super) fn extent(track: &Track) -> (f64, f64) {
    let x = &track.displacement_mm;
    (x.iter().copied().fold(f64::INFINITY, f64::min), range(x))
}

/// Branch of a point: 1 where the displacement grows.
fn branch(track: &Track, i: usize) -> usize {
    usize::from(track.direction[i] > 0.0)
}

/// Makes the variance of a difference to a point between two others that of one point.
fn pair_scale(share: f64) -> f64 {
    1.0 / (1.0 + (1.0 - share).powi(2) + share.powi(2)).sqrt()
}

impl Pairs {
    pub(super) fn new(track: &Track, weight: &[f64], residuals: &[f64]) -> Option<Pairs> {
        let counted: Vec<usize> = (0..track.len()).filter(|&i| weight[i] > 0.0).collect();
        let mut cycles: Vec<u32> = counted.iter().map(|&i| track.cycle[i]).collect();
        cycles.sort_unstable();
        cycles.dedup();
        if cycles.len() < LEAST_CYCLES {
            return None;
        }
        let place = |i: usize| cycles.binary_search(&track.cycle[i]).unwrap_or(0);
        let mut branches: Vec<[Vec<usize>; 2]> = vec![[Vec::new(), Vec::new()]; cycles.len()];
        let side = |i: usize| branch(track, i);
        for &i in &counted {
            branches[place(i)][side(i)].push(i);
        }
        let x = &track.displacement_mm;
        let is_same = is_same_place(track);
        for branch in branches.iter_mut().flatten() {
            branch.sort_by(|&a, &b| x[a].total_cmp(&x[b]));
        }
        let (low_mm, stroke_mm) = extent(track);
        let mut pairs = Pairs {
            points: Vec::new(),
            place: Vec::new(),
            others: Vec::new(),
            difference: Vec::new(),
            cycles: cycles.len(),
            low_mm,
            stroke_mm,
        };
        for &i in &counted {
            let away = (place(i) + cycles.len() / 2) % cycles.len();
            let branch = &branches[away][side(i)];
            let above = branch.partition_point(|&j| x[j] < x[i]);
            if above == 0 || above == branch.len() {
                continue;
            }
            let [a, b] = [branch[above - 1], branch[above]];
            if !is_same(i, a) {
                continue;
            }
            let share = if x[b] > x[a] {
                (x[i] - x[a]) / (x[b] - x[a])
            } else {
                0.5
            };
            let there = residuals[a] + share * (residuals[b] - residuals[a]);
            pairs.points.push(i);
            pairs.place.push(place(i));
            pairs.others.push(([a, b], share, away));
            pairs.difference.push((residuals[i] - there) * pair_scale(share));
        }
        (pairs.points.len() >= LEAST_PAIRS).then_some(pairs)
    }

    /// The differences without what changes smoothly with the cycles, or once, at the reversal that explains most.
    pub(super) fn without_changes(&self, track: &Track) -> Option<Vec<f64>> {
        let difference = DVector::from_column_slice(&self.difference);
        let smooth = self.smooth(track);
        let inner = smooth.tr_mul(&smooth).resize(CHANGES, CHANGES, 0.0);
        let right = smooth.tr_mul(&difference).resize_vertically(CHANGES, 0.0);
        let n = self.points.len();
        let rest = |change: Change| {
            let once = self.once(track, change);
            let (mut normal, mut right) = (inner.clone(), right.clone());
            // The lower triangle is enough.
            let mut below = normal.rows_mut(SMOOTH, ONCE);
            below.columns_mut(0, SMOOTH).copy_from(&once.tr_mul(&smooth));
            below.columns_mut(SMOOTH, ONCE).copy_from(&once.tr_mul(&once));
            right.rows_mut(SMOOTH, ONCE).copy_from(&once.tr_mul(&difference));
            for k in 0..CHANGES {
                normal[(k, k)] += RIDGE * n as f64;
            }
            let solved = normal.cholesky()?.solve(&right);
            Some(&difference - &smooth * solved.rows(0, SMOOTH) - once * solved.rows(SMOOTH, ONCE))
        };
        let changes = (1..self.cycles).flat_map(Change::around);
        let rest = changes
            .filter_map(rest)
            .min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
        let scale = (n as f64 / n.saturating_sub(CHANGES).max(1) as f64).sqrt();
        Some((rest * scale).as_slice().to_vec())
    }

    /// Columns of what changes smoothly with the cycles.
    fn smooth(&self, track: &Track) -> DMatrix<f64> {
        let last_s = track.time_s[track.len() - 1].max(f64::MIN_POSITIVE);
        let mut columns = DMatrix::<f64>::zeros(self.points.len(), SMOOTH);
        for (row, (&i, (around, share, away))) in self.points.iter().zip(&self.others).enumerate() {
            let there_s = (1.0 - share) * track.time_s[around[0]] + share * track.time_s[around[1]];
            let scale = pair_scale(*share);
            columns[(row, 0)] = scale * (track.time_s[i] - there_s) / last_s;
            let along = self.along(track, i) - 0.5;
            let shapes = [1.0, along, track.direction[i], along * track.direction[i]];
            let apart = |f: &dyn Fn(f64) -> f64| f(self.place[row] as f64) - f(*away as f64);
            let mut amounts = [apart(&|cycle| cycle / self.cycles as f64); DECAYS.len() + 1];
            for (amount, decay) in amounts.iter_mut().zip(DECAYS) {
                *amount = apart(&|cycle| (-cycle / decay).exp());
            }
            for (k, amount) in amounts.iter().enumerate() {
                for (s, shape) in shapes.iter().enumerate() {
                    columns[(row, 1 + k * SHAPES + s)] = scale * amount * shape;
                }
            }
        }
        columns
    }

    /// Columns of what changes once.
    fn once(&self, track: &Track, change: Change) -> DMatrix<f64> {
        let mut columns = DMatrix::<f64>::zeros(self.points.len(), ONCE);
        for (row, (&i, (_, share, away))) in self.points.iter().zip(&self.others).enumerate() {
            let branch = branch(track, i);
            let amount = change.is_done(self.place[row], branch) - change.is_done(*away, branch);
            if amount == 0.0 {
                continue;
            }
            let at = self.along(track, i) * (PLACES - 1) as f64;
            let below = (at as usize).min(PLACES - 2);
            let over = at - below as f64;
            let amount = pair_scale(*share) * amount;
            columns[(row, branch * PLACES + below)] = amount * (1.0 - over);
            columns[(row, branch * PLACES + below + 1)] = amount * over;
        }
        columns
    }

    /// Place of a point along the stroke, 0 to 1.
    fn along(&self, track: &Track, i: usize) -> f64 {
        (track.displacement_mm[i] - self.low_mm) / self.stroke_mm
    }

    /// Mean square in each third of the stroke on each branch; parts with few points are left out.
    pub(super) fn groups(&self, track: &Track, rest: &[f64]) -> Vec<f64> {
        let mut sums = [(0.0, 0usize); 6];
        for (&i, e) in self.points.iter().zip(rest) {
            let third = ((3.0 * self.along(track, i)) as usize).min(2);
            let group = &mut sums[2 * third + branch(track, i)];
            group.0 += e * e;
            group.1 += 1;
        }
        let enough = sums.iter().filter(|(_, count)| *count >= LEAST_PAIRS / 6);
        enough.map(|(sum, count)| sum / *count as f64).collect()
    }
}
