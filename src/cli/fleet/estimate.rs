//! `leafbench fleet estimate`: the table of estimates of many runs, one row for each quantity of each run.
//!
//! The table is written again after every few runs, whole, so an interrupted command loses little. A run that is in the table is
//! not estimated again; who it belongs to and its age are brought up to date.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::Args;
use jiff::Timestamp;
use rayon::prelude::*;

use crate::cli::shared::local::model_names;
use crate::cli::shared::progress::Progress;
use crate::cli::{CliError, Done, Output};
use crate::diagnose::{Baseline, DiagnoseOptions, Estimates, estimate};
use crate::fleet::diagnosed::scale;
use crate::fleet::estimate::{EstimateRow, EstimateScale, read_estimates, write_estimates};
use crate::fleet::members::{Member, Members};
use crate::model::{self, Model};
use crate::recording::atomic_file;
use crate::recording::run_file::{self, EXTENSION, RunFile, RunListing};
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

/// Who a run belongs to.
#[derive(Debug, Clone)]
struct RunPlace {
    path: PathBuf,
    run_id: String,
    specimen: Member,
    bench: String,
    operator: String,
    started_utc: Timestamp,
    age_cycles: u32,
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
        let (runs, mut refused) = run_places(&self.runs, &specimens(&self.specimens)?)?;
        let mut rows = self.present()?;
        let there: BTreeSet<String> = rows.iter().map(|row| row.run_id.clone()).collect();
        let (present, missing): (Vec<&RunPlace>, Vec<&RunPlace>) =
            runs.iter().partition(|run| there.contains(&run.run_id));
        let mut progress = Progress::new("fleet estimate", output.json);
        let mut done = 0;
        for some in missing.chunks(RUNS_BETWEEN_WRITINGS * rayon::current_num_threads()) {
            let estimated: Vec<_> = some.par_iter().map(|run| rows_of_run(run, model)).collect();
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

/// The runs of a folder, sorted by their start, with their ages; and those that cannot be used, with the reason.
fn run_places(folder: &Path, specimens: &Members) -> Result<(Vec<RunPlace>, Vec<String>), CliError> {
    let mut listings = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(CliError::file(folder, "listing"))? {
        let path = entry.map_err(CliError::file(folder, "listing"))?.path();
        if path.extension().is_some_and(|e| e == EXTENSION) {
            listings.push(run_file::listing(path));
        }
    }
    if listings.is_empty() {
        return Err(CliError::Input(format!(
            "{} has no run files: name the folder with the .leafrun files",
            folder.display()
        )));
    }
    listings.sort_by(|a, b| (&a.started_utc, &a.run_id).cmp(&(&b.started_utc, &b.run_id)));
    let mut seen: BTreeMap<String, u32> = BTreeMap::new();
    let (mut runs, mut refused) = (Vec::new(), Vec::new());
    for listing in listings {
        let seen = seen.entry(listing.specimen.clone()).or_default();
        let age_cycles = *seen;
        // A run that cannot be estimated has aged its specimen all the same.
        *seen += listing.cycles_completed;
        match run_place(&listing, age_cycles, specimens) {
            Ok(run) => runs.push(run),
            Err(reason) => refused.push(format!("{}: {reason}", listing.path.display())),
        }
    }
    Ok((runs, refused))
}

fn run_place(listing: &RunListing, age_cycles: u32, specimens: &Members) -> Result<RunPlace, String> {
    if !listing.problem.is_empty() {
        return Err(listing.problem.clone());
    }
    if !listing.is_closed() {
        return Err("the run has no end: give the command again after it".to_owned());
    }
    let specimen = specimens.of(&listing.specimen).ok_or_else(|| {
        format!(
            "specimen \"{}\" is not in the table of specimens: add a row",
            listing.specimen
        )
    })?;
    let header = RunFile::open(&listing.path).map_err(|e| crate::daemon::chain(&e))?;
    let header = header.header();
    let bench: toml::Table = header.bench_toml.parse().unwrap_or_default();
    let bench = bench.get("name").and_then(|name| name.as_str());
    let started_utc = listing.started_utc.parse();
    Ok(RunPlace {
        path: listing.path.clone(),
        run_id: listing.run_id.clone(),
        specimen: specimen.clone(),
        bench: bench.ok_or("its bench has no name")?.to_owned(),
        operator: listing.operator.clone(),
        started_utc: started_utc.map_err(|e: jiff::Error| format!("its start is no time ({e})"))?,
        age_cycles,
    })
}

/// Estimates one run; an error names it.
fn rows_of_run(run: &RunPlace, model: &'static Model) -> Result<Vec<EstimateRow>, String> {
    let named =
        |error: &dyn std::error::Error| format!("run {}: {}", run.run_id, crate::daemon::chain(error));
    let file = RunFile::open(&run.path).map_err(|e| named(&e))?;
    let recording = run_recording::read(&run.run_id, &file);
    // The runs share the cores.
    let options = DiagnoseOptions {
        threads: 1,
        ..DiagnoseOptions::default()
    };
    let estimates = estimate(&[recording], &Baseline::of(model), &options).map_err(|e| named(&e))?;
    Ok(rows(run, model, &estimates))
}

/// The rows of one run. Parameters without a standard error and effects that the run cannot test have none.
fn rows(run: &RunPlace, model: &Model, estimates: &Estimates) -> Vec<EstimateRow> {
    let row = |quantity: &str, unit: &str, estimate, [std_error, form_error]: [f64; 2], scale| EstimateRow {
        run_id: run.run_id.clone(),
        specimen: run.specimen.specimen.clone(),
        family: run.specimen.family.clone(),
        batch: run.specimen.batch.clone(),
        bench: run.bench.clone(),
        operator: run.operator.clone(),
        started_utc: run.started_utc,
        age_cycles: f64::from(run.age_cycles),
        quantity: quantity.to_owned(),
        unit: if unit.is_empty() { "1" } else { unit }.to_owned(),
        estimate,
        std_error,
        form_error,
        scale,
    };
    let parameters = estimates.baseline.iter().filter_map(|p| {
        let scale = scale(model, &p.name);
        let usable = scale == EstimateScale::Absolute || p.value > 0.0;
        let std_error = p.std_error.filter(|s| usable && *s > 0.0)?;
        Some(row(&p.name, &p.unit, p.value, [std_error, 0.0], scale))
    });
    let effects = estimates.effects.iter().filter(|e| e.testable).filter_map(|e| {
        let std_error = e.std_error.filter(|s| s.is_finite() && *s > 0.0)?;
        Some(row(
            &e.code,
            &e.unit,
            e.amplitude,
            [std_error, e.form_error.unwrap_or(0.0)],
            EstimateScale::Absolute,
        ))
    });
    parameters.chain(effects).collect()
}

/// Writes the table sorted by start, after it has taken over who the runs belong to.
fn write_table(path: &Path, rows: &mut [EstimateRow], runs: &[RunPlace]) -> Result<(), CliError> {
    let places: BTreeMap<&str, &RunPlace> = runs.iter().map(|run| (run.run_id.as_str(), run)).collect();
    for row in rows.iter_mut() {
        if let Some(run) = places.get(row.run_id.as_str()) {
            row.specimen.clone_from(&run.specimen.specimen);
            row.family.clone_from(&run.specimen.family);
            row.batch.clone_from(&run.specimen.batch);
            row.age_cycles = f64::from(run.age_cycles);
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
