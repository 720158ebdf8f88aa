//! Reads runs back from an archive: the list, and one run as a recording.

use std::collections::BTreeMap;

use arrow_array::cast::AsArray;
use arrow_array::types::{Decimal128Type, Float64Type, Int64Type, TimestampMicrosecondType};
use arrow_array::{Array, RecordBatch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;

use super::manifest::{Manifest, ManifestEntry};
use super::partition::{RUNS, SAMPLES, hash};
use super::{ArchiveError, ArchiveStore};
use crate::recording::Recording;
use crate::units::Mode;

/// What the table of runs says about one run.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct ArchivedRun {
    /// Id of the run.
    pub run_id: String,
    /// Name or serial number of the specimen.
    pub specimen: String,
    /// Name of the bench.
    pub bench: String,
    /// Name of the operator; empty if none was given.
    pub operator: String,
    /// RFC 3339; empty if the run file had no time that could be read.
    pub started_utc: String,
    /// Counted cycles that the run completed.
    pub cycles_completed: i64,
}

/// An archive that is read.
pub(crate) struct ArchiveReader<'a> {
    store: &'a ArchiveStore,
    manifest: Manifest,
}

impl<'a> ArchiveReader<'a> {
    /// The archive as its manifest says it now.
    pub(crate) fn open(store: &'a ArchiveStore) -> Result<ArchiveReader<'a>, ArchiveError> {
        let manifest = Manifest::read(store)?.ok_or_else(|| ArchiveError::NoArchive {
            place: store.name().to_owned(),
        })?;
        Ok(ArchiveReader { store, manifest })
    }

    /// All runs, by start and then by id.
    pub(crate) fn runs(&self) -> Result<Vec<ArchivedRun>, ArchiveError> {
        let mut runs = Vec::new();
        for entry in self.manifest.of_table(RUNS) {
            for batch in self.batches(entry)? {
                runs.extend((0..batch.num_rows()).map(|row| archived_run(&batch, row)));
            }
        }
        runs.sort_unstable_by(|a, b| (&a.started_utc, &a.run_id).cmp(&(&b.started_utc, &b.run_id)));
        Ok(runs)
    }

    /// The text of each run's profile by run id.
    pub(crate) fn profiles(&self) -> Result<BTreeMap<String, String>, ArchiveError> {
        let mut profiles = BTreeMap::new();
        for entry in self.manifest.of_table(RUNS) {
            for batch in self.batches(entry)? {
                let texts = |row| ["run_id", "profile_toml"].map(|column| text_at(&batch, column, row));
                profiles.extend((0..batch.num_rows()).map(texts).map(|[id, text]| (id, text)));
            }
        }
        Ok(profiles)
    }

    /// One run as a recording: the same numbers as those of its run file and its CSV.
    pub(crate) fn recording(&self, run_id: &str) -> Result<Recording, ArchiveError> {
        let entry = self
            .manifest
            .of_table(SAMPLES)
            .find(|entry| entry.runs.iter().any(|run| run == run_id));
        let entry = entry.ok_or_else(|| ArchiveError::NoRun {
            place: self.store.name().to_owned(),
            run_id: run_id.to_owned(),
        })?;
        Ok(recording(run_id, &self.batches(entry)?))
    }

    /// All rows of an object, after its bytes were compared with the manifest.
    pub(super) fn batches(&self, entry: &ManifestEntry) -> Result<Vec<RecordBatch>, ArchiveError> {
        let changed = || ArchiveError::Changed {
            place: self.store.name().to_owned(),
            object: entry.path.clone(),
        };
        let content = self.store.get(&entry.path)?.ok_or_else(changed)?;
        if hash(&content) != entry.sha256 {
            return Err(changed());
        }
        let rows = || -> Result<Vec<RecordBatch>, ParquetError> {
            let reader = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(content))?.build()?;
            Ok(reader.collect::<Result<_, _>>()?)
        };
        rows().map_err(|source| ArchiveError::Parquet {
            what: "a table of the archive",
            source: Box::new(source),
        })
    }

    /// What the archive holds.
    pub(super) fn manifest(&self) -> &Manifest {
        &self.manifest
    }
}

fn archived_run(batch: &RecordBatch, row: usize) -> ArchivedRun {
    let text = |column: &str| text_at(batch, column, row);
    let started = batch
        .column_by_name("started_utc")
        .map(|c| c.as_primitive::<TimestampMicrosecondType>());
    let started = started.filter(|c| c.is_valid(row)).map(|c| c.value(row));
    let started = started.and_then(|at| jiff::Timestamp::from_microsecond(at).ok());
    ArchivedRun {
        run_id: text("run_id"),
        specimen: text("specimen_name"),
        bench: text("bench"),
        operator: text("operator"),
        started_utc: started.map(|at| at.to_string()).unwrap_or_default(),
        cycles_completed: whole_at(batch, "cycles_completed", row),
    }
}

/// The text of a cell; empty if there is none.
pub(super) fn text_at(batch: &RecordBatch, column: &str, row: usize) -> String {
    let column = batch
        .column_by_name(column)
        .and_then(|c| c.as_string_opt::<i32>());
    column
        .filter(|c| c.is_valid(row))
        .map(|c| c.value(row).to_owned())
        .unwrap_or_default()
}

/// The number of a cell.
pub(super) fn number_at(batch: &RecordBatch, column: &str, row: usize) -> Option<f64> {
    let column = batch.column_by_name(column)?.as_primitive_opt::<Float64Type>()?;
    column.is_valid(row).then(|| column.value(row))
}

/// The whole number of a cell; 0 if there is none.
pub(super) fn whole_at(batch: &RecordBatch, column: &str, row: usize) -> i64 {
    let column = batch
        .column_by_name(column)
        .and_then(|c| c.as_primitive_opt::<Int64Type>());
    column.filter(|c| c.is_valid(row)).map_or(0, |c| c.value(row))
}

fn recording(run_id: &str, batches: &[RecordBatch]) -> Recording {
    let whole = |column: &str| -> Vec<i64> {
        let arrays = batches.iter().filter_map(|batch| batch.column_by_name(column));
        arrays
            .flat_map(|array| array.as_primitive::<Int64Type>().values().to_vec())
            .collect()
    };
    let cycle = whole("cycle")
        .into_iter()
        .map(|c| u32::try_from(c).unwrap_or(u32::MAX));
    let flags = whole("flags")
        .into_iter()
        .map(|f| u16::try_from(f).unwrap_or(u16::MAX));
    // As in a CSV with the commands of both modes: those of the mode that came first.
    let commands = [Mode::Displacement, Mode::Force].map(|mode| {
        let column = match mode {
            Mode::Displacement => "command_mm",
            Mode::Force => "command_n",
        };
        (mode, decimals(batches, column))
    });
    let first = commands.into_iter().filter_map(|(mode, values)| {
        let at = values.iter().position(|value| !value.is_nan())?;
        Some((at, mode, values))
    });
    let first = first.min_by_key(|(at, ..)| *at);
    let (command_mode, command) = first.map(|(_, mode, values)| (mode, values)).unzip();
    Recording {
        name: run_id.to_owned(),
        time_s: decimals(batches, "time_s"),
        displacement_mm: decimals(batches, "displacement_mm"),
        force_n: decimals(batches, "force_n"),
        command,
        command_mode,
        cycle: Some(cycle.collect()),
        flags: Some(flags.collect()),
    }
}

/// The numbers of a column of decimals; NaN where there is none.
fn decimals(batches: &[RecordBatch], column: &str) -> Vec<f64> {
    let mut numbers = Vec::with_capacity(batches.iter().map(RecordBatch::num_rows).sum());
    for array in batches.iter().filter_map(|batch| batch.column_by_name(column)) {
        let array = array.as_primitive::<Decimal128Type>();
        let unit = 10f64.powi(i32::from(array.scale()));
        // A quotient of two whole numbers is rounded once, as the text of a CSV is.
        numbers.extend(
            array
                .iter()
                .map(|digits| digits.map_or(f64::NAN, |digits| digits as f64 / unit)),
        );
    }
    numbers
}
