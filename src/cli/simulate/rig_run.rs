//! A profile on the mock rig in virtual time, and its CSV as an export would write it.

use std::path::{Path, PathBuf};

use super::super::shared::local;
use super::super::shared::virtual_bench::record_run;
use super::super::{CliError, Done, Output};
use crate::config::Bench;
use crate::profile::Profile;
use crate::recording::datapackage;
use crate::recording::export::{self, Selection};
use crate::recording::run_file::RunFile;
use crate::recording::{Ending, Outcome, Sample};

/// What is to be run.
pub(super) struct RigRun {
    pub bench: Bench,
    pub profile: Profile,
    pub profile_toml: String,
    /// CSV to write; `None`: PROFILE.rig.csv here.
    pub out: Option<PathBuf>,
    /// Seed of the sensor noise; `None`: that of the bench.
    pub seed: Option<i64>,
    /// Replace what is there.
    pub force: bool,
}

/// The result as JSON.
#[derive(serde::Serialize)]
struct RigRunResult {
    csv: PathBuf,
    rows: usize,
    ending: Ending,
    cause: String,
    peak_force_n: f64,
    peak_displacement_mm: f64,
    cycles_completed: u32,
    virtual_s: f64,
}

/// Runs the profile and exports the run. The run file itself is not kept.
pub(super) fn play(mut order: RigRun, output: &Output) -> Result<Done, CliError> {
    let csv = order
        .out
        .unwrap_or_else(|| format!("{}.rig.csv", order.profile.name).into());
    local::require_new(&[csv.as_path(), &datapackage::path_of(&csv)], order.force)?;
    if let Some(seed) = order.seed {
        order.bench.mock_rig.insert("seed".to_owned(), seed.into());
    }
    let folder = ScratchFolder::beside(&csv)?;
    let run = record_run(
        &order.bench,
        &order.profile,
        order.profile_toml,
        &folder.0,
        output.json,
    )?;
    export::export(&run.file, Selection::Whole, &csv)?;
    let result = result(&run.file, csv, run.virtual_s)?;
    output.result(&result, || text(&result))?;
    Ok(Done::success_if(result.ending == Ending::Completed))
}

fn result(file: &RunFile, csv: PathBuf, virtual_s: f64) -> Result<RigRunResult, CliError> {
    let outcome: &Outcome = file
        .outcome()
        .ok_or_else(|| CliError::Internal("a run in virtual time has no outcome".to_owned()))?;
    let peak = |value: fn(&Sample) -> f64| {
        file.samples()
            .map(|s| value(&s))
            .fold(f64::NEG_INFINITY, f64::max)
    };
    Ok(RigRunResult {
        csv,
        rows: file.samples().count(),
        ending: outcome.ending,
        cause: outcome.cause.clone(),
        peak_force_n: peak(|s| s.force_n),
        peak_displacement_mm: peak(|s| s.displacement_mm),
        cycles_completed: outcome.cycles_completed,
        virtual_s,
    })
}

fn text(r: &RigRunResult) -> String {
    let ended = match r.ending {
        Ending::Completed => "completed".to_owned(),
        _ => format!("did not complete: {}", r.cause),
    };
    format!(
        "{}  ({} rows of the mock rig, {:.0} s of bench time): {ended}, peak {:.1} N, {:.3} mm",
        r.csv.display(),
        r.rows,
        r.virtual_s,
        r.peak_force_n,
        r.peak_displacement_mm
    )
}

/// A folder for the run file; removed at the end.
struct ScratchFolder(PathBuf);

impl ScratchFolder {
    fn beside(csv: &Path) -> Result<ScratchFolder, CliError> {
        let mut name = std::ffi::OsString::from(".");
        name.push(csv.file_name().unwrap_or_default());
        name.push(format!(".{}", std::process::id()));
        let folder = csv.with_file_name(name);
        std::fs::create_dir(&folder).map_err(CliError::file(csv, "writing"))?;
        Ok(ScratchFolder(folder))
    }
}

impl Drop for ScratchFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
