//! Identification: parameters of a plant from recordings, curves or aggregates, with intervals and warnings.
//!
//! [`fit`] takes anything that has residuals ([`Residuals`]): whole recordings ([`curve`]), aggregates of rows ([`targets`]),
//! or a published characteristic ([`objective`]). What a misfit means is for `diagnose`. Seeded, and the same bits whatever
//! the number of threads.

pub(crate) mod confidence;
pub(crate) mod curve;
pub(crate) mod differential_evolution;
pub(crate) mod drive;
pub(crate) mod evaluator;
pub(crate) mod jacobian;
pub(crate) mod least_squares;
pub(crate) mod nelder_mead;
pub(crate) mod objective;
pub(crate) mod path;
pub(crate) mod profile_likelihood;
pub(crate) mod targets;
#[cfg(test)]
mod testing;

use nalgebra::DMatrix;

pub(crate) use confidence::Warning;
pub(crate) use curve::{CurveOptions, CurveProblem};
pub(crate) use objective::Residuals;

use crate::model::{BuildError, Parameter};
use evaluator::Evaluator;

/// Why a problem of identification cannot be put or solved.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum IdentifyError {
    /// The model refuses the start.
    #[error("the fit cannot start: {0}")]
    Build(#[from] BuildError),
    /// Nothing to compare with.
    #[error(
        "{what} has {have} usable samples, {need} are needed: use a longer recording or fewer free parameters"
    )]
    TooFewSamples {
        /// Of what.
        what: String,
        /// Usable samples.
        have: usize,
        /// How many it takes.
        need: usize,
    },
    /// A parameter to be fixed or started is not one of the problem's.
    #[error("there is no parameter \"{name}\" to fit: use one of {known}")]
    UnknownParameter {
        /// As given.
        name: String,
        /// What there is.
        known: String,
    },
    /// The start is not one value a parameter, or residuals there are not finite.
    #[error("the start does not work: {reason}")]
    Start {
        /// What is wrong and what to do.
        reason: String,
    },
    /// A table of targets could not be read.
    #[error("targets, row {row}, column \"{column}\": {reason}")]
    Targets {
        /// From 1, the header not counted; 0 for the header.
        row: usize,
        /// Column.
        column: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// What a watcher of a fit answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FitControl {
    /// Go on.
    Continue,
    /// End with the best so far.
    Stop,
}

/// Where a search stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FitProgress<'a> {
    /// The method, in words.
    pub stage: &'static str,
    /// Iteration or generation.
    pub iteration: usize,
    /// Evaluations of the problem so far.
    pub evaluations: usize,
    /// Least cost so far.
    pub best_cost: f64,
    /// Values at hand, free parameters only.
    pub best_values: &'a [f64],
    /// Share of the allowed work that is done, 0 to 1; a search may end well before.
    pub share: f64,
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FitEnding {
    /// Settled.
    Converged,
    /// Its iterations, generations or evaluations are used up.
    Exhausted,
    /// The watcher said so.
    Stopped,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Optimum {
    /// Best values.
    pub values: Vec<f64>,
    /// Their cost.
    pub cost: f64,
    /// Iterations or generations done.
    pub iterations: usize,
    /// How it ended.
    pub ending: FitEnding,
}

/// Which search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Method {
    /// Bounded Levenberg-Marquardt: the one to use.
    LeastSquares(least_squares::LeastSquaresSettings),
    /// The third paper's simplex.
    NelderMead(nelder_mead::SimplexSettings),
    /// The first paper's differential evolution.
    DifferentialEvolution(differential_evolution::EvolutionSettings),
}

/// How to fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FitOptions {
    /// Search.
    pub method: Method,
    /// Start, one value a parameter; the parameters' own where `None`.
    pub start: Option<Vec<f64>>,
    /// Names of parameters that stay at their start.
    pub fixed: Vec<String>,
    /// For whatever is drawn at random.
    pub seed: u64,
    /// Cores to use; 0 for all. The result does not depend on it.
    pub threads: usize,
    /// Intervals and what they need (one evaluation a free parameter); off where only the values matter.
    pub intervals: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        FitOptions {
            method: Method::LeastSquares(least_squares::LeastSquaresSettings::default()),
            start: None,
            fixed: Vec::new(),
            seed: 1,
            threads: 0,
            intervals: true,
        }
    }
}

/// A fit: one entry a parameter of the problem, fixed ones included.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Fit {
    /// Parameters, as the problem has them.
    pub parameters: Vec<Parameter>,
    /// Best values.
    pub values: Vec<f64>,
    /// True where the parameter was fitted.
    pub free: Vec<bool>,
    /// 95 % intervals; `None` where fixed, at a bound or not identifiable.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// Standard deviations; infinite where there is no interval.
    pub sigma: Vec<f64>,
    /// Correlations of the estimates.
    pub correlation: DMatrix<f64>,
    /// The problem's cost at `values`.
    pub cost: f64,
    /// Independent samples that the residuals are worth; their number where intervals are off.
    pub effective_samples: f64,
    /// Evaluations of the problem, those for the intervals included.
    pub evaluations: usize,
    /// Iterations or generations.
    pub iterations: usize,
    /// How the search ended.
    pub ending: FitEnding,
    /// What to know before believing it.
    pub warnings: Vec<Warning>,
}

impl Fit {
    /// True where the search settled.
    pub(crate) fn converged(&self) -> bool {
        self.ending == FitEnding::Converged
    }

    /// Value of a parameter by name.
    pub(crate) fn value(&self, name: &str) -> Option<f64> {
        let index = self.parameters.iter().position(|p| p.name == name)?;
        self.values.get(index).copied()
    }
}

/// The problem with some parameters held.
struct Restricted<'a> {
    inner: &'a dyn Residuals,
    parameters: Vec<Parameter>,
    values: Vec<f64>,
    free: Vec<usize>,
}

impl Restricted<'_> {
    fn all_values(&self, free_values: &[f64]) -> Vec<f64> {
        let mut values = self.values.clone();
        for (&i, &value) in self.free.iter().zip(free_values) {
            values[i] = value;
        }
        values
    }
}

impl Residuals for Restricted<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    fn count(&self) -> usize {
        self.inner.count()
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        self.inner.evaluate(&self.all_values(values), out)
    }
    fn cost(&self, residuals: &[f64]) -> f64 {
        self.inner.cost(residuals)
    }
    fn stretches(&self) -> Vec<usize> {
        self.inner.stretches()
    }
}

/// Fits the free parameters of `problem`. `watch` is called from this thread, once an iteration.
pub(crate) fn fit(
    problem: &dyn Residuals,
    options: &FitOptions,
    watch: &mut dyn FnMut(FitProgress<'_>) -> FitControl,
) -> Result<Fit, IdentifyError> {
    let restricted = restrict(problem, options)?;
    let start: Vec<f64> = restricted.free.iter().map(|&i| restricted.values[i]).collect();
    let bounds: Vec<[f64; 2]> = restricted.parameters.iter().map(|p| p.bounds).collect();
    let mut residuals = vec![0.0; problem.count()];
    problem.evaluate(&restricted.values, &mut residuals)?;
    if let Some(i) = residuals.iter().position(|r| !r.is_finite()) {
        return Err(IdentifyError::Start {
            reason: format!("residual {i} is not finite there: check the recordings and the start values"),
        });
    }

    let mut evaluator = Evaluator::new(&restricted, options.threads);
    let optimum = match &options.method {
        Method::LeastSquares(settings) => {
            least_squares::minimise(&mut evaluator, &start, &bounds, settings, options.seed, watch)
        }
        Method::NelderMead(settings) => {
            nelder_mead::minimise(&mut evaluator, &start, &bounds, settings, watch)
        }
        Method::DifferentialEvolution(settings) => {
            differential_evolution::minimise(&mut evaluator, &start, &bounds, settings, options.seed, watch)
        }
    };
    problem.evaluate(&restricted.all_values(&optimum.values), &mut residuals)?;
    let certainty = options.intervals.then(|| {
        let step = match &options.method {
            Method::LeastSquares(settings) => settings.relative_step,
            _ => least_squares::LeastSquaresSettings::default().relative_step,
        };
        confidence::confidence(&mut evaluator, &optimum.values, &residuals, step)
    });
    let evaluations = evaluator.evaluations() + 2;
    Ok(assemble(
        problem,
        &restricted,
        optimum,
        &residuals,
        certainty,
        evaluations,
    ))
}

/// Checks the options against the problem.
fn restrict<'a>(problem: &'a dyn Residuals, options: &FitOptions) -> Result<Restricted<'a>, IdentifyError> {
    let parameters = problem.parameters();
    let values = match &options.start {
        Some(start) => start.clone(),
        None => parameters.iter().map(|p| p.start).collect(),
    };
    if values.len() != parameters.len() {
        return Err(IdentifyError::Start {
            reason: format!(
                "{} values for {} parameters: give one each",
                values.len(),
                parameters.len()
            ),
        });
    }
    for name in &options.fixed {
        if !parameters.iter().any(|p| p.name == name) {
            let known: Vec<&str> = parameters.iter().map(|p| p.name).collect();
            return Err(IdentifyError::UnknownParameter {
                name: name.clone(),
                known: known.join(", "),
            });
        }
    }
    let free: Vec<usize> = (0..parameters.len())
        .filter(|&i| !options.fixed.iter().any(|name| name == parameters[i].name))
        .collect();
    if problem.count() < free.len().max(1) {
        return Err(IdentifyError::TooFewSamples {
            what: "the problem".to_owned(),
            have: problem.count(),
            need: free.len().max(1),
        });
    }
    Ok(Restricted {
        inner: problem,
        parameters: free.iter().map(|&i| parameters[i]).collect(),
        values,
        free,
    })
}

/// Puts the free parameters' results back among all.
fn assemble(
    problem: &dyn Residuals,
    restricted: &Restricted<'_>,
    optimum: Optimum,
    residuals: &[f64],
    certainty: Option<confidence::Confidence>,
    evaluations: usize,
) -> Fit {
    let n = restricted.values.len();
    let mut fit = Fit {
        parameters: problem.parameters().to_vec(),
        values: restricted.all_values(&optimum.values),
        free: (0..n).map(|i| restricted.free.contains(&i)).collect(),
        ci95: vec![None; n],
        sigma: vec![f64::INFINITY; n],
        correlation: DMatrix::identity(n, n),
        cost: problem.cost(residuals),
        effective_samples: residuals.len() as f64,
        evaluations,
        iterations: optimum.iterations,
        ending: optimum.ending,
        warnings: Vec::new(),
    };
    if let Some(certainty) = certainty {
        for (a, &i) in restricted.free.iter().enumerate() {
            fit.ci95[i] = certainty.ci95[a];
            fit.sigma[i] = certainty.sigma[a];
            for (b, &j) in restricted.free.iter().enumerate() {
                fit.correlation[(i, j)] = certainty.correlation[(a, b)];
            }
        }
        fit.effective_samples = certainty.effective_samples;
        fit.warnings = certainty.warnings;
    }
    if optimum.ending == FitEnding::Exhausted {
        fit.warnings.push(Warning::NotConverged);
    }
    fit
}
