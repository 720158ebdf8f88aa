//! The table of runs: one row for each run, with its header, calibration and outcome.

use super::ArchiveError;
use super::parquet_file::{ColumnForm, ParquetFile, TableColumn, TableValue, needed, optional};
use crate::recording::run_file::{RunFile, Survey};
use crate::recording::{Ending, Header, Outcome, datapackage};

/// Columns of the table.
const COLUMNS: [TableColumn; 40] = [
    needed("run_id", ColumnForm::Text, ""),
    needed("specimen_name", ColumnForm::Text, ""),
    optional("started_utc", ColumnForm::Time, ""),
    needed("bench", ColumnForm::Text, ""),
    needed("operator", ColumnForm::Text, ""),
    needed("profile", ColumnForm::Text, ""),
    needed("twin", ColumnForm::Text, ""),
    needed("ending", ColumnForm::Text, ""),
    needed("cause", ColumnForm::Text, ""),
    needed("sample_rate_hz", ColumnForm::Number, "Hz"),
    needed("duration_planned_s", ColumnForm::Number, "s"),
    needed("samples", ColumnForm::Whole, "1"),
    needed("lost", ColumnForm::Whole, "1"),
    needed("late", ColumnForm::Whole, "1"),
    needed("flagged", ColumnForm::Whole, "1"),
    needed("cycles_completed", ColumnForm::Whole, "1"),
    needed("cycles_planned", ColumnForm::Whole, "1"),
    needed("first_cycle", ColumnForm::Whole, "1"),
    needed("resumes_run", ColumnForm::Text, ""),
    needed("continues", ColumnForm::Text, ""),
    needed("force_scale_per_count", ColumnForm::Number, "N"),
    needed("force_offset_n", ColumnForm::Number, "N"),
    needed("force_tare_n", ColumnForm::Number, "N"),
    needed("force_serial", ColumnForm::Text, ""),
    needed("force_certificate", ColumnForm::Text, ""),
    needed("displacement_scale_per_count", ColumnForm::Number, "mm"),
    needed("displacement_offset_mm", ColumnForm::Number, "mm"),
    needed("displacement_tare_mm", ColumnForm::Number, "mm"),
    needed("displacement_serial", ColumnForm::Text, ""),
    needed("displacement_certificate", ColumnForm::Text, ""),
    needed("calibration", ColumnForm::Text, ""),
    needed("firmware_serial", ColumnForm::Whole, "1"),
    needed("calibration_hash", ColumnForm::Text, ""),
    needed("program_version", ColumnForm::Text, ""),
    needed("bench_sha256", ColumnForm::Text, ""),
    needed("bench_toml", ColumnForm::Text, ""),
    needed("profile_toml", ColumnForm::Text, ""),
    needed("remarks", ColumnForm::Text, ""),
    needed("run_file_sha256", ColumnForm::Text, ""),
    needed("run_file_bytes", ColumnForm::Whole, "1"),
];

/// What the table needs of one run.
#[derive(Debug, Clone)]
pub(super) struct ArchiveRow {
    pub header: Header,
    pub outcome: Outcome,
    /// Samples with any flag except that of a gap.
    pub flagged: u64,
    pub run_file_sha256: String,
    pub run_file_bytes: u64,
}

impl ArchiveRow {
    /// Row of a closed run.
    pub(super) fn of(
        run: &RunFile,
        outcome: &Outcome,
        survey: &Survey,
        sha256: String,
        bytes: u64,
    ) -> ArchiveRow {
        ArchiveRow {
            header: run.header().clone(),
            outcome: outcome.clone(),
            flagged: survey.flagged,
            run_file_sha256: sha256,
            run_file_bytes: bytes,
        }
    }
}

/// Runs as the bytes of a Parquet file, and the number of its rows.
pub(super) fn file<'a>(rows: impl Iterator<Item = &'a ArchiveRow>) -> Result<(Vec<u8>, u64), ArchiveError> {
    let mut file = ParquetFile::new(&COLUMNS, &[])?;
    for row in rows {
        let texts = Texts::of(row);
        file.row(&values(row, &texts))?;
    }
    file.finish()
}

/// Texts that a row has to make first.
struct Texts {
    bench: String,
    calibration: String,
    calibration_hash: String,
    remarks: String,
}

impl Texts {
    fn of(row: &ArchiveRow) -> Texts {
        let header = &row.header;
        Texts {
            bench: bench_name(&header.bench_toml),
            calibration: datapackage::calibration(header).to_string(),
            calibration_hash: format!("{:#010x}", header.firmware.calibration_hash),
            remarks: header.remarks.join("; "),
        }
    }
}

fn values<'a>(row: &'a ArchiveRow, texts: &'a Texts) -> [TableValue<'a>; 40] {
    use TableValue::{Number, Text};
    let (h, o) = (&row.header, &row.outcome);
    let count = |number: u64| TableValue::Whole(number.cast_signed());
    let few = |number: u32| TableValue::Whole(i64::from(number));
    [
        Text(&h.run_id),
        Text(&h.specimen),
        microseconds(&h.started_utc).map_or(TableValue::Empty, TableValue::Whole),
        Text(&texts.bench),
        Text(&h.operator),
        Text(&h.profile_name),
        Text(&h.twin),
        Text(ending(o.ending)),
        Text(&o.cause),
        Number(h.sample_rate_hz),
        Number(h.duration_planned_s),
        count(o.samples),
        count(o.lost),
        count(o.late),
        count(row.flagged),
        few(o.cycles_completed),
        few(h.cycles_planned),
        few(h.first_cycle),
        Text(&h.resumes_run),
        Text(&h.continues),
        Number(h.force_channel.scale_per_count),
        Number(h.force_channel.offset),
        Number(h.force_channel.tare),
        Text(&h.force_sensor.serial),
        Text(&h.force_sensor.certificate),
        Number(h.displacement_channel.scale_per_count),
        Number(h.displacement_channel.offset),
        Number(h.displacement_channel.tare),
        Text(&h.displacement_sensor.serial),
        Text(&h.displacement_sensor.certificate),
        Text(&texts.calibration),
        few(h.firmware.serial),
        Text(&texts.calibration_hash),
        Text(&h.program_version),
        Text(&h.bench_sha256),
        Text(&h.bench_toml),
        Text(&h.profile_toml),
        Text(&texts.remarks),
        Text(&row.run_file_sha256),
        count(row.run_file_bytes),
    ]
}

/// Name of a bench from the text of its file; empty if the text has none.
pub(crate) fn bench_name(bench_toml: &str) -> String {
    let table: Option<toml::Table> = bench_toml.parse().ok();
    let name = table
        .as_ref()
        .and_then(|t| t.get("name"))
        .and_then(|n| n.as_str());
    name.unwrap_or_default().to_owned()
}

/// Microseconds since 1970 of a time in RFC 3339.
fn microseconds(utc: &str) -> Option<i64> {
    let time: jiff::Timestamp = utc.parse().ok()?;
    Some(time.as_microsecond())
}

fn ending(ending: Ending) -> &'static str {
    match ending {
        Ending::Completed => "completed",
        Ending::Stopped => "stopped",
        Ending::Aborted => "aborted",
    }
}
