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
/// Share of the variance above white noise that trends must leave, for it to be noise and no trend.
const WANDERS: f64 = 0.08;
/// Standard errors of the variance that are added to it.
const UPPER_LIMIT: f64 = 2.0;
/// Two cycles repeat at a place if their speeds differ by at most this share of the top speed, and the travels since the reversal by
/// this share of the stroke: else missing physics would differ, too.
const SAME_SPEED: f64 = 0.1;
const SAME_TRAVEL: f64 = 0.05;
/// Decay of a run-in, in cycles.
const DECAYS: [f64; 3] = [1.5, 5.0, 20.0];
/// Columns of the regression: time, and four shapes for each decay, for a linear change and for a single step.
const SHAPES: usize = 4;
const TRENDS: usize = 1 + SHAPES * (DECAYS.len() + 2);

/// Raises the noise of all recordings by their coloured noise; `residuals` are the weighted residuals of the baseline.
pub(super) fn raise_noise(data: &mut Data, residuals: &mut [f64]) {
    let mut from = 0;
    let mut found: Vec<Option<f64>> = Vec::with_capacity(data.tracks.len());
    for (track, &length) in data.tracks.iter().zip(&data.lengths) {
        let points = from..from + length;
        found.push(slow_noise_n(
            track,
            &data.weight[points.clone()],
            &residuals[points],
        ));
        from += length;
    }
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
            let track = &mut data.tracks[k];
            track.notes.push(Note::new(
                &track.name,
                NoteKind::Colour,
                (slow_n, "N"),
                NoteAction::Corrected,
                format!(
                    "the force has slow noise of {slow_n:.2} N beside {:.2} N of white noise: the larger noise is used, and effects that \
                     are smaller cannot be named; check the warm-up and the filters of the amplifier",
                    track.noise_n
                ),
            ));
        }
    }
}

/// RMS in N of the noise beyond white noise; 0 if there is none, `None` if too few cycles repeat.
fn slow_noise_n(track: &Track, weight: &[f64], residuals: &[f64]) -> Option<f64> {
    let pairs = Pairs::new(track, weight, residuals)?;
    let mut rest = pairs.without_trends(track)?;
    let excess = |rest: &[f64]| median(pairs.groups(track, rest)) - 1.0;
    if excess(&rest) > WANDERS * excess(&pairs.difference) {
        // Trends take away little: what they fit is noise as well.
        rest.clone_from(&pairs.difference);
    }
    let groups = pairs.groups(track, &rest);
    let least = groups.iter().copied().fold(f64::INFINITY, f64::min);
    let variance = median(groups);
    let coloured = variance > COLOURED && least > EVERYWHERE * variance && correlation(&rest) > CORRELATED;
    if !coloured {
        return Some(0.0);
    }
    // Few independent values know the variance badly: its upper limit is used.
    let independent = rest.len() as f64 / correlation_time(&rest, &[rest.len()]);
    let upper = (variance - 1.0) * (1.0 + UPPER_LIMIT * (2.0 / independent).sqrt());
    let weights = pairs.points.iter().map(|&i| weight[i]).collect();
    Some(upper.sqrt() / median(weights))
}

/// Says of two points at one displacement whether speed and travel since the reversal are the same, too.
fn repeats(track: &Track) -> impl Fn(usize, usize) -> bool {
    let speed_mm_s = |i: usize| track.motion[i].velocity_mm_s.abs();
    let most_mm_s = SAME_SPEED * track.top_speed_mm_s();
    let most_mm = SAME_TRAVEL * range(&track.displacement_mm);
    move |i, there| {
        (speed_mm_s(i) - speed_mm_s(there)).abs() <= most_mm_s
            && (track.since_reversal_mm[i] - track.since_reversal_mm[there]).abs() <= most_mm
    }
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
        let side = |i: usize| usize::from(track.direction[i] > 0.0);
        for &i in &counted {
            branches[place(i)][side(i)].push(i);
        }
        let x = &track.displacement_mm;
        let is_repeated = repeats(track);
        for branch in branches.iter_mut().flatten() {
            branch.sort_by(|&a, &b| x[a].total_cmp(&x[b]));
        }
        let mut pairs = Pairs {
            points: Vec::new(),
            place: Vec::new(),
            others: Vec::new(),
            difference: Vec::new(),
            cycles: cycles.len(),
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
            let variance = 1.0 + (1.0 - share).powi(2) + share.powi(2);
            pairs.points.push(i);
            pairs.place.push(place(i));
            pairs.others.push(([a, b], share, away));
            pairs.difference.push((residuals[i] - there) / variance.sqrt());
        }
        (pairs.points.len() >= LEAST_PAIRS).then_some(pairs)
    }

    /// The differences without what changes smoothly with the cycles, or once, after the cycle that explains most.
    fn without_trends(&self, track: &Track) -> Option<Vec<f64>> {
        (1..self.cycles)
            .filter_map(|step| self.regression(track, step))
            .min_by(|a, b| squares(a).total_cmp(&squares(b)))
    }

    /// Residuals of a regression of the differences on the trends, with a step before cycle `step`.
    fn regression(&self, track: &Track, step: usize) -> Option<Vec<f64>> {
        let n = self.points.len();
        let last_s = track.time_s[track.len() - 1].max(f64::MIN_POSITIVE);
        let x = &track.displacement_mm;
        let (stroke_mm, low_mm) = (range(x), x.iter().copied().fold(f64::INFINITY, f64::min));
        let mut columns = DMatrix::<f64>::zeros(n, TRENDS);
        for (row, (&i, (around, share, away))) in self.points.iter().zip(&self.others).enumerate() {
            let there_s = (1.0 - share) * track.time_s[around[0]] + share * track.time_s[around[1]];
            let scale = 1.0 / (1.0 + (1.0 - share).powi(2) + share.powi(2)).sqrt();
            columns[(row, 0)] = scale * (track.time_s[i] - there_s) / last_s;
            let along = (x[i] - low_mm) / stroke_mm - 0.5;
            let shapes = [1.0, along, track.direction[i], along * track.direction[i]];
            let (here, there) = (self.place[row], *away);
            let apart = |f: &dyn Fn(f64) -> f64| f(here as f64) - f(there as f64);
            let mut amounts = [0.0; DECAYS.len() + 2];
            for (amount, decay) in amounts.iter_mut().zip(DECAYS) {
                *amount = apart(&|cycle| (-cycle / decay).exp());
            }
            amounts[DECAYS.len()] = apart(&|cycle| cycle / self.cycles as f64);
            amounts[DECAYS.len() + 1] = apart(&|cycle| f64::from(u8::from(cycle >= step as f64)));
            for (k, amount) in amounts.iter().enumerate() {
                for (s, shape) in shapes.iter().enumerate() {
                    columns[(row, 1 + k * SHAPES + s)] = scale * amount * shape;
                }
            }
        }
        let difference = DVector::from_column_slice(&self.difference);
        let mut normal = columns.tr_mul(&columns);
        for k in 0..TRENDS {
            // Regularised, because decays of few cycles are nearly the same.
            normal[(k, k)] += 1e-6 * n as f64;
        }
        let solved = normal.cholesky()?.solve(&columns.tr_mul(&difference));
        let scale = (n as f64 / n.saturating_sub(TRENDS).max(1) as f64).sqrt();
        Some(
            ((difference - columns * solved) * scale)
                .iter()
                .copied()
                .collect(),
        )
    }

    /// Mean square in each third of the stroke on each branch; parts with few points are left out.
    fn groups(&self, track: &Track, rest: &[f64]) -> Vec<f64> {
        let x = &track.displacement_mm;
        let (stroke_mm, low_mm) = (range(x), x.iter().copied().fold(f64::INFINITY, f64::min));
        let mut sums = [(0.0, 0usize); 6];
        for (&i, e) in self.points.iter().zip(rest) {
            let third = ((3.0 * (x[i] - low_mm) / stroke_mm) as usize).min(2);
            let group = &mut sums[2 * third + usize::from(track.direction[i] > 0.0)];
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
        let estimate = |r: &[f64]| slow_noise_n(track, &data.weight, r).expect("20 cycles");
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
    }
}
