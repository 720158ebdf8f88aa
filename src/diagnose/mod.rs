//! Says which physics a model left out, and proves it on data that no parameter was fitted on.
//!
//! The steps, one file each: `condition` the recordings (`smoothing`, `turning`, `travel`), `baseline` with what it is said
//! to know, `problem` (structure against data), `surrogate` (for slow models), `hum` taken out, `score` every candidate from
//! one simulation, `select` by a search and `choose` on held-out cycles, `residual` (where), `bank` (what nothing explains, with
//! what `repeats`), `next_test` among the `trial`s that the bench can run, `verdict`.
//! Files, configs and pages are for others; `Diagnosis` has all they need.

pub(crate) mod aggregates;
mod bank;
mod baseline;
mod choose;
mod condition;
pub(crate) mod diagnosis;
mod fit;
mod hum;
mod next_test;
mod problem;
mod repeats;
mod residual;
mod score;
mod select;
mod smoothing;
mod surrogate;
mod tables;
mod traced;
mod travel;
mod trial;
mod turning;
mod verdict;

pub(crate) use baseline::{Baseline, BaselineError};
pub(crate) use condition::{ConditionError, Track, condition};
pub(crate) use diagnosis::{Diagnosis, Verdict};

use crate::effect::Span;
use crate::profile::ProfileLimits;
use crate::recording::Recording;

/// Why there is no diagnosis. Physics gives verdicts, not errors: these are about the input.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(crate) enum DiagnoseError {
    /// Nothing to judge.
    #[error("no recording was given: name at least one")]
    NoRecording,
    /// A recording cannot be judged.
    #[error(transparent)]
    Condition(#[from] ConditionError),
    /// The baseline cannot be used.
    #[error(transparent)]
    Baseline(#[from] BaselineError),
    /// The baseline has no finite force on these displacements.
    #[error("the baseline cannot follow the recordings: check the sign and the zero of the displacement")]
    OutOfDomain,
}

/// How to diagnose.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DiagnoseOptions {
    /// Points that a recording is thinned to.
    pub points: usize,
    /// Cores; 0 for all. The result does not depend on it.
    pub threads: usize,
    /// What the bench allows the next test; as fast as the recordings at most where `None`.
    pub limits: Option<ProfileLimits>,
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        DiagnoseOptions {
            points: 3000,
            threads: 0,
            limits: None,
        }
    }
}

/// Diagnoses recordings of one specimen. `progress` hears the share done, 0 to 1, and the step in words.
pub(crate) fn diagnose(
    recordings: &[Recording],
    baseline: &Baseline,
    options: &DiagnoseOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Diagnosis, DiagnoseError> {
    if recordings.is_empty() {
        return Err(DiagnoseError::NoRecording);
    }
    let mut setup = baseline::Setup::new(baseline)?;
    progress(0.0, "conditioning the recordings");
    let mut tracks = condition(recordings, options.points)?;
    condition::share_out(&mut tracks);
    let mut data = problem::Data::new(tracks);
    let means = Means {
        span: span(&data),
        threads: match options.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        },
        limits: options.limits,
    };
    progress(0.05, "refitting the baseline");
    let slow = setup.model.slow;
    if slow {
        surrogate::install(&mut setup, &data, &means).ok_or(DiagnoseError::OutOfDomain)?;
    }
    let mut first = means
        .bench(&setup, &data)
        .baseline()
        .ok_or(DiagnoseError::OutOfDomain)?;
    let mut model_n = vec![0.0; data.len()];
    problem::ModelStructure::new(&setup, &data, first.attached.clone())
        .predict(&first.values, &mut model_n)
        .map_err(BaselineError::from)?;
    data.still_hum(&mut first.residuals, &model_n);
    data.rescale(&mut first.residuals, &model_n);
    if slow {
        let coarse_n = surrogate::coarseness_n(&means.bench(&setup, &data), &first.values);
        data.allow(&coarse_n.ok_or(DiagnoseError::OutOfDomain)?);
    }
    let started = means.bench(&setup, &data);
    let nominal = started
        .structure(setup.extras.clone())
        .residuals(&started.start());
    let (mut plain, tangent) = started.settled(&first).ok_or(DiagnoseError::OutOfDomain)?;
    // The law of the baseline's friction is a choice of its author, no physics: it is freed before anything is missed.
    let freed = setup.form.clone().and_then(|form| started.freed(&plain, form));
    let mut heads = Vec::new();
    if let Some((freed, form)) = freed.as_ref().zip(setup.form.clone()) {
        heads = started.heads(&plain, &tangent, &form);
        setup.extras.clone_from(&freed.attached);
    }
    let base = freed.unwrap_or_else(|| plain.clone());
    progress(0.15, "comparing candidates");
    let mut search = select::search(&means.bench(&setup, &data), base.clone(), &heads, &mut |share| {
        progress(0.15 + 0.65 * share, "comparing candidates");
    });
    if slow {
        search = surrogate::confirm(&mut setup, &data, &means, (&mut plain, &base), search);
    }
    let bench = means.bench(&setup, &data);
    progress(0.8, "looking for look-alikes and the next test");
    let diagnosis = verdict::conclude(&bench, search, &plain, nominal);
    progress(1.0, "done");
    Ok(diagnosis)
}

/// What stays the same while the baseline is settled.
struct Means {
    span: Span,
    threads: usize,
    limits: Option<ProfileLimits>,
}

impl Means {
    fn bench<'a>(&self, setup: &'a baseline::Setup, data: &'a problem::Data) -> select::FitContext<'a> {
        select::FitContext {
            setup,
            data,
            span: self.span,
            threads: self.threads,
            limits: self.limits,
        }
    }
}

/// What the data cover.
fn span(data: &problem::Data) -> Span {
    let fold = |f: fn(&Track) -> &Vec<f64>| {
        let values = data.tracks.iter().flat_map(|t| f(t).iter().copied());
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| {
            [l.min(v), h.max(v)]
        })
    };
    let most = |f: &dyn Fn(&Track) -> f64, least: f64| data.tracks.iter().map(f).fold(least, f64::max);
    Span {
        displacement_mm: fold(|t| &t.displacement_mm),
        force_n: fold(|t| &t.force_n),
        speed_mm_s: most(&Track::top_speed_mm_s, 0.0),
        duration_s: most(&|t| t.time_s[t.len() - 1], 0.0),
        cycles: most(&|t| f64::from(t.cycles), 1.0),
    }
}
