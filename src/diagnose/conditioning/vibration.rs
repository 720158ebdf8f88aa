//! Hum and vibration of one frequency on a channel. Its reversals are no reversals of the test. It uses no recordings and no models:
//! input and output are columns of numbers.
//!
//! In each of many short windows a polynomial takes out the motion and a sine is fitted to the rest. The windows are shorter than half a
//! cycle of the motion, so that harmonics of the motion form no line. What has the same frequency and phase in most windows is a
//! steady line; corners and friction jumps are in few of them, and the median leaves them out. At fast sampling such a window is too short
//! for slow lines, so these are looked for in means of several samples.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use nalgebra::{Complex, SMatrix, SVector};

use super::smoothing::{median, range};
use crate::recording::cycles;

/// Lowest frequency in Hz that counts as vibration whatever the motion is. Test motions are slower.
const LOWEST_HZ: f64 = 8.0;
/// On a slow motion, lines are looked for from this many times its frequency on, where that is below [`LOWEST_HZ`]: a vibration beyond half
/// the sampling rate of a slowly sampled ramp appears at such a low frequency. The harmonics of a square wave have 2 % there.
const LOWEST_OF_MOTION: f64 = 50.0;
/// Periods of a vibration that a window holds, at least: fewer are like the motion itself.
const LEAST_PERIODS: f64 = 5.0;
/// Highest frequency as a share of the sampling rate. At half of it, sine and cosine are no longer told apart.
const HIGHEST: f64 = 0.45;
/// Samples of a window, and the longest window in periods of the motion.
const SAMPLES: Range<usize> = 24..256;
const OF_MOTION: f64 = 0.4;
/// A mean takes at most this many times the samples of the next shorter one, so that the frequencies that both show overlap.
const STRIDE_RATIO: usize = 16;
/// Coefficients of the polynomial that the motion is in a window. With four, a sine of 7 mm left 0.01 mm in the longest window.
const MOTION: usize = 8;
/// These, and the cosine and the sine of a vibration.
const WITH_SINE: usize = MOTION + 2;
/// Reversals of the test come back by more than this share of the stroke.
const TEST_REVERSAL: f64 = 0.2;
/// Number of windows of the spectrum; at least the lower number must be there.
const WINDOWS: Range<usize> = 6..16;
/// A line stands this far above the spectrum around it. The median spectrum of noise reaches 3.
const PROMINENT: f64 = 15.0;
/// Places in the spectrum on either side of a line, in half reciprocals of the window: the line's own, and those it is compared with.
const OWN: usize = 3;
const BESIDE: usize = 14;
/// A line is steady if its amplitude and phase in most windows differ from their median by less than this share.
const STEADY: f64 = 0.35;
/// Rounds of the mean over the windows that agree.
const TRIMMED_ROUNDS: usize = 4;
/// Smallest amplitude of a line as a share of the channel's range: below it, rounding of the file counts.
const LEAST_AMPLITUDE: f64 = 1e-5;
/// Largest number of lines of a channel.
const MOST_LINES: usize = 3;

/// A line in a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vibration {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Amplitude in the unit of the channel.
    pub amplitude: f64,
    /// Distance in Hz at which two lines can be told apart.
    resolution_hz: f64,
    /// Cosine and sine amplitude; `None` if the phase wanders, so that the line cannot be subtracted.
    parts: Option<[f64; 2]>,
}

impl Vibration {
    /// True if it is a line of constant phase.
    pub(super) fn is_steady(&self) -> bool {
        self.parts.is_some()
    }

    /// Its value at a time; zero if the phase wanders.
    fn at(&self, time_s: f64) -> f64 {
        let (sine, cosine) = (TAU * self.frequency_hz * time_s).sin_cos();
        self.parts.map_or(0.0, |[c, s]| c * cosine + s * sine)
    }
}

/// Removes the steady lines of a channel and returns all that were found. `motion_hz` is the frequency of the test's motion.
pub(super) fn remove_vibrations(time_s: &[f64], values: &mut [f64], motion_hz: f64) -> Vec<Vibration> {
    let mut found = Vec::new();
    remove_lines(time_s, values, (motion_hz, LOWEST_HZ), &|_| true, &mut found);
    found
}

/// The same, and on a slow motion also the lines below [`LOWEST_HZ`] that are steady and no motion of the specimen.
pub(super) fn remove_all_vibrations(
    time_s: &[f64],
    values: &mut [f64],
    motion_hz: f64,
    is_motion: &dyn Fn(&Vibration) -> bool,
) -> Vec<Vibration> {
    let mut found = remove_vibrations(time_s, values, motion_hz);
    let lowest_hz = LOWEST_OF_MOTION * motion_hz;
    if lowest_hz < LOWEST_HZ {
        let is_vibration = |line: &Vibration| line.is_steady() && !is_motion(line);
        remove_lines(time_s, values, (motion_hz, lowest_hz), &is_vibration, &mut found);
    }
    found
}

/// Subtracts the steady lines of a channel from `lowest_hz` on and adds them to `found`. It ends at the first line that is no vibration; one
/// that is not steady is added, too, and ends it as well.
fn remove_lines(
    time_s: &[f64],
    values: &mut [f64],
    (motion_hz, lowest_hz): (f64, f64),
    is_vibration: &dyn Fn(&Vibration) -> bool,
    found: &mut Vec<Vibration>,
) {
    while found.len() < MOST_LINES && found.last().is_none_or(Vibration::is_steady) {
        // A line this close to one that was subtracted is what the subtraction left of it.
        let is_rest = |line: &Vibration, of: &Vibration| {
            (line.frequency_hz - of.frequency_hz).abs() < line.resolution_hz
        };
        let line = vibration(time_s, values, motion_hz, lowest_hz);
        let is_new = |line: &Vibration| is_vibration(line) && !found.iter().any(|of| is_rest(line, of));
        let Some(line) = line.filter(is_new) else {
            break;
        };
        found.push(line);
        for (value, t) in values.iter_mut().zip(time_s) {
            *value -= line.at(*t);
        }
    }
}

/// True if a line of every frequency from [`LOWEST_HZ`] on would be found. Windows of a fast motion are too short for slow lines.
pub(super) fn shows_all_vibrations(time_s: &[f64], motion_hz: f64) -> bool {
    let slowest = strides(time_s, motion_hz, LOWEST_HZ)[0];
    Windows::new(&means(time_s, slowest), motion_hz, LOWEST_HZ)
        .is_some_and(|windows| windows.search_hz.start <= LOWEST_HZ)
}

/// Frequency in Hz of the test's motion, from reversals that no vibration makes. With fewer than two the recording is half a cycle.
pub(super) fn motion_frequency_hz(time_s: &[f64], displacement_mm: &[f64]) -> f64 {
    let turns = cycles::reversals(displacement_mm, TEST_REVERSAL * range(displacement_mm));
    let halves: Vec<f64> = turns
        .windows(2)
        .map(|w| time_s[w[1].index] - time_s[w[0].index])
        .collect();
    let half_s = if halves.is_empty() {
        time_s[time_s.len() - 1] - time_s[0]
    } else {
        median(halves)
    };
    0.5 / half_s
}

/// The strongest line from `lowest_hz` on. Slow lines are looked for first.
fn vibration(time_s: &[f64], values: &[f64], motion_hz: f64, lowest_hz: f64) -> Option<Vibration> {
    let line = strides(time_s, motion_hz, lowest_hz)
        .into_iter()
        .find_map(|stride| line_of_means(time_s, values, (motion_hz, lowest_hz), stride))?;
    (line.amplitude > LEAST_AMPLITUDE * range(values)).then_some(line)
}

/// The strongest line of the means of `stride` samples each. Its amplitude is that of the samples.
fn line_of_means(
    time_s: &[f64],
    values: &[f64],
    (motion_hz, lowest_hz): (f64, f64),
    stride: usize,
) -> Option<Vibration> {
    let (means_s, means) = (means(time_s, stride), means(values, stride));
    let windows = Windows::new(&means_s, motion_hz, lowest_hz)?;
    let frequency_hz = windows.line(&means_s, &means)?;
    let fits: Vec<Option<Complex<f64>>> = windows
        .all
        .iter()
        .map(|window| sine_in(&means_s, &means, window.clone(), frequency_hz))
        .collect();
    let refined_hz = windows.refined(&means_s, &fits, frequency_hz);
    Some(windows.of_samples(stride).line_at(time_s, values, refined_hz))
}

/// How many samples a mean takes. The first is long enough that a window holds five periods of the slowest vibration; the last is one
/// sample, for the fastest.
fn strides(time_s: &[f64], motion_hz: f64, lowest_hz: f64) -> Vec<usize> {
    let needed_s = (LEAST_PERIODS / lowest_hz).min(OF_MOTION / motion_hz);
    let longest = (needed_s / interval_s(time_s) / SAMPLES.end as f64).ceil() as usize;
    let shorter = |stride: &usize| (*stride > 1).then(|| stride.div_ceil(STRIDE_RATIO));
    std::iter::successors(Some(longest.max(1)), shorter).collect()
}

/// Means of `stride` samples each. Samples at the end that fill no mean are left out.
fn means(values: &[f64], stride: usize) -> Vec<f64> {
    let blocks = values.chunks_exact(stride);
    blocks
        .map(|block| block.iter().sum::<f64>() / stride as f64)
        .collect()
}

fn interval_s(time_s: &[f64]) -> f64 {
    median(time_s.windows(2).map(|w| w[1] - w[0]).collect())
}

/// Amplitude on another channel at the frequency of a line; 0 if the recording is too short.
pub(super) fn amplitude_at(time_s: &[f64], values: &[f64], motion_hz: f64, frequency_hz: f64) -> f64 {
    let lowest_hz = frequency_hz.min(LOWEST_HZ);
    let of_means =
        |stride| Some(Windows::new(&means(time_s, stride), motion_hz, lowest_hz)?.of_samples(stride));
    let windows: Vec<Windows> = strides(time_s, motion_hz, lowest_hz)
        .into_iter()
        .filter_map(of_means)
        .collect();
    let reaches = |windows: &&Windows| frequency_hz < windows.search_hz.end;
    windows
        .iter()
        .find(reaches)
        .or(windows.last())
        .map_or(0.0, |windows| {
            windows.line_at(time_s, values, frequency_hz).amplitude
        })
}

/// Windows of equal number of samples over a recording, half overlapping.
struct Windows {
    all: Vec<Range<usize>>,
    /// Duration in s of a window without a gap.
    duration_s: f64,
    /// Frequencies that are searched, Hz.
    search_hz: Range<f64>,
}

impl Windows {
    /// `None` if the recording is too short or too coarse for a vibration to be seen.
    fn new(time_s: &[f64], motion_hz: f64, lowest_hz: f64) -> Option<Windows> {
        let interval_s = interval_s(time_s);
        let longest = (OF_MOTION / motion_hz / interval_s) as usize;
        let samples = longest.min(SAMPLES.end).min(time_s.len() / WINDOWS.start);
        if samples < SAMPLES.start {
            return None;
        }
        let duration_s = samples as f64 * interval_s;
        let search_hz = lowest_hz.max(LEAST_PERIODS / duration_s)..HIGHEST / interval_s;
        let all: Vec<Range<usize>> = (0..)
            .map(|k| k * samples / 2..k * samples / 2 + samples)
            .take_while(|w| w.end <= time_s.len())
            .filter(|w| time_s[w.end - 1] - time_s[w.start] < 1.5 * duration_s)
            .collect();
        (all.len() >= WINDOWS.start && search_hz.start < search_hz.end).then_some(Windows {
            all,
            duration_s,
            search_hz,
        })
    }

    /// The same windows of the samples that means of `stride` samples each were made of.
    fn of_samples(mut self, stride: usize) -> Windows {
        for window in &mut self.all {
            *window = stride * window.start..stride * window.end;
        }
        self
    }

    /// Distance in Hz of two places of the spectrum.
    fn step_hz(&self) -> f64 {
        0.5 / self.duration_s
    }

    fn middle_s(&self, time_s: &[f64], k: usize) -> f64 {
        0.5 * (time_s[self.all[k].start] + time_s[self.all[k].end - 1])
    }

    /// Frequency of the most prominent line of the median spectrum, Hz.
    fn line(&self, time_s: &[f64], values: &[f64]) -> Option<f64> {
        let step_hz = self.step_hz();
        // The spectrum begins below the search, so that a line is compared with what is beside it on both sides.
        let first = (self.search_hz.start / step_hz) as usize
            - BESIDE.min((self.search_hz.start / step_hz) as usize - 2);
        let last = (self.search_hz.end / step_hz) as usize;
        let every = self.all.len().div_ceil(WINDOWS.end);
        let spectra: Vec<Vec<f64>> = self
            .all
            .iter()
            .step_by(every)
            .map(|window| {
                let rest = without_motion(time_s, values, window.clone());
                (first..=last)
                    .map(|k| power(&time_s[window.clone()], &rest, k as f64 * step_hz))
                    .collect()
            })
            .collect();
        let spectrum: Vec<f64> = (0..=last - first)
            .map(|k| median(spectra.iter().map(|s| s[k]).collect()))
            .collect();
        let beside = |range: Range<usize>| median(spectrum[range].to_vec());
        let prominence = |k: usize| {
            let left = beside(k.saturating_sub(BESIDE)..k.saturating_sub(OWN));
            let right = beside((k + OWN + 1).min(spectrum.len())..(k + BESIDE + 1).min(spectrum.len()));
            spectrum[k] / left.max(right).max(f64::MIN_POSITIVE)
        };
        (0..spectrum.len())
            .filter(|k| (first + k) as f64 * step_hz >= self.search_hz.start)
            .map(|k| (prominence(k), k))
            .filter(|(prominence, _)| *prominence > PROMINENT)
            .max_by(|a, b| spectrum[a.1].total_cmp(&spectrum[b.1]))
            .map(|(_, k)| (first + k) as f64 * step_hz)
    }

    /// The line at a frequency, with the amplitude and phase on which most windows agree.
    fn line_at(&self, time_s: &[f64], values: &[f64], frequency_hz: f64) -> Vibration {
        let fits = self.all.iter();
        let fits: Vec<Complex<f64>> = fits
            .filter_map(|window| sine_in(time_s, values, window.clone(), frequency_hz))
            .collect();
        let mut middle = Complex::new(
            median(fits.iter().map(|a| a.re).collect()),
            median(fits.iter().map(|a| a.im).collect()),
        );
        let distance = |middle: Complex<f64>| median(fits.iter().map(|a| (a - middle).norm()).collect());
        let steady = distance(middle) < STEADY * middle.norm();
        for _ in 0..TRIMMED_ROUNDS {
            // The nearer half: a corner or a friction jump moves the amplitude of its window.
            let limit = distance(middle);
            let near: Vec<&Complex<f64>> = fits.iter().filter(|a| (*a - middle).norm() <= limit).collect();
            middle = near.iter().copied().sum::<Complex<f64>>() / near.len().max(1) as f64;
        }
        Vibration {
            frequency_hz,
            amplitude: if steady {
                middle.norm()
            } else {
                median(fits.iter().map(|a| a.norm()).collect())
            },
            resolution_hz: OWN as f64 * self.step_hz(),
            // The real part of a exp(i w t) is the line.
            parts: steady.then_some([middle.re, -middle.im]),
        }
    }

    /// The frequency at which the phases in the windows agree. Longer and longer distances of two windows give it more and more
    /// exactly, without doubt about the number of turns between them.
    fn refined(&self, time_s: &[f64], fits: &[Option<Complex<f64>>], frequency_hz: f64) -> f64 {
        let spacing_s = 0.5 * self.duration_s;
        let mut refined_hz = frequency_hz;
        let mut lag = 1;
        while lag < fits.len() {
            let mut sum = Complex::new(0.0, 0.0);
            let mut pairs = 0;
            for k in 0..fits.len() - lag {
                let (Some(a), Some(b)) = (fits[k], fits[k + lag]) else {
                    continue;
                };
                let apart_s = self.middle_s(time_s, k + lag) - self.middle_s(time_s, k);
                if (apart_s / (lag as f64 * spacing_s) - 1.0).abs() < 0.1 {
                    let turn = -TAU * (refined_hz - frequency_hz) * apart_s;
                    sum += b * a.conj() * Complex::new(turn.cos(), turn.sin());
                    pairs += 1;
                }
            }
            if pairs < 4 {
                break;
            }
            refined_hz += sum.arg() / (TAU * lag as f64 * spacing_s);
            lag *= 2;
        }
        refined_hz
    }
}

/// Polynomial of the motion over a window: its Chebyshev columns at a sample, and the time there from -1 to 1.
fn motion_at(time_s: &[f64], window: &Range<usize>, i: usize) -> (SVector<f64, MOTION>, f64) {
    let (from, to) = (time_s[window.start], time_s[window.end - 1]);
    let t = (2.0 * time_s[i] - from - to) / (to - from);
    let mut row = SVector::from_element(1.0);
    row[1] = t;
    for k in 2..MOTION {
        row[k] = 2.0 * t * row[k - 1] - row[k - 2];
    }
    (row, t)
}

/// What the polynomial of the motion leaves of a window, tapered.
fn without_motion(time_s: &[f64], values: &[f64], window: Range<usize>) -> Vec<f64> {
    let (mut normal, mut right) = (
        SMatrix::<f64, MOTION, MOTION>::zeros(),
        SVector::<f64, MOTION>::zeros(),
    );
    let level = values[window.start];
    for i in window.clone() {
        let (row, _) = motion_at(time_s, &window, i);
        normal += row * row.transpose();
        right += row * (values[i] - level);
    }
    let motion = normal.cholesky().map_or(SVector::zeros(), |c| c.solve(&right));
    window
        .clone()
        .map(|i| {
            let (row, t) = motion_at(time_s, &window, i);
            (values[i] - level - row.dot(&motion)) * 0.5 * (1.0 + (PI * t).cos())
        })
        .collect()
}

/// Power of a column at a frequency.
fn power(time_s: &[f64], rest: &[f64], frequency_hz: f64) -> f64 {
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (t, value) in time_s.iter().zip(rest) {
        let (s, c) = (TAU * frequency_hz * (t - time_s[0])).sin_cos();
        cosine += c * value;
        sine += s * value;
    }
    cosine * cosine + sine * sine
}

/// Complex amplitude of a sine in a window, beside the polynomial of the motion; its phase counts from time 0.
fn sine_in(time_s: &[f64], values: &[f64], window: Range<usize>, frequency_hz: f64) -> Option<Complex<f64>> {
    let (mut normal, mut right) = (
        SMatrix::<f64, WITH_SINE, WITH_SINE>::zeros(),
        SVector::<f64, WITH_SINE>::zeros(),
    );
    let level = values[window.start];
    for i in window.clone() {
        let (motion, _) = motion_at(time_s, &window, i);
        let (sine, cosine) = (TAU * frequency_hz * time_s[i]).sin_cos();
        let mut row = motion.fixed_resize::<WITH_SINE, 1>(cosine);
        row[MOTION + 1] = sine;
        normal += row * row.transpose();
        right += row * (values[i] - level);
    }
    let solved = normal.cholesky()?.solve(&right);
    Some(Complex::new(solved[MOTION], -solved[MOTION + 1]))
}

#[cfg(test)]
mod tests {
    use super::super::smoothing::tests::noisy;
    use super::*;

    fn times(rate_hz: f64, duration_s: f64) -> Vec<f64> {
        (0..(rate_hz * duration_s) as u32)
            .map(|i| f64::from(i) / rate_hz)
            .collect()
    }

    fn triangle(t: f64) -> f64 {
        10.0 - (20.0 * t.fract() - 10.0).abs()
    }

    #[test]
    fn a_steady_line_is_removed_from_a_sine_and_a_triangle() {
        let sine = |t: f64| 5.0 * (TAU * t).sin();
        for motion in [sine, triangle] {
            let time_s = times(1000.0, 20.0);
            let clean: Vec<f64> = time_s.iter().map(|t| motion(*t)).collect();
            let mut x: Vec<f64> = (0..time_s.len())
                .map(|i| clean[i] + 0.05 * (TAU * 49.97 * time_s[i] + 1.0).sin() + 0.003 * noisy(i))
                .collect();
            let motion_hz = motion_frequency_hz(&time_s, &x);
            assert!((motion_hz - 1.0).abs() < 0.05, "{motion_hz}");
            let found = remove_vibrations(&time_s, &mut x, motion_hz);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(
                found[0].is_steady() && (found[0].amplitude - 0.05).abs() < 0.002,
                "{found:?}"
            );
            assert!((found[0].frequency_hz - 49.97).abs() < 0.002, "{found:?}");
            let worst = x
                .iter()
                .zip(&clean)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            // Noise of 3 um, and 4 % of the line.
            assert!(worst < 0.006, "{worst}");
        }
    }

    #[test]
    fn a_test_motion_with_noise_has_no_line() {
        let jump = |t: f64| 80.0 * triangle(t) + if t.fract() < 0.5 { 30.0 } else { -30.0 };
        let sine = |t: f64| 5.0 * (TAU * 2.5 * t).sin();
        for (motion, rate_hz, hz) in [
            (&triangle as &dyn Fn(f64) -> f64, 1000.0, 1.0),
            (&triangle, 200.0, 1.0),
            (&jump, 1000.0, 1.0),
            (&sine, 200.0, 2.5),
            (&sine, 1000.0, 2.5),
        ] {
            let time_s = times(rate_hz, 20.0);
            for size in [0.0, 0.003] {
                let mut x: Vec<f64> = (0..time_s.len())
                    .map(|i| motion(time_s[i]) + size * noisy(i))
                    .collect();
                assert_eq!(remove_vibrations(&time_s, &mut x, hz), [], "{rate_hz} {size}");
            }
        }
    }

    /// 256 samples are 0.13 s here, four periods of the line.
    #[test]
    fn a_slow_line_is_found_in_fast_samples() {
        let time_s = times(2000.0, 5.0);
        let clean: Vec<f64> = time_s.iter().map(|t| 7.0 * (TAU * 0.8 * t).sin()).collect();
        let mut x: Vec<f64> = (0..time_s.len())
            .map(|i| clean[i] + 0.01 * (TAU * 33.9 * time_s[i]).sin() + 0.003 * noisy(i))
            .collect();
        let found = remove_vibrations(&time_s, &mut x, 0.8);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].is_steady() && (found[0].amplitude - 0.01).abs() < 0.001,
            "{found:?}"
        );
        assert!((found[0].frequency_hz - 33.9).abs() < 0.05, "{found:?}");
        let force_n = amplitude_at(&time_s, &clean, 0.8, 33.9);
        assert!(force_n < 0.001, "{force_n}");
    }

    /// 47 samples a second of a ramp: 28 Hz look like 19 Hz, and 42 Hz like 5 Hz.
    #[test]
    fn a_line_beyond_half_the_sampling_rate_is_removed_from_a_ramp() {
        for (hz, seen_hz) in [(20.5, 20.5), (28.0, 19.0), (42.0, 5.0)] {
            let time_s = times(47.0, 64.0);
            let clean: Vec<f64> = time_s.iter().map(|t| 1.5 * triangle(t / 64.0)).collect();
            let mut x: Vec<f64> = (0..time_s.len())
                .map(|i| clean[i] + 0.016 * (TAU * hz * time_s[i] + 1.0).sin() + 0.003 * noisy(i))
                .collect();
            let motion_hz = motion_frequency_hz(&time_s, &x);
            let found = remove_all_vibrations(&time_s, &mut x, motion_hz, &|_| false);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!((found[0].frequency_hz - seen_hz).abs() < 0.01, "{found:?}");
            assert!((found[0].amplitude - 0.016).abs() < 0.001, "{found:?}");
        }
    }

    /// A motion of 2 Hz on top of a ramp. The force answers it, so it is no vibration.
    #[test]
    fn a_slow_line_that_is_motion_stays() {
        let time_s = times(200.0, 64.0);
        let clean: Vec<f64> = time_s
            .iter()
            .map(|t| 1.5 * triangle(t / 64.0) + 0.1 * (TAU * 2.0 * t).sin())
            .collect();
        let mut x = clean.clone();
        let motion_hz = motion_frequency_hz(&time_s, &x);
        assert_eq!(remove_all_vibrations(&time_s, &mut x, motion_hz, &|_| true), []);
        assert_eq!(x, clean);
    }

    #[test]
    fn a_line_whose_phase_wanders_is_found_and_left() {
        let time_s = times(1000.0, 20.0);
        let x: Vec<f64> = (0..time_s.len())
            .map(|i| {
                let t = time_s[i];
                5.0 * (TAU * t).sin()
                    + 0.05 * (TAU * 30.0 * t + 4.0 * (0.9 * t).sin()).sin()
                    + 0.003 * noisy(i)
            })
            .collect();
        let mut left = x.clone();
        let found = remove_vibrations(&time_s, &mut left, 1.0);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            !found[0].is_steady() && (found[0].amplitude - 0.05).abs() < 0.01,
            "{found:?}"
        );
        assert_eq!(left, x);
    }
}
