//! All tracks of a specimen, laid end to end, with weights that follow from the noise.

use std::sync::Arc;

use super::discrepancy::Discrepancy;
use crate::diagnose::conditioning::{Track, noise, range};
use crate::diagnose::course::Split;
use crate::diagnose::note::{Note, NoteAction, NoteKind};

/// Best linearity of a load cell as a share of the range. No point is weighted as if its force were known better.
pub(in crate::diagnose) const LINEARITY: f64 = 2e-4;
/// Standard deviation of the force zero that a tare leaves, as a share of the range.
const ZERO_SIGMA: f64 = 2e-3;
/// Largest slope of the force that counts for the noise, in mean rates: steeper ones come from two samples at one place.
pub(in crate::diagnose) const STEEPEST: f64 = 100.0;
/// The white noise of the residuals changes the weights of a track only if at least this many points show it.
const LEAST_POINTS: usize = 20;
/// Range in which the white noise changes the weights, in units of the noise that was estimated before.
const NOISE_RANGE: [f64; 2] = [0.05, 200.0];

/// Columns over the points of all tracks.
#[derive(Clone)]
pub(in crate::diagnose) struct Data {
    pub tracks: Vec<Track>,
    pub force_n: Vec<f64>,
    pub weight: Vec<f64>,
    pub split: Vec<Split>,
    pub lengths: Vec<usize>,
    /// Standard deviation of the force channel's zero in N.
    pub zero_sigma_n: f64,
    /// Measured range of the force in N over all tracks.
    pub force_range_n: f64,
    /// By what the friction law may deviate; `None` in the first search.
    pub discrepancy: Option<Arc<Discrepancy>>,
}

impl Data {
    pub(in crate::diagnose) fn new(tracks: Vec<Track>) -> Data {
        let chain =
            |f: fn(&Track) -> &Vec<f64>| tracks.iter().flat_map(|t| f(t).clone()).collect::<Vec<f64>>();
        let force_n = chain(|t| &t.force_n);
        let force_range_n = range(&force_n);
        Data {
            weight: chain(|t| &t.weight),
            split: tracks.iter().flat_map(|t| t.split.clone()).collect(),
            lengths: tracks.iter().map(Track::len).collect(),
            zero_sigma_n: ZERO_SIGMA * force_range_n,
            force_range_n,
            force_n,
            tracks,
            discrepancy: None,
        }
    }

    pub(in crate::diagnose) fn len(&self) -> usize {
        self.force_n.len()
    }

    /// Sum of squares of weighted residuals over one split.
    pub(in crate::diagnose) fn sum(&self, residuals: &[f64], split: Split) -> f64 {
        residuals
            .iter()
            .zip(&self.split)
            .filter(|(_, s)| **s == split)
            .map(|(r, _)| r * r)
            .sum()
    }

    /// Number of points of one split that have a weight.
    pub(in crate::diagnose) fn count(&self, split: Split) -> usize {
        self.weight
            .iter()
            .zip(&self.split)
            .filter(|(w, s)| **w > 0.0 && **s == split)
            .count()
    }

    /// The same with no cycle held out.
    pub(in crate::diagnose) fn all_fitted(&self) -> Data {
        let split = vec![Split::Fit; self.len()];
        Data {
            discrepancy: self.of_discrepancy(|d| d.with_split(&split)),
            split,
            ..self.clone()
        }
    }

    /// One recording alone.
    pub(super) fn one(&self, file: usize) -> Data {
        let from = self.lengths[..file].iter().sum::<usize>();
        let points = from..from + self.lengths[file];
        Data {
            tracks: vec![self.tracks[file].clone()],
            force_n: self.force_n[points.clone()].to_vec(),
            weight: self.weight[points.clone()].to_vec(),
            split: self.split[points.clone()].to_vec(),
            lengths: vec![self.lengths[file]],
            discrepancy: self.of_discrepancy(|d| d.on(points.clone(), &self.split[points.clone()])),
            ..*self
        }
    }

    fn of_discrepancy(&self, new: impl Fn(&Discrepancy) -> Option<Discrepancy>) -> Option<Arc<Discrepancy>> {
        self.discrepancy.as_deref().and_then(new).map(Arc::new)
    }

    /// Adds notes to the recordings that they are about.
    pub(super) fn add_notes(&mut self, notes: Vec<Note>) {
        for note in notes {
            if let Some(track) = self.tracks.iter_mut().find(|t| t.name == note.recording) {
                track.notes.push(note);
            }
        }
    }

    /// Number of points that are fitted or compared.
    pub(in crate::diagnose) fn counted(&self) -> usize {
        self.count(Split::Fit) + self.count(Split::Select)
    }

    /// Removes mains hum from the recordings whose residuals show it.
    pub(super) fn remove_hum(&mut self, residuals: &mut [f64], model_n: &[f64]) {
        let mut from = 0;
        for (track, &length) in self.tracks.iter_mut().zip(&self.lengths) {
            let points = from..from + length;
            let left_n: Vec<f64> = points.clone().map(|i| self.force_n[i] - model_n[i]).collect();
            if let Some(hum) = super::mains_hum::detect(track, &self.weight[points.clone()], &left_n) {
                for (i, at) in points.enumerate() {
                    let hum_n = hum.mean_n(track.time_s[i], track.width_s[i]);
                    track.force_n[i] -= hum_n;
                    self.force_n[at] -= hum_n;
                    residuals[at] -= self.weight[at] * hum_n;
                }
                let text = format!(
                    "mains hum of {:.2} N at {:.2} Hz was removed from the force: check shielding and grounding",
                    hum.amplitude_n(),
                    hum.frequency_hz
                );
                track.remarks.push(text.clone());
                let size = (hum.amplitude_n(), "N");
                track.notes.push(Note::new(
                    &track.name,
                    NoteKind::Hum,
                    size,
                    NoteAction::Corrected,
                    text,
                ));
            }
            from += length;
        }
    }

    /// Sets the weights by a fit of the baseline. First errors in variables: displacement noise counts by the local slope of the
    /// force, which after a reversal is far above the mean rate. Then the white noise of the residuals, track by track. Last, motion
    /// that the track does not have.
    pub(super) fn set_weights(&mut self, residuals: &mut [f64], model_n: &[f64]) {
        let mut from = 0;
        for (track, &length) in self.tracks.iter().zip(&self.lengths) {
            let points = from..from + length;
            let slopes = slopes(track, &model_n[points.clone()]);
            for (i, factor) in slope_factors(track, &slopes) {
                self.weight[from + i] *= factor;
                residuals[from + i] *= factor;
            }
            let (times_s, counted): (Vec<f64>, Vec<f64>) = points
                .clone()
                .filter(|&i| self.weight[i] > 0.0)
                .map(|i| (track.time_s[i - from], residuals[i]))
                .unzip();
            let white = noise(&times_s, &counted);
            if counted.len() > LEAST_POINTS && white > 0.0 {
                let finest = 1.0 / (LINEARITY * self.force_range_n);
                let [low, high] = NOISE_RANGE;
                for i in points.clone() {
                    self.weight[i] = (self.weight[i] / white.clamp(low, high)).min(finest);
                }
            }
            // What a track does not have of the motion is no noise: it does not average out. The specimen turned there.
            let steepest = slopes.into_iter().fold(0.0, f64::max);
            for (weight, hidden_mm) in self.weight[points].iter_mut().zip(&track.hidden_mm) {
                *weight /= (1.0f64).hypot(*weight * steepest * hidden_mm);
            }
            from += length;
        }
    }

    /// Lowers the weights by an error of the model itself, in N at each point.
    pub(super) fn add_model_error(&mut self, error_n: &[f64]) {
        for (weight, error_n) in self.weight.iter_mut().zip(error_n) {
            *weight /= (1.0f64).hypot(*weight * error_n);
        }
    }
}

/// Slope of the force at each point of a track from the second on, N/mm.
fn slopes(track: &Track, model_n: &[f64]) -> Vec<f64> {
    let rate = mean_rate(track);
    let slope = |i: usize| {
        let dx = (track.displacement_mm[i] - track.displacement_mm[i - 1]).abs();
        let df = (model_n[i] - model_n[i - 1]).abs();
        (df / dx.max(0.5 * track.noise_mm).max(1e-9)).min(STEEPEST * rate)
    };
    // The geometric mean of both sides is the exact slope of an exponential, however sparse the samples are.
    let next = |i: usize| slope(if i + 1 < track.len() { i + 1 } else { i });
    (1..track.len()).map(|i| (slope(i) * next(i)).sqrt()).collect()
}

/// Mean rate of a track, N/mm.
fn mean_rate(track: &Track) -> f64 {
    range(&track.force_n) / range(&track.displacement_mm)
}

/// Points of a track whose force is steeper than the mean rate, with the factor for their weight.
fn slope_factors(track: &Track, slopes: &[f64]) -> Vec<(usize, f64)> {
    let rate = mean_rate(track);
    let plain_n = track.noise_n.hypot(rate * track.noise_mm);
    let factor = |(i, &here): (usize, &f64)| {
        // Friction depends on the travel since the reversal: its error is an error of the force.
        let reversal_n = (here - rate).max(0.0) * track.turn_error_mm[i];
        let steep_n = track
            .noise_n
            .hypot(here * track.noise_mm)
            .hypot(reversal_n)
            .max(plain_n);
        (plain_n > 0.0 && steep_n > plain_n).then(|| (i, plain_n / steep_n))
    };
    (1..track.len()).zip(slopes).filter_map(factor).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::diagnose::conditioning::tracks;
    use crate::recording::Recording;

    /// Ten cycles between 1 and 11 mm, and residuals of unit noise plus `extra` of (displacement, direction).
    pub(in crate::diagnose) fn case(extra: impl Fn(f64, f64) -> f64) -> (Data, Vec<f64>) {
        sampled(0.005, 10.0, extra)
    }

    /// The same motion for `duration_s`, sampled every `dt_s`.
    pub(in crate::diagnose) fn sampled(
        dt_s: f64,
        duration_s: f64,
        extra: impl Fn(f64, f64) -> f64,
    ) -> (Data, Vec<f64>) {
        let count = (duration_s / dt_s) as i32;
        let time_s: Vec<f64> = (0..count).map(|i| dt_s * f64::from(i)).collect();
        let displacement_mm: Vec<f64> = time_s
            .iter()
            .map(|t| 6.0 - 5.0 * (std::f64::consts::TAU * t).cos())
            .collect();
        let recording = Recording {
            force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
            time_s,
            displacement_mm,
            ..Recording::default()
        };
        let mut data = Data::new(tracks(&[recording], 3000).expect("conditioned"));
        data.weight
            .iter_mut()
            .filter(|w| **w > 0.0)
            .for_each(|w| *w = 1.0);
        let track = &data.tracks[0];
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let residuals = (0..data.len())
            .map(|i| {
                let noise = 3f64.sqrt() * (2.0 * random.random::<f64>() - 1.0);
                let at = extra(track.displacement_mm[i], track.direction[i]);
                if data.weight[i] > 0.0 { noise + at } else { 0.0 }
            })
            .collect();
        (data, residuals)
    }
}
