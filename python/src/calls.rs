//! The calls of the package. Each takes names, numbers and columns, and returns columns or JSON.

use std::path::PathBuf;
use std::sync::Arc;

use leafbench::{CallFailure, DiagnoseOptions, DiagnoseOrder, FailureKind, IdentifyOrder, Recording};
use pyo3::prelude::*;

use crate::columns::Columns;
use crate::errors;
use crate::work::{until_done, until_done_on};

/// Reads a run file or a CSV: the columns, the specimen, and what is not whole about the file.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf) -> PyResult<(Columns, Option<String>, Vec<String>)> {
    let read = until_done(py, |_| leafbench::read_recording(&path))?;
    Ok((Columns(Arc::new(read.recording)), read.specimen, read.notes))
}

/// The runs of an archive, as JSON.
#[pyfunction]
pub(crate) fn archived_runs(py: Python<'_>, place: String) -> PyResult<String> {
    until_done(py, |_| json(&leafbench::archived_runs(&place)?))
}

/// Runs of an archive: the columns and the specimen of each.
#[pyfunction]
pub(crate) fn read_archived(
    py: Python<'_>,
    place: String,
    run_ids: Vec<String>,
) -> PyResult<Vec<(Columns, Option<String>)>> {
    let read = until_done(py, |_| leafbench::read_archived(&place, &run_ids))?;
    let runs = read.into_iter();
    Ok(runs
        .map(|run| (Columns(Arc::new(run.recording)), run.specimen))
        .collect())
}

/// Ids of the runs that have no diagnosis with this model yet.
#[pyfunction]
pub(crate) fn undiagnosed_runs(py: Python<'_>, place: String, baseline: String) -> PyResult<Vec<String>> {
    until_done(py, |_| leafbench::undiagnosed_runs(&place, &baseline))
}

/// Diagnoses one run of an archive on this thread: the row for its table of diagnoses, as JSON.
#[pyfunction]
pub(crate) fn diagnose_archived(
    py: Python<'_>,
    place: String,
    run_id: String,
    baseline: String,
    estimates_only: bool,
) -> PyResult<String> {
    until_done(py, |_| {
        json(&leafbench::diagnose_archived(
            &place,
            &run_id,
            &baseline,
            estimates_only,
        )?)
    })
}

/// Puts diagnoses, each as JSON, into the archive; returns how many are new.
#[pyfunction]
pub(crate) fn store_diagnoses(py: Python<'_>, place: String, diagnosed: Vec<String>) -> PyResult<usize> {
    until_done(py, |_| leafbench::store_diagnoses(&place, &diagnosed))
}

/// Steps the bench's model along a profile, or with `rig` runs it on the mock rig.
#[pyfunction]
pub(crate) fn simulate(
    py: Python<'_>,
    profile: String,
    bench: Option<String>,
    configs: PathBuf,
    rig: bool,
    seed: Option<u32>,
) -> PyResult<(Columns, String)> {
    until_done(py, |job| {
        let bench = leafbench::find_bench(bench.as_deref(), &configs)?;
        let profile = leafbench::find_profile(&profile, &configs)?;
        let recording = match rig {
            true => leafbench::record_run(&bench, &profile, seed, &job.flag)?,
            false => leafbench::simulate(&bench, &profile, &job.flag)?,
        };
        Ok((Columns(Arc::new(recording)), bench.specimen_name().to_owned()))
    })
}

/// Predicts a profile and compares it with the limits: JSON as of `leafbench plan --json`.
#[pyfunction]
pub(crate) fn plan(
    py: Python<'_>,
    profile: String,
    bench: Option<String>,
    configs: PathBuf,
) -> PyResult<String> {
    until_done(py, |job| {
        let bench = leafbench::find_bench(bench.as_deref(), &configs)?;
        let profile = leafbench::find_profile(&profile, &configs)?;
        json(&leafbench::plan(&bench, &profile, &job.flag)?)
    })
}

/// Fits a model: JSON as of `leafbench identify --json`, and the text of a specimen file.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the arguments of the command")]
pub(crate) fn identify(
    py: Python<'_>,
    recordings: Vec<PyRef<'_, Columns>>,
    model: Option<String>,
    specimen: Option<PathBuf>,
    method: String,
    fix: Vec<(String, f64)>,
    free: Vec<String>,
    begin: String,
    seed: u64,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(String, String)> {
    let recordings = copies(&recordings);
    let order = IdentifyOrder {
        model,
        specimen,
        method,
        fix,
        free,
        begin,
        seed,
    };
    until_done_on(py, 0, progress, |job| {
        let show = &mut |share: f64| job.show(share, "fitting");
        let (found, specimen) = leafbench::identify(recordings, &order, &job.flag, show)?;
        Ok((json(&found)?, specimen))
    })
}

/// Diagnoses recordings: JSON as in `diagnosis.json`, and the text of `improved.toml` if there is one.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the arguments of the command")]
pub(crate) fn diagnose(
    py: Python<'_>,
    recordings: Vec<PyRef<'_, Columns>>,
    left_out: Vec<PyRef<'_, Columns>>,
    baseline: Option<String>,
    known: Option<Vec<String>>,
    bench: Option<String>,
    configs: PathBuf,
    threads: usize,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(String, Option<String>)> {
    let (recordings, left_out) = (copies(&recordings), copies(&left_out));
    until_done_on(py, threads, progress, |job| {
        let bench = leafbench::find_bench(bench.as_deref(), &configs)?;
        let order = DiagnoseOrder {
            bench: &bench,
            baseline: baseline.as_deref(),
            known: known.as_deref(),
        };
        let mut options = DiagnoseOptions::default();
        options.threads = threads;
        options.cancel = job.flag.clone();
        let show = &mut |share: f64, step: &str| job.show(share, step);
        let found = leafbench::diagnose_on_bench(&recordings, &left_out, order, options, show)?;
        Ok((json(&found.diagnosis)?, found.improved_toml))
    })
}

/// Refuses recordings of different specimens, each given by its name and specimen.
#[pyfunction]
pub(crate) fn require_one_specimen(
    py: Python<'_>,
    recordings: Vec<(String, Option<String>)>,
) -> PyResult<()> {
    let named = recordings
        .iter()
        .map(|(name, specimen)| (name.as_str(), specimen.as_deref()));
    leafbench::require_one_specimen(named).map_err(|failure| errors::exception(py, failure))
}

/// The bench as one complete file, with its specimen.
#[pyfunction]
pub(crate) fn bench_toml(py: Python<'_>, bench: Option<String>, configs: PathBuf) -> PyResult<String> {
    until_done(py, |_| {
        Ok(leafbench::find_bench(bench.as_deref(), &configs)?.to_toml())
    })
}

/// Name and description of each model.
#[pyfunction]
pub(crate) fn models() -> Vec<(&'static str, &'static str)> {
    leafbench::models().iter().map(|m| (m.name, m.what)).collect()
}

/// Codes of physics.
#[pyfunction]
pub(crate) fn physics() -> Vec<&'static str> {
    leafbench::codes_of_physics()
}

/// The library takes recordings in one piece; a copy is small beside the work that follows.
fn copies(recordings: &[PyRef<'_, Columns>]) -> Vec<Recording> {
    recordings
        .iter()
        .map(|columns| Recording::clone(&columns.0))
        .collect()
}

fn json(value: &impl serde::Serialize) -> Result<String, CallFailure> {
    serde_json::to_string(value).map_err(|error| CallFailure {
        kind: FailureKind::Defect,
        text: error.to_string(),
        file: None,
        row: None,
        column: None,
    })
}
