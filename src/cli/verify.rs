//! `leafbench verify`: checks an archive.

use std::path::PathBuf;
use std::sync::Mutex;

use clap::Args;

use super::archive::run_files;
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::archive::{self, ArchiveStore, Verified};

/// Check every byte of an archive, and whether it has every run; exit code 1 if something is wrong or missing
#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// Folder of the archive, or s3://BUCKET/PREFIX
    #[arg(value_name = "ARCHIVE")]
    archive: String,
    /// Run files or folders with run files that the archive should have
    #[arg(long, value_name = "RUNS", num_args = 1..)]
    runs: Vec<PathBuf>,
}

impl CliCommand for VerifyArgs {
    const NAME: &'static str = "verify";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench verify lab-archive",
        "leafbench verify lab-archive --runs leafbench-data",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let files = match self.runs.as_slice() {
            [] => Vec::new(),
            named => run_files(named, &PathBuf::new())?,
        };
        let store = ArchiveStore::open_existing(&self.archive)?;
        let progress = Mutex::new(Progress::new("verify", output.json));
        let verified = archive::verify(&store, &files, &|share| {
            if let Ok(mut progress) = progress.lock() {
                progress.show_share(share, "reading");
            }
        })?;
        drop(progress);
        output.result(&verified, || text(&self.archive, &verified))?;
        Ok(Done::success_if(verified.is_clean()))
    }
}

fn text(place: &str, verified: &Verified) -> String {
    let mut lines = vec![format!(
        "{place}: {} runs, {} samples, {} files, {:.1} MB{}",
        verified.runs,
        verified.samples,
        verified.objects,
        verified.bytes as f64 / 1e6,
        if verified.is_clean() {
            ": all as they were written"
        } else {
            ""
        }
    )];
    let problems = verified.problems.iter();
    lines
        .extend(problems.map(|problem| format!("DAMAGED: {problem}: restore it from a copy of the archive")));
    let leftovers = verified.leftovers.iter();
    lines.extend(
        leftovers.map(|path| format!("LEFT OVER: {path}: give the `leafbench archive` command again")),
    );
    let missing = verified.missing_runs.iter();
    lines
        .extend(missing.map(|run| format!("MISSING: run {run}: give the `leafbench archive` command again")));
    lines.join("\n")
}
