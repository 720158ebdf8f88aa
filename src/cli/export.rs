//! `leafbench export`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::shared::client::DataArg;
use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::recording::export::{self, Selection};
use crate::recording::run_file::{EXTENSION, GapCause, RunFile, Survey};
use crate::recording::{atomic_file, datapackage};

/// In the file names of a run that has no end yet.
const SO_FAR: &str = "-so-far";

/// Write a run as CSV with its data package, and its cycles as a second CSV; needs no daemon
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// Run id, whole or short, `latest`, or a .leafrun file
    #[arg(value_name = "RUN")]
    run: String,
    /// Folder to write to
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    #[command(flatten)]
    part: PartArgs,
    /// Replace files that are there already
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    data: DataArg,
}

/// Which samples are exported; at most one of these.
#[derive(Debug, Args)]
#[group(multiple = false)]
struct PartArgs {
    /// One counted cycle, from 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    cycle: Option<u32>,
    /// The mean over the complete counted cycles
    #[arg(long)]
    mean_loop: bool,
    /// Every n-th sample; a sample is 1 ms
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    every: Option<u32>,
}

impl PartArgs {
    /// The selection, and what it adds to the name of the CSV.
    fn selection(&self) -> (Selection, String) {
        match (self.cycle, self.every, self.mean_loop) {
            (Some(cycle), _, _) => (Selection::Cycle(cycle), format!("-cycle-{cycle}")),
            (_, Some(n), _) => (Selection::Every(u64::from(n)), format!("-every-{n}")),
            (_, _, true) => (Selection::MeanLoop, "-mean-loop".to_owned()),
            _ => (Selection::Whole, String::new()),
        }
    }
}

#[derive(serde::Serialize)]
struct Written {
    csv: PathBuf,
    datapackage: PathBuf,
    cycles_csv: Option<PathBuf>,
    /// The run has no end yet: the files hold what was recorded so far.
    still_going: bool,
    rows: u64,
    lost: u64,
    late: u64,
    damaged: u64,
    unsaved: u64,
    /// Ranges that are damaged or not on the disk, in words.
    missing: Vec<String>,
    /// What in the run file is damaged, in words.
    damage: Vec<String>,
}

impl CliCommand for ExportArgs {
    const NAME: &'static str = "export";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench export latest --out loops",
        "leafbench export latest --mean-loop --out loops",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let file = RunFile::open(&self.run_path()?)?;
        let folder = self.out;
        atomic_file::create_private_folder(&folder)
            .map_err(CliError::file(&folder, "creating the folder"))?;
        let (selection, suffix) = self.part.selection();
        let still_going = file.outcome().is_none();
        let mark = if still_going { SO_FAR } else { "" };
        let run_id = file.header().run_id.clone();
        let csv = folder.join(format!("{run_id}{suffix}{mark}.csv"));
        let cycles_csv = folder.join(format!("{run_id}{mark}.cycles.csv"));
        // What is known of a run that goes on is out of date at the next export. The table of cycles is the same for every part.
        local::require_new(&[&csv, &datapackage::path_of(&csv)], self.force || still_going)?;
        let exported = export::export(&file, selection, &csv)?;
        let cycles_csv = match exported.survey.cycles.is_empty() {
            true => None,
            false => {
                export::export_cycles(&file, &cycles_csv)?;
                Some(cycles_csv)
            }
        };
        let partial = exported.is_partial();
        let written = Written {
            still_going,
            rows: exported.rows,
            lost: exported.survey.lost,
            late: exported.survey.late,
            damaged: exported.survey.damaged,
            unsaved: exported.survey.unsaved,
            missing: missing_ranges(&exported.survey, file.header().sample_rate_hz),
            damage: exported.survey.damage.clone(),
            csv: exported.csv,
            datapackage: exported.datapackage,
            cycles_csv,
        };
        output.result(&written, || text(&written))?;
        Ok(Done::success_if(!partial))
    }
}

impl ExportArgs {
    fn run_path(&self) -> Result<PathBuf, CliError> {
        let path = Path::new(&self.run);
        if path.extension().is_some_and(|e| e == EXTENSION) {
            return Ok(path.to_owned());
        }
        Ok(local::find_run(&self.data.folder, &self.run)?.path)
    }
}

fn text(w: &Written) -> String {
    let mut lines = vec![
        format!(
            "{}  ({} rows, {} samples lost, {} late)",
            w.csv.display(),
            w.rows,
            w.lost,
            w.late
        ),
        w.datapackage.display().to_string(),
    ];
    lines.extend(w.cycles_csv.as_ref().map(|path| path.display().to_string()));
    if w.still_going {
        lines.push(
            "NOT WHOLE: the run is still going, or its daemon was killed: the files end at its newest sample; export it again \
             after its end"
                .to_owned(),
        );
    }
    let told = w.damage.iter().chain(&w.missing);
    lines.extend(told.map(|sentence| format!("NOT WHOLE: {sentence}")));
    lines.join("\n")
}

/// Ranges of time that were recorded and are not in the export.
fn missing_ranges(survey: &Survey, sample_rate_hz: f64) -> Vec<String> {
    let zero = survey.ticks.map_or(0, |(first, _)| first);
    let time_s = |tick: u64| tick.saturating_sub(zero) as f64 / sample_rate_hz;
    let missing = survey.gaps.iter().filter_map(|gap| {
        let why = match gap.cause {
            GapCause::Lost => return None,
            GapCause::Damaged => "damaged",
            GapCause::Unsaved => "not on the disk",
        };
        let (from_s, to_s) = (time_s(gap.from_tick), time_s(gap.to_tick));
        Some(format!(
            "{} samples from {from_s:.3} s to {to_s:.3} s are {why}",
            gap.ticks()
        ))
    });
    missing.collect()
}
