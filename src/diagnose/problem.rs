//! One structure (baseline and effects) against all tracks, as a problem that `identify` can solve.
//!
//! Residuals of samples that are held out are zero here; a zero of the force channel is fitted within its prior, because
//! a tare is never exact. Each recording has a small one of its own besides, which is linear and thus solved for on the way
//! (variable projection, Golub and Pereyra 1973): hum that the sampling folds to a constant, what moved since the last run.

use nalgebra::{DMatrix, DVector};

use super::baseline::{Attached, Setup, build, wrap};
use super::condition::{Split, Track};
use crate::identify::Residuals;
use crate::identify::jacobian::typical;
use crate::model::{BuildError, Parameter};

/// All tracks of a specimen, laid end to end.
pub(super) struct Data {
    pub tracks: Vec<Track>,
    pub force_n: Vec<f64>,
    pub weight: Vec<f64>,
    pub part: Vec<Split>,
    pub lengths: Vec<usize>,
    /// Standard deviation of the force channel's zero in N.
    pub zero_sigma_n: f64,
    /// Measured range of the force in N over all tracks.
    pub force_range_n: f64,
}

impl Data {
    pub(super) fn new(tracks: Vec<Track>) -> Data {
        let chain =
            |f: fn(&Track) -> &Vec<f64>| tracks.iter().flat_map(|t| f(t).clone()).collect::<Vec<f64>>();
        let force_n = chain(|t| &t.force_n);
        let force_range_n = super::condition::range(&force_n);
        Data {
            weight: chain(|t| &t.weight),
            part: tracks.iter().flat_map(|t| t.part.clone()).collect(),
            lengths: tracks.iter().map(Track::len).collect(),
            zero_sigma_n: 2e-3 * force_range_n,
            force_range_n,
            force_n,
            tracks,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.force_n.len()
    }

    /// Sum of squares of weighted residuals over one part.
    pub(super) fn sum(&self, residuals: &[f64], part: Split) -> f64 {
        residuals
            .iter()
            .zip(&self.part)
            .filter(|(_, p)| **p == part)
            .map(|(r, _)| r * r)
            .sum()
    }

    /// Takes mains hum out of the recordings where a fitted structure leaves it.
    pub(super) fn still_hum(&mut self, residuals: &mut [f64], model_n: &[f64]) {
        let mut from = 0;
        for (track, &length) in self.tracks.iter_mut().zip(&self.lengths) {
            let piece = from..from + length;
            let left_n: Vec<f64> = piece.clone().map(|i| self.force_n[i] - model_n[i]).collect();
            if let Some(hum) = super::hum::found(track, &self.weight[piece.clone()], &left_n) {
                for (i, at) in piece.enumerate() {
                    let hum_n = hum.mean_n(track.time_s[i], track.width_s[i]);
                    track.force_n[i] -= hum_n;
                    self.force_n[at] -= hum_n;
                    residuals[at] -= self.weight[at] * hum_n;
                }
                track.remarks.push(format!(
                    "mains hum of {:.2} N at {:.2} Hz on the force was taken out: look at shields and grounds",
                    hum.amplitude_n(),
                    hum.frequency_hz
                ));
            }
            from += length;
        }
    }

    /// Sets the weights by what a fitted structure shows: noise of the displacement times the slope that it has there
    /// (after a reversal it is far above the rate: errors in variables), then the white noise of the residuals, track by track.
    pub(super) fn rescale(&mut self, residuals: &mut [f64], model_n: &[f64]) {
        let mut from = 0;
        for (track, &length) in self.tracks.iter().zip(&self.lengths) {
            let piece = from..from + length;
            let rate =
                super::condition::range(&track.force_n) / super::condition::range(&track.displacement_mm);
            let plain = track.noise_n.hypot(rate * track.noise_mm);
            let slope = |i: usize| {
                let dx = (track.displacement_mm[i] - track.displacement_mm[i - 1]).abs();
                let df = (model_n[from + i] - model_n[from + i - 1]).abs();
                (df / dx.max(0.5 * track.noise_mm).max(1e-9)).min(100.0 * rate)
            };
            for i in 1..length {
                // Of an exponential after a reversal the geometric mean of both sides is the slope, however sparse the samples.
                let next = if i + 1 < length { slope(i + 1) } else { slope(i) };
                let here = (slope(i) * next).sqrt();
                // Friction counts from where the motion turned: what is not known of that is not known of the force.
                let turned_n = (here - rate).max(0.0) * track.turn_error_mm[i];
                let steep = track
                    .noise_n
                    .hypot(here * track.noise_mm)
                    .hypot(turned_n)
                    .max(plain);
                if plain > 0.0 && steep > plain {
                    self.weight[from + i] *= plain / steep;
                    residuals[from + i] *= plain / steep;
                }
            }
            let (times_s, counted): (Vec<f64>, Vec<f64>) = piece
                .clone()
                .filter(|&i| self.weight[i] > 0.0)
                .map(|i| (track.time_s[i - from], residuals[i]))
                .unzip();
            let white = super::condition::noise(&times_s, &counted);
            if counted.len() > 20 && white > 0.0 {
                let finest = 1.0 / (LINEARITY * self.force_range_n);
                for i in piece {
                    self.weight[i] = (self.weight[i] / white.clamp(0.05, 200.0)).min(finest);
                }
            }
            from += length;
        }
    }

    /// Samples that are fitted or compared.
    pub(super) fn counted(&self) -> usize {
        self.count(Split::Fit) + self.count(Split::Select)
    }

    /// Lowers the weights by what is not the recordings' doing, N at each point.
    pub(super) fn allow(&mut self, off_n: &[f64]) {
        for (weight, off_n) in self.weight.iter_mut().zip(off_n) {
            *weight /= (1.0f64).hypot(*weight * off_n);
        }
    }

    /// Samples of one part that count.
    pub(super) fn count(&self, part: Split) -> usize {
        self.weight
            .iter()
            .zip(&self.part)
            .filter(|(w, p)| **w > 0.0 && **p == part)
            .count()
    }
}

/// No load cell is straighter than this share of what was measured, however little it rustles: less is no finding.
const LINEARITY: f64 = 2e-4;
/// Step of a difference quotient as a share of the parameter's scale.
const RELATIVE_STEP: f64 = 1e-5;

/// Expected size of a recording's own zero in units of its noise: hum stays below the noise that is seen beside it.
const OWN_ZERO: f64 = 0.2;

/// Zero of the force channel: an instrument parameter of every structure.
const ZERO: Parameter = Parameter {
    name: "force_zero_n",
    unit: "N",
    start: 0.0,
    bounds: [-1e6, 1e6],
    belief: [-1e6, 1e6],
    what: "zero of the force channel that the tare left",
};

/// A structure against the data. Values: the model's, one group an attached effect, the zero.
pub(super) struct ModelStructure<'a> {
    pub setup: &'a Setup,
    pub data: &'a Data,
    pub attached: Vec<Attached>,
    parameters: Vec<Parameter>,
    /// The model itself, even where a surrogate stands for it.
    exact: bool,
}

impl<'a> ModelStructure<'a> {
    pub(super) fn new(setup: &'a Setup, data: &'a Data, attached: Vec<Attached>) -> Self {
        let mut parameters = setup.model.parameters.to_vec();
        for a in &attached {
            parameters.extend(a.parameters.iter().copied());
        }
        let mut zero = ZERO;
        zero.bounds = [-0.05 * data.force_range_n, 0.05 * data.force_range_n];
        zero.belief = [-5.0 * data.zero_sigma_n, 5.0 * data.zero_sigma_n];
        parameters.push(zero);
        ModelStructure {
            setup,
            data,
            attached,
            parameters,
            exact: false,
        }
    }

    /// The same on the model itself, even where a surrogate stands for it.
    pub(super) fn exact(mut self) -> Self {
        self.exact = true;
        self
    }

    /// Model force at every point of every track, in N; the zero included.
    pub(super) fn predict(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let (zero_n, values) = values.split_last().expect("every structure has a zero");
        let mut plant = match &self.setup.surrogate {
            Some(surrogate) if !self.exact => {
                let (own, groups) = values.split_at(self.setup.model.parameters.len());
                wrap(surrogate.plant(own), &self.attached, groups, *zero_n)
            }
            _ => build(self.setup, &self.attached, values, *zero_n)?,
        };
        let mut k = 0;
        for track in &self.data.tracks {
            plant.reset();
            for i in 0..track.len() {
                plant.told(&track.motion[i]);
                out[k] = plant.step(track.displacement_mm[i], track.dt_s(i));
                k += 1;
            }
        }
        Ok(())
    }

    /// Weighted residuals (measured less model) of every point, whatever its part.
    pub(super) fn residuals(&self, values: &[f64]) -> Option<Vec<f64>> {
        let mut out = vec![0.0; self.data.len()];
        self.compare(values, &mut out).ok()?;
        out.iter().all(|r| r.is_finite()).then_some(out)
    }

    /// Weighted residuals of every point; returns each recording's own zero, in units of what is expected of one.
    fn compare(&self, values: &[f64], out: &mut [f64]) -> Result<Vec<f64>, BuildError> {
        self.predict(values, out)?;
        let data = self.data;
        for ((o, f), w) in out.iter_mut().zip(&data.force_n).zip(&data.weight) {
            *o = (f - *o) * w;
        }
        let mut from = 0;
        let zeros = data.tracks.iter().zip(&data.lengths).map(|(track, &length)| {
            let piece = from..from + length;
            from += length;
            let sigma_n = OWN_ZERO * track.noise_n;
            let (mut along, mut power) = (0.0, 0.0);
            for i in piece.clone().filter(|&i| data.part[i] == Split::Fit) {
                along += data.weight[i] * out[i];
                power += data.weight[i] * data.weight[i];
            }
            let zero_n = along * sigma_n * sigma_n / (1.0 + power * sigma_n * sigma_n);
            for i in piece {
                out[i] -= data.weight[i] * zero_n;
            }
            if sigma_n > 0.0 { zero_n / sigma_n } else { 0.0 }
        });
        Ok(zeros.collect())
    }

    /// Bounds of every parameter.
    pub(super) fn parameters_bounds(&self) -> Vec<[f64; 2]> {
        self.parameters.iter().map(|p| p.bounds).collect()
    }

    /// The same structure with one effect more.
    pub(super) fn with(&self, candidate: &Attached) -> ModelStructure<'a> {
        let mut attached = self.attached.clone();
        attached.push(candidate.clone());
        ModelStructure::new(self.setup, self.data, attached)
    }

    /// Residuals as a fit sees them: held-out points zero, the priors' rows last. None where the model has no finite force.
    pub(super) fn fitted(&self, values: &[f64]) -> Option<DVector<f64>> {
        let mut out = DVector::zeros(self.count());
        self.evaluate(values, out.as_mut_slice()).ok()?;
        out.iter().all(|r| r.is_finite()).then_some(out)
    }

    /// Change of the fitted residuals for a move of each parameter by its scale, and the scales.
    pub(super) fn sensitivities(&self, values: &[f64], residuals: &DVector<f64>) -> (DMatrix<f64>, Vec<f64>) {
        let every: Vec<usize> = (0..values.len()).collect();
        let scale = self.scale(values);
        (self.columns(values, residuals, &every, &scale), scale)
    }

    /// Natural size of a move of each parameter.
    pub(super) fn scale(&self, values: &[f64]) -> Vec<f64> {
        values
            .iter()
            .zip(&self.parameters)
            .map(|(v, p)| typical(*v, p.belief, p.bounds))
            .collect()
    }

    /// Columns of the Jacobian, one a parameter in `which`, by forward differences within the bounds.
    pub(super) fn columns(
        &self,
        values: &[f64],
        residuals: &DVector<f64>,
        which: &[usize],
        scale: &[f64],
    ) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(residuals.len(), which.len());
        let mut moved = values.to_vec();
        for (column, &n) in which.iter().enumerate() {
            let step = RELATIVE_STEP * scale[n];
            let fits = values[n] + step <= self.parameters[n].bounds[1];
            moved[n] = values[n] + if fits { step } else { -step };
            if let Some(there) = self.fitted(&moved) {
                let factor = scale[n] / (moved[n] - values[n]);
                jacobian.set_column(column, &((there - residuals) * factor));
            }
            moved[n] = values[n];
        }
        jacobian
    }
}

impl Residuals for ModelStructure<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        self.data.len() + self.data.lengths.len() + 1
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let (samples, priors) = out.split_at_mut(self.data.len());
        let zeros = self.compare(values, samples)?;
        for (o, part) in samples.iter_mut().zip(&self.data.part) {
            if *part != Split::Fit {
                *o = 0.0;
            }
        }
        priors[..zeros.len()].copy_from_slice(&zeros);
        priors[zeros.len()] = -values[values.len() - 1] / self.data.zero_sigma_n;
        Ok(())
    }

    fn stretches(&self) -> Vec<usize> {
        let mut lengths = self.data.lengths.clone();
        lengths.extend(std::iter::repeat_n(1, self.data.lengths.len() + 1));
        lengths
    }
}
