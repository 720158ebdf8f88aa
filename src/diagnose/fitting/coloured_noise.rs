//! Noise that is slower than white noise: amplifier drift that wanders, 1/f noise, an AR(1) process. Differences of neighbouring
//! samples do not show it, so the weights would be too large, and the wandering would be taken for drift or run-in.
//!
//! It is estimated where the motion repeats: residuals at the same displacement and direction in another cycle half the recording
//! away. What the model lacks is the same in both and drops out. What changes smoothly or once with time, cycle, direction and
//! displacement may be physics, so a regression takes it out first. The rest is noise, whatever its spectrum.
//!
//! | file | what it does |
//! |---|---|
//! | `same_place` | when two points are at the same place of the same motion |
//! | `pairs` | the differences at such places, with and without a change of the specimen |

mod pairs;
mod same_place;

use pairs::Pairs;

use super::data::Data;
use crate::diagnose::conditioning::{Track, median};
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::identify::confidence::correlation_time;

/// Variance of the noise, in variances of the white noise, from which it is coloured, and correlation of neighbouring points. Both
/// follow from a noise that is not white; a white noise that was estimated too low has only the first.
const COLOURED: f64 = 1.5;
const CORRELATED: f64 = 0.25;
/// Noise is the same in all parts of the motion: the quietest of six has at least this share of the median. Physics that does not
/// repeat, such as stick-slip, is local.
const EVERYWHERE: f64 = 0.25;
/// Share of the variance above white noise, of all recordings together, that changes must leave for it to be noise and no change. In
/// cases that were looked at, losses of strength leave 0.005 to 0.09, run-in and drift up to 0.16, slow noise 0.17 to 0.74. Other values
/// were not tried.
const WANDERS: f64 = 0.12;
/// Standard errors of the variance that are added to it.
const UPPER_LIMIT: f64 = 2.0;
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

/// What a technician is told. Where the displacement vibrates, that is the likely cause.
fn note(track: &Track, slow_n: f64) -> Note {
    let white_n = track.noise_n;
    let (kind, found, check) = if track.vibration_mm > 0.0 {
        let found = format!(
            "the displacement vibrates, and the force differs by {slow_n:.2} N (RMS) from cycle to cycle, with {white_n:.2} N of white \
             noise"
        );
        (NoteKind::Hum, found, "where the vibration comes from")
    } else {
        let found = format!("the force has slow noise of {slow_n:.2} N beside {white_n:.2} N of white noise");
        let check = "the warm-up and the filters of the amplifier";
        (NoteKind::Colour, found, check)
    };
    let text = format!(
        "{found}: the larger noise is used, and effects that are smaller cannot be named; check {check}"
    );
    Note::new(&track.name, kind, (slow_n, "N"), NoteAction::Corrected, text)
}

/// True if the changes only fitted noise. Either they leave too much of all recordings together, or most recordings that are noisy with the
/// changes are noisy without them, too. All recordings are judged together, because they come from one channel.
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
        let noise = if all_is_noise {
            &self.pairs.difference
        } else {
            &self.rest
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
        let (low_mm, stroke_mm) = pairs::extent(track);
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
