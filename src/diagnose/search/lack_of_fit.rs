//! Lack of fit: structure in the residuals that no candidate explains.
//!
//! It is found by regressions on bins of displacement, travel since reversal, force, speed, cycle and time, with and without the
//! sign of the direction. Whatever repeats along one of these axes is found, without a name. The regressions are fitted on fitted
//! cycles and judged on selecting cycles.

use nalgebra::{DMatrix, DVector};

use super::binning::{AXES, BinnedAxis, binned};
use super::near_replicates;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, LikelihoodScale, Node};
use crate::effect::Axis;

/// Number of bins along the displacement, where ripples are finest, and along every other axis.
const FINE: usize = 64;
const COARSE: usize = 12;
/// Bins of a regression on displacement only. Fewer bins fit less noise. A ripple is the same in both directions.
const DISPLACEMENT_BINS: [usize; 2] = [24, FINE];
/// Numbers of cycles after which the specimen may have changed, so that earlier and later residuals differ.
const CHANGE_CYCLES: [u32; 4] = [2, 3, 5, 10];
/// Ridge penalty: structure of half the noise is expected in a bin, so empty bins stay at zero and uncertain ones small.
const RIDGE: f64 = 4.0;

/// The lack of fit is structure only if it exceeds both: a mean square in units of the noise, a gain in log-likelihood. Chosen so
/// that noise and the inexact form of an effect stay below.
pub(in crate::diagnose) const LACK_POWER: f64 = 0.06;
pub(in crate::diagnose) const LACK_GAIN: f64 = 10.0;

/// What the best of the regressions explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::diagnose) struct LackOfFit {
    /// Fall of the sum of squares on selecting cycles.
    pub sum: f64,
    /// The same per selecting point where the structure acts: a mean square in units of the noise.
    pub power: f64,
}

/// Sum of squares of the structure that a set leaves, over all fitted and compared points.
pub(in crate::diagnose) fn rest(data: &Data, residuals: &[f64]) -> f64 {
    lack_of_fit(data, residuals).power.max(0.0) * data.counted() as f64
}

/// True if a set leaves more than noise and the inexact form of an effect.
pub(super) fn leaves_structure(data: &Data, likelihood: LikelihoodScale, set: &Node) -> bool {
    let left = lack_of_fit(data, &set.residuals);
    left.power > LACK_POWER && likelihood.gain(left.sum) > LACK_GAIN
}

/// The largest of four: all axes together, displacement alone, near replicates, and a change after some cycles.
pub(in crate::diagnose) fn lack_of_fit(data: &Data, residuals: &[f64]) -> LackOfFit {
    let selecting = data.count(Split::Select).max(1) as f64;
    let mut most = 0f64.max(near_replicates::gain(data, residuals));
    most = most.max(axes_together(data, residuals, &AXES));
    most = most.max(displacement_alone(data, residuals));
    let repeated = LackOfFit {
        sum: most,
        power: most / selecting,
    };
    changed(data, residuals, repeated)
}

/// The part of a lack of fit that follows the place, the cycle or the time, as a fall of the sum of squares: no friction law knows them.
pub(in crate::diagnose) fn beyond_friction(data: &Data, residuals: &[f64]) -> f64 {
    let none = LackOfFit { sum: 0.0, power: 0.0 };
    let places = axes_together(data, residuals, &[Axis::DisplacementMm, Axis::Cycle, Axis::TimeS]);
    let places = places.max(displacement_alone(data, residuals));
    places.max(changed(data, residuals, none).sum)
}

/// Gain of the displacement alone, the same in both directions.
fn displacement_alone(data: &Data, residuals: &[f64]) -> f64 {
    let gains = DISPLACEMENT_BINS.map(|bins| {
        let axis = binned(data, Axis::DisplacementMm, bins)?;
        let row = |i: usize| axis.bin[i].map(|b| (b, data.weight[i])).into_iter().collect();
        Some(gain(data, residuals, bins, row))
    });
    gains.into_iter().flatten().fold(0.0, f64::max)
}

/// Gain of axes together, each with one column per bin and one per bin times the direction.
fn axes_together(data: &Data, residuals: &[f64], axes: &[Axis]) -> f64 {
    let axes: Vec<BinnedAxis> = axes
        .iter()
        .filter_map(|&a| binned(data, a, if a == Axis::DisplacementMm { FINE } else { COARSE }))
        .collect();
    let bins: usize = axes.iter().map(BinnedAxis::len).sum();
    let row = |i: usize| {
        let mut entries = Vec::with_capacity(2 * axes.len());
        let mut first = 0;
        for axis in &axes {
            if let Some(bin) = axis.bin[i] {
                entries.push((first + bin, data.weight[i]));
                entries.push((bins + first + bin, data.weight[i] * axis.direction[i]));
            }
            first += axis.len();
        }
        entries
    };
    gain(data, residuals, 2 * bins, row)
}

/// The lack of fit of a change after some cycles, if that is larger than `found`.
fn changed(data: &Data, residuals: &[f64], mut found: LackOfFit) -> LackOfFit {
    let Some(axis) = binned(data, Axis::DisplacementMm, COARSE) else {
        return found;
    };
    let cycle: Vec<u32> = data.tracks.iter().flat_map(|t| t.cycle.clone()).collect();
    let counted: Vec<usize> = (0..data.len()).filter(|&i| data.weight[i] > 0.0).collect();
    for cycles in CHANGE_CYCLES {
        let before = |i: usize| cycle[i] <= cycles;
        let early: Vec<usize> = counted.iter().copied().filter(|&i| before(i)).collect();
        let share = early.len() as f64 / counted.len().max(1) as f64;
        let acts = early.iter().filter(|&&i| data.split[i] == Split::Select).count();
        // Orthogonal to a constant over all cycles.
        let row = |i: usize| {
            let side = if before(i) { 1.0 - share } else { -share };
            axis.bin[i]
                .map(|b| (b, data.weight[i] * side))
                .into_iter()
                .collect()
        };
        let sum = gain(data, residuals, COARSE, row);
        if acts > 0 && sum / acts as f64 > found.power && sum > found.sum {
            found = LackOfFit {
                sum,
                power: sum / acts as f64,
            };
        }
    }
    found
}

/// Fall of the sum of squares on selecting cycles by a ridge regression on fitted cycles. `row` gives the columns of a point that
/// are not zero.
fn gain(data: &Data, residuals: &[f64], columns: usize, row: impl Fn(usize) -> Vec<(usize, f64)>) -> f64 {
    let mut normal = DMatrix::<f64>::zeros(columns, columns);
    let mut right = DVector::<f64>::zeros(columns);
    for (i, residual) in residuals.iter().enumerate() {
        if data.split[i] != Split::Fit {
            continue;
        }
        let entries = row(i);
        for &(c, v) in &entries {
            right[c] += v * residual;
            for &(d, w) in &entries {
                normal[(c, d)] += v * w;
            }
        }
    }
    let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1) as f64;
    let ridge = RIDGE * data.weight.iter().map(|w| w * w).sum::<f64>() / counted;
    for c in 0..columns {
        normal[(c, c)] += ridge;
    }
    let Some(solved) = normal.cholesky().map(|c| c.solve(&right)) else {
        return 0.0;
    };
    let mut gain = 0.0;
    for (i, residual) in residuals.iter().enumerate() {
        if data.split[i] != Split::Select || data.weight[i] == 0.0 {
            continue;
        }
        let predicted: f64 = row(i).iter().map(|&(c, v)| v * solved[c]).sum();
        gain += residual.powi(2) - (residual - predicted).powi(2);
    }
    gain
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fitting::case;

    #[test]
    fn structure_is_found_and_noise_is_not() {
        let (data, noise) = case(|_, _| 0.0);
        let none = lack_of_fit(&data, &noise).sum;
        // A fit to noise makes the other cycles worse, by about 1 per bin.
        assert!(none < 4.8, "{none}");
        let (data, ripple) = case(|x, _| (4.0 * x).sin());
        let found = lack_of_fit(&data, &ripple).sum;
        // The ripple has a mean square of 0.5; most of it is found.
        assert!(found > 0.25 * data.count(Split::Select) as f64, "{found}");
    }

    #[test]
    fn a_ripple_is_beyond_friction_and_an_error_after_reversals_is_not() {
        let (data, ripple) = case(|x, _| (4.0 * x).sin());
        assert!(beyond_friction(&data, &ripple) > 0.9 * lack_of_fit(&data, &ripple).sum);
        let (data, mut turning) = case(|_, _| 0.0);
        let track = &data.tracks[0];
        for (i, residual) in turning.iter_mut().enumerate() {
            *residual += track.direction[i] * (-track.since_reversal_mm[i]).exp();
        }
        let found = lack_of_fit(&data, &turning).sum;
        let beyond = beyond_friction(&data, &turning);
        assert!(found > 20.0 && beyond < 0.7 * found, "{beyond} of {found}");
    }

    #[test]
    fn a_change_after_two_cycles_is_found() {
        let (data, mut residuals) = case(|_, _| 0.0);
        let noise = lack_of_fit(&data, &residuals);
        let track = &data.tracks[0];
        for (i, residual) in residuals.iter_mut().enumerate() {
            if track.cycle[i] <= 2 && data.weight[i] > 0.0 {
                *residual += 1.2 * (-((track.displacement_mm[i] - 5.0) / 2.0).powi(2)).exp();
            }
        }
        let found = lack_of_fit(&data, &residuals);
        // It acts in two of ten cycles over a third of the travel: over all points its power is small.
        assert!(
            found.power > 0.06 && noise.power < 0.02,
            "{found:?}, noise {noise:?}"
        );
    }
}
