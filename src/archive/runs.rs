//! The table of runs: one row for each run, with its header, calibration and outcome.

use super::ArchiveError;
use super::parquet_file::{Form, ParquetFile, TableColumn, TableValue, needed, optional};
use crate::recording::run_file::{RunFile, Survey};
use crate::recording::{Ending, Header, Outcome, datapackage};

/// Columns of the table.
const COLUMNS: [TableColumn; 40] = [
    needed("run_id", Form::Text, ""),
    needed("specimen_name", Form::Text, ""),
    optional("started_utc", Form::Time, ""),
    needed("bench", Form::Text, ""),
    needed("operator", Form::Text, ""),
    needed("profile", Form::Text, ""),
    needed("twin", Form::Text, ""),
    needed("ending", Form::Text, ""),
    needed("cause", Form::Text, ""),
    needed("sample_rate_hz", Form::Number, "Hz"),
    needed("duration_planned_s", Form::Number, "s"),
    needed("samples", Form::Whole, "1"),
    needed("lost", Form::Whole, "1"),
    needed("late", Form::Whole, "1"),
    needed("flagged", Form::Whole, "1"),
    needed("cycles_completed", Form::Whole, "1"),
    needed("cycles_planned", Form::Whole, "1"),
    needed("first_cycle", Form::Whole, "1"),
    needed("resumes_run", Form::Text, ""),
    needed("continues", Form::Text, ""),
    needed("force_scale_per_count", Form::Number, "N"),
    needed("force_offset_n", Form::Number, "N"),
    needed("force_tare_n", Form::Number, "N"),
    needed("force_serial", Form::Text, ""),
    needed("force_certificate", Form::Text, ""),
    needed("displacement_scale_per_count", Form::Number, "mm"),
    needed("displacement_offset_mm", Form::Number, "mm"),
    needed("displacement_tare_mm", Form::Number, "mm"),
    needed("displacement_serial", Form::Text, ""),
    needed("displacement_certificate", Form::Text, ""),
    needed("calibration", Form::Text, ""),
    needed("firmware_serial", Form::Whole, "1"),
    needed("calibration_hash", Form::Text, ""),
    needed("program_version", Form::Text, ""),
    needed("bench_sha256", Form::Text, ""),
    needed("bench_toml", Form::Text, ""),
    needed("profile_toml", Form::Text, ""),
    needed("remarks", Form::Text, ""),
    needed("run_file_sha256", Form::Text, ""),
    needed("run_file_bytes", Form::Whole, "1"),
];

/// What the table needs of one run.
#[derive(Debug, Clone)]
pub(super) struct RunRow {
    pub header: Header,
    pub outcome: Outcome,
    /// Samples with any flag except that of a gap.
    pub flagged: u64,
    pub run_file_sha256: String,
    pub run_file_bytes: u64,
}

impl RunRow {
    /// Row of a closed run.
    pub(super) fn of(
        run: &RunFile,
        outcome: &Outcome,
        survey: &Survey,
        sha256: String,
        bytes: u64,
    ) -> RunRow {
        RunRow {
            header: run.header().clone(),
            outcome: outcome.clone(),
            flagged: survey.flagged,
            run_file_sha256: sha256,
            run_file_bytes: bytes,
        }
    }
}

/// Runs as the bytes of a Parquet file, and the number of its rows.
pub(super) fn file<'a>(rows: impl Iterator<Item = &'a RunRow>) -> Result<(Vec<u8>, u64), ArchiveError> {
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
    fn of(row: &RunRow) -> Texts {
        let header = &row.header;
        Texts {
            bench: bench_name(&header.bench_toml),
            calibration: datapackage::calibration(header).to_string(),
            calibration_hash: format!("{:#010x}", header.firmware.calibration_hash),
            remarks: header.remarks.join("; "),
        }
    }
}

fn values<'a>(row: &'a RunRow, texts: &'a Texts) -> [TableValue<'a>; 40] {
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
fn bench_name(bench_toml: &str) -> String {
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
