//! Thins a recording into bins of samples: fine after reversals, coarse in cycles that are not compared.

use std::ops::Range;

use super::travel::Travel;

/// About this many cycles, spread over the recording, are compared, besides the first two and the last two.
const FINE_CYCLES: u32 = 9;
/// Width of a fine bin: one 600th of the stroke, or this share of the travel from or to the nearer reversal if that is more.
const FINE_PER_STROKE: f64 = 600.0;
const FINE_TRAVEL: f64 = 0.04;
/// Width of a coarse bin: one 25th of the stroke. The second figure is how much longer it may last than a fine one.
const COARSE_PER_STROKE: f64 = 25.0;
const COARSE_TIME: f64 = 8.0;
/// A fine bin lasts at most one 300th of the recording, or of 30 s if that is less.
const BINS_IN_TIME: f64 = 300.0;
const LONGEST_S: f64 = 30.0;
/// Bins that may exceed the budget, per half cycle: samples at a turning point have bins of their own.
const EXTRA_PER_HALF: usize = 4;

/// At most about `budget` bins, none over a gap, and whether each is compared. `gaps` are the last samples before one. Bins of cycles that are not compared are too wide for their mean
/// force to belong to their mean displacement; the plant is only stepped over them.
pub(super) fn bins(
    time_s: &[f64],
    x: &[f64],
    travel: &Travel,
    gaps: &[usize],
    stroke_mm: f64,
    budget: usize,
) -> Vec<(Range<usize>, bool)> {
    let n = time_s.len();
    if n <= budget {
        return (0..n).map(|i| (i..i + 1, true)).collect();
    }
    let halves = travel.half[n - 1] + 1;
    let cycles = halves.div_ceil(2);
    let every = cycles.div_ceil(FINE_CYCLES).max(1);
    let fine = |i: usize| {
        let cycle = travel.half[i] / 2;
        cycle.is_multiple_of(every) || cycle + 2 >= cycles || cycle <= 1
    };
    let widths = widths(time_s, x, travel, stroke_mm, &fine);
    let mut scale = widths.iter().sum::<f64>() / budget as f64;
    loop {
        let bins = filled(&widths, scale, travel, gaps);
        if bins.len() <= budget + gaps.len() + EXTRA_PER_HALF * halves as usize || scale > 1e12 {
            return bins
                .into_iter()
                .map(|bin| (bin.clone(), fine(bin.start)))
                .collect();
        }
        scale *= 1.1;
    }
}

/// Distance of each sample from the one before, in bin widths.
fn widths(
    time_s: &[f64],
    x: &[f64],
    travel: &Travel,
    stroke_mm: f64,
    fine: &dyn Fn(usize) -> bool,
) -> Vec<f64> {
    let n = time_s.len();
    let duration_s = time_s[n - 1] - time_s[0];
    let width = |i: usize| {
        let (resolution_mm, slow) = if fine(i) {
            let turn_mm = travel.since_mm[i].min(travel.until_mm[i]);
            ((stroke_mm / FINE_PER_STROKE).max(FINE_TRAVEL * turn_mm), 1.0)
        } else {
            (stroke_mm / COARSE_PER_STROKE, COARSE_TIME)
        };
        let dt_s = time_s[i] - time_s[i - 1];
        (x[i] - x[i - 1]).abs() / resolution_mm + BINS_IN_TIME * dt_s / duration_s.min(LONGEST_S) / slow
    };
    (0..n).map(|i| if i == 0 { 0.0 } else { width(i) }).collect()
}

/// Bins that are each filled with `scale` widths. A turning point and the sample before it have bins of their own: a mean would
/// shorten the travel.
fn filled(widths: &[f64], scale: f64, travel: &Travel, gaps: &[usize]) -> Vec<Range<usize>> {
    let n = widths.len();
    let mut bins = Vec::new();
    let (mut start, mut filled) = (0, 0.0);
    for (i, width) in widths.iter().enumerate() {
        filled += width / scale;
        let turns = (1..=2).any(|k| i + k < n && travel.half[i + k] != travel.half[i])
            || (i > 0 && travel.half[i - 1] != travel.half[i]);
        if filled >= 1.0 || turns || i + 1 == n || gaps.contains(&i) {
            bins.push(start..i + 1);
            start = i + 1;
            filled = 0.0;
        }
    }
    bins
}
