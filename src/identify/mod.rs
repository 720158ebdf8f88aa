//! Identification: finds a plant's parameters from recordings, curves or tables of tests, with intervals and warnings.
//!
//! [`fit`] takes any problem that has residuals ([`Residuals`]): recordings ([`curve`]), rows of peak force and loop energy
//! ([`targets`], [`leaf_pack_rows`]), points of one loop ([`loop_points`]) or a published characteristic ([`objective`]).
//! `diagnose` decides what a misfit means. A fit is seeded and gives the same bits for any number of threads.

pub(crate) mod confidence;
pub(crate) mod curve;
pub(crate) mod differential_evolution;
pub(crate) mod drive;
pub(crate) mod evaluator;
pub(crate) mod jacobian;
pub(crate) mod leaf_pack_rows;
pub(crate) mod least_squares;
pub(crate) mod loop_points;
pub(crate) mod nelder_mead;
pub(crate) mod objective;
pub(crate) mod path;
pub(crate) mod target_table;
pub(crate) mod targets;
#[cfg(test)]
mod testing;

pub(crate) use confidence::Warning;
pub(crate) use curve::CurveProblem;
pub(crate) use objective::Residuals;

use crate::model::{BuildError, Parameter};
use evaluator::Evaluator;

/// Why a fit cannot start.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum IdentifyError {
    /// The model refuses the start values or the structure.
    #[error("the fit cannot start")]
    Build(#[from] BuildError),
    /// Fewer residuals than free parameters.
    #[error(
        "{what} has {have} usable samples, {need} are needed: use a longer recording or fewer free parameters"
    )]
    TooFewSamples {
        /// The input that is too short.
        what: String,
        /// Number of usable samples.
        have: usize,
        /// Number of samples that the fit needs.
        need: usize,
    },
    /// A recording that cannot be compared with a model.
    #[error("recording {name}: {reason}")]
    Recording {
        /// Name of the recording.
        name: String,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// A parameter to be fixed is not one of the problem's.
    #[error("there is no parameter \"{name}\" to fit: use one of {known}")]
    UnknownParameter {
        /// The name as it was given.
        name: String,
        /// All names that the problem has.
        known: String,
    },
    /// The start has not one value per parameter, or the residuals there are not finite.
    #[error("the start values cannot be used: {reason}")]
    Start {
        /// What is wrong and what to do.
        reason: String,
    },
    /// A table of targets cannot be read.
    #[error("targets, row {row}, column \"{column}\": {reason}")]
    Targets {
        /// Row of the file; the header is row 1.
        row: usize,
        /// Name of the column; empty where the row as a whole cannot be read.
        column: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// What the caller answers after an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FitControl {
    /// Continue the search.
    Continue,
    /// End with the best values so far.
    Stop,
}

/// Progress of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FitProgress {
    /// Lowest cost so far.
    pub best_cost: f64,
    /// Share of the allowed work that is done, 0 to 1; a search may end well before.
    pub share: f64,
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FitEnding {
    /// The search met its tolerances.
    Converged,
    /// The search used up its iterations, generations or evaluations.
    Exhausted,
    /// The caller stopped the search.
    Stopped,
}

/// Result of a search.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Optimum {
    /// Best values, one per free parameter.
    pub values: Vec<f64>,
    /// Cost at `values`.
    pub cost: f64,
    /// How the search ended.
    pub ending: FitEnding,
}

/// Search method, with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Method {
    /// Bounded Levenberg-Marquardt: the default.
    LeastSquares(least_squares::LeastSquaresSettings),
    /// The simplex of Polach and Hajzman.
    NelderMead(nelder_mead::SimplexSettings),
    /// The differential evolution of Kadziela et al. (2015).
    DifferentialEvolution(differential_evolution::EvolutionSettings),
}

/// Settings of a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FitOptions {
    /// Search method to use.
    pub method: Method,
    /// Start, one value per parameter; the parameters' own start values where `None`.
    pub start: Option<Vec<f64>>,
    /// Names of parameters that stay at their start.
    pub fixed: Vec<String>,
    /// Seed of what the search draws at random.
    pub seed: u64,
    /// Cores to use; 0 for all. The result does not depend on it.
    pub threads: usize,
    /// Computes intervals (one more evaluation per free parameter); false where only the values matter.
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

/// Result of a fit. The lists have one entry per parameter of the problem, fixed ones included.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Fit {
    /// Parameters of the problem.
    pub parameters: Vec<Parameter>,
    /// Fitted values; the start values of fixed parameters.
    pub values: Vec<f64>,
    /// True where the parameter was fitted.
    pub free: Vec<bool>,
    /// 95 % intervals; `None` where fixed, at a bound or not identifiable.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// The problem's cost at `values`.
    pub cost: f64,
    /// Evaluations of the problem, those for the intervals included.
    pub evaluations: usize,
    /// How the search ended.
    pub ending: FitEnding,
    /// Reasons to doubt the result.
    pub warnings: Vec<Warning>,
}

impl Fit {
    /// True where the search met its tolerances.
    pub(crate) fn converged(&self) -> bool {
        self.ending == FitEnding::Converged
    }
}

/// A problem with some parameters fixed.
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

/// Fits the free parameters of `problem`. `watch` is called once per iteration, from the calling thread.
pub(crate) fn fit(
    problem: &dyn Residuals,
    options: &FitOptions,
    watch: &mut dyn FnMut(FitProgress) -> FitControl,
) -> Result<Fit, IdentifyError> {
    let restricted = restrict(problem, options)?;
    let start: Vec<f64> = restricted.free.iter().map(|&i| restricted.values[i]).collect();
    let bounds: Vec<[f64; 2]> = restricted.parameters.iter().map(|p| p.bounds).collect();
    let mut residuals = vec![0.0; problem.count()];
    problem.evaluate(&restricted.values, &mut residuals)?;
    if let Some(i) = residuals.iter().position(|r| !r.is_finite()) {
        return Err(IdentifyError::Start {
            reason: format!("residual {i} is not finite: check the recordings and the start values"),
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
    Ok(assemble(&restricted, optimum, &residuals, certainty, evaluations))
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
                "{} values were given for {} parameters: give one value per parameter",
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

/// Puts the results of the free parameters back among all parameters.
fn assemble(
    restricted: &Restricted<'_>,
    optimum: Optimum,
    residuals: &[f64],
    certainty: Option<confidence::Confidence>,
    evaluations: usize,
) -> Fit {
    let n = restricted.values.len();
    let mut fit = Fit {
        parameters: restricted.inner.parameters().to_vec(),
        values: restricted.all_values(&optimum.values),
        free: (0..n).map(|i| restricted.free.contains(&i)).collect(),
        ci95: vec![None; n],
        cost: restricted.inner.cost(residuals),
        evaluations,
        ending: optimum.ending,
        warnings: Vec::new(),
    };
    if let Some(certainty) = certainty {
        for (a, &i) in restricted.free.iter().enumerate() {
            fit.ci95[i] = certainty.ci95[a];
        }
        fit.warnings = certainty.warnings;
    }
    if optimum.ending == FitEnding::Exhausted {
        fit.warnings.push(Warning::NotConverged);
    }
    fit
}
