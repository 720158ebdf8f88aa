//! Position of each sample between two turning points: half cycle, direction, travel. Input and output are columns of numbers.

use super::smoothing::{median, range};
use super::turning_points::TurningPoint;

/// Columns over the samples of a recording.
pub(super) struct Travel {
    /// Half cycle, from 0.
    pub half: Vec<u32>,
    /// Direction of travel: 1 loading, -1 unloading.
    pub direction: Vec<f64>,
    /// Travel since the last reversal in mm.
    pub since_mm: Vec<f64>,
    /// Travel to the next reversal in mm.
    pub until_mm: Vec<f64>,
    /// Samples at which the motion turns, in order.
    pub turns: Vec<usize>,
}

/// The motion begins at rest at the unloaded end if the first displacement is within this share of the stroke from the lowest, and
/// the first force within this share of the range.
const REST_DISPLACEMENT: f64 = 0.03;
const REST_FORCE: f64 = 0.05;
/// A motion that first falls by more than this share of the stroke began within a cycle; a vibration at rest falls by less.
const REST_FALL: f64 = 0.003;
/// Share of the stroke after which a motion from rest is compared.
const FIRST_TRAVEL: f64 = 0.1;
/// Travel in one direction, as a share of the stroke, after which an unknown state of the friction counts as forgotten. The largest share
/// is used with which all such states together cost at most `MOST_FORGETTING` of the samples, otherwise the smallest. After the smallest, a friction that reverses over a twentieth of the stroke has
/// 2 % of the unknown state left; one that reverses over a third needs the largest.
const FORGETTING: [f64; 3] = [0.8, 0.4, 0.2];
const MOST_FORGETTING: f64 = 0.1;

impl Travel {
    pub(super) fn new(x: &[f64], turns: &[usize]) -> Travel {
        let n = x.len();
        let mut travel = Travel {
            half: Vec::with_capacity(n),
            direction: Vec::with_capacity(n),
            since_mm: Vec::with_capacity(n),
            until_mm: Vec::with_capacity(n),
            turns: turns.to_vec(),
        };
        let mut bounds = vec![0];
        bounds.extend(turns);
        bounds.push(n - 1);
        let mut half = 0;
        for i in 0..n {
            while half + 2 < bounds.len() && i > bounds[half + 1] {
                half += 1;
            }
            let sign = if x[bounds[half + 1]] >= x[bounds[half]] {
                1.0
            } else {
                -1.0
            };
            travel.half.push(half as u32);
            travel.direction.push(sign);
            travel.since_mm.push((x[i] - x[bounds[half]]).abs());
            travel.until_mm.push((x[bounds[half + 1]] - x[i]).abs());
        }
        travel
    }

    /// Displacement in mm of the turning points before and after a sample, the lower first; infinite at the ends of a recording.
    pub(super) fn reach(&self, i: usize, points: &[TurningPoint]) -> [f64; 2] {
        let half = self.half[i] as usize;
        let before = half.checked_sub(1).and_then(|k| points.get(k)).map(|t| t.mm);
        let after = points.get(half).map(|t| t.mm);
        let [low, high] = if self.direction[i] > 0.0 {
            [before, after]
        } else {
            [after, before]
        };
        let (low, high) = (low.unwrap_or(f64::NEG_INFINITY), high.unwrap_or(f64::INFINITY));
        // Where noise is as large as a half cycle, its two turning points may be estimated in the wrong order.
        [low.min(high), high.max(low)]
    }

    /// Error in mm of the turning point before a sample.
    pub(super) fn turn_error_mm(&self, i: usize, points: &[TurningPoint]) -> f64 {
        let before = (self.half[i] as usize).checked_sub(1);
        before.and_then(|k| points.get(k)).map_or(0.0, |t| t.error_mm)
    }

    /// Frequency from the median half cycle; 0 with fewer than two reversals.
    pub(super) fn frequency_hz(&self, time_s: &[f64]) -> f64 {
        let halves: Vec<f64> = self
            .turns
            .windows(2)
            .map(|w| time_s[w[1]] - time_s[w[0]])
            .collect();
        if halves.is_empty() {
            0.0
        } else {
            0.5 / median(halves)
        }
    }
}

/// True if the motion begins at rest at the unloaded end: a motion that unloads first began elsewhere.
pub(super) fn starts_from_rest(x: &[f64], force_n: &[f64], travel: &Travel) -> bool {
    let lowest = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    x[0] - lowest(x) < REST_DISPLACEMENT * range(x)
        && force_n[0] - lowest(force_n) < REST_FORCE * range(force_n)
        && fall_mm(x, travel) < REST_FALL * range(x)
}

/// How far the motion falls before it first rises, mm.
fn fall_mm(x: &[f64], travel: &Travel) -> f64 {
    let first = travel.turns.first().copied().unwrap_or(x.len() - 1);
    x[0] - x[first]
}

/// For each sample, whether the hysteresis no longer depends on a state that nobody recorded: that before the recording, and that
/// after motion that nobody recorded (`unseen` are the last samples before it is over).
///
/// From rest at the unloaded end it is known after a tenth of the stroke, because all shorter friction elements slide. From any
/// other state it is known after the first half cycle, unless there is only one.
pub(super) fn compared(x: &[f64], force_n: &[f64], travel: &Travel, unseen: &[usize]) -> Vec<bool> {
    let stroke_mm = range(x);
    let turns = &travel.turns;
    let from_rest = starts_from_rest(x, force_n, travel);
    let most = (MOST_FORGETTING * x.len() as f64) as usize / (unseen.len() + 1);
    let mut first = match turns.as_slice() {
        [first, _, ..] if !from_rest || turns.len() > 3 => *first,
        _ => x
            .iter()
            .position(|v| (v - x[0]).abs() > FIRST_TRAVEL * stroke_mm)
            .unwrap_or(0),
    };
    // A half cycle that is cut short leaves longer elements as they were.
    if !from_rest {
        first = match remembered_from(x, travel, 0, stroke_mm, most) {
            Some(known) if known > first || (x[first] - x[0]).abs() < FORGETTING[2] * stroke_mm => known,
            _ => first,
        };
    }
    let mut known = vec![true; x.len()];
    known[..first].fill(false);
    for &last in unseen {
        let again = remembered_from(x, travel, last + 1, stroke_mm, most).unwrap_or(x.len());
        known[last + 1..again].fill(false);
    }
    known
}

/// First sample from which the motion since `from` has wiped out what the friction remembered: after travel in one direction. `most`:
/// samples that may be lost to be surer.
fn remembered_from(x: &[f64], travel: &Travel, from: usize, stroke_mm: f64, most: usize) -> Option<usize> {
    let after = |share: f64| {
        let mut began = from;
        (from..x.len()).find(|&i| {
            if i > from && travel.half[i] != travel.half[i - 1] {
                began = i - 1;
            }
            (x[i] - x[began]).abs() > share * stroke_mm
        })
    };
    let [most_sure @ .., least_sure] = FORGETTING;
    let soon = |share: f64| after(share).filter(|&known| known <= from + most);
    most_sure.into_iter().find_map(soon).or_else(|| after(least_sure))
}
