//! `leafbench fleet estimate`: the table of estimates of many runs, one row for each quantity of each run.
//!
//! The table is written again after every few runs, whole, so an interrupted command loses little. A run that is in the table is
//! not estimated again; who it belongs to and its age are brought up to date.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::Args;
use rayon::prelude::*;

use crate::archive::{ArchivedRun, bench_name};
use crate::cli::archive::run_files;
use crate::cli::shared::local::model_names;
use crate::cli::shared::progress::Progress;
use crate::cli::{CliError, Done, Output};
use crate::fleet::diagnosed::{Depth, diagnose_run};
use crate::fleet::estimate::{EstimateRow, read_estimates, write_estimates};
use crate::fleet::members::{Members, PlacedRun, placed_runs};
use crate::model::{self, Model};
use crate::recording::atomic_file;
use crate::recording::run_file::{self, RunFile, RunListing};
use crate::recording::run_recording;
use crate::regular_file::{self, TABLE_MAX_BYTES};

/// Runs of each thread between two writings of the table.
const RUNS_BETWEEN_WRITINGS: usize = 4;

/// Write the table of estimates of many runs: the parameters of a model and how much there is of every effect, each with its
/// standard error
#[derive(Debug, Args)]
#[command(
    after_help = "The age of a specimen is the number of counted cycles in earlier runs of RUNS. Runs that are in the table already are\n\
                  not estimated again, so the same command can be given after new runs, or after it was interrupted."
)]
pub(super) struct EstimateArgs {
    /// Folder with run files (.leafrun)
    #[arg(value_name = "RUNS")]
    runs: PathBuf,
    /// Table with the columns specimen, family and batch
    #[arg(long, value_name = "CSV")]
    specimens: PathBuf,
    #[arg(
        long,
        value_name = "MODEL",
        default_value = "equivalent",
        help = format!("Model that is fitted to each run: {}", model_names())
    )]
    baseline: String,
    /// Table to write, or to go on with
    #[arg(long, value_name = "CSV", default_value = "estimates.csv")]
    out: PathBuf,
}

/// A run file with what its run belongs to.
#[derive(Debug, Clone)]
struct PlacedFile {
    path: PathBuf,
    run: PlacedRun,
}

#[derive(serde::Serialize)]
struct EstimatedRuns {
    table: PathBuf,
    rows: usize,
    estimated: usize,
    present: usize,
    /// Runs that cannot be used, with the reason.
    refused: Vec<String>,
}

impl EstimateArgs {
    pub(super) fn run(self, output: &Output) -> Result<Done, CliError> {
        let model = model::find(&self.baseline)?;
        let (runs, mut refused) = placed_files(&self.runs, &specimens(&self.specimens)?)?;
        let mut rows = self.present()?;
        let there: BTreeSet<String> = rows.iter().map(|row| row.run_id.clone()).collect();
        let (present, missing): (Vec<&PlacedFile>, Vec<&PlacedFile>) =
            runs.iter().partition(|file| there.contains(&file.run.run_id));
        let mut progress = Progress::new("fleet estimate", output.json);
        let mut done = 0;
        for some in missing.chunks(RUNS_BETWEEN_WRITINGS * rayon::current_num_threads()) {
            let estimated: Vec<_> = some.par_iter().map(|file| rows_of(file, model)).collect();
            for result in estimated {
                match result {
                    Ok(new) => rows.extend(new),
                    Err(reason) => refused.push(reason),
                }
            }
            write_table(&self.out, &mut rows, &runs)?;
            done += some.len();
            let step = format!("run {done} of {}", missing.len());
            progress.show_share(done as f64 / missing.len() as f64, &step);
        }
        progress.finish();
        if missing.is_empty() && !rows.is_empty() {
            write_table(&self.out, &mut rows, &runs)?;
        }
        let result = EstimatedRuns {
            rows: rows.len(),
            estimated: missing.len(),
            present: present.len(),
            table: self.out,
            refused,
        };
        output.result(&result, || text(&result))?;
        Ok(Done::success_if(result.refused.is_empty()))
    }

    /// The rows of the table that is there; none without a table.
    fn present(&self) -> Result<Vec<EstimateRow>, CliError> {
        if !self.out.exists() {
            return Ok(Vec::new());
        }
        let file = std::fs::File::open(&self.out).map_err(CliError::file(&self.out, "reading"))?;
        Ok(read_estimates(&self.out.display().to_string(), file)?)
    }
}

fn text(result: &EstimatedRuns) -> String {
    let first = format!(
        "{}: {} rows; {} runs estimated, {} were there already",
        result.table.display(),
        result.rows,
        result.estimated,
        result.present
    );
    let refused = result.refused.iter();
    std::iter::once(first)
        .chain(refused.map(|reason| format!("LEFT OUT: {reason}")))
        .collect::<Vec<_>>()
        .join("\n")
}

/// The table of specimens.
pub(super) fn specimens(path: &Path) -> Result<Members, CliError> {
    let text = regular_file::read_text(path, TABLE_MAX_BYTES).map_err(CliError::file(path, "reading"))?;
    Members::read(&path.display().to_string(), text.as_bytes())
        .map_err(|e| CliError::Input(crate::daemon::chain(&e)))
}

/// The runs of a folder, sorted by their start; and those that cannot be used, with the reason.
fn placed_files(folder: &Path, specimens: &Members) -> Result<(Vec<PlacedFile>, Vec<String>), CliError> {
    let mut listings: Vec<RunListing> = run_files(&[folder.to_owned()], folder)?
        .into_iter()
        .map(run_file::listing)
        .collect();
    if listings.is_empty() {
        return Err(CliError::Input(format!(
            "{} has no run files: name the folder with the .leafrun files",
            folder.display()
        )));
    }
    listings.sort_by(|a, b| (&a.started_utc, &a.run_id).cmp(&(&b.started_utc, &b.run_id)));
    let runs: Vec<ArchivedRun> = listings.iter().map(described).collect();
    let (mut files, mut refused) = (Vec::new(), Vec::new());
    for (listing, placed) in listings.into_iter().zip(placed_runs(&runs, Some(specimens))) {
        match whole(&listing).and(placed) {
            Ok(run) => files.push(PlacedFile {
                path: listing.path,
                run,
            }),
            Err(reason) => refused.push(format!("{}: {reason}", listing.path.display())),
        }
    }
    Ok((files, refused))
}

/// The run of a listing as an archive would have it.
fn described(listing: &RunListing) -> ArchivedRun {
    let bench = RunFile::open(&listing.path).map(|run| bench_name(&run.header().bench_toml));
    ArchivedRun {
        run_id: listing.run_id.clone(),
        specimen: listing.specimen.clone(),
        bench: bench.unwrap_or_default(),
        operator: listing.operator.clone(),
        started_utc: listing.started_utc.clone(),
        cycles_completed: i64::from(listing.cycles_completed),
    }
}

/// An error if the run is damaged or still goes on.
fn whole(listing: &RunListing) -> Result<(), String> {
    if !listing.problem.is_empty() {
        return Err(listing.problem.clone());
    }
    match listing.is_closed() {
        true => Ok(()),
        false => Err("the run has no end: give the command again after it".to_owned()),
    }
}

/// Estimates one run; an error names it.
fn rows_of(file: &PlacedFile, model: &'static Model) -> Result<Vec<EstimateRow>, String> {
    let run_id = &file.run.run_id;
    let read = RunFile::open(&file.path)
        .map_err(|error| format!("run {run_id}: {}", crate::daemon::chain(&error)))?;
    let diagnosed = diagnose_run(run_recording::read(run_id, &read), model, Depth::Estimates);
    let rows = file.run.rows(&diagnosed);
    rows.map_err(|reason| format!("run {run_id}: {reason}"))
}

/// Writes the table sorted by start, after it has taken over who the runs belong to.
fn write_table(path: &Path, rows: &mut [EstimateRow], files: &[PlacedFile]) -> Result<(), CliError> {
    let placed = files.iter().map(|file| (file.run.run_id.as_str(), &file.run));
    let placed: BTreeMap<&str, &PlacedRun> = placed.collect();
    for row in rows.iter_mut() {
        if let Some(run) = placed.get(row.run_id.as_str()) {
            row.specimen.clone_from(&run.member.specimen);
            row.family.clone_from(&run.member.family);
            row.batch.clone_from(&run.member.batch);
            row.age_cycles = run.age_cycles;
        }
    }
    rows.sort_by(|a, b| (a.started_utc, &a.run_id).cmp(&(b.started_utc, &b.run_id)));
    let failed = |e: std::io::Error| CliError::file(path, "writing")(e);
    atomic_file::write(path, |file| {
        write_estimates(file, rows).map_err(std::io::Error::from)
    })
    .map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::lab;
    use crate::truth::{Lab, LabRequest};

    const QUIET: Output = Output { json: true };

    fn args(folder: &Path) -> EstimateArgs {
        EstimateArgs {
            runs: folder.join("lab/runs"),
            specimens: folder.join("lab/specimens.csv"),
            baseline: "equivalent".to_owned(),
            out: folder.join("estimates.csv"),
        }
    }

    fn table(folder: &Path) -> Vec<EstimateRow> {
        let file = std::fs::File::open(folder.join("estimates.csv")).expect("written");
        read_estimates("estimates.csv", file).expect("a table")
    }

    #[test]
    fn a_table_goes_on_where_it_ended_and_ages_are_counted_from_the_runs() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let mut lab = Lab::draw(&LabRequest {
            seed: 4,
            specimens: 8,
            runs: 16,
            nothing: true,
        });
        // Each specimen has two runs.
        lab.runs.retain(|run| run.specimen == 0);
        lab::write(&lab, &folder.join("lab"), &QUIET).expect("written");
        let files = std::fs::read_dir(folder.join("lab/runs")).expect("listed");
        let mut files: Vec<PathBuf> = files.map(|e| e.expect("an entry").path()).collect();
        files.sort();
        let second = files[1].clone();
        let aside = folder.join("aside");
        std::fs::rename(&second, &aside).expect("moved");
        args(folder).run(&QUIET).expect("estimated");
        let first = table(folder);
        std::fs::rename(&aside, &second).expect("moved back");
        args(folder).run(&QUIET).expect("estimated");
        let both = table(folder);
        assert_eq!(both[..first.len()], first, "the rows of the first run are kept");
        let ages: Vec<f64> = both
            .iter()
            .filter(|r| r.quantity == "rate_n_per_mm")
            .map(|r| r.age_cycles)
            .collect();
        assert_eq!(ages, [0.0, f64::from(lab.runs[1].age_cycles)]);
        assert!(both.iter().all(|row| row.family == "F1" && row.batch == "F1-A"));
        // Without its specimen in the table no run can be used, and every run is named.
        std::fs::write(
            folder.join("lab/specimens.csv"),
            "specimen,family,batch\nother,F1,A\n",
        )
        .expect("written");
        assert_eq!(args(folder).run(&QUIET).expect("told"), Done::Negative);
    }
}
