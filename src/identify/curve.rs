//! Whole recordings as a problem: a plant is led along the recorded displacement and its force compared sample by sample.
//!
//! Every sample is stepped, because the plant has memory; masked and held-out ones are not compared. The state of the
//! hysteresis at a recording's first sample is unknown: [`Initial`] says what is done about it.

use super::IdentifyError;
use super::objective::{Factory, Residuals};
use super::path::{approach, range, reversals, smoothed};
use crate::model::{BuildError, Model, Parameter, Plant};
use crate::recording::{Flags, Recording};

/// How samples count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Weighting {
    /// Each recording's misfit over its range of force: every sample of every recording alike.
    Range,
    /// Over the noise: `1 / sqrt(force^2 + (rate * displacement)^2)`, rate from the recording's own ranges. Residuals of a
    /// perfect model have variance 1.
    Noise {
        /// Standard deviation of the load cell in N.
        force_n: f64,
        /// Standard deviation of the LVDT in mm.
        displacement_mm: f64,
    },
}

/// What is assumed of the plant's state at the first sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Initial {
    /// Virgin at zero displacement, brought straight to the first sample.
    FromRest,
    /// As `FromRest`, and nothing is compared before the second reversal.
    DropFirstHalfCycle,
    /// The first cycle is run through once before it counts.
    ReplayFirstCycle,
    /// `FromRest` for a recording whose first sample carries no load: what is not pressed remembers no friction. Else
    /// `DropFirstHalfCycle`.
    Unknown,
}

/// Share of the force's range below which a first sample carries no load.
const UNLOADED: f64 = 0.02;

/// What no parameter is fitted on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum HeldOut {
    /// Everything is fitted.
    None,
    /// These recordings, by index.
    Recordings(Vec<usize>),
    /// Every n-th cycle of each recording (n at least 2; the first one held out is cycle n).
    EveryNthCycle(usize),
}

/// How recordings become residuals.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CurveOptions {
    /// How samples count.
    pub weighting: Weighting,
    /// State at the first sample.
    pub initial: Initial,
    /// What is held out.
    pub held_out: HeldOut,
    /// A turning point is one that the displacement leaves by more than this share of its range.
    pub reversal_band: f64,
    /// Samples to either side over which the displacement is smoothed (zero phase, local parabola); 0 for none. Noise on a
    /// slow ramp turns back and forth, and friction with presliding would follow: its ratio comes out too small.
    pub smoothing: usize,
}

impl Default for CurveOptions {
    fn default() -> Self {
        CurveOptions {
            weighting: Weighting::Range,
            initial: Initial::ReplayFirstCycle,
            held_out: HeldOut::None,
            reversal_band: 0.02,
            smoothing: 0,
        }
    }
}

/// One recording, ready to be compared.
#[derive(Debug, Clone)]
struct PreparedCurve {
    name: String,
    displacement_mm: Vec<f64>,
    dt_s: Vec<f64>,
    force_n: Vec<f64>,
    /// Weight of every sample, before holding out; 0 = masked.
    weight: Vec<f64>,
    held_out: Vec<bool>,
    /// Displacements that lead from rest to the state before the first sample, and their step.
    approach_mm: Vec<f64>,
    approach_dt_s: f64,
}

/// Recordings of one specimen against a plant of `factory`.
pub(crate) struct CurveProblem<'a> {
    parameters: Vec<Parameter>,
    factory: Box<Factory<'a>>,
    curves: Vec<PreparedCurve>,
}

/// Misfit of a set of values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Score {
    /// Root mean square of measured minus model over the measured force's range, on what was fitted.
    pub nrmse_train: f64,
    /// The same on what was held out; `None` where nothing was.
    pub nrmse_heldout: Option<f64>,
    /// Largest share by which a recording's peak force is missed.
    pub peak_force_error: f64,
    /// Largest share by which a recording's enclosed energy is missed.
    pub loop_energy_error: f64,
}

impl<'a> CurveProblem<'a> {
    /// `factory` takes one value a parameter.
    pub(crate) fn new(
        parameters: Vec<Parameter>,
        factory: Box<Factory<'a>>,
        recordings: &[Recording],
        options: &CurveOptions,
    ) -> Result<Self, IdentifyError> {
        let curves = recordings
            .iter()
            .enumerate()
            .map(|(i, recording)| PreparedCurve::new(recording, i, options))
            .collect::<Result<Vec<_>, _>>()?;
        let problem = CurveProblem {
            parameters,
            factory,
            curves,
        };
        let (have, need) = (problem.count(), problem.parameters.len().max(1));
        if have < need {
            return Err(IdentifyError::TooFewSamples {
                what: "the recordings, masked and held-out samples left out,".to_owned(),
                have,
                need,
            });
        }
        Ok(problem)
    }

    /// A listed model as it stands, all its parameters.
    pub(crate) fn of_model(
        model: &'static Model,
        structure: &'a toml::Table,
        recordings: &[Recording],
        options: &CurveOptions,
    ) -> Result<Self, IdentifyError> {
        let factory = move |values: &[f64]| model.plant(values, structure);
        Self::new(model.parameters.to_vec(), Box::new(factory), recordings, options)
    }

    /// Replaces the weights of a recording's samples (one each, 0 masks). Errors where the lengths differ.
    pub(crate) fn set_weights(&mut self, recording: usize, weights: &[f64]) -> Result<(), IdentifyError> {
        let curve = self.curves.get_mut(recording);
        match curve {
            Some(curve) if curve.weight.len() == weights.len() && weights.iter().all(|w| w.is_finite()) => {
                curve.weight.copy_from_slice(weights);
                Ok(())
            }
            _ => Err(IdentifyError::TooFewSamples {
                what: format!("the table of weights of recording {recording}"),
                have: weights.len(),
                need: self.curves.get(recording).map_or(0, |curve| curve.weight.len()),
            }),
        }
    }

    /// Weight of every sample of a recording; 0 where masked or held out.
    pub(crate) fn weights(&self, recording: usize) -> Vec<f64> {
        self.curves.get(recording).map_or(Vec::new(), |curve| {
            (0..curve.weight.len()).map(|i| curve.fitted_weight(i)).collect()
        })
    }

    /// Model force in N at every sample of every recording.
    pub(crate) fn predict(&self, values: &[f64]) -> Result<Vec<Vec<f64>>, BuildError> {
        let mut plant = (self.factory)(values)?;
        let mut forces = Vec::with_capacity(self.curves.len());
        for curve in &self.curves {
            let mut force_n = Vec::with_capacity(curve.force_n.len());
            curve.run(plant.as_mut(), |_, force| force_n.push(force));
            forces.push(force_n);
        }
        Ok(forces)
    }

    /// Misfit of `values`, on what was fitted and on what was held out.
    pub(crate) fn score(&self, values: &[f64]) -> Result<Score, BuildError> {
        let (mut train, mut held_out) = (Mean::default(), Mean::default());
        let (mut peak_force_error, mut loop_energy_error) = (0.0f64, 0.0f64);
        for (curve, model_n) in self.curves.iter().zip(self.predict(values)?) {
            let range_n = range(&curve.force_n);
            for (i, model) in model_n.iter().enumerate().filter(|&(i, _)| curve.weight[i] > 0.0) {
                let misfit = (curve.force_n[i] - model) / range_n;
                let mean = if curve.held_out[i] {
                    &mut held_out
                } else {
                    &mut train
                };
                mean.add(misfit * misfit);
            }
            let compared = |i: &usize| curve.weight[*i] > 0.0;
            let peak = |force: &[f64]| {
                (0..force.len())
                    .filter(compared)
                    .fold(f64::MIN, |m, i| m.max(force[i]))
            };
            let (measured, model) = (peak(&curve.force_n), peak(&model_n));
            peak_force_error = peak_force_error.max((model / measured - 1.0).abs());
            let (measured, model) = (curve.energy_nmm(&curve.force_n), curve.energy_nmm(&model_n));
            if measured != 0.0 {
                loop_energy_error = loop_energy_error.max((model / measured - 1.0).abs());
            }
        }
        Ok(Score {
            nrmse_train: train.root(),
            nrmse_heldout: (held_out.count > 0).then(|| held_out.root()),
            peak_force_error,
            loop_energy_error,
        })
    }

    /// Names of the recordings, in order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.curves.iter().map(|curve| curve.name.as_str())
    }
}

impl Residuals for CurveProblem<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        self.stretches().iter().sum()
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let mut plant = (self.factory)(values)?;
        let mut places = out.iter_mut();
        for curve in self.curves.iter().filter(|curve| curve.fitted() > 0) {
            curve.run(plant.as_mut(), |i, force_n| {
                let weight = curve.fitted_weight(i);
                if weight > 0.0
                    && let Some(place) = places.next()
                {
                    *place = (curve.force_n[i] - force_n) * weight;
                }
            });
        }
        Ok(())
    }

    fn stretches(&self) -> Vec<usize> {
        self.curves.iter().map(PreparedCurve::fitted).collect()
    }
}

impl PreparedCurve {
    fn new(recording: &Recording, index: usize, options: &CurveOptions) -> Result<Self, IdentifyError> {
        let n = recording.len();
        let columns = n >= 2 && recording.displacement_mm.len() == n && recording.force_n.len() == n;
        let numbers = [&recording.time_s, &recording.displacement_mm, &recording.force_n];
        let finite = numbers.iter().all(|column| column.iter().all(|x| x.is_finite()));
        if !columns || !finite {
            return Err(IdentifyError::TooFewSamples {
                what: format!("{} (columns of equal length, finite numbers)", recording.name),
                have: if finite { n } else { 0 },
                need: 2,
            });
        }
        let mut dt_s: Vec<f64> = recording.time_s.windows(2).map(|t| t[1] - t[0]).collect();
        dt_s.insert(0, dt_s[0]);
        let displacement_mm = smoothed(&recording.displacement_mm, options.smoothing);
        let reversals = reversals(&displacement_mm, options.reversal_band * range(&displacement_mm));
        let mut curve = PreparedCurve {
            name: recording.name.clone(),
            weight: vec![sample_weight(recording, options.weighting); n],
            held_out: held_out(recording, index, &reversals, &options.held_out),
            approach_mm: approach(
                &displacement_mm,
                &reversals,
                options.initial == Initial::ReplayFirstCycle,
            ),
            approach_dt_s: dt_s.iter().sum::<f64>() / n as f64,
            displacement_mm,
            dt_s,
            force_n: recording.force_n.clone(),
        };
        curve.mask(recording, &reversals, options.initial);
        Ok(curve)
    }

    /// Takes weight from samples that the rig flagged, and from the first half cycle where it is to be dropped.
    fn mask(&mut self, recording: &Recording, reversals: &[usize], initial: Initial) {
        if let Some(flags) = &recording.flags {
            for (weight, &flag) in self.weight.iter_mut().zip(flags) {
                if Flags::from_bits_retain(flag).intersects(Flags::UNUSABLE) {
                    *weight = 0.0;
                }
            }
        }
        let loaded = || self.force_n[0].abs() > UNLOADED * range(&self.force_n);
        if initial == Initial::DropFirstHalfCycle || (initial == Initial::Unknown && loaded()) {
            // A single ramp has no second reversal: then its first one.
            let dropped = reversals.get(1).or(reversals.first()).copied().unwrap_or(0);
            self.weight[..dropped].fill(0.0);
        }
    }

    fn fitted_weight(&self, i: usize) -> f64 {
        if self.held_out[i] { 0.0 } else { self.weight[i] }
    }

    fn fitted(&self) -> usize {
        (0..self.weight.len())
            .filter(|&i| self.fitted_weight(i) > 0.0)
            .count()
    }

    /// Leads the plant from rest through all samples.
    fn run(&self, plant: &mut dyn Plant, mut take: impl FnMut(usize, f64)) {
        plant.reset();
        for &x in &self.approach_mm {
            plant.step(x, self.approach_dt_s);
        }
        for (i, (&x, &dt)) in self.displacement_mm.iter().zip(&self.dt_s).enumerate() {
            take(i, plant.step(x, dt));
        }
    }

    /// Area under force over displacement in N mm; that of the loops where the recording ends where it began.
    fn energy_nmm(&self, force_n: &[f64]) -> f64 {
        (1..force_n.len())
            .filter(|&i| self.weight[i] > 0.0)
            .map(|i| {
                0.5 * (force_n[i] + force_n[i - 1]) * (self.displacement_mm[i] - self.displacement_mm[i - 1])
            })
            .sum()
    }
}

fn sample_weight(recording: &Recording, weighting: Weighting) -> f64 {
    let range_n = range(&recording.force_n).max(f64::MIN_POSITIVE);
    match weighting {
        Weighting::Range => 1.0 / range_n,
        Weighting::Noise {
            force_n,
            displacement_mm,
        } => {
            let rate = range_n / range(&recording.displacement_mm).max(f64::MIN_POSITIVE);
            1.0 / force_n
                .hypot(rate * displacement_mm)
                .max(1e-12 * range_n.max(f64::MIN_POSITIVE))
        }
    }
}

fn held_out(recording: &Recording, index: usize, reversals: &[usize], rule: &HeldOut) -> Vec<bool> {
    let n = recording.len();
    match rule {
        HeldOut::None => vec![false; n],
        HeldOut::Recordings(chosen) => vec![chosen.contains(&index); n],
        HeldOut::EveryNthCycle(every) => {
            let every = (*every).max(2);
            let by_reversals = |i: usize| reversals.partition_point(|&r| r <= i) / 2 + 1;
            let cycle = |i: usize| match &recording.cycle {
                Some(cycles) => cycles.get(i).map_or(0, |&c| c as usize),
                None => by_reversals(i),
            };
            (0..n)
                .map(|i| cycle(i) > 0 && cycle(i).is_multiple_of(every))
                .collect()
        }
    }
}

/// Running mean of squares.
#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, square: f64) {
        self.sum += square;
        self.count += 1;
    }

    fn root(&self) -> f64 {
        (self.sum / self.count.max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests;
