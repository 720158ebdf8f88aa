//! `leafbench export`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::shared::client::DataArg;
use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::recording::export::{self, Selection, TableFormat};
use crate::recording::run_file::{EXTENSION, GapCause, RunFile, Survey};
use crate::recording::{atomic_file, datapackage};

/// In the file names of a run that has no end yet.
const SO_FAR: &str = "-so-far";

/// Write a run as CSV with its data package and its cycles as a second CSV, or as MF4 or Parquet; needs no daemon
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// Run id, whole or short, `latest`, or a .leafrun file
    #[arg(value_name = "RUN")]
    run: String,
    /// Folder to write to
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Formats, separated by commas; mf4 (ASAM MDF 4.1) and parquet hold units, profile and bench in the same file
    #[arg(long, value_name = "FORMAT", value_delimiter = ',', default_value = "csv")]
    format: Vec<FormatArg>,
    #[command(flatten)]
    part: PartArgs,
    /// Replace files that are there already
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    data: DataArg,
}

/// A format of exported files; docs/formats.md describes each.
// Doc comments of the variants would give the help of this one command a layout of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FormatArg {
    Csv,
    Mf4,
    Parquet,
}

impl FormatArg {
    const ALL: [FormatArg; 3] = [FormatArg::Csv, FormatArg::Mf4, FormatArg::Parquet];
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

#[derive(Default, serde::Serialize)]
struct Written {
    csv: Option<PathBuf>,
    datapackage: Option<PathBuf>,
    cycles_csv: Option<PathBuf>,
    mf4: Option<PathBuf>,
    parquet: Option<PathBuf>,
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

impl Written {
    /// All files, in the order of the formats.
    fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let files = [
            &self.csv,
            &self.datapackage,
            &self.cycles_csv,
            &self.mf4,
            &self.parquet,
        ];
        files.into_iter().flatten()
    }

    /// Adds what is in the run file, and the number of rows: both are the same for every format.
    fn count(&mut self, rows: u64, survey: Survey, sample_rate_hz: f64) {
        self.rows = rows;
        self.lost = survey.lost;
        self.late = survey.late;
        self.damaged = survey.damaged;
        self.unsaved = survey.unsaved;
        self.missing = missing_ranges(&survey, sample_rate_hz);
        self.damage = survey.damage;
    }
}

impl CliCommand for ExportArgs {
    const NAME: &'static str = "export";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench export latest --out loops",
        "leafbench export latest --mean-loop --out loops",
        "leafbench export latest --format mf4,parquet --out loops",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let file = RunFile::open(&self.run_path()?)?;
        atomic_file::create_private_folder(&self.out)
            .map_err(CliError::file(&self.out, "creating the folder"))?;
        let mut written = Written {
            still_going: file.outcome().is_none(),
            ..Written::default()
        };
        self.require_new(&file)?;
        let mut whole = true;
        for format in FormatArg::ALL {
            if self.format.contains(&format) {
                whole &= self.write(&file, format, &mut written)?;
            }
        }
        output.result(&written, || text(&written))?;
        Ok(Done::success_if(whole))
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

    /// File of this run with an extension; `part` says which samples, and a run that goes on is marked.
    fn path(&self, run: &RunFile, part: &str, extension: &str) -> PathBuf {
        let mark = if run.outcome().is_none() { SO_FAR } else { "" };
        let run_id = &run.header().run_id;
        self.out.join(format!("{run_id}{part}{mark}.{extension}"))
    }

    /// Refuses to replace files. What is known of a run that goes on is out of date at the next export, so that is replaced; the table
    /// of cycles is the same for every part.
    fn require_new(&self, run: &RunFile) -> Result<(), CliError> {
        let (_, part) = self.part.selection();
        let paths = self.format.iter().flat_map(|format| match format {
            FormatArg::Csv => {
                let csv = self.path(run, &part, "csv");
                vec![datapackage::path_of(&csv), csv]
            }
            FormatArg::Mf4 => vec![self.path(run, &part, TableFormat::Mf4.extension())],
            FormatArg::Parquet => vec![self.path(run, &part, TableFormat::Parquet.extension())],
        });
        let paths: Vec<PathBuf> = paths.collect();
        local::require_new(&paths, self.force || run.outcome().is_none())
    }

    /// Writes one format; false if something of the run is damaged or not on the disk.
    fn write(&self, run: &RunFile, format: FormatArg, written: &mut Written) -> Result<bool, CliError> {
        let (selection, suffix) = self.part.selection();
        let header = run.header();
        let path = |extension: &str| self.path(run, &suffix, extension);
        let table = |format: TableFormat| {
            let path = path(format.extension());
            let (rows, survey) = export::export_table(run, selection, format, &path)?;
            Ok::<_, CliError>((Some(path), rows, survey))
        };
        let (rows, survey) = match format {
            FormatArg::Csv => {
                let exported = export::export(run, selection, &path("csv"))?;
                written.csv = Some(exported.csv);
                written.datapackage = Some(exported.datapackage);
                if !exported.survey.cycles.is_empty() {
                    let path = self.path(run, "", "cycles.csv");
                    export::export_cycles(run, &path)?;
                    written.cycles_csv = Some(path);
                }
                (exported.rows, exported.survey)
            }
            FormatArg::Mf4 => {
                let (path, rows, survey) = table(TableFormat::Mf4)?;
                written.mf4 = path;
                (rows, survey)
            }
            FormatArg::Parquet => {
                let (path, rows, survey) = table(TableFormat::Parquet)?;
                written.parquet = path;
                (rows, survey)
            }
        };
        let whole = survey.incomplete().is_empty();
        written.count(rows, survey, header.sample_rate_hz);
        Ok(whole)
    }
}

fn text(w: &Written) -> String {
    let mut lines: Vec<String> = w.files().map(|path| path.display().to_string()).collect();
    if let Some(first) = lines.first_mut() {
        *first += &format!("  ({} rows, {} samples lost, {} late)", w.rows, w.lost, w.late);
    }
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
