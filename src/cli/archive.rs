//! `leafbench archive`: puts runs into the archive of the lab.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use clap::Args;

use super::shared::client::DataArg;
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::archive::{self, AddOptions, Added, ArchiveStore};
use crate::recording::run_file::EXTENSION;

/// Put runs into an archive: a Parquet data set of all runs of a lab, on a disk or an object store
#[derive(Debug, Args)]
#[command(
    after_help = "Runs that are in the archive already are skipped, so the same command can be given every night, or again after it \
                  was interrupted. Damaged runs and runs under way are named and left out. docs/archive.md describes the tables."
)]
pub(super) struct ArchiveArgs {
    /// Folder of the archive, or s3://BUCKET/PREFIX with the key in AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY
    #[arg(value_name = "TO")]
    to: String,
    /// Run files (.leafrun), or folders with run files [default: the data folder]
    #[arg(value_name = "RUNS")]
    runs: Vec<PathBuf>,
    /// Write although another command has the archive: only if you know that it has ended
    #[arg(long)]
    take_over: bool,
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for ArchiveArgs {
    const NAME: &'static str = "archive";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench archive lab-archive",
        "leafbench archive s3://lab/leafbench bench-1/runs bench-2/runs",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let files = run_files(&self.runs, &self.data.folder)?;
        let store = ArchiveStore::open(&self.to)?;
        let options = AddOptions {
            take_over: self.take_over,
        };
        let progress = Mutex::new(Progress::new("archive", output.json));
        let count = files.len();
        let added = archive::add(&store, &files, options, &|done| {
            if let Ok(mut progress) = progress.lock() {
                let share = done as f64 / count.max(1) as f64;
                progress.show_share(share, &format!("{done} of {count} runs"));
            }
        })?;
        drop(progress);
        output.result(&added, || text(&self.to, &added))?;
        Ok(Done::success_if(added.refused.is_empty()))
    }
}

/// The run files of a command: those that are named, those of named folders, or those of the data folder.
pub(in crate::cli) fn run_files(named: &[PathBuf], data: &Path) -> Result<Vec<PathBuf>, CliError> {
    let data = [data.to_owned()];
    let places = if named.is_empty() { &data[..] } else { named };
    let mut files = Vec::new();
    for place in places {
        match place.is_dir() {
            true => files.extend(files_of_folder_or_runs(place)?),
            false => files.push(place.clone()),
        }
    }
    Ok(files)
}

/// The run files of a folder, or of its folder `runs` where it has none itself: data of another lab may be laid out so.
fn files_of_folder_or_runs(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let (files, runs) = (files_of(folder)?, folder.join("runs"));
    match files.is_empty() && runs.is_dir() {
        true => files_of(&runs),
        false => Ok(files),
    }
}

/// The run files of a folder, sorted by name.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let entries = std::fs::read_dir(folder).map_err(CliError::file(folder, "listing"))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(CliError::file(folder, "listing"))?.path();
        if path.extension().is_some_and(|e| e == EXTENSION) {
            files.push(path);
        }
    }
    files.sort_unstable();
    Ok(files)
}

fn text(to: &str, added: &Added) -> String {
    let mut lines = vec![format!(
        "{to}: {} runs added ({} samples, {:.1} MB), {} were there already",
        added.added,
        added.samples,
        added.bytes as f64 / 1e6,
        added.present
    )];
    if added.leftovers_removed > 0 {
        lines.push(format!(
            "{} files of an interrupted command were removed; their runs are archived again",
            added.leftovers_removed
        ));
    }
    let open = added.open.iter();
    lines.extend(open.map(|run| {
        format!("NOT ARCHIVED: run {run} is still going, or its daemon was killed: archive it after its end")
    }));
    let refused = added.refused.iter();
    lines.extend(refused.map(|reason| format!("NOT ARCHIVED: {reason}")));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_run_files_stands_for_its_folder_runs() {
        let data = tempfile::tempdir().expect("a folder");
        let runs = data.path().join("runs");
        std::fs::create_dir(&runs).expect("made");
        let inner = runs.join("b.leafrun");
        std::fs::write(&inner, "").expect("written");
        let found = |folder: &Path| run_files(&[folder.to_owned()], Path::new("none")).expect("listed");
        assert_eq!(found(data.path()), std::slice::from_ref(&inner));
        assert_eq!(found(&runs), [inner]);
        let outer = data.path().join("a.leafrun");
        std::fs::write(&outer, "").expect("written");
        assert_eq!(found(data.path()), [outer]);
    }
}
