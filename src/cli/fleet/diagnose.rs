//! `leafbench fleet diagnose`: diagnoses the runs of an archive that have no diagnosis yet.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::Args;
use rayon::prelude::*;

use crate::archive::{ArchiveReader, ArchiveStore, DiagnosedRun, add_diagnoses};
use crate::cli::shared::local::model_names;
use crate::cli::shared::progress::Progress;
use crate::cli::{CliError, Done, Output};
use crate::fleet::diagnosed::{Depth, FAILED, diagnose_run};
use crate::model;

/// Runs of each thread between two commits: what an interruption loses.
const RUNS_OF_A_COMMIT: usize = 16;

/// Diagnose the runs of an archive that have no diagnosis yet, for `fleet report`
#[derive(Debug, Args)]
#[command(
    after_help = "The diagnoses are a table of the archive (docs/archive.md). An interrupted command goes on where it was. For many machines \
                  there is `python -m leafbench.fleet diagnose ARCHIVE --engine ray`, which finds the same."
)]
pub(super) struct FleetDiagnoseArgs {
    /// Folder of the archive, or s3://BUCKET/PREFIX
    #[arg(value_name = "ARCHIVE")]
    archive: String,
    #[arg(
        long,
        value_name = "MODEL",
        default_value = "equivalent",
        help = format!("Model that each diagnosis begins with: {}", model_names())
    )]
    baseline: String,
    /// Estimate parameters and sizes of effects, and do not search for missing effects in each run alone: some ten times as fast
    #[arg(long)]
    estimates_only: bool,
}

#[derive(serde::Serialize)]
struct DiagnosedArchive {
    archive: String,
    diagnosed: usize,
    present: usize,
    /// Runs that could not be diagnosed, with the reason. The table says so too.
    failed: Vec<String>,
}

impl FleetDiagnoseArgs {
    pub(super) fn run(self, output: &Output) -> Result<Done, CliError> {
        let model = model::find(&self.baseline)?;
        let store = ArchiveStore::open_existing(&self.archive)?;
        let reader = ArchiveReader::open(&store)?;
        let runs = reader.undiagnosed(model.name)?;
        let present = reader.runs()?.len() - runs.len();
        let depth = match self.estimates_only {
            true => Depth::Estimates,
            false => Depth::Diagnosis,
        };
        let progress = Mutex::new(Progress::new("fleet diagnose", output.json));
        let done = AtomicUsize::new(0);
        let mut failed = Vec::new();
        for some in runs.chunks(RUNS_OF_A_COMMIT * rayon::current_num_threads()) {
            let diagnosed: Result<Vec<DiagnosedRun>, CliError> = some
                .par_iter()
                .map(|run_id| {
                    let diagnosed = diagnose_run(reader.recording(run_id)?, model, depth);
                    let so_far = 1 + done.fetch_add(1, Ordering::Relaxed);
                    if let Ok(mut progress) = progress.lock() {
                        let step = format!("run {so_far} of {}", runs.len());
                        progress.show_share(so_far as f64 / runs.len() as f64, &step);
                    }
                    Ok(diagnosed)
                })
                .collect();
            let diagnosed = diagnosed?;
            add_diagnoses(&store, &diagnosed)?;
            let without = diagnosed.iter().filter(|run| run.verdict == FAILED);
            failed.extend(without.map(|run| format!("run {}: {}", run.run_id, run.message)));
        }
        drop(progress);
        let result = DiagnosedArchive {
            archive: self.archive,
            diagnosed: runs.len(),
            present,
            failed,
        };
        output.result(&result, || text(&result))?;
        Ok(Done::Success)
    }
}

fn text(result: &DiagnosedArchive) -> String {
    let first = format!(
        "{}: {} runs diagnosed, {} were already",
        result.archive, result.diagnosed, result.present
    );
    let failed = result
        .failed
        .iter()
        .map(|reason| format!("WITHOUT DIAGNOSIS: {reason}"));
    std::iter::once(first)
        .chain(failed)
        .collect::<Vec<_>>()
        .join("\n")
}
