//! Turning points of a motion: between its samples, and where it dwells. It uses no recordings and no models: input and output
//! are columns of numbers.

use std::ops::Range;

use super::smoothing::{Local, fit_window, median};

/// Samples within this many noises of a turning point may be a dwell, if there are at least this many of them.
const DWELL: f64 = 6.0;
const LEAST_DWELL: usize = 12;
/// A dwell is a rest if this share of the samples near the turning point lies within one noise of the median. The share of a
/// parabola is 0.65.
const REST_SHARE: f64 = 0.85;
/// Fall of the sum of squares, in variances of the noise, from which a dwell creeps: chance reaches it once in 3000.
const LEAST_CREEP: f64 = 16.0;
/// A turning point is a corner if the speed changes this many times faster than the accelerations around it would change it.
const CORNER: f64 = 3.0;
/// A turn is resolved if the curvature two samples away is at least this share of the curvature at the turn.
const RESOLVED: f64 = 0.4;

/// Smooths dwells at turning points. There the largest noisy sample would become the turning point, and all others a motion back.
/// The dwell becomes a rest at one level, or a parabola if it significantly creeps.
pub(super) fn smooth_dwells(
    time_s: &[f64],
    values: &[f64],
    turns: &[usize],
    noise: f64,
    locals: &mut [Local],
) {
    for &turn in turns {
        let Some((near, dwell)) = dwell(values, turn, noise, locals) else {
            continue;
        };
        let window = dwell.len();
        let parabola: Option<Vec<Local>> = dwell
            .clone()
            .map(|i| Some(fit_window::<3>(time_s, values, dwell.clone(), i, f64::INFINITY)?.local))
            .collect();
        let Some(mut path) = parabola else { continue };
        if window as f64 > REST_SHARE * near.len() as f64 {
            path = rest(&values[dwell.clone()], &path, noise).unwrap_or(path);
            limit_approach(values, locals, &near, &dwell, &path);
        } else if median(locals[dwell.clone()].iter().map(|l| l.window as f64).collect()) >= window as f64 {
            // At the crest of a wave a wider window estimates better, above all the acceleration.
            continue;
        }
        for (local, smooth) in locals[dwell].iter_mut().zip(path) {
            *local = Local { window, ..smooth };
        }
    }
}

/// Samples near a turning point, and the dwell among them: those within one noise of their median. `None` if they are too few.
fn dwell(values: &[f64], turn: usize, noise: f64, locals: &[Local]) -> Option<(Range<usize>, Range<usize>)> {
    let near = |j: usize| (locals[j].mm - locals[turn].mm).abs() < DWELL * noise;
    let first = (0..turn).rev().take_while(|&j| near(j)).last().unwrap_or(turn);
    let last = (turn..values.len())
        .take_while(|&j| near(j))
        .last()
        .unwrap_or(turn);
    // The ends of the range already move, so the level is the median.
    let level = median(values[first..=last].to_vec());
    let stays = |j: &usize| (locals[*j].mm - level).abs() < noise;
    let from = (first..=last).find(stays)?;
    let to = (first..=last).rev().find(stays)?;
    (to - from >= LEAST_DWELL).then_some((first..last + 1, from..to + 1))
}

/// Limits the samples before and after a rest to its ends: one that goes beyond would become the turning point.
fn limit_approach(
    values: &[f64],
    locals: &mut [Local],
    near: &Range<usize>,
    dwell: &Range<usize>,
    path: &[Local],
) {
    let level = median(values[near.clone()].to_vec());
    let outside = [near.start.checked_sub(1), Some(near.end)];
    let neighbour = outside.into_iter().flatten().find_map(|j| locals.get(j));
    let sign = if neighbour.is_none_or(|l| l.mm < level) {
        1.0
    } else {
        -1.0
    };
    let (before, after) = (near.start..dwell.start, dwell.end..near.end);
    for (samples, end) in [(before, path[0]), (after, path[path.len() - 1])] {
        for local in &mut locals[samples] {
            local.mm = sign * (sign * local.mm).min(sign * end.mm);
        }
    }
}

/// A dwell at one level; `None` if the path `creeping` explains more of it than chance would.
fn rest(values: &[f64], creeping: &[Local], noise: f64) -> Option<Vec<Local>> {
    let mm = values.iter().sum::<f64>() / values.len() as f64;
    let squares = |at: &dyn Fn(usize) -> f64| -> f64 {
        let off = values.iter().enumerate().map(|(k, v)| v - at(k));
        off.map(|off| off * off).sum()
    };
    let fall = squares(&|_| mm) - squares(&|k| creeping[k].mm);
    let rest = Local {
        mm,
        ..Local::default()
    };
    (fall <= LEAST_CREEP * noise * noise).then(|| vec![rest; values.len()])
}

/// The best estimate of a turning point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TurningPoint {
    /// Displacement reached, mm.
    pub mm: f64,
    /// Error of `mm`.
    pub error_mm: f64,
    /// The sample before it and its time in s, if it lies between two samples.
    pub between: Option<(usize, f64)>,
}

/// Turning points near the samples `turns`: the crossing of two straight lines for a corner, the vertex of a parabola for a round
/// turn. If the samples are too sparse to tell these apart, the difference is the error.
pub(super) fn turning_points(
    time_s: &[f64],
    locals: &[Local],
    x: &[f64],
    turns: &[usize],
    noise_mm: f64,
) -> Vec<TurningPoint> {
    turns
        .iter()
        .map(|&index| turning_point(time_s, locals, x, index, noise_mm))
        .collect()
}

fn turning_point(time_s: &[f64], locals: &[Local], x: &[f64], index: usize, noise_mm: f64) -> TurningPoint {
    let mut turn = TurningPoint {
        mm: x[index],
        error_mm: noise_mm,
        between: None,
    };
    if index < 2 || index + 2 >= locals.len() {
        return turn;
    }
    let Some(i) = [index - 1, index]
        .into_iter()
        .find(|&i| locals[i].mm_s * locals[i + 1].mm_s < 0.0)
    else {
        return turn;
    };
    let (a, b) = (locals[i], locals[i + 1]);
    let dt_s = time_s[i + 1] - time_s[i];
    let around_mm_s2 = locals[i - 1].mm_s2.abs().max(locals[i + 2].mm_s2.abs());
    let [corner, vertex] = extrapolated(a, b, dt_s);
    let is_corner = (b.mm_s - a.mm_s).abs() / dt_s > CORNER * around_mm_s2;
    let (after_s, mm) = if is_corner { corner } else { vertex };
    let sign = a.mm_s.signum();
    let beyond = (sign * (mm - x[i])).min(sign * (mm - x[i + 1]));
    let at_s = time_s[i] + after_s;
    if beyond > 0.5 * noise_mm && at_s > time_s[i] && at_s < time_s[i + 1] {
        turn.mm = mm;
        turn.between = Some((i, at_s));
    }
    let resolved = (a.window > 0 && b.window > 0) || is_round(time_s, x, i);
    if !resolved {
        // The turning point is between the samples and the point where the straight lines through their neighbours meet.
        let t = time_s[i] + after_s.clamp(0.0, dt_s);
        let met_mm = lines_meet_mm(time_s, x, i, t).unwrap_or(corner.1);
        turn.error_mm = turn.error_mm.max(0.5 * (met_mm - turn.mm).abs());
    }
    turn
}

/// Time in s after the first of two samples, and displacement in mm, of the turn between them: as a corner and as a vertex.
fn extrapolated(a: Local, b: Local, dt_s: f64) -> [(f64, f64); 2] {
    let crossing_s = (b.mm - b.mm_s * dt_s - a.mm) / (a.mm_s - b.mm_s);
    let crossing_mm = a.mm + a.mm_s * crossing_s;
    let vertex_s = dt_s * a.mm_s / (a.mm_s - b.mm_s);
    // Mean of the extrapolations from both samples.
    let (here, there) = (0.5 * a.mm_s * vertex_s, 0.5 * b.mm_s * (dt_s - vertex_s));
    let vertex_mm = 0.5 * (a.mm + here + b.mm - there);
    [(crossing_s, crossing_mm), (vertex_s, vertex_mm)]
}

/// Mean at time `t` of the straight lines through the two samples before and after samples `i` and `i + 1`; `None` at the ends.
fn lines_meet_mm(time_s: &[f64], x: &[f64], i: usize, t: f64) -> Option<f64> {
    let line = |p: usize, q: usize| x[p] + (x[q] - x[p]) / (time_s[q] - time_s[p]) * (t - time_s[p]);
    (i >= 2 && i + 3 < x.len()).then(|| 0.5 * (line(i - 2, i - 1) + line(i + 3, i + 2)))
}

/// True if the curvature two samples from the turn is about as large as at the turn: then the samples resolve it.
fn is_round(time_s: &[f64], x: &[f64], i: usize) -> bool {
    let curvature = |j: usize| {
        let (h, k) = (time_s[j] - time_s[j - 1], time_s[j + 1] - time_s[j]);
        (((x[j + 1] - x[j]) / k - (x[j] - x[j - 1]) / h) / (h + k)).abs()
    };
    if i < 2 || i + 3 >= x.len() {
        return false;
    }
    let most = curvature(i).max(curvature(i + 1));
    curvature(i - 1).min(curvature(i + 2)) > RESOLVED * most
}

#[cfg(test)]
mod tests {
    use super::super::smoothing::tests::noisy;
    use super::super::smoothing::{monotone, noise, smoothed};
    use super::*;

    #[test]
    fn a_corner_is_seen_from_both_sides() {
        let time_s: Vec<f64> = (0..400).map(|i| 0.001 * f64::from(i)).collect();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| 2.0 - 50.0 * (t - 0.2003f64).abs() + 0.002 * noisy(i))
            .collect();
        let locals = smoothed(&time_s, &x, noise(&time_s, &x));
        let turn = turning_points(&time_s, &locals, &x, &[200], 0.002)[0];
        let (t, mm) = (turn.between.expect("between samples").1, turn.mm);
        assert_eq!(turn.error_mm, 0.002, "both sides are straight");
        assert!((t - 0.2003).abs() < 5e-5 && (mm - 2.0).abs() < 0.003, "{t} {mm}");
        assert!((locals[190].mm_s - 50.0).abs() < 1.0 && (locals[210].mm_s + 50.0).abs() < 1.0);
    }

    /// Up at 0.7 mm/s, 12 s of rest with a creep of `creep_mm`, down again; 30 samples per second with noise of 1.7 um.
    fn with_rest(creep_mm: f64) -> (Vec<f64>, f64) {
        let time_s: Vec<f64> = (0..1200).map(|i| f64::from(i) / 30.0).collect();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, &t)| {
                let rest = creep_mm * ((t - 14.0) / 12.0).clamp(0.0, 1.0);
                0.7 * f64::min(14.0, t).min(40.0 - t) + rest + 0.003 * noisy(i)
            })
            .collect();
        let noise_mm = noise(&time_s, &x);
        let mut locals = smoothed(&time_s, &x, noise_mm);
        let top = (0..x.len())
            .max_by(|&a, &b| locals[a].mm.total_cmp(&locals[b].mm))
            .expect("samples");
        smooth_dwells(&time_s, &x, &[top], noise_mm, &mut locals);
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        (monotone(&smooth_mm, &[top]), noise_mm)
    }

    #[test]
    fn a_rest_is_constant_and_nothing_goes_beyond_it() {
        let (x, noise_mm) = with_rest(0.0);
        let resting = &x[14 * 30 + 2..26 * 30 - 2];
        assert!(resting.iter().all(|x| *x == resting[0]), "constant");
        let highest = x.iter().copied().fold(0.0, f64::max);
        assert!(
            highest - resting[0] < 1e-12,
            "{} mm beyond it",
            highest - resting[0]
        );
        assert!((resting[0] - 9.8).abs() < 0.3 * noise_mm, "{}", resting[0]);
    }

    #[test]
    fn significant_creep_is_kept() {
        let (x, _) = with_rest(-0.006);
        let crept_mm = x[25 * 30] - x[15 * 30];
        // The creep of 10 of the 12 s; the ends of a parabola over 360 samples have an error of 0.3 um.
        assert!((crept_mm + 0.005).abs() < 0.001, "{crept_mm}");
    }

    /// 6 mm at 1 Hz: at 1 kHz about 20 samples lie within six noises of the crest, as in a short rest.
    #[test]
    fn the_crest_of_a_wave_is_not_a_rest() {
        let time_s: Vec<f64> = (0..20_000).map(|i| 1e-3 * f64::from(i)).collect();
        let truth = |t: f64| -6.0 * (std::f64::consts::TAU * t).cos();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, &t)| truth(t) + 0.003 * noisy(i))
            .collect();
        let noise_mm = noise(&time_s, &x);
        let mut locals = smoothed(&time_s, &x, noise_mm);
        let crests: Vec<usize> = (0..19).map(|k| 500 + 1000 * k).collect();
        smooth_dwells(&time_s, &x, &crests, noise_mm, &mut locals);
        let off = crests.iter().map(|&i| locals[i].mm - truth(time_s[i]));
        let mean_mm = off.sum::<f64>() / crests.len() as f64;
        assert!(
            mean_mm.abs() < 0.2 * noise_mm,
            "{mean_mm} mm, noise {noise_mm} mm"
        );
        // Nor does it get a window of its own: 20 samples would give its acceleration to 60 mm/s2.
        let bend = |i: usize| locals[i].mm_s2.abs() - 6.0 * std::f64::consts::TAU.powi(2);
        let worst = crests.iter().map(|&i| bend(i).abs()).fold(0.0, f64::max);
        assert!(worst < 15.0, "{worst} mm/s2");
    }
}
