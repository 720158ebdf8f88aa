//! The table of samples: one file for each run, one row for each sample.

use super::ArchiveError;
use super::parquet_file::{ColumnForm, ParquetFile, TableColumn, TableValue, needed, optional};
use crate::recording::Sample;
use crate::recording::csv::CsvFormat;
use crate::recording::run_file::{RunFile, Survey};
use crate::units::Mode;

/// Digits behind the point of a force in N: 1 mN.
const FORCE_DIGITS: u8 = 3;
/// Digits behind the point of a displacement in mm: 10 nm. A sixth digit costs 0.4 bytes a sample and no sensor of a frame has it.
const DISPLACEMENT_DIGITS: u8 = 5;
/// Digits behind the point of a time in s: 1 us.
const TIME_DIGITS: u8 = 6;
/// The largest number of 18 digits.
const LARGEST: f64 = 1e18;

/// Columns of the table.
const COLUMNS: [TableColumn; 11] = [
    needed("run_id", ColumnForm::Text, ""),
    needed("tick", ColumnForm::Whole, "1"),
    needed("time_s", ColumnForm::Decimal(TIME_DIGITS), "s"),
    needed("displacement_mm", ColumnForm::Decimal(DISPLACEMENT_DIGITS), "mm"),
    needed("force_n", ColumnForm::Decimal(FORCE_DIGITS), "N"),
    optional("command_mm", ColumnForm::Decimal(DISPLACEMENT_DIGITS), "mm"),
    optional("command_n", ColumnForm::Decimal(FORCE_DIGITS), "N"),
    needed("cycle", ColumnForm::Whole, "1"),
    needed("segment", ColumnForm::Whole, "1"),
    optional("twin_force_n", ColumnForm::Decimal(FORCE_DIGITS), "N"),
    needed("flags", ColumnForm::Whole, "1"),
];

/// A run as the bytes of a Parquet file, and the number of its rows.
pub(super) fn file(run: &RunFile, survey: &Survey) -> Result<(Vec<u8>, u64), ArchiveError> {
    let header = run.header();
    let facts = [
        ("run_id", header.run_id.as_str()),
        ("specimen", &header.specimen),
        ("started_utc", &header.started_utc),
        ("bench_toml", &header.bench_toml),
        ("profile_toml", &header.profile_toml),
    ];
    let mut file = ParquetFile::new(&COLUMNS, &facts)?;
    let digits = Digits::of(&CsvFormat::new(header, &survey.modes));
    for sample in run.samples() {
        let row = digits.row(&header.run_id, &sample)?;
        file.row(&row)?;
    }
    file.finish()
}

/// Digits of the numbers of one run: those of its CSV, so that both have the same numbers, as far as the columns go.
struct Digits {
    time: Rounding,
    displacement: Rounding,
    force: Rounding,
}

impl Digits {
    fn of(csv: &CsvFormat) -> Digits {
        Digits {
            time: Rounding::new(csv.time_decimals, TIME_DIGITS),
            displacement: Rounding::new(csv.displacement_decimals, DISPLACEMENT_DIGITS),
            force: Rounding::new(csv.force_decimals, FORCE_DIGITS),
        }
    }

    fn row<'a>(&self, run_id: &'a str, sample: &Sample) -> Result<[TableValue<'a>; 11], ArchiveError> {
        let number = |column: &'static str, rounding: &Rounding, value: f64| {
            let digits = rounding.digits(value);
            digits
                .map(TableValue::Whole)
                .ok_or_else(|| ArchiveError::OutOfRange {
                    run: run_id.to_owned(),
                    column,
                    value,
                    sample: sample.tick,
                })
        };
        let command = |mode: Mode, column: &'static str, rounding: &Rounding| {
            let command = sample.command.filter(|command| command.mode() == mode);
            command.map_or(Ok(TableValue::Empty), |c| number(column, rounding, c.value()))
        };
        let twin_n = sample.twin_force_n.filter(|force_n| force_n.is_finite());
        Ok([
            TableValue::Text(run_id),
            TableValue::Whole(sample.tick.cast_signed()),
            number("time_s", &self.time, sample.time_s)?,
            number("displacement_mm", &self.displacement, sample.displacement_mm)?,
            number("force_n", &self.force, sample.force_n)?,
            command(Mode::Displacement, "command_mm", &self.displacement)?,
            command(Mode::Force, "command_n", &self.force)?,
            TableValue::Whole(i64::from(sample.cycle)),
            TableValue::Whole(i64::from(sample.segment)),
            twin_n.map_or(Ok(TableValue::Empty), |n| number("twin_force_n", &self.force, n))?,
            TableValue::Whole(i64::from(sample.flags.bits())),
        ])
    }
}

/// Rounds to the decimals of the CSV and gives the digits of the column.
struct Rounding {
    unit: f64,
    factor: i64,
}

impl Rounding {
    fn new(csv_decimals: u32, column_digits: u8) -> Rounding {
        let digits = u32::from(column_digits);
        let kept = csv_decimals.min(digits);
        Rounding {
            unit: 10u64.pow(kept) as f64,
            factor: 10i64.pow(digits - kept),
        }
    }

    /// `None` if the number is not finite or has more digits than the column.
    fn digits(&self, value: f64) -> Option<i64> {
        let scaled = (value.abs() * self.unit).round();
        let fits = scaled * (self.factor as f64) < LARGEST;
        fits.then(|| (scaled.copysign(value) as i64) * self.factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_as_in_the_csv() {
        let force = Rounding::new(2, FORCE_DIGITS);
        assert_eq!(force.digits(-1234.567), Some(-1_234_570));
        assert_eq!(force.digits(0.004), Some(0));
        // A finer CSV than the column: the column's digits count.
        let fine = Rounding::new(5, FORCE_DIGITS);
        assert_eq!(fine.digits(0.12345), Some(123));
        assert_eq!(force.digits(f64::NAN), None);
        assert_eq!(force.digits(f64::INFINITY), None);
        assert_eq!(force.digits(1e15), None);
        assert!(force.digits(9e14).is_some());
    }
}
