//! One-step amplitudes: how much of every effect of the library some recordings hold, named or not.
//!
//! A diagnosis names an effect that one specimen shows. An effect that is too weak for that is found in many specimens, if each says
//! without a choice how much of it there is, and how sure that is. So there is no search here, and an amplitude may be negative.
//!
//! ```text
//! s = W (F(reference) - F(absent))       s' = s - J (J'J)^-1 J's       r = W (measured - F)
//! a = s'r / s's'       e = r - a s'      amplitude = a reference
//! variance of a = largest of  v tau / s's',  long-run variance of z,  sum over places of (sum z)^2 G / (G - 1)
//! ```
//! s is one simulation of the effect in its reference size, J the sensitivities of the baseline with a general friction law whose shape
//! is in doubt (`discrepancy`), z = s' e / s's' the influence of each point. v and tau are variance and correlation time of e, which
//! is what the effect does not explain. The first variance is of noise; the second (Newey and West 1987) sees noise that is
//! concentrated where the effect acts; the third (White 1980, in clusters) an error of the model that repeats at the same place of the
//! loop in every cycle. G is the number of places among which the signature is spread: the inverse of the sum of squared shares.
//!
//! Specimens of one drawing share the error of the model, so it does not average out over them. One run cannot tell this part from
//! noise, so the form error is a fixed share of the standard error ([`FORM_SHARE`]), measured over families without an effect.
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
use crate::identify::confidence::{confidence, correlation_time, long_run_variance, sigma_of_sum};
use crate::identify::evaluator::Evaluator;

/// Form error divided by standard error. In two synthetic labs without an effect (`docs/fleet.md`) the mean amplitude of a family was off by
/// 0.8 standard errors of one run (RMS over effects and families), and runs scattered about it by 0.4 to 1.
const FORM_SHARE: f64 = 0.9;
/// Preload plus zero of the force channel, N: the force without friction at displacement 0. One run tells the sum a hundred times better
/// than its parts, which only the growth of the friction with the load tells apart.
pub(crate) const FORCE_AT_ZERO: &str = "force_at_zero_n";
/// The two parameters whose sum [`FORCE_AT_ZERO`] is.
pub(crate) const PARTS_OF_FORCE_AT_ZERO: [&str; 2] = ["preload_n", "force_zero_n"];
/// Code of a delay between the channels.
const DELAY: &str = "channel_delay";
/// Step of the difference quotients as a share of a parameter's scale.
const RELATIVE_STEP: f64 = 1e-5;
/// Sum of squares of a signature, in variances of the noise, below which it is rounding.
const LEAST_POWER: f64 = 1e-12;
/// Largest sum of squared shares of the places that is taken for its correction: a signature in one place has no degree of freedom.
const MOST_CONCENTRATED: f64 = 0.75;
/// Places of the loop on each branch: residuals within one are taken to have the same error of the model.
const PLACES: usize = 12;

/// What some recordings of one specimen say about the baseline and about every effect of the library.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimates {
    /// Parameters of the baseline with its own friction law, then the zero of the force channel, then `force_at_zero_n` if there is a
    /// preload.
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
    /// The part of the standard error that runs of specimens of the same drawing share; in `unit`, not above `std_error`.
    pub form_error: Option<f64>,
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
    /// The part of the standard error that runs of specimens of the same drawing share, because the baseline is wrong in the same way
    /// in all of them. In the unit of the amplitude; not above `std_error`.
    pub form_error: Option<f64>,
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
    let delayed = with_delay(&context, &own, &setup.candidates);
    let baseline = parameters(&context, delayed.as_ref().map_or(&own, |(node, _)| node));
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
    let alone = OneStep::new(&context, &node, &tangent)?;
    let delayed = with_delay(&context, &node, &setup.candidates);
    let beside = delayed
        .as_ref()
        .and_then(|(node, tangent)| OneStep::new(&context, node, tangent));
    let effects = context.parallel_map(&setup.candidates, |candidate| {
        let is_delay = candidate.effect.code == DELAY;
        let step = beside.as_ref().filter(|_| !is_delay).unwrap_or(&alone);
        step.estimate(candidate)
    });
    Some(Estimates { baseline, effects })
}

/// The baseline with a free delay between the channels, converged. A delay is a fault of a bench that leaves traces in everything that
/// depends on speed, so all else is estimated beside it. `None` where the baseline has one already.
fn with_delay(context: &FitContext<'_>, base: &Node, candidates: &[Attached]) -> Option<(Node, Tangent)> {
    let delay = candidates
        .iter()
        .find(|candidate| candidate.effect.code == DELAY)?;
    let mut attached = base.attached.clone();
    attached.push(delay.clone());
    let values = insert_group(&base.values, &reference(delay, context));
    context.converge(attached, values)
}

/// The parameters of the baseline with their standard errors.
fn parameters(context: &FitContext<'_>, node: &Node) -> Vec<ParameterEstimate> {
    let structure = context.structure(node.attached.clone());
    let mut evaluator = Evaluator::new(&structure, context.threads());
    let mut residuals = vec![0.0; structure.count()];
    evaluator.residuals(&node.values, &mut residuals);
    let found = confidence(&mut evaluator, &node.values, &residuals, RELATIVE_STEP);
    let listed = structure.parameters().iter().zip(&node.values).zip(&found.sigma);
    let of_delay = |name: &str| {
        let mut delays = node
            .attached
            .iter()
            .filter(|attached| attached.effect.code == DELAY);
        delays.any(|delay| delay.parameters.iter().any(|parameter| parameter.name == name))
    };
    let baseline = listed.filter(|((parameter, _), _)| !of_delay(parameter.name));
    let estimate = |name: &str, unit: &str, value: f64, sigma: f64| ParameterEstimate {
        name: name.to_owned(),
        unit: unit.to_owned(),
        value,
        std_error: sigma.is_finite().then_some(sigma),
        form_error: sigma.is_finite().then_some(FORM_SHARE * sigma),
    };
    let mut estimates: Vec<ParameterEstimate> = baseline
        .map(|((parameter, &value), sigma)| estimate(parameter.name, parameter.unit, value, *sigma))
        .collect();
    let place = |name: &&str| structure.parameters().iter().position(|p| p.name == *name);
    let parts: Vec<usize> = PARTS_OF_FORCE_AT_ZERO.iter().filter_map(place).collect();
    if parts.len() == PARTS_OF_FORCE_AT_ZERO.len() {
        let sum = parts.iter().map(|i| node.values[*i]).sum();
        let sigma = sigma_of_sum(&mut evaluator, &node.values, &residuals, RELATIVE_STEP, &parts);
        estimates.push(estimate(FORCE_AT_ZERO, "N", sum, sigma));
    }
    estimates
}

/// A converged baseline from which one step is taken towards each effect.
struct OneStep<'c> {
    context: &'c FitContext<'c>,
    node: &'c Node,
    tangent: &'c Tangent,
    /// Weighted residuals with the rows of the priors.
    residuals: DVector<f64>,
    /// Number of points with a weight.
    counted: usize,
    /// Place of each point on the loop: recording, branch and displacement.
    places: Vec<usize>,
}

/// A step towards an effect, in multiples of its reference.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct StepSize {
    multiple: f64,
    /// Standard error; `None` where nothing of the effect is seen.
    error: Option<f64>,
    /// Share of the signature that survives.
    surviving: f64,
}

impl<'c> OneStep<'c> {
    fn new(context: &'c FitContext<'c>, node: &'c Node, tangent: &'c Tangent) -> Option<OneStep<'c>> {
        let data = context.data;
        Some(OneStep {
            context,
            node,
            tangent,
            counted: data.weight.iter().filter(|w| **w > 0.0).count().max(1),
            places: places(data),
            residuals: context.structure(node.attached.clone()).fitted(&node.values)?,
        })
    }

    fn estimate(&self, candidate: &Attached) -> EffectEstimate {
        let reference = reference(candidate, self.context);
        let (size, unit) = reference_size(candidate.effect, &reference);
        let step = self.step(candidate, &reference).unwrap_or_default();
        let std_error = step.error.map(|error| size.abs() * error);
        EffectEstimate {
            code: candidate.effect.code.to_owned(),
            parameter: candidate.parameters[leading(candidate.effect)].name.to_owned(),
            unit: unit.to_owned(),
            amplitude: size * step.multiple,
            std_error,
            form_error: std_error.map(|error| FORM_SHARE * error),
            testable: std_error.is_some() && step.surviving >= TESTABLE,
            surviving: step.surviving,
            reference: candidate
                .parameters
                .iter()
                .zip(&reference)
                .map(|(parameter, value)| (parameter.name.to_owned(), *value))
                .collect(),
        }
    }

    /// The step towards an effect; `None` where the model has no finite force with it.
    fn step(&self, candidate: &Attached, reference: &[f64]) -> Option<StepSize> {
        let structure = self.context.structure(self.node.attached.clone()).with(candidate);
        let moved = structure.fitted(&insert_group(&self.node.values, reference))?;
        let signature = &self.residuals - moved;
        let left = self.tangent.project(&signature);
        let (whole, power) = (signature.norm_squared(), left.norm_squared());
        if power <= LEAST_POWER {
            return Some(StepSize::default());
        }
        let multiple = self.residuals.dot(&left) / power;
        let unexplained = &self.residuals - &left * multiple;
        Some(StepSize {
            multiple,
            error: Some(self.error(&left, &unexplained)),
            surviving: (power / whole).sqrt(),
        })
    }

    /// Standard error of a multiple.
    fn error(&self, left: &DVector<f64>, unexplained: &DVector<f64>) -> f64 {
        let lengths = &self.context.data.lengths;
        // The rows of the priors follow those of the points.
        let points = self.places.len();
        let (left, power) = (&left.as_slice()[..points], left.norm_squared());
        let unexplained = &unexplained.as_slice()[..points];
        let influence: Vec<f64> = left.iter().zip(unexplained).map(|(s, e)| s * e / power).collect();
        let squares: f64 = unexplained.iter().map(|e| e * e).sum();
        let noise = (squares / self.counted as f64).max(1.0) * correlation_time(unexplained, lengths);
        let variance = (noise / power)
            .max(long_run_variance(&influence, lengths))
            .max(variance_of_places(&influence, left, &self.places));
        variance.sqrt()
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

/// Variance of the sum of influences that are independent between places but not within one; `left` is the signature.
fn variance_of_places(influence: &[f64], left: &[f64], places: &[usize]) -> f64 {
    let mut sums = vec![[0.0; 2]; places.iter().max().map_or(0, |last| last + 1)];
    for ((z, s), &place) in influence.iter().zip(left).zip(places) {
        sums[place][0] += z;
        sums[place][1] += s * s;
    }
    let power: f64 = sums.iter().map(|[_, power]| power).sum();
    let concentration: f64 = sums.iter().map(|[_, p]| (p / power) * (p / power)).sum();
    let squares: f64 = sums.iter().map(|[z, _]| z * z).sum();
    // G / (G - 1): the fitted multiple has taken a part of the error out of the places where the signature is.
    squares / (1.0 - concentration).max(1.0 - MOST_CONCENTRATED)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: sums 3 and -1 in places with 3/4 and 1/4 of the power, so G is 1.6.
    #[test]
    fn influences_of_one_place_are_added_before_they_are_squared() {
        let variance = variance_of_places(&[1.0, 2.0, -1.0], &[1.0, -1.0, 0.0], &[0, 0, 1]);
        // All of the signature is in one place: the correction is bounded.
        assert!((variance - 10.0 / (1.0 - MOST_CONCENTRATED)).abs() < 1e-12);
        let left = [1.5f64.sqrt(), 1.5f64.sqrt(), -1.0];
        let variance = variance_of_places(&[1.0, 2.0, -1.0], &left, &[0, 0, 1]);
        assert!((variance - 10.0 * 1.6 / 0.6).abs() < 1e-12);
    }
}
