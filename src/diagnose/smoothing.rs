//! Takes the noise out of a displacement and gives its speed and acceleration with hindsight.
//! No recording, no model: columns in, columns out.

use nalgebra::{SMatrix, SVector};

/// Half widths of the windows that are tried, in samples.
const HALVES: [usize; 6] = [96, 48, 24, 12, 6, 3];

/// Noises that a sample and its neighbours may lie off the piece that explains them: of a wide window's squares those beyond a
/// corner are little. The mean of three is noise beyond it once in 3000.
const OUTLYING: f64 = 2.1;
/// A sample that only a window so many times narrower explains is odd by itself: a corner is seen to one side about as far.
const ODD: usize = 4;
/// Where a window leaves more than the noise, but less than `BURST` times its power, and neighbours are not alike by more than
/// `ALIKE` times what chance does (1 over the root of the count), the noise is larger there for a while. Fewer samples do not tell.
const BURST: f64 = 4.0;
const ALIKE: f64 = 1.5;
const LEAST_BURST: usize = 25;

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
    /// Samples of the smooth piece that explains them to within the noise; 0 where it only goes through the samples.
    pub window: usize,
}

/// Least-squares polynomials over the widest window that leaves nothing but noise: on both sides of a sample, or on one where
/// the other is beyond a corner (Savitzky and Golay 1964; width after Lepski 1991).
pub(super) fn smoothed(time_s: &[f64], values: &[f64], noise: f64) -> Vec<Local> {
    (0..values.len())
        .map(|i| explained(time_s, values, i, noise).unwrap_or_else(|| through(time_s, values, i)))
        .collect()
}

/// The widest piece that explains a sample; none where nothing smooth is as fine as that.
fn explained(time_s: &[f64], values: &[f64], i: usize, noise: f64) -> Option<Local> {
    let n = values.len();
    let middle = |half: usize| {
        let inside = i >= half && i + half < n;
        inside
            .then(|| fitted::<5>(time_s, values, i - half..i + half + 1, i, noise))
            .flatten()
    };
    // Beyond a corner only one side belongs to the sample: the one that it lies nearer to.
    let side = |half: usize| {
        let sides = [i.saturating_sub(2 * half)..i + 1, i..(i + 2 * half + 1).min(n)];
        sides
            .into_iter()
            .filter(|side| side.len() > half.max(4))
            .filter_map(|side| fitted::<3>(time_s, values, side, i, noise))
            .min_by(|a, b| a.off.total_cmp(&b.off))
    };
    let belongs = |p: &FitWindow| p.off <= OUTLYING * noise;
    // Half width of the widest window of which all is explained but the sample.
    let mut odd: Option<(usize, Local)> = None;
    let mut next = middle(HALVES[0]);
    for (k, &half) in HALVES.iter().enumerate() {
        let both = next;
        let seen = both.filter(belongs).or_else(|| {
            next = HALVES.get(k + 1).and_then(|&h| middle(h));
            // A bend that is too much for this window is seen by the next; one to the side would hide it in its parabola.
            let corner = !next.as_ref().is_some_and(belongs);
            corner.then(|| side(half)).flatten().filter(belongs)
        });
        match (seen, odd) {
            (Some(_), Some((wide, local))) if ODD * half <= wide => return Some(local),
            (Some(piece), _) => return Some(piece.local),
            (None, None) => odd = both.map(|p| (half, p.local)),
            (None, Some(_)) => {}
        }
    }
    let (wide, local) = odd?;
    (wide >= ODD * HALVES[HALVES.len() - 1]).then_some(local)
}

/// Through the samples themselves.
fn through(time_s: &[f64], values: &[f64], i: usize) -> Local {
    let around = i.saturating_sub(2)..(i + 3).min(values.len());
    let piece = if around.len() == 5 {
        fitted::<5>(time_s, values, around, i, f64::INFINITY)
    } else {
        fitted::<3>(time_s, values, around, i, f64::INFINITY)
    };
    piece.map_or(
        Local {
            mm: values[i],
            ..Local::default()
        },
        |piece| piece.local,
    )
}

/// A polynomial at one sample of its window.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitWindow {
    pub local: Local,
    /// How far the sample and its neighbours lie off it in the mean, mm.
    pub off: f64,
}

/// Polynomial of `N` coefficients over a window, at sample `i`; none where it leaves more than noise.
pub(super) fn fitted<const N: usize>(
    time_s: &[f64],
    values: &[f64],
    window: std::ops::Range<usize>,
    i: usize,
    noise: f64,
) -> Option<FitWindow> {
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
    let left = |j: usize| values[j] - values[i] - row(j).dot(&solved);
    if noise.is_finite() && !is_noise(window.clone().map(left), count - N, noise) {
        return None;
    }
    let near = i.saturating_sub(1).max(window.start)..(i + 2).min(window.end);
    Some(FitWindow {
        off: (near.clone().map(left).sum::<f64>() / near.len() as f64).abs(),
        local: Local {
            mm: values[i] + solved[0],
            mm_s: solved[1] / width_s,
            mm_s2: 2.0 * solved[2] / (width_s * width_s),
            window: if noise.is_finite() { count } else { 0 },
        },
    })
}

/// Is what a polynomial leaves, with `free` degrees of freedom, noise and nothing else?
fn is_noise(left: impl Iterator<Item = f64>, free: usize, noise: f64) -> bool {
    let (mut count, mut squares, mut alike, mut before) = (0usize, 0.0, 0.0, 0.0);
    for value in left {
        squares += value * value;
        alike += value * before;
        before = value;
        count += 1;
    }
    let free = free.max(1) as f64;
    let power = squares / (free * noise * noise);
    power.sqrt() <= 1.0 + 2.0 / (2.0 * free).sqrt()
        || (count >= LEAST_BURST && power <= BURST && alike <= ALIKE * squares / (count as f64).sqrt())
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Uniform within one, the same for the same index.
    pub fn noisy(i: usize) -> f64 {
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

    /// 3 mm/s at 200 Hz, 15 um a sample: what a window to one side makes of the first sample beyond the corner is no travel.
    #[test]
    fn a_ramp_that_stops_does_not_overshoot() {
        let time_s: Vec<f64> = (0..1600).map(|i| 0.005 * f64::from(i)).collect();
        let truth = |t: f64| 3.0 * f64::min(t, 5.002);
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| truth(*t) + 0.0046 * noisy(i))
            .collect();
        let noise_mm = noise(&time_s, &x);
        let locals = smoothed(&time_s, &x, noise_mm);
        let worst = locals
            .iter()
            .zip(&time_s)
            .map(|(l, t)| (l.mm - truth(*t)).abs())
            .fold(0.0, f64::max);
        assert!(worst < 2.5 * noise_mm, "{worst} mm, noise {noise_mm} mm");
    }

    /// A mass of 75 kg makes 1 N of 13 mm/s2: what is no more than an odd sample, or a while of more noise, must not be a force.
    #[test]
    fn odd_samples_and_bursts_of_noise_are_no_acceleration() {
        let omega = std::f64::consts::TAU;
        let time_s: Vec<f64> = (0..6000).map(|i| 1e-3 * f64::from(i)).collect();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let odd = if i % 500 == 123 { 0.015 } else { 0.0 };
                let burst = if i % 1000 < 60 { 2.0 } else { 1.0 };
                6.0 * (omega * t).sin() + 0.003 * burst * noisy(i) + odd
            })
            .collect();
        let locals = smoothed(&time_s, &x, noise(&time_s, &x));
        let off = |(l, t): (&Local, &f64)| (l.mm_s2 + 6.0 * omega * omega * (omega * t).sin()).abs();
        let worst = locals
            .iter()
            .zip(&time_s)
            .skip(100)
            .take(5800)
            .map(off)
            .fold(0.0, f64::max);
        assert!(worst < 20.0, "{worst} mm/s2");
    }
}
