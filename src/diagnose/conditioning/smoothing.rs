//! Smooths a displacement and gives its speed and acceleration, from samples before and after each instant.
//!
//! It uses no recordings and no models: input and output are columns of numbers.

use nalgebra::{SMatrix, SVector};

/// Half widths of the windows that are tried, in samples, widest first.
const HALVES: [usize; 6] = [96, 48, 24, 12, 6, 3];

/// Largest distance of the mean of a sample and its two neighbours from the polynomial, in noises: a corner adds little to the
/// squares of a wide window, but moves this mean. Noise exceeds it once in 3000.
const LARGEST_OFFSET: f64 = 2.1;
/// A sample is an outlier if a window that explains it is at least this many times narrower than one that explains its neighbours.
const OUTLIER_RATIO: usize = 4;
/// A window with more than the noise is a burst of noise, not a misfit, if its variance is below `BURST_VARIANCE` and its lag-1
/// autocorrelation below `BURST_CORRELATION` standard deviations of chance (1 / sqrt n). It needs `BURST_SAMPLES` samples.
const BURST_VARIANCE: f64 = 4.0;
const BURST_CORRELATION: f64 = 1.5;
const BURST_SAMPLES: usize = 25;

/// The upper median; 0 without values.
pub(in crate::diagnose) fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    values.select_nth_unstable_by(middle, f64::total_cmp);
    values[middle]
}

/// Largest minus smallest value.
pub(in crate::diagnose) fn range(values: &[f64]) -> f64 {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    high - low
}

/// Standard deviation of the white noise, at even or uneven times.
///
/// Divided differences remove a smooth motion: of seven samples a sine with 20 samples per cycle, of three a triangle, whose
/// corners disturb the wider ones. The smallest of the estimates is nearest to the noise.
pub(in crate::diagnose) fn noise(time_s: &[f64], values: &[f64]) -> f64 {
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
    // A quantised channel may stand still most of the time; then its step, the smallest distance of two values, is its noise.
    let scale = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut levels = values.to_vec();
    levels.sort_unstable_by(f64::total_cmp);
    let step = levels
        .windows(2)
        .map(|w| w[1] - w[0])
        .filter(|&d| d > 1e-9 * scale)
        .fold(f64::INFINITY, f64::min);
    // A periodic motion repeats its values too, but not on a grid.
    let first = levels.first().copied().unwrap_or(0.0);
    let off_grid = |v: &f64| {
        let steps = (v - first) / step;
        (steps - steps.round()).abs() > 0.01
    };
    let quantised = step.is_finite() && !levels.iter().any(off_grid);
    let quantisation = if quantised { step / 12f64.sqrt() } else { 0.0 };
    from_differences.max(quantisation).max(1e-9 * scale)
}

/// Noise from the middle half of the divided differences of `N` samples.
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

/// Mean of the middle half: robust against outliers, and the steps of a converter do not make it jump as they do a median.
fn midmean(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let quarter = values.len() / 4;
    let middle = &values[quarter..values.len() - quarter];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// Midmean of the absolute value of a standard normal variable: 4 (phi(0.3186) - phi(1.1503)), phi its density.
const MIDMEAN_OF_NORMAL: f64 = 0.69328;

/// Smoothed displacement, speed and acceleration at one sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Local {
    pub mm: f64,
    pub mm_s: f64,
    pub mm_s2: f64,
    /// Number of samples of the window that explains them to within the noise; 0 where the samples are interpolated.
    pub window: usize,
}

/// Least-squares polynomials over the widest window that leaves only noise: on both sides of a sample, or on one side of a corner
/// (Savitzky and Golay 1964; width after Lepski 1991).
pub(super) fn smoothed(time_s: &[f64], values: &[f64], noise: f64) -> Vec<Local> {
    (0..values.len())
        .map(|i| widest_fit(time_s, values, i, noise).unwrap_or_else(|| interpolated(time_s, values, i)))
        .collect()
}

/// The polynomial over the widest window that explains a sample; `None` if no window does.
fn widest_fit(time_s: &[f64], values: &[f64], i: usize, noise: f64) -> Option<Local> {
    let n = values.len();
    let middle = |half: usize| {
        let inside = i >= half && i + half < n;
        inside
            .then(|| fit_window::<5>(time_s, values, i - half..i + half + 1, i, noise))
            .flatten()
    };
    // At a corner only one side belongs to the sample: the one whose polynomial is nearer to it.
    let side = |half: usize| {
        let sides = [i.saturating_sub(2 * half)..i + 1, i..(i + 2 * half + 1).min(n)];
        sides
            .into_iter()
            .filter(|side| side.len() > half.max(4))
            .filter_map(|side| fit_window::<3>(time_s, values, side, i, noise))
            .min_by(|a, b| a.offset.total_cmp(&b.offset))
    };
    let belongs = |p: &FitWindow| p.offset <= LARGEST_OFFSET * noise;
    // Half width of the widest window that explains all samples but this one.
    let mut outlier: Option<(usize, Local)> = None;
    let mut next = middle(HALVES[0]);
    for (k, &half) in HALVES.iter().enumerate() {
        let both = next;
        let found = both.filter(belongs).or_else(|| {
            next = HALVES.get(k + 1).and_then(|&h| middle(h));
            // A curvature that is too large for this window fits the next; a one-sided parabola would hide it.
            let corner = !next.as_ref().is_some_and(belongs);
            corner.then(|| side(half)).flatten().filter(belongs)
        });
        match (found, outlier) {
            (Some(_), Some((wide, local))) if OUTLIER_RATIO * half <= wide => return Some(local),
            (Some(window), _) => return Some(window.local),
            (None, None) => outlier = both.map(|p| (half, p.local)),
            (None, Some(_)) => {}
        }
    }
    let (wide, local) = outlier?;
    (wide >= OUTLIER_RATIO * HALVES[HALVES.len() - 1]).then_some(local)
}

/// A polynomial through a sample and its neighbours.
fn interpolated(time_s: &[f64], values: &[f64], i: usize) -> Local {
    let around = i.saturating_sub(2)..(i + 3).min(values.len());
    let window = if around.len() == 5 {
        fit_window::<5>(time_s, values, around, i, f64::INFINITY)
    } else {
        fit_window::<3>(time_s, values, around, i, f64::INFINITY)
    };
    window.map_or(
        Local {
            mm: values[i],
            ..Local::default()
        },
        |window| window.local,
    )
}

/// A polynomial over a window, at one of its samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitWindow {
    pub local: Local,
    /// Distance of the mean of the sample and its neighbours from the polynomial.
    pub offset: f64,
}

/// Polynomial of `N` coefficients over a window, at sample `i`; `None` if it leaves more than noise.
pub(super) fn fit_window<const N: usize>(
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
        // Relative to the sample, so that a large offset costs no digits.
        right += row * (values[j] - values[i]);
    }
    let solved = normal.cholesky()?.solve(&right);
    let left = |j: usize| values[j] - values[i] - row(j).dot(&solved);
    if noise.is_finite() && !is_noise(window.clone().map(left), count - N, noise) {
        return None;
    }
    let near = i.saturating_sub(1).max(window.start)..(i + 2).min(window.end);
    Some(FitWindow {
        offset: (near.clone().map(left).sum::<f64>() / near.len() as f64).abs(),
        local: Local {
            mm: values[i] + solved[0],
            mm_s: solved[1] / width_s,
            mm_s2: 2.0 * solved[2] / (width_s * width_s),
            window: if noise.is_finite() { count } else { 0 },
        },
    })
}

/// True if the residuals of a polynomial, with `free` degrees of freedom, are noise.
fn is_noise(left: impl Iterator<Item = f64>, free: usize, noise: f64) -> bool {
    let (mut count, mut squares, mut products, mut before) = (0usize, 0.0, 0.0, 0.0);
    for value in left {
        squares += value * value;
        products += value * before;
        before = value;
        count += 1;
    }
    let free = free.max(1) as f64;
    let power = squares / (free * noise * noise);
    power.sqrt() <= 1.0 + 2.0 / (2.0 * free).sqrt()
        || (count >= BURST_SAMPLES
            && power <= BURST_VARIANCE
            && products <= BURST_CORRELATION * squares / (count as f64).sqrt())
}

/// Least-squares monotone path between reversals, rising and falling alternately.
pub(super) fn monotone(values: &[f64], turns: &[usize]) -> Vec<f64> {
    let mut out = Vec::with_capacity(values.len());
    let mut ends: Vec<usize> = turns.iter().map(|t| t + 1).collect();
    ends.push(values.len());
    let mut start = 0;
    for end in ends {
        if end <= start {
            continue;
        }
        let half = &values[start..end];
        let sign = if half[half.len() - 1] >= half[0] {
            1.0
        } else {
            -1.0
        };
        // Blocks of mean and count; a block that falls below its neighbour is pooled with it.
        let mut blocks: Vec<(f64, usize)> = Vec::new();
        for &value in half {
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

    /// Uniform within -1 to 1, the same for the same index.
    pub(in crate::diagnose) fn noisy(i: usize) -> f64 {
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
            // Fourth-order interpolation at 20 samples per cycle: (omega dt)^4 / 30 and / 90 of the peak; at 400, noise of 1 um.
            assert!(share(speed, 6.0 * omega) < 3e-3, "{per_cycle}: {speed}");
            assert!(
                share(acceleration, 6.0 * omega * omega) < 1.5e-2,
                "{per_cycle}: {acceleration}"
            );
        }
    }

    /// 3 mm/s at 200 Hz, 15 um per sample: the one-sided window at the first sample after the corner must add no travel.
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

    /// A mass of 75 kg turns 13 mm/s2 into 1 N: an outlier or a burst of noise must not become an inertia force.
    #[test]
    fn outliers_and_bursts_of_noise_are_no_acceleration() {
        let omega = std::f64::consts::TAU;
        let time_s: Vec<f64> = (0..6000).map(|i| 1e-3 * f64::from(i)).collect();
        let x: Vec<f64> = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let outlier = if i % 500 == 123 { 0.015 } else { 0.0 };
                let burst = if i % 1000 < 60 { 2.0 } else { 1.0 };
                6.0 * (omega * t).sin() + 0.003 * burst * noisy(i) + outlier
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
