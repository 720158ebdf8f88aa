//! Says which physics a model lacks, and checks the answer on cycles that no parameter was fitted to.
//!
//! The data walk once through five rooms, in this order. Each is a folder with a front door, `mod.rs`, that hands on only what
//! later rooms need. A part uses only parts in rows above its own: `tests/architecture.rs` compares this table with every import.
//!
//! | part | what it does |
//! |---|---|
//! | `note`, `course`, `options`, `error` | words that all parts share: what is imperfect about a recording, a recording as plants are driven over it, what may be set, why there is no diagnosis |
//! | `diagnosis` | the result: the [`Diagnosis`] and its parts |
//! | `conditioning` | recordings become tracks: checked, cleaned, smoothed, cut into points that are fitted, compared or reported on |
//! | `fitting` | the baseline is fitted to the tracks, and what the instruments added is taken out |
//! | `search` | which set of effects explains the data |
//! | `judgement` | verdict, findings with their rivals, locations, errors, the improved model |
//! | `estimates` | how much of every effect there is, named or not: for a pooling of many runs; after `fitting`, without a search |
//! | `next_test` | the test that separates a finding from its rivals, the axes of the unknown, or shows what could not be tested |
//! | `aggregates` | the same for tables of peak force and loop energy, without the rooms |
//!
//! Files, configs and pages are left to others.

pub(crate) mod aggregates;
#[cfg(test)]
mod any_input_tests;
mod conditioning;
pub(crate) mod course;
pub(crate) mod diagnosis;
mod error;
mod estimates;
#[cfg(test)]
mod fit_tests;
mod fitting;
mod judgement;
mod next_test;
pub(crate) mod note;
mod options;
mod search;

pub(crate) use course::Split;
pub use diagnosis::{Diagnosis, Finding, Verdict};
pub(crate) use error::{ConditionError, DiagnoseError, TurnedSign};
pub use estimates::{EffectEstimate, Estimates, ParameterEstimate};
pub(crate) use estimates::{FORCE_AT_ZERO, PARTS_OF_FORCE_AT_ZERO};
pub use fitting::Baseline;
pub(crate) use judgement::{YARDSTICKS, left_out, nrmse_leftout};
pub use options::DiagnoseOptions;

use crate::cancel;
use crate::recording::Recording;
use fitting::Setup;
use judgement::Known;

/// Diagnoses recordings of one specimen. `progress` gets the share done, 0 to 1, and the current step.
pub fn diagnose(
    recordings: &[Recording],
    baseline: &Baseline,
    options: &DiagnoseOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Diagnosis, DiagnoseError> {
    cancel::caught(|| whole_diagnosis(recordings, baseline, options, progress))
        .unwrap_or(Err(DiagnoseError::Cancelled))
}

fn whole_diagnosis(
    recordings: &[Recording],
    baseline: &Baseline,
    options: &DiagnoseOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Diagnosis, DiagnoseError> {
    if recordings.is_empty() {
        return Err(DiagnoseError::NoRecording);
    }
    let mut setup = Setup::new(baseline)?;
    setup.cancel = options.cancel.clone();
    progress(0.0, "conditioning the recordings");
    let tracks = conditioning::tracks(recordings, options.points_of_each(recordings.len()))?;
    let input = fitting::input(tracks, options)?;
    progress(0.05, "refitting the baseline");
    let (data, run, fitted) = fitting::fitted_input(&mut setup, input, recordings, options)?;
    let nominal = run.context(&setup, &data).nominal();
    let searches = search::searches(&run, &mut setup, &data, &fitted, progress);
    let searches = searches.ok_or(DiagnoseError::OutOfDomain)?;
    progress(0.8, "checking alternatives and planning the next test");
    let plain = run.context(&setup, &data);
    let courses = judgement::courses(&data);
    let known = Known {
        plain: &plain,
        refitted: &searches.start.refitted,
        base: &searches.first.nodes[0].clone(),
        nominal,
        yardsticks: judgement::yardstick_errors(&courses, plain.threads()),
        courses,
        of_path: None,
        path_given_away: searches.path.is_some(),
    };
    let (data, search) = judgement::search_to_judge(
        &run,
        &plain,
        [known.base, known.refitted],
        searches.first,
        searches.second,
    );
    let context = run.context(&setup, &data);
    let search = match &searches.path {
        Some(path) => {
            let beside = (&run.context(&path.setup, &path.data), &path.search);
            judgement::confirmed_beside_path(&context, search, beside)
        }
        None => search,
    };
    let judged = judgement::conclude(&context, search, known.clone());
    let of_path = searches.path.filter(|path| path.likelier).and_then(|path| {
        let context = run.context(&path.setup, &path.data);
        let judged = judgement::conclude_of_path(&context, path.search, known, &judged.diagnosis)?;
        Some(next_test::planned(&context, judged))
    });
    let diagnosis = of_path.unwrap_or_else(|| next_test::planned(&context, judged));
    progress(1.0, "done");
    Ok(diagnosis)
}

/// Estimates the baseline's parameters and the one-step amplitude of every effect from recordings of one specimen, without a search.
///
/// To pool many runs: every amplitude has its standard error, also where a diagnosis would name nothing. It takes about as long as the
/// fit of the baseline. An error says which recording cannot be used and what to do.
pub fn estimate(
    recordings: &[Recording],
    baseline: &Baseline,
    options: &DiagnoseOptions,
) -> Result<Estimates, DiagnoseError> {
    if recordings.is_empty() {
        return Err(DiagnoseError::NoRecording);
    }
    let mut setup = Setup::new(baseline)?;
    let tracks = conditioning::tracks(recordings, options.points_of_each(recordings.len()))?;
    let input = fitting::input(tracks, options)?;
    let (data, run, fitted) = fitting::fitted_input(&mut setup, input, recordings, options)?;
    estimates::estimates(&run, &mut setup, &data, &fitted).ok_or(DiagnoseError::OutOfDomain)
}
