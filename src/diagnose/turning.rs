//! Where a motion really turned: between its samples, and where it dwells. No recording, no model: columns in, columns out.

use super::smoothing::{Local, fitted, median};

/// Distance from a turning point, in noises, and number of samples that make a dwell.
const DWELL: f64 = 6.0;
const LEAST_DWELL: usize = 12;
/// Share of the samples near a turning point from which a dwell is a rest: of a parabola's, 0.65 lie within a noise of their median.
const RESTS: f64 = 0.85;
/// Squares in noises that a creep must take off a dwell: chance takes as many from one in 3000.
const CREEP: f64 = 16.0;

/// Where the motion dwells at a turning point, the largest of many noisy samples passes for the turn and all others for a way
/// back. What the dwell does takes their place: it stands, or creeps along a parabola where it surely does.
pub(super) fn settle_turns(
    time_s: &[f64],
    values: &[f64],
    turns: &[usize],
    noise: f64,
    locals: &mut [Local],
) {
    for &turn in turns {
        let near = |j: usize| (locals[j].mm - locals[turn].mm).abs() < DWELL * noise;
        let first = (0..turn).rev().take_while(|&j| near(j)).last().unwrap_or(turn);
        let last = (turn..values.len())
            .take_while(|&j| near(j))
            .last()
            .unwrap_or(turn);
        // Its ends are on the way already: the level is the middle's.
        let level = median(values[first..=last].to_vec());
        let stays = |j: &usize| (locals[*j].mm - level).abs() < noise;
        let (Some(from), Some(to)) = ((first..=last).find(stays), (first..=last).rev().find(stays)) else {
            continue;
        };
        if to - from < LEAST_DWELL {
            continue;
        }
        let dwell = from..to + 1;
        let window = dwell.len();
        let round: Option<Vec<Local>> = dwell
            .clone()
            .map(|i| Some(fitted::<3>(time_s, values, dwell.clone(), i, f64::INFINITY)?.local))
            .collect();
        let Some(mut path) = round else { continue };
        // The crest of a wave leaves its own level as soon as it has come; a rest is nearly all that lies near it.
        if window as f64 > RESTS * (last + 1 - first) as f64 {
            let rest = rested(&values[dwell.clone()], &path, noise);
            path = rest.unwrap_or(path);
            // On the way to it and from it nothing goes beyond it: that too would pass for the turn.
            let outside = [first.checked_sub(1), Some(last + 1)];
            let neighbour = outside.into_iter().flatten().find_map(|j| locals.get(j));
            let sign = if neighbour.is_none_or(|l| l.mm < level) {
                1.0
            } else {
                -1.0
            };
            for (way, end) in [(first..from, path[0]), (to + 1..last + 1, path[path.len() - 1])] {
                for local in &mut locals[way] {
                    local.mm = sign * (sign * local.mm).min(sign * end.mm);
                }
            }
        } else if median(locals[dwell.clone()].iter().map(|l| l.window as f64).collect()) >= window as f64 {
            // Wider pieces saw the crest better, its acceleration above all.
            continue;
        }
        for (local, settled) in locals[dwell].iter_mut().zip(path) {
            *local = Local { window, ..settled };
        }
    }
}

/// A dwell at one level; none where `creeping` explains more of it than chance would.
fn rested(values: &[f64], creeping: &[Local], noise: f64) -> Option<Vec<Local>> {
    let mm = values.iter().sum::<f64>() / values.len() as f64;
    let squares = |at: &dyn Fn(usize) -> f64| -> f64 {
        let off = values.iter().enumerate().map(|(k, v)| v - at(k));
        off.map(|off| off * off).sum()
    };
    let taken = squares(&|_| mm) - squares(&|k| creeping[k].mm);
    let rest = Local {
        mm,
        ..Local::default()
    };
    (taken <= CREEP * noise * noise).then(|| vec![rest; values.len()])
}

/// A turning point as well as it can be known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TurningPoint {
    /// Sample nearest to it.
    pub index: usize,
    /// Displacement reached.
    pub mm: f64,
    /// How far that may be off.
    pub error_mm: f64,
    /// Sample before it and its time, where it lies between two samples.
    pub between: Option<(usize, f64)>,
}

/// Where the motion really turned: the crossing of two straight lines for a triangle, the vertex of a parabola for anything
/// round. Where the samples are too sparse to tell how it turned, what they leave open is the error.
pub(super) fn turned(
    time_s: &[f64],
    locals: &[Local],
    x: &[f64],
    turns: &[usize],
    noise_mm: f64,
) -> Vec<TurningPoint> {
    let at = |index: usize| {
        let mut turn = TurningPoint {
            index,
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
        let crossing_s = (b.mm - b.mm_s * dt_s - a.mm) / (a.mm_s - b.mm_s);
        let crossing_mm = a.mm + a.mm_s * crossing_s;
        let vertex_s = dt_s * a.mm_s / (a.mm_s - b.mm_s);
        // From either side: both see the same vertex.
        let (here, there) = (0.5 * a.mm_s * vertex_s, 0.5 * b.mm_s * (dt_s - vertex_s));
        let vertex_mm = 0.5 * (a.mm + here + b.mm - there);
        let bend_mm_s2 = (b.mm_s - a.mm_s).abs() / dt_s;
        let around_mm_s2 = locals[i - 1].mm_s2.abs().max(locals[i + 2].mm_s2.abs());
        let corner = bend_mm_s2 > 3.0 * around_mm_s2;
        let (after_s, mm) = if corner {
            (crossing_s, crossing_mm)
        } else {
            (vertex_s, vertex_mm)
        };
        let sign = a.mm_s.signum();
        let beyond = (sign * (mm - x[i])).min(sign * (mm - x[i + 1]));
        if beyond > 0.5 * noise_mm && after_s > 0.0 && after_s < dt_s {
            turn.mm = mm;
            turn.between = Some((i, time_s[i] + after_s));
        }
        let resolved = (a.window > 0 && b.window > 0) || round(time_s, x, i);
        if !resolved {
            // Somewhere between the samples and where their straight neighbours would meet.
            let line =
                |p: usize, q: usize, t: f64| x[p] + (x[q] - x[p]) / (time_s[q] - time_s[p]) * (t - time_s[p]);
            let t = time_s[i] + after_s.clamp(0.0, dt_s);
            let met_mm = if i >= 2 && i + 3 < x.len() {
                0.5 * (line(i - 2, i - 1, t) + line(i + 3, i + 2, t))
            } else {
                crossing_mm
            };
            turn.error_mm = turn.error_mm.max(0.5 * (met_mm - turn.mm).abs());
        }
        turn
    };
    turns.iter().map(|&index| at(index)).collect()
}

/// Does the motion bend about as much two samples from the turn as at it? Then the samples resolve how it turns.
fn round(time_s: &[f64], x: &[f64], i: usize) -> bool {
    let bend = |j: usize| {
        let (h, k) = (time_s[j] - time_s[j - 1], time_s[j + 1] - time_s[j]);
        (((x[j + 1] - x[j]) / k - (x[j] - x[j - 1]) / h) / (h + k)).abs()
    };
    if i < 2 || i + 3 >= x.len() {
        return false;
    }
    let most = bend(i).max(bend(i + 1));
    bend(i - 1).min(bend(i + 2)) > 0.4 * most
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
        let turn = turned(&time_s, &locals, &x, &[200], 0.002)[0];
        let (t, mm) = (turn.between.expect("between samples").1, turn.mm);
        assert_eq!(turn.error_mm, 0.002, "both sides are straight");
        assert!((t - 0.2003).abs() < 5e-5 && (mm - 2.0).abs() < 0.003, "{t} {mm}");
        assert!((locals[190].mm_s - 50.0).abs() < 1.0 && (locals[210].mm_s + 50.0).abs() < 1.0);
    }

    /// Up at 0.7 mm/s, 12 s of rest, down again, 30 samples a second of 1.7 um noise; `creep_mm` while it rests.
    fn dwelt(creep_mm: f64) -> (Vec<f64>, f64) {
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
        settle_turns(&time_s, &x, &[top], noise_mm, &mut locals);
        let smooth_mm: Vec<f64> = locals.iter().map(|l| l.mm).collect();
        (monotone(&smooth_mm, &[top]), noise_mm)
    }

    #[test]
    fn what_rests_stands_still_and_nothing_goes_beyond_it() {
        let (x, noise_mm) = dwelt(0.0);
        let resting = &x[14 * 30 + 2..26 * 30 - 2];
        assert!(resting.iter().all(|x| *x == resting[0]), "it stands");
        let highest = x.iter().copied().fold(0.0, f64::max);
        assert!(
            highest - resting[0] < 1e-12,
            "{} mm beyond it",
            highest - resting[0]
        );
        assert!((resting[0] - 9.8).abs() < 0.3 * noise_mm, "{}", resting[0]);
    }

    #[test]
    fn what_surely_creeps_is_seen_to_creep() {
        let (x, _) = dwelt(-0.006);
        let crept_mm = x[25 * 30] - x[15 * 30];
        // 10 of the 12 s; a parabola's ends over 360 samples are known to 0.3 um.
        assert!((crept_mm + 0.005).abs() < 0.001, "{crept_mm}");
    }

    /// 6 mm at 1 Hz: at 1 kHz some 20 samples lie within six noises of the crest, few enough to pass for a rest.
    #[test]
    fn the_crest_of_a_wave_is_no_rest() {
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
        settle_turns(&time_s, &x, &crests, noise_mm, &mut locals);
        let off = crests.iter().map(|&i| locals[i].mm - truth(time_s[i]));
        let mean_mm = off.sum::<f64>() / crests.len() as f64;
        assert!(
            mean_mm.abs() < 0.2 * noise_mm,
            "{mean_mm} mm, noise {noise_mm} mm"
        );
        // Nor is it a piece of its own: 20 samples would know its acceleration to 60 mm/s2.
        let bend = |i: usize| locals[i].mm_s2.abs() - 6.0 * std::f64::consts::TAU.powi(2);
        let worst = crests.iter().map(|&i| bend(i).abs()).fold(0.0, f64::max);
        assert!(worst < 15.0, "{worst} mm/s2");
    }
}
