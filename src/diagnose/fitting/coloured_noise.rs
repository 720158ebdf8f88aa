//! Noise that is slower than white noise: amplifier drift that wanders, 1/f noise, an AR(1) process. Differences of neighbouring
//! samples do not show it, so the weights would be too large, and the wandering would be taken for drift or run-in.
//!
//! It is estimated where the motion repeats: residuals at the same displacement and direction in another cycle half the recording
//! away. What the model lacks is the same in both and drops out. What changes smoothly or once with time, cycle, direction and
//! displacement may be physics, so a regression takes it out first. The rest is noise, whatever its spectrum.

use nalgebra::{DMatrix, DVector};

use super::data::Data;
use crate::diagnose::conditioning::{Track, median, range};
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::identify::confidence::correlation_time;

/// Fewest cycles that are compared, and fewest pairs of points, for an estimate.
const LEAST_CYCLES: usize = 4;
const LEAST_PAIRS: usize = 60;
/// Variance of the noise, in variances of the white noise, from which it is coloured, and correlation of neighbouring points. Both
/// follow from a noise that is not white; a white noise that was estimated too low has only the first.
const COLOURED: f64 = 1.5;
const CORRELATED: f64 = 0.25;
/// Noise is the same in all parts of the motion: the quietest of six has at least this share of the median. Physics that does not
/// repeat, such as stick-slip, is local.
const EVERYWHERE: f64 = 0.25;
/// Share of the variance above white noise, of all recordings together, that changes must leave for it to be noise and no change.
const WANDERS: f64 = 0.12;
/// Standard errors of the variance that are added to it.
const UPPER_LIMIT: f64 = 2.0;
/// Two cycles repeat at a place if their speeds differ by at most this share of the top speed, and the travels since the reversal, and
/// so many reversals before, by this share of the travel of half a cycle: else missing physics would differ, too.
const SAME_SPEED: f64 = 0.1;
const SAME_TRAVEL: f64 = 0.05;
const SAME_TURNS: usize = 4;
/// Decay of a run-in, in cycles.
const DECAYS: [f64; 3] = [1.5, 5.0, 20.0];
/// Columns of the regression for what changes smoothly: time, and four shapes for each decay and for a linear change.
const SHAPES: usize = 4;
const SMOOTH: usize = 1 + SHAPES * (DECAYS.len() + 1);
/// Ridge of the regression, as a share of the number of points.
const RIDGE: f64 = 1e-6;
/// Columns for what changes once: the change at each of some places of the travel, linear between them, on each branch. A leaf that
/// cracks is softer in a part of the travel only.
const PLACES: usize = 6;
const ONCE: usize = 2 * PLACES;
const CHANGES: usize = SMOOTH + ONCE;

/// Raises the noise of all recordings by their coloured noise; `residuals` are the weighted residuals of the baseline.
pub(super) fn raise_noise(data: &mut Data, residuals: &mut [f64]) {
    let mut from = 0;
    let mut compared = Vec::with_capacity(data.tracks.len());
    for (track, &length) in data.tracks.iter().zip(&data.lengths) {
        let points = from..from + length;
        compared.push(RepeatedCycles::new(
            track,
            &data.weight[points.clone()],
            &residuals[points],
        ));
        from += length;
    }
    let all_is_noise = is_no_change(&compared);
    let noise_n = |c: &Option<RepeatedCycles<'_>>| c.as_ref().map(|c| c.slow_noise_n(all_is_noise));
    let found: Vec<Option<f64>> = compared.iter().map(noise_n).collect();
    // The channel is the same in all recordings: one that is too short to show its noise has that of the others.
    let estimates: Vec<f64> = found.iter().flatten().copied().collect();
    let coloured = estimates.iter().filter(|n| **n > 0.0).count();
    let usual_n = if 2 * coloured >= estimates.len() {
        median(estimates.into_iter().filter(|n| *n > 0.0).collect())
    } else {
        0.0
    };
    from = 0;
    for (k, found_n) in found.into_iter().enumerate() {
        let length = data.lengths[k];
        let slow_n = found_n.unwrap_or(usual_n).max(usual_n);
        let points = from..from + length;
        for (weight, residual) in data.weight[points.clone()].iter_mut().zip(&mut residuals[points]) {
            let factor = 1.0 / (1.0f64).hypot(*weight * slow_n);
            *weight *= factor;
            *residual *= factor;
        }
        from += length;
        if slow_n > 0.0 {
            let note = note(&data.tracks[k], slow_n);
            data.tracks[k].notes.push(note);
        }
    }
}

/// What a technician is told. Where the displacement vibrates, the shaken friction differs from cycle to cycle.
fn note(track: &Track, slow_n: f64) -> Note {
    let (kind, what, check) = if track.vibration_mm > 0.0 {
        let what = "differs from cycle to cycle, as that of a specimen that is shaken, by";
        (NoteKind::Hum, what, "where the vibration comes from")
    } else {
        let what = "has slow noise of";
        (
            NoteKind::Colour,
            what,
            "the warm-up and the filters of the amplifier",
        )
    };
    let text = format!(
        "the force {what} {slow_n:.2} N beside {:.2} N of white noise: the larger noise is used, and effects that are smaller cannot be \
         named; check {check}",
        track.noise_n
    );
    Note::new(&track.name, kind, (slow_n, "N"), NoteAction::Corrected, text)
}

/// True if what the changes fit is noise as well: of all recordings together they leave too much, or most of those that seemed to be
/// noisy still are. One channel records all.
fn is_no_change(compared: &[Option<RepeatedCycles<'_>>]) -> bool {
    let all = || compared.iter().flatten();
    let left: f64 = all().map(|c| c.excess(&c.rest).max(0.0)).sum();
    let had: f64 = all().map(|c| c.excess(&c.pairs.difference).max(0.0)).sum();
    let noisy: Vec<_> = all().filter(|c| c.slow_noise_n(true) > 0.0).collect();
    let still = noisy.iter().filter(|c| c.slow_noise_n(false) > 0.0).count();
    left > WANDERS * had || 2 * still > noisy.len()
}

/// A recording whose cycles are compared.
struct RepeatedCycles<'a> {
    track: &'a Track,
    weight: &'a [f64],
    pairs: Pairs,
    /// The differences of the pairs without what changes smoothly or once.
    rest: Vec<f64>,
}

impl<'a> RepeatedCycles<'a> {
    /// `None` if too few cycles repeat.
    fn new(track: &'a Track, weight: &'a [f64], residuals: &[f64]) -> Option<RepeatedCycles<'a>> {
        let pairs = Pairs::new(track, weight, residuals)?;
        let rest = pairs.without_changes(track)?;
        Some(RepeatedCycles {
            track,
            weight,
            pairs,
            rest,
        })
    }

    /// Variance of some differences beyond white noise.
    fn excess(&self, differences: &[f64]) -> f64 {
        median(self.pairs.groups(self.track, differences)) - 1.0
    }

    /// RMS in N of the noise beyond white noise; 0 if there is none. With `all_is_noise`, nothing of it is a change.
    fn slow_noise_n(&self, all_is_noise: bool) -> f64 {
        let noise = match all_is_noise {
            true => &self.pairs.difference,
            false => &self.rest,
        };
        let groups = self.pairs.groups(self.track, noise);
        let least = groups.iter().copied().fold(f64::INFINITY, f64::min);
        let variance = median(groups);
        let coloured =
            variance > COLOURED && least > EVERYWHERE * variance && correlation(noise) > CORRELATED;
        if !coloured {
            return 0.0;
        }
        // Few independent values know the variance badly: its upper limit is used.
        let independent = noise.len() as f64 / correlation_time(noise, &[noise.len()]);
        let upper = (variance - 1.0) * (1.0 + UPPER_LIMIT * (2.0 / independent).sqrt());
        let weights = self.pairs.points.iter().map(|&i| self.weight[i]).collect();
        upper.sqrt() / median(weights)
    }
}

/// Says of two points at one displacement whether speed, travel since the reversal and the reversals before are the same, too.
fn repeats(track: &Track) -> impl Fn(usize, usize) -> bool {
    let speed_mm_s = |i: usize| track.motion[i].velocity_mm_s.abs();
    let most_mm_s = SAME_SPEED * track.top_speed_mm_s();
    let turns_mm = turns_before(track);
    let most_mm = SAME_TRAVEL * half_cycle_mm(track, &turns_mm);
    move |i, there| {
        // Where one of them has no such reversal, none differs.
        let other_turn = |(a, b): (&f64, &f64)| (a - b).abs() > most_mm;
        (speed_mm_s(i) - speed_mm_s(there)).abs() <= most_mm_s
            && (track.since_reversal_mm[i] - track.since_reversal_mm[there]).abs() <= most_mm
            && !turns_mm[i].iter().zip(&turns_mm[there]).any(other_turn)
    }
}

/// Usual travel in mm between two reversals. Of a random motion, only turns that are as near as a small share of it are the same.
fn half_cycle_mm(track: &Track, turns_mm: &[[f64; SAME_TURNS]]) -> f64 {
    let travels_mm: Vec<f64> = track
        .turns()
        .map(|i| (turns_mm[i][0] - turns_mm[i][1]).abs())
        .filter(|mm| mm.is_finite())
        .collect();
    if travels_mm.is_empty() {
        range(&track.displacement_mm)
    } else {
        median(travels_mm)
    }
}

/// Displacement in mm of the last reversals before each point, the last one first; not a number before the first reversals.
fn turns_before(track: &Track) -> Vec<[f64; SAME_TURNS]> {
    let mut turns = track.turns().peekable();
    let mut last_mm = [f64::NAN; SAME_TURNS];
    (0..track.len())
        .map(|i| {
            if turns.next_if_eq(&i).is_some() {
                last_mm.rotate_right(1);
                last_mm[0] = track.displacement_mm[i - 1];
            }
            last_mm
        })
        .collect()
}

/// Points with what they are compared with in another cycle.
struct Pairs {
    /// Index of each point, in order of time.
    points: Vec<usize>,
    /// Number of the point's cycle among those that are compared.
    place: Vec<usize>,
    /// The two points around it in the other cycle, the share of the second, and the number of that cycle.
    others: Vec<([usize; 2], f64, usize)>,
    /// Difference of the residuals, with the variance of one.
    difference: Vec<f64>,
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
fn extent(track: &Track) -> (f64, f64) {
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
    fn new(track: &Track, weight: &[f64], residuals: &[f64]) -> Option<Pairs> {
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
        let is_repeated = repeats(track);
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
            if !is_repeated(i, a) {
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
    fn without_changes(&self, track: &Track) -> Option<Vec<f64>> {
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
                // Regularised, because decays of few cycles are nearly the same.
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
    fn groups(&self, track: &Track, rest: &[f64]) -> Vec<f64> {
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

fn squares(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum()
}

/// Correlation of neighbours in a column.
fn correlation(values: &[f64]) -> f64 {
    let products: f64 = values.windows(2).map(|w| w[0] * w[1]).sum();
    products / squares(values).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::super::data::tests::sampled;
    use super::*;
    use crate::diagnose::conditioning::noisy;

    /// Slow noise of 3 N that the residuals show beside white noise of 1 N.
    #[test]
    fn slow_noise_is_measured_and_physics_is_not() {
        let (data, white) = sampled(0.005, 20.0, |_, _| 0.0);
        let track = &data.tracks[0];
        let (low_mm, stroke_mm) = extent(track);
        let estimate = |r: &[f64]| {
            let compared = [RepeatedCycles::new(track, &data.weight, r)];
            let all_is_noise = is_no_change(&compared);
            compared[0]
                .as_ref()
                .expect("20 cycles")
                .slow_noise_n(all_is_noise)
        };
        assert_eq!(estimate(&white), 0.0);
        let mut wander = 0.0;
        let coloured: Vec<f64> = (0..data.len())
            .map(|i| {
                // 0.9 from point to point: a standard deviation of 3.
                wander = 0.9 * wander + 3.0 * (1.0f64 - 0.81).sqrt() * 3f64.sqrt() * noisy(i + 99);
                if data.weight[i] > 0.0 {
                    white[i] + wander
                } else {
                    0.0
                }
            })
            .collect();
        let slow_n = estimate(&coloured);
        // The estimate and its upper limit.
        assert!((2.6..4.2).contains(&slow_n), "{slow_n}");
        // Drift, run-in of the friction, a step of the load and a ripple leave white noise.
        let physics: Vec<f64> = (0..data.len())
            .map(|i| {
                let (t, x) = (track.time_s[i], track.displacement_mm[i]);
                let cycle = f64::from(track.cycle[i]);
                let step = if cycle > 7.0 { 0.5 * x } else { 0.0 };
                let run_in = 5.0 * (-cycle / 4.0).exp() * track.direction[i];
                let all = white[i] + 0.5 * t + run_in + step + 3.0 * (4.0 * x).sin();
                if data.weight[i] > 0.0 { all } else { 0.0 }
            })
            .collect();
        assert_eq!(estimate(&physics), 0.0);
        // A leaf cracks at a reversal: from there on, the middle of the travel carries less.
        let crack: Vec<f64> = (0..data.len())
            .map(|i| {
                let unloads = u32::from(track.direction[i] < 0.0);
                let is_cracked = 2 * track.cycle[i] + unloads >= 19;
                let middle = (track.displacement_mm[i] - low_mm) / stroke_mm / 0.25 - 1.8;
                let lost = if is_cracked {
                    6.0 * (-middle * middle).exp()
                } else {
                    0.0
                };
                if data.weight[i] > 0.0 {
                    white[i] - lost
                } else {
                    0.0
                }
            })
            .collect();
        assert_eq!(estimate(&crack), 0.0);
    }
}
