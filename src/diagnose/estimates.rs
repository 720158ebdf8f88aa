//! One-step amplitudes: how much of every effect of the library some recordings hold, named or not.
//!
//! A diagnosis names an effect that one specimen shows. An effect that is too weak for that is found in many specimens, if each says
//! without a choice how much of it there is, and how sure that is. So there is no search here, and an amplitude may be negative.
//!
//! ```text
//! s = W (F(reference) - F(absent))       s' = s - J (J'J)^-1 J's       r = W (measured - F)
//! amplitude = (s'r / s's') reference     variance = largest of  v tau / s's',  long-run variance of z,  sum over places of (sum z)^2
//! ```
//! s is one simulation of the effect in its reference size, J the sensitivities of the baseline with a general friction law whose shape
//! is in doubt (`discrepancy`), z = s' r / s's' the influence of each point. v and tau are variance and correlation time of the
//! residuals. The first variance is of noise; the second (Newey and West 1987) sees noise that is concentrated where the effect acts;
//! the third (White 1980, in clusters) an error of the model that repeats at the same place of the loop in every cycle.
//!
//! An amplitude is a Gauss-Newton step from zero: for an effect that is not linear in its size it is right near the reference.

use nalgebra::DVector;
use serde::Serialize;

use super::conditioning::range;
use super::fitting::{
    Attached, Data, Doubt, FitContext, Node, RunSettings, Setup, Tangent, generalise, insert_group,
};
use super::judgement::TESTABLE;
use super::search::in_doubt;
use crate::effect::Effect;
use crate::identify::Residuals;
use crate::identify::confidence::{confidence, correlation_time, long_run_variance};
use crate::identify::evaluator::Evaluator;

/// Step of the difference quotients as a share of a parameter's scale.
const RELATIVE_STEP: f64 = 1e-5;
/// Sum of squares of a signature, in variances of the noise, below which it is rounding.
const LEAST_POWER: f64 = 1e-12;
/// Places of the loop on each branch: residuals within one are taken to have the same error of the model.
const PLACES: usize = 12;

/// What some recordings of one specimen say about the baseline and about every effect of the library.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimates {
    /// Parameters of the baseline with its own friction law, then the zero of the force channel.
    pub baseline: Vec<ParameterEstimate>,
    /// Every effect that the baseline does not have, sorted by code.
    pub effects: Vec<EffectEstimate>,
}

/// A fitted parameter of the baseline.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Name with its unit at the end.
    pub name: String,
    /// Unit as text; empty for a pure number.
    pub unit: String,
    /// Fitted value, in `unit`.
    pub value: f64,
    /// Standard error in `unit`; `None` at a bound, or where the recordings do not determine the parameter.
    pub std_error: Option<f64>,
}

/// The one-step amplitude of an effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectEstimate {
    /// Code of physics (`docs/formats.md`).
    pub code: String,
    /// The parameter that the amplitude is a value of.
    pub parameter: String,
    /// Unit of amplitude and standard error. Empty for a pure number, and for `lift_off` and `sensor_saturation`: they are no
    /// multiple of a size, so their amplitude is a multiple of the reference.
    pub unit: String,
    /// The effect that was simulated: name and value of each parameter. A comparison of runs assumes the same reference.
    pub reference: Vec<(String, f64)>,
    /// Amplitude; 0 where the effect is absent. It may be negative, also where the effect itself cannot.
    pub amplitude: f64,
    /// Standard error of the amplitude; `None` where the recordings show nothing of the effect.
    pub std_error: Option<f64>,
    /// False where less than 5 % of the effect survives: the amplitude says little then.
    pub testable: bool,
    /// Share of the effect's change of the force that the baseline's parameters and the doubt cannot imitate, 0 to 1.
    pub surviving: f64,
}

/// Estimates from the fitted baseline; `None` if the model has no finite force. All cycles are used: nothing is selected on them.
pub(super) fn estimates(
    run: &RunSettings,
    setup: &mut Setup,
    data: &Data,
    fitted: &Node,
) -> Option<Estimates> {
    let data = data.all_fitted();
    let context = run.context(setup, &data);
    let (own, _) = context.converged(fitted)?;
    let baseline = parameters(&context, &own);
    let form = setup.form.as_ref();
    let general =
        form.and_then(|form| generalise(&context, &own, form, &(form.effect.starts)(&context.span)));
    let base = general.unwrap_or(own);
    // A slow model is fitted by its surrogate, whose friction law is that of the model.
    let doubted = (!setup.model.slow)
        .then(|| in_doubt(run, setup, &data, &base, Doubt::Friction))
        .flatten();
    let (data, base) = doubted.unwrap_or((data, base));
    let context = run.context(setup, &data);
    let (node, tangent) = context.converged(&base)?;
    let step = OneStep::new(&context, &node, &tangent)?;
    let effects = context.parallel_map(&setup.candidates, |candidate| step.estimate(candidate));
    Some(Estimates { baseline, effects })
}

/// The parameters of the baseline with their standard errors.
fn parameters(context: &FitContext<'_>, node: &Node) -> Vec<ParameterEstimate> {
    let structure = context.structure(node.attached.clone());
    let mut evaluator = Evaluator::new(&structure, context.threads());
    let mut residuals = vec![0.0; structure.count()];
    evaluator.residuals(&node.values, &mut residuals);
    let found = confidence(&mut evaluator, &node.values, &residuals, RELATIVE_STEP);
    let listed = structure.parameters().iter().zip(&node.values).zip(&found.sigma);
    listed
        .map(|((parameter, &value), sigma)| ParameterEstimate {
            name: parameter.name.to_owned(),
            unit: parameter.unit.to_owned(),
            value,
            std_error: sigma.is_finite().then_some(*sigma),
        })
        .collect()
}

/// A converged baseline from which one step is taken towards each effect.
struct OneStep<'c> {
    context: &'c FitContext<'c>,
    node: &'c Node,
    tangent: &'c Tangent,
    /// Weighted residuals with the rows of the priors.
    residuals: DVector<f64>,
    /// Variance of a residual times its correlation time, in variances of the white noise.
    noise: f64,
    /// Place of each point on the loop: recording, branch and displacement.
    places: Vec<usize>,
}

impl<'c> OneStep<'c> {
    fn new(context: &'c FitContext<'c>, node: &'c Node, tangent: &'c Tangent) -> Option<OneStep<'c>> {
        let data = context.data;
        let residuals = context.structure(node.attached.clone()).fitted(&node.values)?;
        let samples = &residuals.as_slice()[..data.len()];
        let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1);
        let variance = samples.iter().map(|r| r * r).sum::<f64>() / counted as f64;
        let noise = variance.max(1.0) * correlation_time(samples, &data.lengths);
        Some(OneStep {
            context,
            node,
            tangent,
            noise,
            places: places(data),
            residuals,
        })
    }

    fn estimate(&self, candidate: &Attached) -> EffectEstimate {
        let reference = reference(candidate, self.context);
        let (size, unit) = reference_size(candidate.effect, &reference);
        let (amplitude, std_error, surviving) =
            self.multiple(candidate, &reference).unwrap_or((0.0, None, 0.0));
        EffectEstimate {
            code: candidate.effect.code.to_owned(),
            parameter: candidate.parameters[leading(candidate.effect)].name.to_owned(),
            unit: unit.to_owned(),
            amplitude: size * amplitude,
            std_error: std_error.map(|sigma| size.abs() * sigma),
            testable: std_error.is_some() && surviving >= TESTABLE,
            surviving,
            reference: candidate
                .parameters
                .iter()
                .zip(&reference)
                .map(|(parameter, value)| (parameter.name.to_owned(), *value))
                .collect(),
        }
    }

    /// How many references the recordings hold, its standard error, and the share of the signature that survives; `None` where the
    /// model has no finite force with the effect.
    fn multiple(&self, candidate: &Attached, reference: &[f64]) -> Option<(f64, Option<f64>, f64)> {
        let structure = self.context.structure(self.node.attached.clone()).with(candidate);
        let moved = structure.fitted(&insert_group(&self.node.values, reference))?;
        let signature = &self.residuals - moved;
        let left = self.tangent.project(&signature);
        let (whole, power) = (signature.norm_squared(), left.norm_squared());
        if power <= LEAST_POWER {
            return Some((0.0, None, 0.0));
        }
        let influence: Vec<f64> = left
            .iter()
            .zip(&self.residuals)
            .take(self.places.len())
            .map(|(s, r)| s * r / power)
            .collect();
        let variance = (self.noise / power)
            .max(long_run_variance(&influence, &self.context.data.lengths))
            .max(variance_of_places(&influence, &self.places));
        let multiple = self.residuals.dot(&left) / power;
        Some((multiple, Some(variance.sqrt()), (power / whole).sqrt()))
    }
}

/// Values of the effect that is simulated: the middle one of the starts of a search, the same for the same span.
fn reference(candidate: &Attached, context: &FitContext<'_>) -> Vec<f64> {
    let starts = (candidate.effect.starts)(&context.span);
    let middle = &starts[(starts.len() - 1) / 2];
    let bounded = middle.iter().zip(&candidate.parameters);
    bounded.map(|(v, p)| v.clamp(p.bounds[0], p.bounds[1])).collect()
}

/// Index of the parameter that gives the size of an effect.
fn leading(effect: &Effect) -> usize {
    effect.amplitudes.first().copied().unwrap_or(0)
}

/// Size of the reference and its unit. A parameter that is no multiple of a size (a limit, a contact) counts as one reference.
fn reference_size(effect: &Effect, reference: &[f64]) -> (f64, &'static str) {
    let leading = leading(effect);
    if effect.neutral[leading] == 0.0 {
        (reference[leading], effect.parameters[leading].unit)
    } else {
        (1.0, "")
    }
}

/// Place of each point on its loop, numbered over all recordings.
fn places(data: &Data) -> Vec<usize> {
    let mut places = Vec::with_capacity(data.len());
    for (k, track) in data.tracks.iter().enumerate() {
        let lowest_mm = track
            .displacement_mm
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min);
        let width_mm = range(&track.displacement_mm).max(f64::MIN_POSITIVE) / PLACES as f64;
        for (x, direction) in track.displacement_mm.iter().zip(&track.direction) {
            let along = (((x - lowest_mm) / width_mm) as usize).min(PLACES - 1);
            let branch = usize::from(*direction > 0.0);
            places.push((2 * k + branch) * PLACES + along);
        }
    }
    places
}

/// Variance of the sum of influences that are independent between places but not within one.
fn variance_of_places(influence: &[f64], places: &[usize]) -> f64 {
    let mut sums = vec![0.0; places.iter().max().map_or(0, |last| last + 1)];
    for (z, &place) in influence.iter().zip(places) {
        sums[place] += z;
    }
    let passed = sums.iter().filter(|sum| **sum != 0.0).count() as f64;
    let squares: f64 = sums.iter().map(|sum| sum * sum).sum();
    squares * passed / (passed - 1.0).max(1.0)
}
