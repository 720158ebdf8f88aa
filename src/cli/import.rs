//! `leafbench import`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{CliCommand, CliError, Done, Output};
use crate::recording::import::{
    DecimalSign, IMPORT_MAX_BYTES, ImportOptions, Imported, MapEntry, import, parse_map,
};
use crate::recording::{atomic_file, csv};
use crate::regular_file;

/// Read a table of another program (CSV or text) and write it as the CSV that diagnose and identify read
#[derive(Debug, Args)]
pub(super) struct ImportArgs {
    /// Table of another program: any separator, decimal sign, column names and units, with or without lines before the header
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[arg(
        long,
        value_name = "COLUMN=TARGET",
        value_parser = map_entries,
        help = "What the columns are: \"Weg [mm]=displacement_mm,Kraft [kN]=force_n*1000\". Targets: time_s, displacement_mm,\n\
                force_n, cycle. A factor goes from the unit of the file to s, mm or N; without one, the unit in the header\n\
                gives it. #2 is the second column [default: from the names and units in the header]"
    )]
    map: Vec<MapEntries>,
    /// Turns the sign of these channels; both must be positive in the direction that loads the spring
    #[arg(
        long,
        value_name = "CHANNEL,CHANNEL",
        value_enum,
        num_args = 1,
        value_delimiter = ','
    )]
    flip: Vec<ImportedChannel>,
    /// Time between two samples in s, in place of a column of time
    #[arg(long = "dt", value_name = "SECONDS", value_parser = interval_s)]
    interval_s: Option<f64>,
    /// Decimal sign of the numbers [default: from the numbers]
    #[arg(long, value_enum)]
    decimal: Option<ImportedDecimal>,
    /// CSV to write [default: NAME.imported.csv here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the CSV if it is there already
    #[arg(long)]
    force: bool,
}

/// The entries of one `--map`.
#[derive(Debug, Clone)]
struct MapEntries(Vec<MapEntry>);

fn map_entries(text: &str) -> Result<MapEntries, String> {
    parse_map(text).map(MapEntries)
}

/// A sample interval in s: above 0, at most a day.
fn interval_s(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    number
        .filter(|s| *s > 0.0 && *s <= 86_400.0)
        .ok_or_else(|| "write a number of seconds above 0, such as 0.001 for 1 kHz".to_owned())
}

/// A channel whose sign is turned while it is imported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ImportedChannel {
    /// The column force_n
    Force,
    /// The column displacement_mm
    Displacement,
}

/// The decimal sign that the user names.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ImportedDecimal {
    /// A point, 1234.5
    Point,
    /// A comma, 1234,5
    Comma,
}

/// The CSV that was written, with what was decided.
#[derive(serde::Serialize)]
struct ImportWritten<'a> {
    csv: &'a Path,
    rows: usize,
    duration_s: f64,
    displacement_min_mm: f64,
    displacement_max_mm: f64,
    force_min_n: f64,
    force_max_n: f64,
    /// The text for `--map` that gives the same columns again.
    map: String,
    #[serde(flatten)]
    imported: &'a Imported,
}

impl CliCommand for ImportArgs {
    const NAME: &'static str = "import";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench import logger.csv",
        "leafbench import logger.csv --map \"Weg=displacement_mm,Kraft=force_n*1000\" --flip force --dt 0.001",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let path = self.out_path()?;
        let bytes = regular_file::read(&self.file, IMPORT_MAX_BYTES)
            .map_err(CliError::file(&self.file, "reading"))?;
        let imported = import(&self.file.display().to_string(), &bytes, &self.options())?;
        atomic_file::write(&path, |file| csv::write_recording(file, &imported.recording))
            .map_err(CliError::file(&path, "writing"))?;
        let recording = &imported.recording;
        let [displacement, force] = [&recording.displacement_mm, &recording.force_n].map(|v| range(v));
        let ends = recording.time_s.first().zip(recording.time_s.last());
        let written = ImportWritten {
            csv: &path,
            rows: recording.len(),
            duration_s: ends.map_or(0.0, |(first, last)| last - first),
            displacement_min_mm: displacement[0],
            displacement_max_mm: displacement[1],
            force_min_n: force[0],
            force_max_n: force[1],
            map: imported.map_text(),
            imported: &imported,
        };
        output.result(&written, || text(&self.file, &written))?;
        Ok(Done::Success)
    }
}

impl ImportArgs {
    /// The CSV to write, which may not be there unless `--force` is given, and never is the table itself.
    fn out_path(&self) -> Result<PathBuf, CliError> {
        let path = self.out.clone().unwrap_or_else(|| {
            let stem = self.file.file_stem().unwrap_or_default().to_string_lossy();
            PathBuf::from(format!("{stem}.imported.csv"))
        });
        let same = path.canonicalize().ok().zip(self.file.canonicalize().ok());
        if same.is_some_and(|(out, table)| out == table) {
            return Err(CliError::Input(format!(
                "{} is the table itself: name another file with --out",
                path.display()
            )));
        }
        super::shared::local::require_new(&[&path], self.force)?;
        Ok(path)
    }

    fn options(&self) -> ImportOptions {
        ImportOptions {
            map: self.map.iter().flat_map(|entries| entries.0.clone()).collect(),
            interval_s: self.interval_s,
            decimal: self.decimal.map(|decimal| match decimal {
                ImportedDecimal::Point => DecimalSign::Point,
                ImportedDecimal::Comma => DecimalSign::Comma,
            }),
            flip_force: self.flip.contains(&ImportedChannel::Force),
            flip_displacement: self.flip.contains(&ImportedChannel::Displacement),
        }
    }
}

/// Least and greatest value.
fn range(values: &[f64]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
            [low.min(*v), high.max(*v)]
        })
}

fn text(file: &Path, w: &ImportWritten<'_>) -> String {
    let i = w.imported;
    let separator = match i.separator {
        '\t' => "tabs",
        ';' => "semicolons",
        ',' => "commas",
        _ => "bars",
    };
    let decimal = match i.decimal {
        DecimalSign::Point => "decimal points",
        DecimalSign::Comma => "decimal commas",
    };
    let header = i
        .header_row
        .map_or("no header".to_owned(), |row| format!("header in row {row}"));
    let mut lines = vec![format!(
        "{}: {separator} between columns, {decimal}, {}, {header}, first sample in row {}",
        file.display(),
        i.encoding.name(),
        i.first_row
    )];
    if let Some(interval_s) = i.interval_s {
        lines.push(format!("  {:<17}every {interval_s} s (--dt)", "time_s"));
    }
    for m in &i.mapped {
        let turned = match i.flipped.contains(&m.target.name()) {
            true => ", sign turned (--flip)",
            false => "",
        };
        lines.push(format!(
            "  {:<17}\"{}\" * {} ({}){turned}",
            m.target.name(),
            m.column,
            m.factor,
            m.reason
        ));
    }
    if !i.unused.is_empty() {
        lines.push(format!("  not used         {}", i.unused.join(", ")));
    }
    if i.guessed {
        lines.push(format!(
            "  taken from names and units; to choose yourself: --map \"{}\"",
            w.map
        ));
    }
    lines.extend(i.notes.iter().map(|note| format!("  NOTE: {note}")));
    lines.push(format!(
        "{}  ({} rows over {:.3} s: {:.3} to {:.3} mm, {:.1} to {:.1} N)",
        w.csv.display(),
        w.rows,
        w.duration_s,
        w.displacement_min_mm,
        w.displacement_max_mm,
        w.force_min_n,
        w.force_max_n
    ));
    lines.join("\n")
}
