//! The table of cycles: one row for each counted cycle of the cycles CSV, with the same names.

use std::collections::BTreeMap;

use arrow_array::RecordBatch;

use super::parquet_file::{ColumnForm, ParquetFile, TableColumn, TableValue, needed, optional};
use super::partition::CYCLES;
use super::read::{number_at, text_at, whole_at};
use super::{ArchiveError, ArchiveReader};
use crate::recording::cycles::CycleSummary;
use crate::recording::metrics::Range;

/// Complete cycles by run id.
pub(crate) type ArchivedCycles = BTreeMap<String, Vec<CycleSummary>>;

impl ArchiveReader<'_> {
    /// The complete cycles of all runs by run id, in their order.
    pub(crate) fn cycles(&self) -> Result<ArchivedCycles, ArchiveError> {
        let mut cycles = ArchivedCycles::new();
        for entry in self.manifest().of_table(CYCLES) {
            for batch in self.batches(entry)? {
                for row in (0..batch.num_rows()).filter(|row| whole_at(&batch, "complete", *row) == 1) {
                    let of_run = cycles.entry(text_at(&batch, "run_id", row)).or_default();
                    of_run.extend(cycle_at(&batch, row));
                }
            }
        }
        Ok(cycles)
    }
}

/// The complete cycle of a row; `None` if a value is missing.
fn cycle_at(batch: &RecordBatch, row: usize) -> Option<CycleSummary> {
    let number = |column: &str| number_at(batch, column, row);
    let count = |column: &str| u64::try_from(whole_at(batch, column, row)).ok();
    let range = |channel: [&str; 2]| {
        Some(Range {
            peak: number(channel[0])?,
            valley: number(channel[1])?,
        })
    };
    Some(CycleSummary {
        cycle: u32::try_from(whole_at(batch, "cycle", row)).ok()?,
        from_s: number("from_s")?,
        to_s: number("to_s")?,
        samples: count("samples")?,
        lost: count("lost")?,
        excluded: count("excluded")?,
        complete: true,
        displacement_mm: range(["displacement_peak_mm", "displacement_valley_mm"])?,
        force_n: range(["force_peak_n", "force_valley_n"])?,
        loop_energy_j: number("loop_energy_j")?,
        secant_rate_n_per_mm: number("secant_rate_n_per_mm"),
        twin_nrmse: number("twin_nrmse"),
    })
}

/// Columns of the table.
const COLUMNS: [TableColumn; 19] = [
    needed("run_id", ColumnForm::Text, ""),
    needed("cycle", ColumnForm::Whole, "1"),
    needed("from_s", ColumnForm::Number, "s"),
    needed("to_s", ColumnForm::Number, "s"),
    needed("samples", ColumnForm::Whole, "1"),
    needed("lost", ColumnForm::Whole, "1"),
    needed("excluded", ColumnForm::Whole, "1"),
    needed("complete", ColumnForm::Whole, "1"),
    optional("displacement_peak_mm", ColumnForm::Number, "mm"),
    optional("displacement_valley_mm", ColumnForm::Number, "mm"),
    optional("displacement_amplitude_mm", ColumnForm::Number, "mm"),
    optional("displacement_mean_mm", ColumnForm::Number, "mm"),
    optional("force_peak_n", ColumnForm::Number, "N"),
    optional("force_valley_n", ColumnForm::Number, "N"),
    optional("force_amplitude_n", ColumnForm::Number, "N"),
    optional("force_mean_n", ColumnForm::Number, "N"),
    optional("loop_energy_j", ColumnForm::Number, "J"),
    optional("secant_rate_n_per_mm", ColumnForm::Number, "N/mm"),
    optional("twin_nrmse", ColumnForm::Number, "1"),
];

/// The cycles of several runs as the bytes of a Parquet file, and the number of its rows.
pub(super) fn file<'a>(
    runs: impl Iterator<Item = (&'a str, &'a [CycleSummary])>,
) -> Result<(Vec<u8>, u64), ArchiveError> {
    let mut file = ParquetFile::new(&COLUMNS, &[])?;
    for (run_id, cycles) in runs {
        for cycle in cycles {
            file.row(&row(run_id, cycle))?;
        }
    }
    file.finish()
}

fn row<'a>(run_id: &'a str, c: &CycleSummary) -> [TableValue<'a>; 19] {
    let count = |number: u64| TableValue::Whole(number.cast_signed());
    let number = |value: f64| TableValue::finite(Some(value));
    [
        TableValue::Text(run_id),
        count(u64::from(c.cycle)),
        number(c.from_s),
        number(c.to_s),
        count(c.samples),
        count(c.lost),
        count(c.excluded),
        count(u64::from(c.complete)),
        number(c.displacement_mm.peak),
        number(c.displacement_mm.valley),
        number(c.displacement_mm.amplitude()),
        number(c.displacement_mm.mean()),
        number(c.force_n.peak),
        number(c.force_n.valley),
        number(c.force_n.amplitude()),
        number(c.force_n.mean()),
        number(c.loop_energy_j),
        TableValue::finite(c.secant_rate_n_per_mm),
        TableValue::finite(c.twin_nrmse),
    ]
}
