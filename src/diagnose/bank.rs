//! What is left that no candidate explains.
//!
//! The bank is a regression on boxes of displacement, travel since reversal, force, speed, cycle and time, each also times the
//! direction: whatever comes again along one of them is found, without a name. Fitted on fitted cycles, judged on others.

use nalgebra::{DMatrix, DVector};

use super::condition::Split;
use super::problem::Data;
use super::repeats;
use super::residual::{AXES, Binned, binned};
use crate::effect::Axis;

/// Boxes along the displacement, and along every other axis.
const FINE: usize = 64;
const COARSE: usize = 12;
/// Boxes along the displacement alone: fewer have less noise to fit, and a ripple is the same both ways.
const ALONE: [usize; 2] = [24, FINE];
/// What is left before and after so many cycles of a recording may differ: something gave way.
const GAVE_WAY: [u32; 4] = [2, 3, 5, 10];

/// What the bank still takes from the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Left {
    /// Sum of squares on selecting cycles.
    pub sum: f64,
    /// The same for each selecting sample where it acts.
    pub power: f64,
}

/// What the bank takes most of: all axes at once, the displacement alone, what comes again at the same place, and what differs
/// along the displacement before and after something gave way.
pub(super) fn left(data: &Data, residuals: &[f64]) -> Left {
    let selecting = data.count(Split::Select).max(1) as f64;
    let mut most = 0f64.max(repeats::gain(data, residuals));
    // Ripples along the travel are finer than anything along the other axes.
    let every: Vec<Binned> = AXES
        .iter()
        .filter_map(|&a| binned(data, a, if a == Axis::DisplacementMm { FINE } else { COARSE }))
        .collect();
    let boxes: usize = every.iter().map(Binned::len).sum();
    let row = |i: usize| {
        let mut entries = Vec::with_capacity(2 * every.len());
        let mut first = 0;
        for axis in &every {
            if let Some(bin) = axis.bin[i] {
                entries.push((first + bin, data.weight[i]));
                entries.push((boxes + first + bin, data.weight[i] * axis.direction[i]));
            }
            first += axis.len();
        }
        entries
    };
    most = most.max(gain(data, residuals, 2 * boxes, row));
    for boxes in ALONE {
        if let Some(axis) = binned(data, Axis::DisplacementMm, boxes) {
            let row = |i: usize| axis.bin[i].map(|b| (b, data.weight[i])).into_iter().collect();
            most = most.max(gain(data, residuals, boxes, row));
        }
    }
    let mut left = Left {
        sum: most,
        power: most / selecting,
    };
    let Some(axis) = binned(data, Axis::DisplacementMm, COARSE) else {
        return left;
    };
    let cycle: Vec<u32> = data.tracks.iter().flat_map(|t| t.cycle.clone()).collect();
    let counted: Vec<usize> = (0..data.len()).filter(|&i| data.weight[i] > 0.0).collect();
    for cycles in GAVE_WAY {
        let before = |i: usize| cycle[i] <= cycles;
        let early: Vec<usize> = counted.iter().copied().filter(|&i| before(i)).collect();
        let share = early.len() as f64 / counted.len().max(1) as f64;
        let acts = early.iter().filter(|&&i| data.part[i] == Split::Select).count();
        // Orthogonal to what is the same in all cycles.
        let row = |i: usize| {
            let side = if before(i) { 1.0 - share } else { -share };
            axis.bin[i]
                .map(|b| (b, data.weight[i] * side))
                .into_iter()
                .collect()
        };
        let sum = gain(data, residuals, COARSE, row);
        if acts > 0 && sum / acts as f64 > left.power && sum > left.sum {
            left = Left {
                sum,
                power: sum / acts as f64,
            };
        }
    }
    left
}

/// Sum of squares on selecting cycles that a regression on fitted cycles takes away; `row` has the columns of a point that are
/// not zero.
fn gain(data: &Data, residuals: &[f64], columns: usize, row: impl Fn(usize) -> Vec<(usize, f64)>) -> f64 {
    let mut normal = DMatrix::<f64>::zeros(columns, columns);
    let mut right = DVector::<f64>::zeros(columns);
    for (i, residual) in residuals.iter().enumerate() {
        if data.part[i] != Split::Fit {
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
    // Structure of half the noise is expected before looking: empty boxes stay empty, doubtful ones small.
    let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1) as f64;
    let expected = 4.0 * data.weight.iter().map(|w| w * w).sum::<f64>() / counted;
    for c in 0..columns {
        normal[(c, c)] += expected;
    }
    let Some(solved) = normal.cholesky().map(|c| c.solve(&right)) else {
        return 0.0;
    };
    let mut gain = 0.0;
    for (i, residual) in residuals.iter().enumerate() {
        if data.part[i] != Split::Select || data.weight[i] == 0.0 {
            continue;
        }
        let predicted: f64 = row(i).iter().map(|&(c, v)| v * solved[c]).sum();
        gain += residual.powi(2) - (residual - predicted).powi(2);
    }
    gain
}

#[cfg(test)]
mod tests {
    use super::super::residual::tests::case;
    use super::*;

    #[test]
    fn the_bank_finds_structure_and_leaves_noise() {
        let (data, noise) = case(|_, _| 0.0);
        let none = left(&data, &noise).sum;
        // Fitting noise makes other cycles worse, by about a unit a box; 48 boxes are the fewest.
        assert!(none < 4.8, "{none}");
        let (data, ripple) = case(|x, _| (4.0 * x).sin());
        let found = left(&data, &ripple).sum;
        // Half a unit of mean square over the selecting cycles, most of it.
        assert!(found > 0.25 * data.count(Split::Select) as f64, "{found}");
    }

    #[test]
    fn what_gave_way_early_is_found_where_it_acts() {
        let (data, mut residuals) = case(|_, _| 0.0);
        let noise = left(&data, &residuals);
        let track = &data.tracks[0];
        for (i, residual) in residuals.iter_mut().enumerate() {
            if track.cycle[i] <= 2 && data.weight[i] > 0.0 {
                *residual += 1.2 * (-((track.displacement_mm[i] - 5.0) / 2.0).powi(2)).exp();
            }
        }
        let found = left(&data, &residuals);
        // Two of ten cycles, a third of the travel: next to nothing of the whole.
        assert!(
            found.power > 0.06 && noise.power < 0.02,
            "{found:?}, of noise {noise:?}"
        );
    }
}
