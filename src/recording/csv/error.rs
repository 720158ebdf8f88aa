//! Reasons why a CSV is refused: each says what is wrong, in which row and column, and what to do.

use super::NEEDED;

/// Why a CSV is not a recording. `name` is the name of the file; rows are lines of the file, the header is row 1.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    #[error("{name} cannot be read: check the path and the permissions")]
    Io { name: String, source: std::io::Error },
    /// The file has no row at all.
    #[error("{name}, row 1: the file is empty: write a header row with {} and one row for each sample", NEEDED.join(","))]
    Empty { name: String },
    /// The file has a header row and no other.
    #[error("{name}, row 2: there are no samples after the header row: export the recording again")]
    NoRows { name: String },
    #[error(
        "{name}, row {row}: this is not UTF-8 text (a spreadsheet or a binary file?): save it as CSV in UTF-8"
    )]
    NotText { name: String, row: u64 },
    /// The columns are not separated by commas.
    #[error(
        "{name}, row 1: the columns are separated by {separator:?}: save the file with commas between columns and \
         points in numbers"
    )]
    Separator { name: String, separator: char },
    #[error(
        "{name}, row 1: column {column} is missing, the file has {found}: rename the matching column to {column}"
    )]
    MissingColumn {
        name: String,
        column: &'static str,
        /// Names of the columns in the file, shortened.
        found: String,
    },
    /// The quantity is there in another unit.
    #[error(
        "{name}, row 1: column {found} has the wrong unit, {column} is needed: multiply it by {factor} and rename it to \
         {column}"
    )]
    WrongUnit {
        name: String,
        /// The column that is needed.
        column: &'static str,
        /// The column that is in the file.
        found: String,
        /// Factor from the unit found to the unit needed.
        factor: f64,
    },
    #[error("{name}, row 1: duplicate column {column}: rename or remove one of the two")]
    DuplicateColumn { name: String, column: String },
    /// A row with more or fewer cells than the header.
    #[error(
        "{name}, row {row}: the row has {found} cells and the header has {expected}: complete or remove the row (a decimal \
         comma also splits a cell: use points)"
    )]
    Ragged {
        name: String,
        row: u64,
        /// Number of cells in the header.
        expected: u64,
        /// Number of cells in the row.
        found: u64,
    },
    #[error("{name}, row {row}, column {column}: the cell is empty: enter the value or remove the row")]
    EmptyCell {
        name: String,
        row: u64,
        column: &'static str,
    },
    #[error("{name}, row {row}, column {column}: {text:?} has a decimal comma: use a point")]
    DecimalComma {
        name: String,
        row: u64,
        column: &'static str,
        text: String,
    },
    #[error(
        "{name}, row {row}, column {column}: {text:?} is not {wanted}: correct the cell or remove the row"
    )]
    NotANumber {
        name: String,
        row: u64,
        column: &'static str,
        /// The cell, shortened.
        text: String,
        /// "a number" or "a whole number from 0 to 65535".
        wanted: String,
    },
    /// NaN or infinite.
    #[error(
        "{name}, row {row}, column {column}: {text:?} is not a finite number: correct the cell or remove the row"
    )]
    NotFinite {
        name: String,
        row: u64,
        column: &'static str,
        text: String,
    },
    #[error(
        "{name}, row {row}, column time_s: {time_s} s comes after {before_s} s, but time must rise from row to row: sort \
         the rows by time_s and remove repeated ones"
    )]
    TimeNotRising {
        name: String,
        row: u64,
        time_s: f64,
        /// Time of the row before.
        before_s: f64,
    },
    #[error(
        "{name}, row {row}: the row is longer than {limit} bytes: check that the file is a CSV and that every quote is closed"
    )]
    LineTooLong {
        name: String,
        row: u64,
        /// Largest number of bytes in a row.
        limit: usize,
    },
    #[error(
        "{name}, row {row}: the file has more than {limit} samples: split the recording or export every n-th sample"
    )]
    TooManyRows {
        name: String,
        row: u64,
        /// Largest number of samples.
        limit: usize,
    },
}

impl CsvError {
    /// Name of the file, row, and column if the error is in one. Where the file cannot be read at all, the row is 1.
    pub(crate) fn place(&self) -> (&str, u64, Option<&str>) {
        match self {
            CsvError::Io { name, .. } | CsvError::Empty { name } | CsvError::Separator { name, .. } => {
                (name, 1, None)
            }
            CsvError::NoRows { name } => (name, 2, None),
            CsvError::MissingColumn { name, column, .. } | CsvError::WrongUnit { name, column, .. } => {
                (name, 1, Some(column))
            }
            CsvError::DuplicateColumn { name, column } => (name, 1, Some(column)),
            CsvError::NotText { name, row }
            | CsvError::Ragged { name, row, .. }
            | CsvError::LineTooLong { name, row, .. }
            | CsvError::TooManyRows { name, row, .. } => (name, *row, None),
            CsvError::EmptyCell { name, row, column }
            | CsvError::DecimalComma {
                name, row, column, ..
            }
            | CsvError::NotANumber {
                name, row, column, ..
            }
            | CsvError::NotFinite {
                name, row, column, ..
            } => (name, *row, Some(column)),
            CsvError::TimeNotRising { name, row, .. } => (name, *row, Some("time_s")),
        }
    }
}
