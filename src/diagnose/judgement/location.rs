//! Where on the loop the residuals lie: of all intervals of an axis, the one whose indicator function scores highest after
//! projection on the baseline's own sensitivities.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::diagnose::course::Split;
use crate::diagnose::diagnosis::Location;
use crate::diagnose::fitting::Data;
use crate::diagnose::search::{AXES, BinnedAxis, binned, coordinate};
use crate::effect::{Axis, Branch, Place};

/// Number of bins of a map and of the scan for a location.
pub(super) const BINS: usize = 24;
/// A place is specific if it holds this many times the energy that its share of the points would.
const SPECIFIC: f64 = 1.4;
/// An interval holds at most this share of the points on its branch, and at most this share of the bins.
const MOST_POINTS: f64 = 0.7;
const MOST_BINS: usize = 3 * BINS / 4;
/// Share of an indicator's power that the baseline's sensitivities must leave, for its score to count.
const LEAST_POWER_LEFT: f64 = 1e-3;
/// Score (a chi-square of one degree of freedom) of an interval that is reported: chance exceeds it once in 640.
const LEAST_SCORE: f64 = 10.0;
/// The score of an interval on one branch counts less: half the points explain less by themselves.
const ONE_BRANCH: f64 = 0.8;
/// Number of axes that are reported.
const MOST_AXES: usize = 4;

/// A location with its share of the explained energy, and whether the place is specific.
type Scanned = (f64, Location, bool);

/// The interval of every axis that explains most, best axis first. `jacobian` holds the baseline's weighted sensitivities.
pub(super) fn locate(data: &Data, residuals: &[f64], jacobian: &DMatrix<f64>) -> Vec<Location> {
    let Some(scan) = LocationScan::new(data, residuals, jacobian) else {
        return Vec::new();
    };
    // Not along the measured force: it contains the residual, so every misfit lies at some force.
    let mut found: Vec<Scanned> = AXES
        .iter()
        .filter(|&&axis| axis != Axis::ForceN)
        .filter_map(|&axis| binned(data, axis, BINS))
        .flat_map(|axis| {
            [Branch::Both, Branch::Loading, Branch::Unloading]
                .into_iter()
                .filter_map(|branch| scan.locate(&axis, branch))
                .collect::<Vec<_>>()
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut axes = Vec::new();
    found.retain(|(_, l, _)| {
        let new = !axes.contains(&l.axis);
        axes.push(l.axis);
        new
    });
    // An interval that covers nearly everything is reported only if there is no other.
    if found.iter().any(|(.., specific)| *specific) {
        found.retain(|(.., specific)| *specific);
    }
    found.into_iter().take(MOST_AXES).map(|(_, l, _)| l).collect()
}

/// Residuals of the fitted cycles, and what the baseline's sensitivities leave of them.
struct LocationScan<'a> {
    data: &'a Data,
    residuals: &'a [f64],
    jacobian: &'a DMatrix<f64>,
    normal: Cholesky<f64, Dyn>,
    /// The residuals after projection; held-out points are zero.
    projected: DVector<f64>,
    /// Sum of squares of `projected` above the noise.
    above_noise: f64,
}

/// Scores of the bins of an axis, for an indicator that is even or odd in the direction of travel.
struct BinScores {
    score: [f64; BINS],
    power: [f64; BINS],
    /// Product of each bin's indicator with each sensitivity.
    overlap: Vec<DVector<f64>>,
}

/// An interval of bins, both ends included, with its score.
#[derive(Clone, Copy)]
struct ScoredInterval {
    score: f64,
    from: usize,
    to: usize,
}

impl<'a> LocationScan<'a> {
    fn new(data: &'a Data, residuals: &'a [f64], jacobian: &'a DMatrix<f64>) -> Option<LocationScan<'a>> {
        let mut normal = jacobian.tr_mul(jacobian);
        for i in 0..jacobian.ncols() {
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + 1e-9;
        }
        let normal = normal.cholesky()?;
        let fitted = |i: usize| i < data.len() && data.split[i] == Split::Fit;
        let rows = (0..jacobian.nrows()).map(|i| if fitted(i) { residuals[i] } else { 0.0 });
        let mut projected = DVector::from_iterator(jacobian.nrows(), rows);
        projected -= jacobian * normal.solve(&jacobian.tr_mul(&projected));
        Some(LocationScan {
            data,
            residuals,
            jacobian,
            above_noise: (projected.norm_squared() - data.count(Split::Fit) as f64).max(1e-9),
            normal,
            projected,
        })
    }

    /// The best interval of an axis on a branch.
    fn locate(&self, axis: &BinnedAxis, branch: Branch) -> Option<Scanned> {
        let (energy, points) = self.energy(axis, branch);
        // Even indicators find stiffness and offsets, odd ones friction.
        let mut best = self.best(None, &self.scores(axis, branch, false), &points);
        if branch == Branch::Both {
            best = self.best(best, &self.scores(axis, branch, true), &points);
        }
        let ScoredInterval { score, from, to } = best?;
        let explained = score / self.above_noise;
        let share = self.share(&energy[from..=to]);
        let (low, high) = (axis.edges[from], axis.edges[to + 1]);
        let location = Location {
            axis: axis.axis,
            from: low,
            to: high,
            direction: branch,
            share,
            words: words(axis.axis, low, high, branch, share),
        };
        let rank = if branch == Branch::Both {
            explained
        } else {
            ONE_BRANCH * explained
        };
        let held = points[from..=to].iter().sum::<usize>() as f64;
        let specific = share > SPECIFIC * held / self.data.count(Split::Fit).max(1) as f64;
        (score > LEAST_SCORE).then_some((rank, location, specific))
    }

    /// Fitted points on a branch, with their bins.
    fn points<'s>(
        &'s self,
        axis: &'s BinnedAxis,
        branch: Branch,
    ) -> impl Iterator<Item = (usize, usize)> + 's {
        (0..self.data.len()).filter_map(move |i| {
            let bin = axis.bin[i]?;
            let on = match branch {
                Branch::Both => true,
                Branch::Loading => axis.direction[i] > 0.0,
                Branch::Unloading => axis.direction[i] < 0.0,
            };
            (on && self.data.split[i] == Split::Fit).then_some((i, bin))
        })
    }

    /// Sum of squares above the noise, and number of points, in each bin.
    fn energy(&self, axis: &BinnedAxis, branch: Branch) -> ([f64; BINS], [usize; BINS]) {
        let (mut energy, mut points) = ([0.0; BINS], [0; BINS]);
        for (i, bin) in self.points(axis, branch) {
            energy[bin] += self.residuals[i] * self.residuals[i] - 1.0;
            points[bin] += 1;
        }
        (energy, points)
    }

    fn scores(&self, axis: &BinnedAxis, branch: Branch, odd: bool) -> BinScores {
        let parameters = self.jacobian.ncols();
        let mut scores = BinScores {
            score: [0.0; BINS],
            power: [0.0; BINS],
            overlap: vec![DVector::zeros(parameters); BINS],
        };
        for (i, bin) in self.points(axis, branch) {
            let w = self.data.weight[i] * if odd { axis.direction[i] } else { 1.0 };
            scores.score[bin] += w * self.projected[i];
            scores.power[bin] += w * w;
            for k in 0..parameters {
                scores.overlap[bin][k] += w * self.jacobian[(i, k)];
            }
        }
        scores
    }

    /// The interval with the highest score, or `best` if none is higher.
    fn best(
        &self,
        mut best: Option<ScoredInterval>,
        bins: &BinScores,
        points: &[usize; BINS],
    ) -> Option<ScoredInterval> {
        let on_branch = points.iter().sum::<usize>() as f64;
        for from in 0..BINS {
            let mut overlap = DVector::<f64>::zeros(self.jacobian.ncols());
            let (mut sum, mut power, mut held) = (0.0, 0.0, 0);
            for (to, count) in points.iter().enumerate().skip(from) {
                sum += bins.score[to];
                power += bins.power[to];
                overlap += &bins.overlap[to];
                held += count;
                if to - from + 1 > MOST_BINS || held as f64 > MOST_POINTS * on_branch {
                    break;
                }
                let left = power - overlap.dot(&self.normal.solve(&overlap));
                if left > LEAST_POWER_LEFT * power && power > 0.0 {
                    let score = sum * sum / left;
                    if best.is_none_or(|b| score > b.score) {
                        best = Some(ScoredInterval { score, from, to });
                    }
                }
            }
        }
        best
    }

    /// Share of the sum of squares above the noise that lies in some bins.
    fn share(&self, energy: &[f64]) -> f64 {
        let inside: f64 = energy.iter().sum();
        let everywhere: f64 = (0..self.data.len())
            .filter(|&i| self.data.split[i] == Split::Fit && self.data.weight[i] > 0.0)
            .map(|i| self.residuals[i] * self.residuals[i] - 1.0)
            .sum();
        (inside / everywhere.max(1e-9)).clamp(0.0, 1.0)
    }
}

/// A location as a sentence.
pub(super) fn words(axis: Axis, from: f64, to: f64, branch: Branch, share: f64) -> String {
    let place = match axis {
        Axis::DistanceFromReversalMm if from < 0.02 * to => format!("within {to:.2} mm after a reversal"),
        Axis::DistanceFromReversalMm => format!("{from:.2} to {to:.2} mm after a reversal"),
        Axis::DisplacementMm => format!("between {from:.2} and {to:.2} mm"),
        Axis::ForceN => format!("between {from:.0} and {to:.0} N"),
        Axis::VelocityMmS => format!("at speeds of {from:.1} to {to:.1} mm/s"),
        Axis::AccelerationMmS2 => format!("at accelerations of {from:.0} to {to:.0} mm/s2"),
        Axis::Cycle => format!("in cycles {from:.0} to {to:.0}"),
        Axis::TimeS => format!("from {from:.1} to {to:.1} s"),
        Axis::FrequencyHz => format!("at {from:.2} to {to:.2} Hz"),
    };
    let branch = match branch {
        Branch::Loading => "on the loading branch",
        Branch::Unloading => "on the unloading branch",
        Branch::Both => "on both branches",
    };
    format!(
        "{:.0} % of the difference above the noise is {place}, {branch}",
        100.0 * share
    )
}

/// Share of the residual's sum of squares above the noise that lies in a place.
pub(super) fn share_in(data: &Data, residuals: &[f64], place: &Place) -> f64 {
    let (mut inside, mut all, mut k) = (0.0, 0.0, 0);
    for track in &data.tracks {
        for i in 0..track.len() {
            if data.weight[k] > 0.0 {
                let energy = residuals[k] * residuals[k] - 1.0;
                all += energy;
                let at = coordinate(track, i, place.axis);
                let on = match place.branch {
                    Branch::Both => true,
                    Branch::Loading => track.direction[i] > 0.0,
                    Branch::Unloading => track.direction[i] < 0.0,
                };
                if on && at >= place.from && at <= place.to {
                    inside += energy;
                }
            }
            k += 1;
        }
    }
    if all > 0.0 {
        (inside / all).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fitting::case;

    #[test]
    fn a_local_friction_is_located_to_a_bin() {
        let (data, residuals) = case(|x, d| if (4.0..6.0).contains(&x) { 3.0 * d } else { 0.0 });
        let jacobian = DMatrix::from_fn(data.len(), 2, |i, k| {
            if k == 0 {
                data.weight[i]
            } else {
                data.weight[i] * data.tracks[0].displacement_mm[i]
            }
        });
        let place = locate(&data, &residuals, &jacobian)
            .into_iter()
            .find(|l| l.axis == Axis::DisplacementMm)
            .expect("located");
        // A bin is 10/24 mm wide.
        assert!(
            (place.from - 4.0).abs() < 0.5 && (place.to - 6.0).abs() < 0.5,
            "{place:?}"
        );
        assert!(place.share > 0.7 && place.words.contains("mm"), "{place:?}");
    }
}
