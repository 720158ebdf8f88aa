//! Spikes: one or two samples that stand far off both their neighbours, as from a loose contact or a misread converter. It uses no
//! recordings and no models: input and output are columns of numbers.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::smoothing::median;

/// Largest number of samples in a row that is a spike: a motion or a force lasts longer.
const LONGEST: usize = 2;
/// Least height of a spike: in noises of the channel, and in median steps of the samples around, because fast motion steps too.
/// White noise has a median step of 1 noise and reaches neither in 10 million samples.
const LEAST_NOISES: f64 = 8.0;
const LEAST_STEPS: f64 = 4.0;
/// Number of steps on either side whose median is the measure.
const AROUND: usize = 5;
/// Least distance of a spike from the parabola through the samples around it, beside the noises: this many times the distance of the sample that
/// fits it worst. Near a corner or a jump the samples fit no parabola, so neither is a spike. A fast motion that was sampled slowly had steps
/// of 80 N; a spike of 330 N in it was fitted as a compliance of the fixture. A copy of this rule in another language found three more spikes
/// in 1672 recordings that were looked at, all in recordings that have some. At half, it also takes the chatter of a damper and the tip of a
/// turn for spikes; at 2.5 times, it misses two of five.
const LEAST_MISFITS: f64 = 8.0;
/// Fewest samples on either side of a run for a parabola.
const LEAST_BESIDE: usize = 3;
/// A channel in which a larger share of the samples stands off has another noise, no spikes.
const MOST_SHARE: f64 = 0.02;

/// Spikes of one channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Spikes {
    /// Indices of the samples, rising.
    pub samples: Vec<usize>,
    /// Largest distance from the neighbours, in the unit of the channel.
    pub largest: f64,
}

/// Finds the spikes of a channel whose white noise is `noise`.
pub(super) fn spikes(time_s: &[f64], values: &[f64], noise: f64) -> Spikes {
    let mut found = Spikes::default();
    let mut i = 0;
    while i < values.len() {
        let mut earlier = (0..i).rev().filter(|j| found.samples.binary_search(j).is_err());
        let before = [earlier.next(), earlier.next()];
        let longest_first = (1..=LONGEST)
            .rev()
            .map(|length| i..(i + length).min(values.len()));
        let spike = longest_first
            .filter_map(|run| Some((height(time_s, values, before, &run)?, run)))
            .find(|(height, run)| {
                let least = LEAST_NOISES * noise;
                *height > least + LEAST_STEPS * step_around(values, run)
                    || *height > least && off_curve(time_s, values, &found.samples, run) > least
            });
        match spike {
            Some((height, run)) => {
                found.largest = found.largest.max(height);
                i = run.end;
                found.samples.extend(run);
            }
            None => i += 1,
        }
    }
    if found.samples.len() as f64 > MOST_SHARE * values.len() as f64 {
        return Spikes::default();
    }
    found
}

/// Least distance of a run's samples from two straight lines, if all lie on one side of both: between the samples around the run, and
/// through the two samples before it, because the next sample may be a spike itself. At the start the lines go through what follows.
fn height(time_s: &[f64], values: &[f64], before: [Option<usize>; 2], run: &Range<usize>) -> Option<f64> {
    let after = Some(run.end).filter(|i| *i < values.len());
    let next = Some(run.end + 1).filter(|i| *i < values.len());
    let both = |a: Option<usize>, b: Option<usize>| Some((a?, b?));
    let [last, earlier] = before;
    let lines = [
        both(last, after),
        both(earlier, last).or(both(last, next)).or(both(after, next)),
    ];
    let off = |(a, b): (usize, usize), i: usize| {
        let rate = (values[b] - values[a]) / (time_s[b] - time_s[a]);
        values[i] - values[a] - rate * (time_s[i] - time_s[a])
    };
    let all = lines
        .into_iter()
        .flatten()
        .flat_map(|line| run.clone().map(move |i| (line, i)));
    let offs: Vec<f64> = all.map(|(line, i)| off(line, i)).collect();
    let sign = offs.first()?.signum();
    let least = offs.iter().map(|off| sign * off).fold(f64::INFINITY, f64::min);
    (least > 0.0).then_some(least)
}

/// Median step between samples around a run, without those of the run.
fn step_around(values: &[f64], run: &Range<usize>) -> f64 {
    let from = run.start.saturating_sub(AROUND + 1);
    let to = (run.end + AROUND + 1).min(values.len());
    let step = |i: usize| (values[i + 1] - values[i]).abs();
    let before = (from..run.start.saturating_sub(1)).map(step);
    median(before.chain((run.end..to.saturating_sub(1)).map(step)).collect())
}

/// How far a run is from the parabola through the samples around it, beyond what these are, 0 where it is not. The spikes `found` are left
/// out, and the sample that is farthest off: it may be the next spike.
fn off_curve(time_s: &[f64], values: &[f64], found: &[usize], run: &Range<usize>) -> f64 {
    let is_good = |i: &usize| found.binary_search(i).is_err();
    let mut around: Vec<usize> = (0..run.start).rev().filter(is_good).take(AROUND).collect();
    let before = around.len();
    around.extend(run.end..(run.end + AROUND).min(values.len()));
    if before.min(around.len() - before) < LEAST_BESIDE {
        return 0.0;
    }
    let off =
        |parabola: &Vector3<f64>, i: usize| values[i] - parabola.dot(&powers(time_s[i] - time_s[run.start]));
    let worst = |parabola: &Vector3<f64>, around: &[usize]| {
        let off = around.iter().map(|&i| off(parabola, i).abs());
        off.enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or_default()
    };
    let through = |around: &[usize]| parabola(time_s, values, around, time_s[run.start]);
    let Some((farthest, _)) = through(&around).map(|first| worst(&first, &around)) else {
        return 0.0;
    };
    around.remove(farthest);
    let Some(parabola) = through(&around) else {
        return 0.0;
    };
    let offs: Vec<f64> = run.clone().map(|i| off(&parabola, i)).collect();
    let least = offs
        .iter()
        .map(|off| offs[0].signum() * off)
        .fold(f64::INFINITY, f64::min);
    least - LEAST_MISFITS * worst(&parabola, &around).1
}

/// Coefficients of the parabola through some samples, of the time since `from_s`; `None` if they are at fewer than three times.
fn parabola(time_s: &[f64], values: &[f64], samples: &[usize], from_s: f64) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for &i in samples {
        let row = powers(time_s[i] - from_s);
        normal += row * row.transpose();
        right += row * values[i];
    }
    normal.try_inverse().map(|inverse| inverse * right)
}

fn powers(t_s: f64) -> Vector3<f64> {
    Vector3::new(1.0, t_s, t_s * t_s)
}

#[cfg(test)]
mod tests {
    use super::super::smoothing::noise;
    use super::super::smoothing::tests::noisy;
    use super::*;

    /// A triangle between 0 and 10 mm with 20, 100 or 1000 samples a cycle, noise of 2 um.
    fn triangle(per_cycle: f64) -> (Vec<f64>, Vec<f64>) {
        let time_s: Vec<f64> = (0..2000).map(|i| f64::from(i) / per_cycle).collect();
        let at = |t: f64| 10.0 - (20.0 * (t + 0.013).fract() - 10.0).abs();
        let x = time_s
            .iter()
            .enumerate()
            .map(|(i, t)| at(*t) + 0.003 * noisy(i))
            .collect();
        (time_s, x)
    }

    #[test]
    fn spikes_are_found_and_corners_are_not() {
        for per_cycle in [20.0, 100.0, 1000.0] {
            let (time_s, mut x) = triangle(per_cycle);
            assert_eq!(
                spikes(&time_s, &x, noise(&time_s, &x)),
                Spikes::default(),
                "{per_cycle}"
            );
            let off = [0, 250, 251, 777, 779, 1999];
            for i in off {
                x[i] += 8.0;
            }
            let found = spikes(&time_s, &x, noise(&time_s, &x));
            assert_eq!(found.samples, off, "{per_cycle}");
            assert!((found.largest - 8.0).abs() < 2.5, "{}", found.largest);
        }
    }

    /// A fast motion that is sampled slowly: its steps are a quarter of the spike, as the force of a spring that is driven at 60 mm/s.
    #[test]
    fn a_spike_of_a_few_steps_is_found_where_the_motion_is_smooth() {
        let time_s: Vec<f64> = (0..600).map(|i| 0.02 * f64::from(i)).collect();
        let smooth = |t: f64| 1500.0 - 1400.0 * (2.8 * t).cos();
        let mut force_n: Vec<f64> = (0..600).map(|i| smooth(time_s[i]) + 2.0 * noisy(i)).collect();
        for (at, off_n) in [(26, 250.0), (30, -180.0), (437, 250.0)] {
            force_n[at] += off_n;
        }
        let found = spikes(&time_s, &force_n, noise(&time_s, &force_n));
        assert_eq!(found.samples, [26, 30, 437]);
    }

    /// Measured at the turn of a tribometer, N at 200 Hz, with the first and the last value held on either side.
    #[test]
    fn the_tip_of_a_turn_is_no_spike() {
        let turn = [
            -2.3847, -2.3851, -2.3862, -2.3866, -2.3869, -2.3876, -2.3887, -2.3866, -2.3842, -2.3816,
            -2.3788, -2.3760, -2.3733, -2.3706,
        ];
        let held = |value: f64| [value; 100];
        let force_n = [&held(turn[0])[..], &turn, &held(turn[13])].concat();
        let time_s: Vec<f64> = (0..force_n.len()).map(|i| 0.005 * i as f64).collect();
        assert_eq!(spikes(&time_s, &force_n, 2.5e-5), Spikes::default());
    }

    /// Dry friction that reverses at once: the force falls by ten steps between two samples.
    #[test]
    fn a_force_that_reverses_at_once_has_no_spikes() {
        let time_s: Vec<f64> = (0..1000).map(|i| 0.01 * f64::from(i)).collect();
        let force_n: Vec<f64> = (0..1000)
            .map(|i| {
                let along = (i as usize + 13) % 200;
                let (up, x) = (along < 100, along.min(200 - along) as f64);
                1000.0 + 20.0 * x + if up { 100.0 } else { -100.0 } + noisy(i as usize)
            })
            .collect();
        assert_eq!(
            spikes(&time_s, &force_n, noise(&time_s, &force_n)),
            Spikes::default()
        );
    }

    #[test]
    fn a_step_of_the_force_is_no_spike() {
        let time_s: Vec<f64> = (0..400).map(|i| 0.01 * f64::from(i)).collect();
        let force_n: Vec<f64> = (0..400)
            .map(|i| if i % 80 < 40 { 100.0 } else { -100.0 } + noisy(i))
            .collect();
        assert_eq!(
            spikes(&time_s, &force_n, noise(&time_s, &force_n)),
            Spikes::default()
        );
    }
}
