//! Where each sample stands between two turning points. Columns in, columns out.

use super::condition::range;
use super::smoothing::median;
use super::turning::TurningPoint;

/// Half cycle, direction and travel since the reversal of every sample.
pub(super) struct Travel {
    pub half: Vec<u32>,
    pub direction: Vec<f64>,
    pub since_mm: Vec<f64>,
    /// Travel to the next reversal in mm.
    pub until_mm: Vec<f64>,
    pub turns: Vec<usize>,
}

impl Travel {
    pub(super) fn new(x: &[f64], turns: &[usize]) -> Travel {
        let n = x.len();
        let mut motion = Travel {
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
            motion.half.push(half as u32);
            motion.direction.push(sign);
            motion.since_mm.push((x[i] - x[bounds[half]]).abs());
            motion.until_mm.push((x[bounds[half + 1]] - x[i]).abs());
        }
        motion
    }

    /// Turning points on either side of a sample, the lower first; without limit where the recording begins or ends.
    pub(super) fn reach(&self, i: usize, turned: &[TurningPoint]) -> [f64; 2] {
        let half = self.half[i] as usize;
        let before = half.checked_sub(1).and_then(|k| turned.get(k)).map(|t| t.mm);
        let after = turned.get(half).map(|t| t.mm);
        let end = [f64::NEG_INFINITY, f64::INFINITY];
        let [low, high] = if self.direction[i] > 0.0 {
            [before, after]
        } else {
            [after, before]
        };
        [low.unwrap_or(end[0]), high.unwrap_or(end[1])]
    }

    /// How far the turning point before a sample may be off.
    pub(super) fn turn_error_mm(&self, i: usize, turned: &[TurningPoint]) -> f64 {
        let before = (self.half[i] as usize).checked_sub(1);
        before.and_then(|k| turned.get(k)).map_or(0.0, |t| t.error_mm)
    }

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

/// First sample that is judged: the hysteresis has forgotten where it came from.
///
/// From rest at the unloaded end a tenth of the stroke is enough (every drag of less than that length has turned round);
/// from anywhere else the first half cycle goes, unless there is nothing else.
pub(super) fn settled_from(x: &[f64], force_n: &[f64], turns: &[usize], stroke_mm: f64) -> usize {
    let lowest_n = force_n.iter().copied().fold(f64::INFINITY, f64::min);
    let low_mm = x.iter().copied().fold(f64::INFINITY, f64::min);
    let from_rest = x[0] - low_mm < 0.03 * stroke_mm && force_n[0] - lowest_n < 0.05 * range(force_n);
    match turns {
        [first, _, ..] if !from_rest || turns.len() > 3 => *first,
        _ => x
            .iter()
            .position(|v| (v - x[0]).abs() > 0.1 * stroke_mm)
            .unwrap_or(0),
    }
}
