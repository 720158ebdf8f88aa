//! One structure (the baseline and a set of effects) against all tracks, as a problem that `identify` can solve.
//!
//! Residuals of held-out points are zero here. The zero of the force channel is fitted within its prior, because a tare is never
//! exact. Each recording also has a small zero of its own: hum that the sampling folds to a constant, and what shifted since the
//! last run. It is linear, so it is solved for inside the residuals (variable projection, Golub and Pereyra 1973).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::baseline::{Attached, Setup, build, wrap};
use super::data::Data;
use super::discrepancy::Discrepancy;
use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::identify::Residuals;
use crate::identify::jacobian::typical;
use crate::model::{BuildError, Parameter, Plant};

/// Step of a difference quotient as a share of the parameter's scale.
const RELATIVE_STEP: f64 = 1e-5;
/// Where points are not fitted, the model is run over one point in this many: its friction depends on the path, not on the steps.
const PASSING_STEP: usize = 4;
/// Standard deviation of a recording's own zero, in units of its noise: folded hum is smaller than the noise.
const OWN_ZERO: f64 = 0.2;
/// Bounds of the force zero as a share of the range, and its plausible values and least bounds in standard deviations.
const ZERO_BOUND: f64 = 0.05;
const ZERO_BELIEF: f64 = 5.0;

/// Zero of the force channel: an instrument parameter of every structure.
const ZERO: Parameter = Parameter {
    name: "force_zero_n",
    unit: "N",
    start: 0.0,
    bounds: [-1e6, 1e6],
    belief: [-1e6, 1e6],
    what: "zero of the force channel that the tare left",
};

/// A structure against the data. Its values are the model's parameters, one group per attached effect, and the force zero.
pub(in crate::diagnose) struct ModelStructure<'a> {
    pub setup: &'a Setup,
    pub data: &'a Data,
    pub attached: Vec<Attached>,
    parameters: Vec<Parameter>,
    /// True to run the model itself, not its surrogate.
    exact: bool,
}

impl<'a> ModelStructure<'a> {
    pub(in crate::diagnose) fn new(setup: &'a Setup, data: &'a Data, attached: Vec<Attached>) -> Self {
        let mut parameters = setup.model.parameters.to_vec();
        for a in &attached {
            parameters.extend(a.parameters.iter().copied());
        }
        let mut zero = ZERO;
        let bound_n = (ZERO_BOUND * data.force_range_n).max(ZERO_BELIEF * data.zero_sigma_n);
        zero.bounds = [-bound_n, bound_n];
        zero.belief = [-ZERO_BELIEF * data.zero_sigma_n, ZERO_BELIEF * data.zero_sigma_n];
        parameters.push(zero);
        ModelStructure {
            setup,
            data,
            attached,
            parameters,
            exact: false,
        }
    }

    /// The same structure on the model itself, not its surrogate.
    pub(in crate::diagnose) fn exact(mut self) -> Self {
        self.exact = true;
        self
    }

    /// The same structure with the model's own friction held at none.
    pub(super) fn without_own_friction(mut self) -> Self {
        if let Some(i) = self.setup.model.friction_ratio {
            self.parameters[i].bounds = [self.parameters[i].bounds[0]; 2];
        }
        self
    }

    /// Model force with the force zero, in N, at every point of every track.
    pub(in crate::diagnose) fn predict(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let mut plant = self.plant(values)?;
        self.setup.count_steps(out.len());
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

    /// The same at the fitted points alone. Between them the plant moves in larger steps; a track without such points is left out.
    fn predict_fitted(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        if self.setup.surrogate.is_some() && !self.exact {
            return self.predict(values, out);
        }
        let mut plant = self.plant(values)?;
        let (mut from, mut steps) = (0, 0);
        for track in &self.data.tracks {
            let split = &self.data.split[from..from + track.len()];
            let out = &mut out[from..from + track.len()];
            from += track.len();
            let Some(last) = split.iter().rposition(|split| *split == Split::Fit) else {
                continue;
            };
            plant.reset();
            let mut before_s = track.time_s[0];
            for i in 0..=last {
                if split[i] == Split::Fit || i % PASSING_STEP == 0 || track.is_at_reversal(i) {
                    plant.told(&track.motion[i]);
                    out[i] = plant.step(track.displacement_mm[i], track.time_s[i] - before_s);
                    before_s = track.time_s[i];
                    steps += 1;
                }
            }
        }
        self.setup.count_steps(steps);
        Ok(())
    }

    /// The model with its effects, ready to be led along a track.
    fn plant(&self, values: &[f64]) -> Result<Box<dyn Plant>, BuildError> {
        let (zero_n, values) = values.split_last().expect("every structure has a zero");
        match &self.setup.surrogate {
            Some(surrogate) if !self.exact => {
                let (own, groups) = values.split_at(self.setup.model.parameters.len());
                Ok(wrap(surrogate.plant(own), &self.attached, groups, *zero_n))
            }
            _ => build(self.setup, &self.attached, values, *zero_n),
        }
    }

    /// Weighted residuals (measured minus model) of every point of every split.
    pub(in crate::diagnose) fn residuals(&self, values: &[f64]) -> Option<Vec<f64>> {
        self.compared(values).map(|(residuals, _)| residuals)
    }

    /// The same, with the size of each term of the discrepancy in its standard deviations.
    pub(in crate::diagnose) fn compared(&self, values: &[f64]) -> Option<(Vec<f64>, DVector<f64>)> {
        let mut out = vec![0.0; self.data.len()];
        self.predict(values, &mut out).ok()?;
        let linear = self.compare(&mut out, Discrepancy::remove);
        let sizes = DVector::from_column_slice(&linear[self.data.lengths.len()..]);
        out.iter().all(|r| r.is_finite()).then_some((out, sizes))
    }

    /// Makes weighted residuals of forces, without what `remove` takes away of the discrepancy; returns each recording's own zero,
    /// then each term of the discrepancy, in standard deviations.
    fn compare(
        &self,
        out: &mut [f64],
        remove: impl Fn(&Discrepancy, &[Split], &mut [f64]) -> DVector<f64>,
    ) -> Vec<f64> {
        let data = self.data;
        for ((o, f), w) in out.iter_mut().zip(&data.force_n).zip(&data.weight) {
            *o = (f - *o) * w;
        }
        let mut from = 0;
        let zero = |(track, &length): (&Track, &usize)| {
            let points = from..from + length;
            from += length;
            let sigma_n = OWN_ZERO * track.noise_n;
            let (mut along, mut power) = (0.0, 0.0);
            for i in points.clone().filter(|&i| data.split[i] == Split::Fit) {
                along += data.weight[i] * out[i];
                power += data.weight[i] * data.weight[i];
            }
            let zero_n = along * sigma_n * sigma_n / (1.0 + power * sigma_n * sigma_n);
            for i in points {
                out[i] -= data.weight[i] * zero_n;
            }
            if sigma_n > 0.0 { zero_n / sigma_n } else { 0.0 }
        };
        let mut linear: Vec<f64> = data.tracks.iter().zip(&data.lengths).map(zero).collect();
        if let Some(discrepancy) = &data.discrepancy {
            linear.extend(remove(discrepancy, &data.split, out).iter());
        }
        linear
    }

    /// Number of values that are solved for inside the residuals.
    fn linear_count(&self) -> usize {
        self.data.lengths.len() + self.data.discrepancy.as_ref().map_or(0, |d| d.count())
    }

    pub(super) fn parameters_bounds(&self) -> Vec<[f64; 2]> {
        self.parameters.iter().map(|p| p.bounds).collect()
    }

    /// This structure with one more effect.
    pub(in crate::diagnose) fn with(&self, candidate: &Attached) -> ModelStructure<'a> {
        let mut attached = self.attached.clone();
        attached.push(candidate.clone());
        ModelStructure::new(self.setup, self.data, attached)
    }

    /// Residuals for a fit: held-out points are zero, the priors are the last rows. `None` where the model has no finite force.
    pub(in crate::diagnose) fn fitted(&self, values: &[f64]) -> Option<DVector<f64>> {
        let mut out = DVector::zeros(self.count());
        self.evaluate(values, out.as_mut_slice()).ok()?;
        out.iter().all(|r| r.is_finite()).then_some(out)
    }

    /// Change of the fitted residuals when each parameter moves by its scale, and the scales.
    pub(in crate::diagnose) fn sensitivities(
        &self,
        values: &[f64],
        residuals: &DVector<f64>,
    ) -> (DMatrix<f64>, Vec<f64>) {
        let every: Vec<usize> = (0..values.len()).collect();
        let scale = self.scale(values);
        (self.columns(values, residuals, &every, &scale), scale)
    }

    /// Typical step of each parameter.
    pub(super) fn scale(&self, values: &[f64]) -> Vec<f64> {
        values
            .iter()
            .zip(&self.parameters)
            .map(|(v, p)| typical(*v, p.belief, p.bounds))
            .collect()
    }

    /// Columns of the Jacobian for the parameters in `which`, by one-sided differences within the bounds; zero for one that is held.
    pub(super) fn columns(
        &self,
        values: &[f64],
        residuals: &DVector<f64>,
        which: &[usize],
        scale: &[f64],
    ) -> DMatrix<f64> {
        let column = |&n: &usize| {
            if !self.parameters[n].is_free() {
                return None;
            }
            let step = RELATIVE_STEP * scale[n];
            let fits = values[n] + step <= self.parameters[n].bounds[1];
            let mut moved = values.to_vec();
            moved[n] = values[n] + if fits { step } else { -step };
            let there = self.fitted(&moved)?;
            Some((there - residuals) * (scale[n] / (moved[n] - values[n])))
        };
        // A fit that was started on the threads of the diagnosis uses them all; any other stays on its own thread.
        let columns: Vec<Option<DVector<f64>>> = match rayon::current_thread_index() {
            Some(_) => which.par_iter().map(column).collect(),
            None => which.iter().map(column).collect(),
        };
        let mut jacobian = DMatrix::zeros(residuals.len(), which.len());
        for (k, column) in columns.iter().enumerate() {
            if let Some(column) = column {
                jacobian.set_column(k, column);
            }
        }
        jacobian
    }
}

impl Residuals for ModelStructure<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        self.data.len() + self.linear_count() + 1
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let (samples, priors) = out.split_at_mut(self.data.len());
        self.predict_fitted(values, samples)?;
        let linear = self.compare(samples, Discrepancy::remove_from_fitted);
        for (o, split) in samples.iter_mut().zip(&self.data.split) {
            if *split != Split::Fit {
                *o = 0.0;
            }
        }
        priors[..linear.len()].copy_from_slice(&linear);
        priors[linear.len()] = -values[values.len() - 1] / self.data.zero_sigma_n;
        Ok(())
    }

    fn stretches(&self) -> Vec<usize> {
        let mut lengths = self.data.lengths.clone();
        lengths.extend(std::iter::repeat_n(1, self.linear_count() + 1));
        lengths
    }
}
