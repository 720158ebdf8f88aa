//! Takes the noise out of a displacement and finds where it really turned. No recording, no model: columns in, columns out.

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    values.select_nth_unstable_by(middle, f64::total_cmp);
    values[middle]
}

/// Standard deviation of the white part: sixth differences leave nothing of a smooth motion, even at 20 samples a cycle.
pub(super) fn noise(values: &[f64]) -> f64 {
    const TAPS: [f64; 7] = [1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0];
    let differences: Vec<f64> = values
        .windows(7)
        .map(|w| w.iter().zip(TAPS).map(|(v, t)| v * t).sum::<f64>().abs())
        .collect();
    // Root of the sum of the squared taps, and the median of |normal|.
    let from_differences = median(differences) / 924f64.sqrt() / 0.6745;
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

/// Local parabolas over the widest window that leaves nothing but noise behind; the window's half width with them.
pub(super) fn smoothed(values: &[f64], noise: f64) -> (Vec<f64>, usize) {
    for half in [24, 12, 6, 3, 2] {
        if values.len() < 8 * half {
            continue;
        }
        let smooth = parabolas(values, half);
        // The remainder of a window of 2 m + 1 keeps nearly all the noise; 15 % more in RMS would be the motion's own.
        let worst = values
            .chunks(8 * half)
            .zip(smooth.chunks(8 * half))
            .map(|(v, s)| {
                let sum: f64 = v.iter().zip(s).map(|(a, b)| (a - b).powi(2)).sum();
                (sum / v.len() as f64).sqrt()
            })
            .fold(0.0, f64::max);
        if worst <= 1.6 * noise {
            return (smooth, half);
        }
    }
    (values.to_vec(), 0)
}

/// Around a turning point the window would round a corner off: there each side is smoothed by itself.
pub(super) fn sharpened(raw: &[f64], mut smooth: Vec<f64>, half: usize, turns: &[usize]) -> Vec<f64> {
    for (k, &turn) in turns.iter().enumerate() {
        let before = if k == 0 { 0 } else { turns[k - 1] };
        let after = turns.get(k + 1).map_or(raw.len() - 1, |t| *t);
        let left = before.max(turn.saturating_sub(2 * half + 1))..turn;
        let right = turn + 1..(turn + 2 * half + 2).min(after + 1);
        for side in [left, right] {
            if half == 0 || side.len() < 6 {
                continue;
            }
            let Some(parabola) = parabola(&raw[side.clone()]) else {
                continue;
            };
            for i in side.clone() {
                if i.abs_diff(turn) <= half {
                    let t = (i - side.start) as f64;
                    smooth[i] = parabola[0] + t * (parabola[1] + t * parabola[2]);
                }
            }
        }
        smooth[turn] = raw[turn];
        if let (Some(a), Some(b)) = (turn.checked_sub(1), (turn + 1 < raw.len()).then_some(turn + 1)) {
            // The extreme of noisy samples lies too far out: no further than either side leads to.
            let peak = smooth[turn] >= smooth[a];
            let reach = 0.5 * (smooth[a] + smooth[b]);
            let step = (smooth[a] - smooth[a.saturating_sub(1)]).abs();
            smooth[turn] = if peak {
                smooth[turn].min((reach + step).max(smooth[a]).max(smooth[b]))
            } else {
                smooth[turn].max((reach - step).min(smooth[a]).min(smooth[b]))
            };
        }
    }
    smooth
}

/// Least-squares parabola through values at 0, 1, 2, ...
pub(super) fn parabola(values: &[f64]) -> Option<[f64; 3]> {
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut right = nalgebra::Vector3::<f64>::zeros();
    for (i, v) in values.iter().enumerate() {
        let t = i as f64;
        let row = nalgebra::Vector3::new(1.0, t, t * t);
        normal += row * row.transpose();
        right += row * *v;
    }
    normal.cholesky().map(|c| c.solve(&right).into())
}

/// Value at the middle of the least-squares parabola over 2 `half` + 1 samples (Savitzky and Golay 1964).
pub(super) fn parabolas(values: &[f64], half: usize) -> Vec<f64> {
    let m = half as f64;
    let taps: Vec<f64> = (0..=2 * half)
        .map(|i| {
            let j = i as f64 - m;
            (3.0 * m * m + 3.0 * m - 1.0 - 5.0 * j * j) * 3.0
                / ((2.0 * m - 1.0) * (2.0 * m + 1.0) * (2.0 * m + 3.0))
        })
        .collect();
    let n = values.len();
    (0..n)
        .map(|i| {
            if i < half || i + half >= n {
                return values[i];
            }
            let window = &values[i - half..=i + half];
            window.iter().zip(&taps).map(|(v, t)| v * t).sum()
        })
        .collect()
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

/// Where the motion really turned, if that is between two samples: (sample before it, time, displacement).
///
/// Corner of two straight lines for a triangle, vertex of a parabola for anything round.
pub(super) fn vertices(time_s: &[f64], x: &[f64], turns: &[usize], noise_mm: f64) -> Vec<(usize, f64, f64)> {
    let mut found = Vec::new();
    for &i in turns {
        if i < 2 || i + 2 >= x.len() {
            continue;
        }
        let bend = |j: usize| x[j - 1] - 2.0 * x[j] + x[j + 1];
        let (here, around) = (bend(i), bend(i - 1).abs().min(bend(i + 1).abs()));
        if here == 0.0 {
            continue;
        }
        let dt_s = time_s[i + 1] - time_s[i];
        let (offset, value) =
            if around < 0.25 * here.abs() && bend(i - 1).abs().max(bend(i + 1).abs()) < here.abs() {
                let (left, right) = (x[i - 1] - x[i - 2], x[i + 2] - x[i + 1]);
                if left == right {
                    continue;
                }
                let offset = (x[i + 1] - x[i - 1] - left - right) / (left - right);
                (offset, x[i - 1] + left * (1.0 + offset))
            } else {
                let slope = 0.5 * (x[i + 1] - x[i - 1]);
                let offset = -slope / here;
                (offset, x[i] + 0.5 * slope * offset)
            };
        let beyond = (value - x[i]) * -here.signum();
        if offset.abs() < 1.0 && beyond > noise_mm {
            let before = if offset >= 0.0 { i } else { i - 1 };
            found.push((before, time_s[i] + offset * dt_s, value));
        }
    }
    found
}
