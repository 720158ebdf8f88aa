//! The input of pooling: one row is one estimated quantity of one run, and its CSV table. `docs/fleet.md` describes the columns.
//!
//! Several recordings of one specimen on one bench on one day may be one row; `run_id` then names the first of them.

use std::collections::BTreeSet;
use std::io::{Read, Write};

use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use serde::Serialize;

/// One estimated quantity of one run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct EstimateRow {
    pub run_id: String,
    pub specimen: String,
    /// Specimens of one drawing.
    pub family: String,
    /// Specimens of a family that were made together; empty if it is not known.
    pub batch: String,
    pub bench: String,
    /// Who ran the test; empty if it is not known.
    pub operator: String,
    /// Start of the run.
    pub started_utc: Timestamp,
    /// Load cycles that the specimen had seen before the run, 0 or more.
    pub age_cycles: f64,
    /// `rate_n_per_mm`, `friction_ratio`, `preload_n`, `presliding_mm`, another parameter of a model, or the code of an effect, whose
    /// estimate is then the amplitude of one step from the model without it: 0 means that the effect is absent.
    pub quantity: String,
    /// Unit of the estimate, such as `N/mm`; `1` for a pure number.
    pub unit: String,
    pub estimate: f64,
    /// Standard error of the estimate within its run, in its unit, above 0.
    pub std_error: f64,
    /// The part of `std_error` that the runs of a family share, because the model is wrong in the same way in all of them; 0 if it is
    /// not known.
    pub form_error: f64,
    pub scale: EstimateScale,
}

/// How a quantity is pooled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EstimateScale {
    /// As its logarithm, with the standard error divided by the estimate: for quantities above 0 that an error of gain multiplies.
    Relative,
    /// As it is.
    Absolute,
}

impl EstimateScale {
    pub(crate) fn word(self) -> &'static str {
        match self {
            EstimateScale::Relative => "relative",
            EstimateScale::Absolute => "absolute",
        }
    }

    pub(crate) fn of_word(word: &str) -> Option<EstimateScale> {
        [EstimateScale::Relative, EstimateScale::Absolute]
            .into_iter()
            .find(|scale| scale.word() == word)
    }
}

/// Columns of the table, in the order in which they are written.
pub(crate) const ESTIMATE_COLUMNS: [&str; 13] = [
    "run_id",
    "specimen",
    "family",
    "batch",
    "bench",
    "operator",
    "started_utc",
    "age_cycles",
    "quantity",
    "unit",
    "estimate",
    "std_error",
    "scale",
];
/// Columns whose cells may be empty.
const MAY_BE_EMPTY: [&str; 2] = ["batch", "operator"];
/// Column that may be missing; it is written last.
const FORM_ERROR: &str = "form_error";

/// Why a table of estimates cannot be used. Rows are lines of the file; the header is row 1.
#[derive(Debug, thiserror::Error)]
pub(crate) enum EstimateTableError {
    /// The text is no CSV, or reading or writing failed.
    #[error("{file}: the table cannot be read or written: save it as CSV with commas, in UTF-8")]
    Csv {
        /// Name of the file.
        file: String,
        /// The error of the CSV reader, with its place.
        source: csv::Error,
    },
    /// A column is missing.
    #[error("{file}, row 1: the column {column} is missing: the header needs {}", ESTIMATE_COLUMNS.join(","))]
    Column {
        /// Name of the file.
        file: String,
        /// The missing column.
        column: &'static str,
    },
    /// A cell cannot be used.
    #[error("{file}, row {row}, column {column}: {problem}")]
    Cell {
        /// Name of the file.
        file: String,
        /// Line of the file, from 1.
        row: u64,
        /// Name of the column.
        column: &'static str,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The table has no rows.
    #[error("{0}: there are no rows below the header: add one row for each quantity of each run")]
    Empty(String),
}

/// Reads a table of estimates. Columns are found by name, in any order; others are ignored. `file` is its name in errors.
pub(crate) fn read_estimates(file: &str, from: impl Read) -> Result<Vec<EstimateRow>, EstimateTableError> {
    let csv_error = |source| EstimateTableError::Csv {
        file: file.to_owned(),
        source,
    };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(from);
    let headers = reader.headers().map_err(csv_error)?.clone();
    let place_of = |column: &str| {
        let mut headers = headers.iter();
        headers.position(|h| h.trim_start_matches('\u{feff}') == column)
    };
    let mut places = [0; ESTIMATE_COLUMNS.len()];
    for (place, column) in places.iter_mut().zip(ESTIMATE_COLUMNS) {
        *place = place_of(column).ok_or_else(|| EstimateTableError::Column {
            file: file.to_owned(),
            column,
        })?;
    }
    let form_error = place_of(FORM_ERROR);
    let mut rows: Vec<EstimateRow> = Vec::new();
    let mut seen = BTreeSet::new();
    for record in reader.records() {
        let record = record.map_err(csv_error)?;
        let cells = RowCells {
            file,
            row: record.position().map_or(0, csv::Position::line),
            record: &record,
            places: &places,
            form_error,
        };
        let row = cells.estimate_row()?;
        if !seen.insert((row.run_id.clone(), row.quantity.clone())) {
            let problem = format!(
                "run {} has {} already: one row for each quantity of a run",
                row.run_id, row.quantity
            );
            return Err(cells.refused("run_id", problem));
        }
        rows.push(row);
    }
    match rows.is_empty() {
        true => Err(EstimateTableError::Empty(file.to_owned())),
        false => Ok(rows),
    }
}

/// Writes a table that [`read_estimates`] reads to the same bits.
pub(crate) fn write_estimates(to: impl Write, rows: &[EstimateRow]) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(to);
    writer.write_record(ESTIMATE_COLUMNS.iter().chain([&FORM_ERROR]))?;
    for row in rows {
        writer.write_record([
            &row.run_id,
            &row.specimen,
            &row.family,
            &row.batch,
            &row.bench,
            &row.operator,
            &row.started_utc.to_string(),
            &row.age_cycles.to_string(),
            &row.quantity,
            &row.unit,
            &row.estimate.to_string(),
            &row.std_error.to_string(),
            row.scale.word(),
            &row.form_error.to_string(),
        ])?;
    }
    writer.flush()?;
    Ok(())
}

/// One row of the file, with its place for errors.
struct RowCells<'r> {
    file: &'r str,
    row: u64,
    record: &'r csv::StringRecord,
    places: &'r [usize; ESTIMATE_COLUMNS.len()],
    /// Place of the column that may be missing.
    form_error: Option<usize>,
}

impl RowCells<'_> {
    fn refused(&self, column: &'static str, problem: impl Into<String>) -> EstimateTableError {
        EstimateTableError::Cell {
            file: self.file.to_owned(),
            row: self.row,
            column,
            problem: problem.into(),
        }
    }

    fn text(&self, column: &'static str) -> Result<&str, EstimateTableError> {
        let index = ESTIMATE_COLUMNS.iter().position(|c| *c == column);
        let text = index
            .and_then(|i| self.record.get(self.places[i]))
            .unwrap_or_default();
        match text.is_empty() && !MAY_BE_EMPTY.contains(&column) {
            true => Err(self.refused(column, "the cell is empty: fill it in")),
            false => Ok(text),
        }
    }

    /// A finite number for which `allowed` holds; `rule` says what is allowed.
    fn number(
        &self,
        column: &'static str,
        rule: &str,
        allowed: fn(f64) -> bool,
    ) -> Result<f64, EstimateTableError> {
        let text = self.text(column)?;
        let number = text.parse::<f64>().ok().filter(|n| n.is_finite());
        number
            .filter(|n| allowed(*n))
            .ok_or_else(|| self.refused(column, format!("\"{text}\" is not {rule}: correct it")))
    }

    /// 0 without the column, and in an empty cell.
    fn form_error(&self, std_error: f64) -> Result<f64, EstimateTableError> {
        let cell = self.form_error.and_then(|place| self.record.get(place));
        let Some(text) = cell.filter(|text| !text.is_empty()) else {
            return Ok(0.0);
        };
        let number = text.parse::<f64>().ok();
        number.filter(|e| (0.0..=std_error).contains(e)).ok_or_else(|| {
            let problem = format!("\"{text}\" is not a number from 0 to std_error: correct it");
            self.refused(FORM_ERROR, problem)
        })
    }

    fn started(&self) -> Result<Timestamp, EstimateTableError> {
        let text = self.text("started_utc")?;
        let midnight = |date: Date| date.to_zoned(TimeZone::UTC).ok().map(|z| z.timestamp());
        let parsed = text.parse::<Timestamp>().ok();
        parsed.or_else(|| midnight(text.parse().ok()?)).ok_or_else(|| {
            let problem = format!("\"{text}\" is no time: write it as 2026-11-25T14:03:00Z or as 2026-11-25");
            self.refused("started_utc", problem)
        })
    }

    fn estimate_row(&self) -> Result<EstimateRow, EstimateTableError> {
        let word = self.text("scale")?;
        let scale = EstimateScale::of_word(word).ok_or_else(|| {
            self.refused(
                "scale",
                format!("\"{word}\" is no scale: write relative or absolute"),
            )
        })?;
        let estimate = match scale {
            EstimateScale::Relative => {
                self.number("estimate", "a number above 0, which scale relative needs", |n| {
                    n > 0.0
                })?
            }
            EstimateScale::Absolute => self.number("estimate", "a finite number", |_| true)?,
        };
        let std_error = self.number("std_error", "a number above 0", |n| n > 0.0)?;
        Ok(EstimateRow {
            run_id: self.text("run_id")?.to_owned(),
            specimen: self.text("specimen")?.to_owned(),
            family: self.text("family")?.to_owned(),
            batch: self.text("batch")?.to_owned(),
            bench: self.text("bench")?.to_owned(),
            operator: self.text("operator")?.to_owned(),
            started_utc: self.started()?,
            age_cycles: self.number("age_cycles", "a number of cycles, 0 or more", |n| n >= 0.0)?,
            quantity: self.text("quantity")?.to_owned(),
            unit: self.text("unit")?.to_owned(),
            estimate,
            std_error,
            form_error: self.form_error(std_error)?,
            scale,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "run_id,specimen,family,batch,bench,operator,started_utc,age_cycles,quantity,unit,estimate,std_error,scale";
    const ROW: &str = "r1,S1,F1,,B1,,2026-11-25T14:03:00Z,1200,rate_n_per_mm,N/mm,80.25,0.1,relative";

    fn read(text: &str) -> Result<Vec<EstimateRow>, EstimateTableError> {
        read_estimates("t.csv", text.as_bytes())
    }

    #[test]
    fn a_table_comes_back_to_the_same_bits() {
        let mut rows = read(&format!("{HEADER}\n{ROW}\n")).expect("a table");
        assert_eq!(rows[0].estimate, 80.25);
        rows[0].estimate = 0.1 + 0.2;
        rows[0].batch = "melt, \"7\"".to_owned();
        rows[0].form_error = 0.07;
        let mut text = Vec::new();
        write_estimates(&mut text, &rows).expect("written");
        assert_eq!(read_estimates("t.csv", &text[..]).expect("read"), rows);
    }

    #[test]
    fn columns_may_come_in_any_order_with_others_between_them() {
        let turned = |line: &str| {
            let mut cells: Vec<&str> = line.split(',').collect();
            cells.reverse();
            cells.insert(3, "other");
            cells.join(",")
        };
        let plain = read(&format!("{HEADER}\n{ROW}\n")).expect("a table");
        let text = format!("\u{feff}{}\n{}\n", turned(HEADER), turned(ROW));
        assert_eq!(read(&text).expect("a table"), plain);
    }

    #[test]
    fn a_date_is_midnight() {
        let row = ROW.replace("2026-11-25T14:03:00Z", "2026-11-25");
        let rows = read(&format!("{HEADER}\n{row}\n")).expect("a table");
        assert_eq!(rows[0].started_utc.to_string(), "2026-11-25T00:00:00Z");
    }

    #[test]
    fn an_error_names_row_column_and_repair() {
        let said = |from: &str, to: &str| {
            let text = format!("{HEADER}\n{ROW}\n{}\n", ROW.replace("r1", "r2").replace(from, to));
            read(&text).expect_err("refused").to_string()
        };
        assert_eq!(
            said("0.1,", "0,"),
            "t.csv, row 3, column std_error: \"0\" is not a number above 0: correct it"
        );
        assert_eq!(
            said("80.25", "-1"),
            "t.csv, row 3, column estimate: \"-1\" is not a number above 0, which scale relative needs: correct it"
        );
        assert_eq!(
            said("relative", "log"),
            "t.csv, row 3, column scale: \"log\" is no scale: write relative or absolute"
        );
        assert_eq!(
            said("S1", ""),
            "t.csv, row 3, column specimen: the cell is empty: fill it in"
        );
        assert!(said("2026-11-25T14:03:00Z", "yesterday").contains("write it as 2026-11-25T14:03:00Z"));
        let with_form_error = format!("{HEADER},form_error\n{ROW},0.2\n");
        assert_eq!(
            read(&with_form_error).expect_err("refused").to_string(),
            "t.csv, row 2, column form_error: \"0.2\" is not a number from 0 to std_error: correct it"
        );
        assert!(said("r2", "r1").contains("run r1 has rate_n_per_mm already"));
    }

    #[test]
    fn a_missing_column_and_an_empty_table_are_refused() {
        let text = format!("{}\n", HEADER.replace("std_error", "error"));
        let said = read(&text).expect_err("refused").to_string();
        assert!(said.contains("row 1: the column std_error is missing"), "{said}");
        let said = read(&format!("{HEADER}\n")).expect_err("refused").to_string();
        assert!(said.contains("there are no rows"), "{said}");
    }
}
