//! Takes the noise out of a displacement, gives its speed and acceleration with hindsight, and finds where it really turned.
//! No recording, no model: columns in, columns out.

use nalgebra::{SMatrix, SVector};

/// Half widths of the windows that are tried, in samples.
const HALVES: [usize; 6] = [96, 48, 24, 12, 6, 3];

/// Distance from a turning point, in noises, and number of samples that make a dwell.
const DWELL: f64 = 6.0;
const LEAST_DWELL: usize = 12;

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    values.select_nth_unstable_by(middle, f64::total_cmp);
    values[middle]
}

/// Standard deviation of the white part, at even or uneven times.
///
/// Divided differences leave nothing of a smooth motion: of seven samples none of a sine with 20 a cycle, of three none of a
/// triangle, whose corners spoil the wider ones. The least of them is nearest to the noise.
pub(super) fn noise(time_s: &[f64], values: &[f64]) -> f64 {
    let from_differences = [
        differences::<3>(time_s, values),
        differences::<5>(time_s, values),
        differences::<7>(time_s, values),
    ]
    .into_iter()
    .fold(f64::INFINITY, f64::min);
    let from_differences = if from_differences.is_finite() {
        from_differences
    } else {
        0.0
    };
    // A quantised channel may stand still most of the time; its step, the least distance of two values, is still uncertain.
    let scale = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut levels = values.to_vec();
    levels.sort_unstable_by(f64::total_cmp);
    let step = levels
        .windows(2)
        .map(|w| w[1] - w[0])
        .filter(|&d| d > 1e-9 * scale)
        .fold(f64::INFINITY, f64::min);
    // A periodic motion repeats its values too, but they stand on no grid.
    let first = levels.first().copied().unwrap_or(0.0);
    let off_grid = |v: &f64| {
        let steps = (v - first) / step;
        (steps - steps.round()).abs() > 0.01
    };
    let quantised = step.is_finite() && !levels.iter().any(off_grid);
    let quantisation = if quantised { step / 12f64.sqrt() } else { 0.0 };
    from_differences.max(quantisation).max(1e-9 * scale)
}

/// Noise as the middle half of `N` samples' divided differences shows it.
fn differences<const N: usize>(time_s: &[f64], values: &[f64]) -> f64 {
    let found: Vec<f64> = values
        .windows(N)
        .zip(time_s.windows(N))
        .map(|(v, t)| {
            let (mut sum, mut power) = (0.0, 0.0);
            for j in 0..N {
                let mut product = 1.0;
                for k in (0..N).filter(|k| *k != j) {
                    product *= (t[j] - t[k]) / (t[N - 1] - t[0]);
                }
                sum += v[j] / product;
                power += product.powi(-2);
            }
            (sum / power.sqrt()).abs()
        })
        .collect();
    if found.is_empty() {
        return f64::INFINITY;
    }
    midmean(found) / MIDMEAN_OF_NORMAL
}

/// Mean of the middle half: as deaf to outliers as anybody needs, and steps of a converter do not make it jump as a median does.
fn midmean(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let quarter = values.len() / 4;
    let middle = &values[quarter..values.len() - quarter];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// Of |normal|: 4 (phi(0.3186) - phi(1.1503)), phi the density.
const MIDMEAN_OF_NORMAL: f64 = 0.69328;

/// Displacement, speed and acceleration at one sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Local {
    pub mm: f64,
    pub mm_s: f64,
    pub mm_s2: f64,
    /// A smooth piece explains its window to within the noise; otherwise it only goes through the samples.
    pub sure: bool,
}

/// Least-squares polynomials over the widest window that leaves nothing but noise: on both sides of a sample, or on one where
/// the other is beyond a corner (Savitzky and Golay 1964; width after Lepski 1991).
pub(super) fn smoothed(time_s: &[f64], values: &[f64], noise: f64) -> Vec<Local> {
    let n = values.len();
    (0..n)
        .map(|i| {
            for half in HALVES {
                let left = i.saturating_sub(2 * half)..i + 1;
                let right = i..(i + 2 * half + 1).min(n);
                let mut sides = [left, right];
                if i >= half && i + half < n {
                    let middle = i - half..i + half + 1;
                    if let Some(local) = fitted::<5>(time_s, values, middle, i, noise) {
                        return local;
                    }
                }
                // The side with more room first.
                if sides[1].len() > sides[0].len() {
                    sides.swap(0, 1);
                }
                for side in sides.into_iter().filter(|s| s.len() > half.max(4)) {
                    if let Some(local) = fitted::<3>(time_s, values, side, i, noise) {
                        return local;
                    }
                }
            }
            // Nothing smooth is as fine as that: through the samples themselves.
            let (from, to) = (i.saturating_sub(2), (i + 3).min(n));
            if to - from == 5 {
                fitted::<5>(time_s, values, from..to, i, f64::INFINITY)
            } else {
                fitted::<3>(time_s, values, from..to, i, f64::INFINITY)
            }
            .unwrap_or(Local {
                mm: values[i],
                ..Local::default()
            })
        })
        .collect()
}

/// Polynomial of `N` coefficients over a window, at sample `i`; none where it leaves more than noise.
fn fitted<const N: usize>(
    time_s: &[f64],
    values: &[f64],
    window: std::ops::Range<usize>,
    i: usize,
    noise: f64,
) -> Option<Local> {
    let count = window.len();
    if count < N {
        return None;
    }
    let width_s = time_s[window.end - 1] - time_s[window.start];
    let row = |j: usize| {
        let t = (time_s[j] - time_s[i]) / width_s;
        let mut row = SVector::<f64, N>::zeros();
        let mut power = 1.0;
        for k in 0..N {
            row[k] = power;
            power *= t;
        }
        row
    };
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    for j in window.clone() {
        let row = row(j);
        normal += row * row.transpose();
        // Near zero, so that nothing is lost to a large offset.
        right += row * (values[j] - values[i]);
    }
    let solved = normal.cholesky()?.solve(&right);
    if noise.is_finite() {
        let squares: f64 = window
            .map(|j| (values[j] - values[i] - row(j).dot(&solved)).powi(2))
            .sum();
        let free = (count - N).max(1) as f64;
        let limit = noise * (1.0 + 2.0 / (2.0 * free).sqrt());
        if squares > free * limit * limit {
            return None;
        }
    }
    Some(Local {
        mm: values[i] + solved[0],
        mm_s: solved[1] / width_s,
        mm_s2: 2.0 * solved[2] / (width_s * width_s),
        sure: noise.is_finite(),
    })
}

/// Where the motion dwells at a turning point, the largest of many noisy samples passes for the turn and all others for a way
/// back. One parabola through all that lies within the noise of it takes their place.
pub(super) fn settle_turns(
    time_s: &[f64],
    values: &[f64],
    turns: &[usize],
    noise: f64,
    locals: &mut [Local],
) {
    for &turn in turns {
        let near = |j: usize| (locals[j].mm - locals[turn].mm).abs() < DWELL * noise;
        let from = (0..turn).rev().take_while(|&j| near(j)).last().unwrap_or(turn);
        let to = (turn..values.len())
            .take_while(|&j| near(j))
            .last()
            .unwrap_or(turn);
        // Its ends are on the way already: the level is the middle's.
        let level = median(values[from..=to].to_vec());
        let stays = |j: &usize| (locals[*j].mm - level).abs() < noise;
        let (Some(from), Some(to)) = ((from..=to).find(stays), (from..=to).rev().find(stays)) else {
            continue;
        };
        if to - from < LEAST_DWELL {
            continue;
        }
        let settled: Option<Vec<Local>> = (from..=to)
            .map(|i| fitted::<3>(time_s, values, from..to + 1, i, f64::INFINITY))
            .collect();
        for (local, settled) in locals[from..=to].iter_mut().zip(settled.into_iter().flatten()) {
            *local = Local {
                sure: true,
                ..settled
            };
        }
    }
}

/// Least-squares monotone path between reversals, rising and falling in turn.
pub(super) fn monotone(values: &[f64], turns: &[usize]) -> Vec<f64> {
    let mut out = Vec::with_capacity(values.len());
    let mut ends: Vec<usize> = turns.iter().map(|t| t + 1).collect();
    ends.push(values.len());
    let mut start = 0;
    for end in ends {
        if end <= start {
            continue;
        }
        let piece = &values[start..end];
        let sign = if piece[piece.len() - 1] >= piece[0] {
            1.0
        } else {
            -1.0
        };
        // Blocks of mean and count; a block that falls below its neighbour is pooled with it.
        let mut blocks: Vec<(f64, usize)> = Vec::new();
        for &value in piece {
            let mut block = (sign * value, 1);
            while let Some(&(mean, count)) = blocks.last() {
                if mean <= block.0 {
                    break;
                }
                blocks.pop();
                let total = count + block.1;
                block = (
                    (mean * count as f64 + block.0 * block.1 as f64) / total as f64,
                    total,
                );
            }
            blocks.push(block);
        }
        for (mean, count) in blocks {
            out.extend(std::iter::repeat_n(sign * mean, count));
        }
        start = end;
    }
    out
}

/// A turning point as well as it can be known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turn {
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
) -> Vec<Turn> {
    let at = |index: usize| {
        let mut turn = Turn {
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
        let resolved = (a.sure && b.sure) || round(time_s, x, i);
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
    use super::*;

    /// Uniform within one, the same for the same index.
    fn noisy(i: usize) -> f64 {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(i as u64);
        2.0 * random.random::<f64>() - 1.0
    }

    /// Uniform noise of 3 um at uneven times: 3 / sqrt 3.
    #[test]
    fn noise_at_uneven_times() {
        let time_s: Vec<f64> = (0..2000)
            .map(|i| 0.02 * (i as f64 + 0.3 * noisy(i + 7919)))
            .collect();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| 8.0 * (15.0 * t).sin() + 0.003 * noisy(i))
            .collect();
        let found = noise(&time_s, &x);
        assert!((found * 3f64.sqrt() / 0.003 - 1.0).abs() < 0.15, "{found}");
    }

    #[test]
    fn speed_and_acceleration_of_a_sine_from_20_samples_a_cycle_to_400() {
        for (per_cycle, uneven) in [(20.0, 0.0), (20.0, 0.3), (100.0, 0.3), (400.0, 0.0)] {
            let omega = std::f64::consts::TAU * 2.0;
            let time_s: Vec<f64> = (0..1200)
                .map(|i| (f64::from(i) + uneven * noisy(i as usize + 31)) / (2.0 * per_cycle))
                .collect();
            let x: Vec<f64> = time_s
                .iter()
                .enumerate()
                .map(|(i, t)| 6.0 * (omega * t).sin() + 0.001 * noisy(i))
                .collect();
            let locals = smoothed(&time_s, &x, noise(&time_s, &x));
            let (mut speed, mut acceleration) = (0.0f64, 0.0f64);
            for (l, t) in locals.iter().zip(&time_s).skip(30).take(1140) {
                speed += (l.mm_s - 6.0 * omega * (omega * t).cos()).powi(2);
                acceleration += (l.mm_s2 + 6.0 * omega * omega * (omega * t).sin()).powi(2);
            }
            let share = |sum: f64, peak: f64| (sum / 1140.0).sqrt() / peak;
            // Interpolation of fourth order at 20 a cycle: (omega dt)^4 / 30 and / 90 of the peak; noise of 1 um at 400.
            assert!(share(speed, 6.0 * omega) < 3e-3, "{per_cycle}: {speed}");
            assert!(
                share(acceleration, 6.0 * omega * omega) < 1.5e-2,
                "{per_cycle}: {acceleration}"
            );
        }
    }

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
}
