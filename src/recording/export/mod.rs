//! Exports a run file: CSV with its data package, the cycles CSV, Parquet and MDF 4 (MF4). `recording::csv`, `datapackage`,
//! `columns` and `mdf` define what is in them.
//!
//! `mean_loop` the mean over the cycles · `table` rows of doubles, for Parquet and MF4 · `facts` what stands beside them ·
//! `parquet` and `mf4` the formats

mod facts;
mod mean_loop;
mod mf4;
mod parquet;
mod table;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::csv::{CsvFormat, CsvWriter};
use super::cycles::{self, CycleMeter, CycleSummary};
use super::datapackage::{self, Resource};
use super::run_file::{RunFile, Survey};
use super::{Ending, Sample, atomic_file};
pub(crate) use facts::{run_file_sha256, sha256_of};
pub(crate) use mean_loop::mean_bins;
use table::Table;

/// Part of a run that is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Selection {
    /// All samples of the run.
    Whole,
    /// The counted cycle of this number; if a hold interrupted it and it was repeated, the repetition.
    Cycle(u32),
    /// The mean over the complete counted cycles, for each tick after the start of the cycle.
    MeanLoop,
    /// Every n-th tick, starting with the first; at least 1.
    Every(u64),
}

impl Selection {
    /// Tells of a sample of the surveyed run whether it belongs to this part.
    fn filter(self, survey: &Survey) -> impl Fn(&Sample) -> bool {
        let first_tick = survey.ticks.map_or(0, |(first, _)| first);
        let span = match self {
            Selection::Cycle(cycle) => survey.span_of(cycle).copied(),
            _ => None,
        };
        move |sample| match self {
            Selection::Cycle(_) => span.is_some_and(|span| span.has(sample)),
            Selection::Every(n) => (sample.tick - first_tick).is_multiple_of(n),
            Selection::Whole | Selection::MeanLoop => true,
        }
    }
}

impl std::fmt::Display for Selection {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Selection::Whole => write!(f, "whole run"),
            Selection::Cycle(cycle) => write!(f, "cycle {cycle}"),
            Selection::MeanLoop => write!(f, "mean loop over the complete counted cycles"),
            Selection::Every(n) => write!(f, "every {n}th tick"),
        }
    }
}

/// The files that an export wrote.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Exported {
    pub csv: PathBuf,
    pub datapackage: PathBuf,
    /// Number of rows without the header row.
    pub rows: u64,
    /// What is in the run file, with its lost and damaged ranges.
    pub survey: Survey,
}

/// Why a run could not be exported.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ExportError {
    #[error("{path} cannot be written: check that the folder exists, its permissions and the free space")]
    Io { path: PathBuf, source: io::Error },
    #[error("{run} has no counted cycle {cycle}: {advice}")]
    NoCycle {
        run: PathBuf,
        cycle: u32,
        /// Which cycles there are, as an order.
        advice: String,
    },
    #[error(
        "{run} has no complete counted cycle without a hold: export the whole run instead of the mean loop"
    )]
    NoLoop { run: PathBuf },
    #[error("the interval between exported samples is 0: the interval must be at least 1")]
    EveryZero,
    /// The start of the run in the header cannot be read; MF4 needs it.
    #[error(
        "{run}: its start \"{started_utc}\" is not a time such as 2026-11-21T10:30:00Z after 1970: export it as CSV or Parquet"
    )]
    Start { run: PathBuf, started_utc: String },
}

/// A format that holds numbers as doubles, with units and facts of the run in the same file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TableFormat {
    /// ASAM MDF 4.1, the file of CANape, asammdf and other programs of vehicle testing.
    Mf4,
    /// Apache Parquet, for pandas, Polars, DuckDB and other programs of data analysis.
    Parquet,
}

impl TableFormat {
    /// Extension of a file, without the dot.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            TableFormat::Mf4 => "mf4",
            TableFormat::Parquet => "parquet",
        }
    }
}

/// Writes a part of a run to `path`, whole or not at all; the number of its rows, and what is in the run file.
pub(crate) fn export_table(
    run: &RunFile,
    selection: Selection,
    format: TableFormat,
    path: &Path,
) -> Result<(u64, Survey), ExportError> {
    let survey = run.survey();
    check(run, selection, &survey)?;
    let start_ns = match format {
        TableFormat::Mf4 => start_ns(run)?,
        TableFormat::Parquet => 0,
    };
    let table = Table::new(run, &survey, selection);
    let written = atomic_file::write(path, |file| {
        let facts = facts::facts(run, &survey, selection)?;
        match format {
            TableFormat::Mf4 => mf4::write(file, &table, &facts, start_ns),
            TableFormat::Parquet => parquet::write(file, &table, &facts),
        }
    });
    let rows = written.map_err(|source| ExportError::Io {
        path: path.to_owned(),
        source,
    })?;
    Ok((rows, survey))
}

/// Start of the run in nanoseconds since 1970, UTC.
fn start_ns(run: &RunFile) -> Result<u64, ExportError> {
    let text = &run.header().started_utc;
    let time: Option<jiff::Timestamp> = text.parse().ok();
    let nanoseconds = time.and_then(|time| u64::try_from(time.as_nanosecond()).ok());
    nanoseconds.ok_or_else(|| ExportError::Start {
        run: run.path().to_owned(),
        started_utc: text.clone(),
    })
}

/// Writes `csv` and its data package, each whole or not at all. The run file is only read.
pub(crate) fn export(run: &RunFile, selection: Selection, csv: &Path) -> Result<Exported, ExportError> {
    let survey = run.survey();
    check(run, selection, &survey)?;
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| ExportError::Io { path, source }
    };
    let resource =
        atomic_file::write(csv, |file| write_csv(run, selection, &survey, csv, file)).map_err(failed(csv))?;
    let package = datapackage::build(run, &survey, &resource);
    let package_path = datapackage::path_of(csv);
    atomic_file::write(&package_path, |file| {
        serde_json::to_writer_pretty(&mut *file, &package)?;
        file.write_all(b"\n")
    })
    .map_err(failed(&package_path))?;
    Ok(Exported {
        csv: csv.to_owned(),
        datapackage: package_path,
        rows: resource.rows,
        survey,
    })
}

fn check(run: &RunFile, selection: Selection, survey: &Survey) -> Result<(), ExportError> {
    let run = run.path().to_owned();
    match selection {
        Selection::Every(0) => Err(ExportError::EveryZero),
        Selection::MeanLoop if survey.unbroken_cycles().next().is_none() => Err(ExportError::NoLoop { run }),
        Selection::Cycle(cycle) if survey.span_of(cycle).is_none() => {
            let advice = match (survey.cycles.first(), survey.cycles.last()) {
                (Some(first), Some(last)) => {
                    format!("choose one of cycles {} to {}", first.cycle, last.cycle)
                }
                _ => "it has no counted cycles, export the whole run".to_owned(),
            };
            Err(ExportError::NoCycle { run, cycle, advice })
        }
        _ => Ok(()),
    }
}

fn write_csv(
    run: &RunFile,
    selection: Selection,
    survey: &Survey,
    csv: &Path,
    file: &mut BufWriter<File>,
) -> io::Result<Resource> {
    let format = CsvFormat::new(run.header(), &survey.modes);
    let mut sink = Hashing {
        sink: file,
        sha256: Sha256::new(),
        bytes: 0,
    };
    let (rows, columns) = if selection == Selection::MeanLoop {
        mean_loop::write_csv(&mut sink, run, survey, &format)?
    } else {
        let columns = format.columns();
        let mut writer = CsvWriter::new(&mut sink, format)?;
        for sample in run.samples().filter(selection.filter(survey)) {
            writer.sample(&sample)?;
        }
        (writer.rows(), columns)
    };
    Ok(Resource {
        file_name: csv.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        bytes: sink.bytes,
        sha256: hex(&sink.sha256.finalize()),
        rows,
        columns,
        selection: selection.to_string(),
    })
}

/// A hash as text.
fn hex(hash: &[u8]) -> String {
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Summary of every counted cycle of a run.
pub(crate) fn cycle_summaries(run: &RunFile) -> Vec<CycleSummary> {
    let mut meter = CycleMeter::default();
    let mut summaries: Vec<CycleSummary> = run.samples().filter_map(|sample| meter.add(&sample)).collect();
    let completed = run
        .outcome()
        .is_some_and(|outcome| outcome.ending == Ending::Completed);
    summaries.extend(meter.finish(completed));
    summaries
}

/// Writes the cycles CSV of a run and returns its rows.
pub(crate) fn export_cycles(run: &RunFile, csv: &Path) -> Result<Vec<CycleSummary>, ExportError> {
    let summaries = cycle_summaries(run);
    atomic_file::write(csv, |file| cycles::write_csv(file, &summaries)).map_err(|source| {
        ExportError::Io {
            path: csv.to_owned(),
            source,
        }
    })?;
    Ok(summaries)
}

/// Counts and hashes the bytes that it passes on.
struct Hashing<W> {
    sink: W,
    sha256: Sha256,
    bytes: u64,
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        self.sink.write_all(buffer)?;
        self.sha256.update(buffer);
        self.bytes += buffer.len() as u64;
        Ok(buffer.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::sync::Arc;

    use ::parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use arrow_array::RecordBatch;
    use arrow_array::cast::AsArray;
    use arrow_array::types::Float64Type;
    use arrow_schema::SchemaRef;

    use super::super::csv;
    use super::super::run_file::RunFileWriter;
    use super::super::run_file::test_support::{header, outcome, sample};
    use super::super::{Header, Recorder};
    use super::*;
    use crate::units::Mode;

    /// Ticks 0 to `ticks` of the sine, without those in `lost`.
    fn run_in(folder: &Path, ticks: u64, lost: std::ops::Range<u64>) -> RunFile {
        let path = folder.join("run.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        for tick in (0..ticks).filter(|tick| !lost.contains(tick)) {
            writer.sample(&sample(tick));
        }
        writer.end(&outcome(ticks));
        RunFile::open(&path).unwrap()
    }

    #[test]
    fn an_exported_run_reads_back_to_the_last_digit() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 3000, 0..0);
        let exported = export(&run, Selection::Whole, &folder.path().join("run.csv")).unwrap();
        assert_eq!(
            (exported.rows, exported.survey.incomplete()),
            (3000, String::new())
        );
        let back = csv::read_file(&exported.csv).unwrap();
        assert_eq!(back.command_mode, Some(Mode::Displacement));
        let (cycle, flags) = (back.cycle.unwrap(), back.flags.unwrap());
        let head = run.header();
        assert_eq!(run.samples().count(), back.time_s.len());
        for (i, s) in run.samples().enumerate() {
            assert_eq!(
                (back.time_s[i], cycle[i], flags[i]),
                (s.time_s, s.cycle, s.flags.bits())
            );
            // Half a unit of the last digit, and a little for the rounding of the double.
            assert!((back.displacement_mm[i] - s.displacement_mm).abs() <= 0.5001e-4);
            assert!((back.force_n[i] - s.force_n).abs() <= 0.5001e-2);
            assert_eq!(head.force_channel.counts(back.force_n[i]), s.force_counts);
            assert_eq!(
                head.displacement_channel.counts(back.displacement_mm[i]),
                s.displacement_counts
            );
        }
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            3,
            "run, CSV and package only"
        );
    }

    #[test]
    fn the_package_has_hash_bytes_and_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 2000, 700..705);
        let exported = export(&run, Selection::Whole, &folder.path().join("run.csv")).unwrap();
        let bytes = std::fs::read(&exported.csv).unwrap();
        let package: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&exported.datapackage).unwrap()).unwrap();
        let resource = &package["resources"][0];
        assert_eq!(resource["bytes"], bytes.len());
        let hex: String = Sha256::digest(&bytes)
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect();
        assert_eq!(resource["hash"], format!("sha256:{hex}"));
        let details = &package["leafbench"];
        assert_eq!((&details["samples"], &details["lost"]), (&1995.into(), &5.into()));
        assert_eq!(details["gaps"][0]["from_s"], 0.7);
        assert_eq!(details["operator"], "=1+1");
        let text = String::from_utf8(bytes).unwrap();
        assert!(
            text.lines().nth(701).unwrap().starts_with("0.705,")
                && text.lines().nth(701).unwrap().ends_with(",1")
        );
    }

    #[test]
    fn parts_of_a_run_can_be_exported() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 2500, 0..0);
        let path = folder.path().join("part.csv");
        export(&run, Selection::Cycle(2), &path).unwrap();
        let cycle = csv::read_file(&path).unwrap();
        assert_eq!(
            (cycle.len(), cycle.time_s[0], cycle.time_s[999]),
            (1000, 1.0, 1.999)
        );
        export(&run, Selection::Every(250), &path).unwrap();
        assert_eq!(csv::read_file(&path).unwrap().time_s[..3], [0.0, 0.25, 0.5]);
        assert!(matches!(
            export(&run, Selection::Every(0), &path),
            Err(ExportError::EveryZero)
        ));
        let missing = export(&run, Selection::Cycle(9), &path).unwrap_err().to_string();
        assert!(missing.contains("cycles 1 to 3"), "{missing}");
    }

    #[test]
    fn the_mean_loop_of_equal_cycles_is_the_cycle() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 3000, 1200..1210);
        let path = folder.path().join("mean.csv");
        assert_eq!(export(&run, Selection::MeanLoop, &path).unwrap().rows, 1000);
        let mean = csv::read_file(&path).unwrap();
        for (i, s) in run.samples().take(1000).enumerate() {
            assert!((mean.displacement_mm[i] - s.displacement_mm).abs() <= 0.5001e-5);
            assert!((mean.force_n[i] - s.force_n).abs() <= 0.5001e-3);
        }
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.lines().nth(206).unwrap().ends_with(",2"),
            "two cycles have a sample at 0.205 s"
        );
        assert!(
            text.lines().nth(100).unwrap().ends_with(",3"),
            "three cycles have a sample at 0.099 s"
        );
    }

    #[test]
    fn a_cycle_that_was_held_and_repeated_is_once_in_the_cycles_and_in_the_mean_loop() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        for tick in 0..3000 {
            let mut s = sample(tick);
            // 300 ms of cycle 2, a hold, the taper in, and cycle 2 again.
            match tick {
                0..1300 => {}
                1300..1800 => {
                    s.cycle = 0;
                    s.flags.insert(crate::recording::Flags::NOT_PROFILE);
                }
                1800..2000 => s.cycle = 0,
                _ => s.cycle = 2,
            }
            writer.sample(&s);
        }
        writer.end(&outcome(3000));
        let run = RunFile::open(&path).unwrap();
        let survey = run.survey();
        let spans: Vec<_> = survey.cycles.iter().map(|c| (c.cycle, c.complete)).collect();
        assert_eq!(spans, [(1, true), (2, false), (2, true)]);
        assert_eq!(survey.cycles_completed(), 2);
        let bins = mean_loop::mean_bins(&run, &survey);
        assert_eq!(bins.len(), 1000);
        assert!(bins.iter().all(|bin| bin.count == 2), "each of both cycles once");
        let rows = export_cycles(&run, &folder.path().join("cycles.csv")).unwrap();
        assert_eq!(rows.iter().filter(|row| row.complete).count(), 2);
        let second = export(&run, Selection::Cycle(2), &folder.path().join("second.csv")).unwrap();
        assert_eq!(second.rows, 1000, "the repetition alone");
    }

    #[test]
    fn the_cycles_of_a_run_are_exported() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 2000, 0..0);
        let rows = export_cycles(&run, &folder.path().join("cycles.csv")).unwrap();
        assert_eq!(
            rows.iter().map(|c| (c.cycle, c.complete)).collect::<Vec<_>>(),
            [(1, true), (2, true)]
        );
    }

    /// The rows of a Parquet file, and its metadata.
    fn read_parquet(path: &Path) -> (Vec<RecordBatch>, SchemaRef, HashMap<String, String>) {
        let builder = ParquetRecordBatchReaderBuilder::try_new(File::open(path).unwrap()).unwrap();
        let footer = builder.metadata().file_metadata().key_value_metadata().unwrap();
        let pairs = footer
            .iter()
            .map(|pair| (pair.key.clone(), pair.value.clone().unwrap()));
        let (schema, facts) = (Arc::clone(builder.schema()), pairs.collect());
        let batches = builder.build().unwrap().map(Result::unwrap).collect();
        (batches, schema, facts)
    }

    #[test]
    fn a_parquet_file_has_every_bit_with_units_and_facts() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 3000, 700..705);
        let path = folder.path().join("run.parquet");
        let (rows, survey) = export_table(&run, Selection::Whole, TableFormat::Parquet, &path).unwrap();
        assert_eq!((rows, survey.lost), (2995, 5));
        let (batches, schema, facts) = read_parquet(&path);
        let samples: Vec<Sample> = run.samples().collect();
        let numbers = |name: &str| -> Vec<Option<u64>> {
            let columns = batches.iter().map(|batch| batch.column_by_name(name).unwrap());
            let cells = columns.flat_map(|column| column.as_primitive::<Float64Type>().iter());
            cells.map(|cell| cell.map(f64::to_bits)).collect()
        };
        let bits = |value: fn(&Sample) -> Option<f64>| -> Vec<Option<u64>> {
            samples.iter().map(|s| value(s).map(f64::to_bits)).collect()
        };
        assert_eq!(numbers("time_s"), bits(|s| Some(s.time_s)));
        assert_eq!(numbers("force_n"), bits(|s| Some(s.force_n)));
        assert_eq!(numbers("command_mm"), bits(|s| s.command.map(|c| c.value())));
        assert_eq!(numbers("twin_force_n"), bits(|s| s.twin_force_n));
        assert!(
            numbers("twin_force_n").contains(&None),
            "the twin was late in every third row"
        );
        let field = schema.field_with_name("displacement_mm").unwrap();
        assert_eq!(field.metadata().get("unit").map(String::as_str), Some("mm"));
        let header = run.header();
        assert_eq!(facts["bench_toml"], header.bench_toml);
        assert_eq!(facts["profile_toml"], header.profile_toml);
        let file = std::fs::read(run.path()).unwrap();
        assert_eq!(facts["run_file_sha256"], hex(&Sha256::digest(file)));
        assert_eq!(schema.metadata().get("operator"), Some(&header.operator));
    }

    #[test]
    fn a_live_run_has_no_hash_of_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        (0..100).for_each(|tick| writer.sample(&sample(tick)));
        writer.flush();
        let run = RunFile::open(&path).unwrap();
        let facts = facts::facts(&run, &run.survey(), Selection::Whole).unwrap();
        assert!(facts.iter().all(|(name, _)| *name != "run_file_sha256"));
        assert!(
            facts
                .iter()
                .any(|(name, text)| *name == "calibration_hash" && text.starts_with("0x"))
        );
    }

    #[test]
    fn parts_of_a_run_are_tables_too() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 3000, 0..0);
        let path = folder.path().join("part.parquet");
        let rows = |selection| {
            let (rows, _) = export_table(&run, selection, TableFormat::Parquet, &path).unwrap();
            let (batches, schema, _) = read_parquet(&path);
            assert_eq!(
                batches.iter().map(RecordBatch::num_rows).sum::<usize>() as u64,
                rows
            );
            (rows, schema.fields().len())
        };
        assert_eq!(rows(Selection::Cycle(2)), (1000, 8));
        assert_eq!(rows(Selection::Every(250)), (12, 8));
        // time, displacement, force, command, twin and the number of cycles.
        assert_eq!(rows(Selection::MeanLoop), (1000, 6));
        let missing = export_table(&run, Selection::Cycle(9), TableFormat::Mf4, &path);
        assert!(matches!(missing, Err(ExportError::NoCycle { .. })));
    }

    #[test]
    fn the_start_of_an_mf4_file_is_that_of_the_run() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path(), 10, 0..0);
        // 2026-11-21T10:30:00Z.
        assert_eq!(start_ns(&run).unwrap(), 1_795_257_000_000_000_000);
        let path = folder.path().join("old.leafrun");
        let old = Header {
            started_utc: "1969-12-31T23:59:59Z".to_owned(),
            ..header()
        };
        let mut writer = RunFileWriter::create(&path, &old).unwrap();
        writer.end(&outcome(0));
        let old = RunFile::open(&path).unwrap();
        let refused = export_table(
            &old,
            Selection::Whole,
            TableFormat::Mf4,
            &folder.path().join("old.mf4"),
        );
        assert!(matches!(refused, Err(ExportError::Start { .. })));
        assert!(!folder.path().join("old.mf4").exists());
    }
}
