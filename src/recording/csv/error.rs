//! What can be wrong with a CSV: which row, which column, and what to do.

/// Why a CSV is no recording. Rows are lines of the file, counted from 1; the header row is line 1.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CsvError {
    /// The file cannot be read.
    #[error("{name} cannot be read: check the path and the rights")]
    Io {
        /// The file.
        name: String,
        /// The system's own words.
        source: std::io::Error,
    },
    /// No header row.
    #[error(
        "{name} is empty: a recording has a header row with time_s,displacement_mm,force_n and a row a sample"
    )]
    Empty {
        /// The file.
        name: String,
    },
    /// A header row and nothing else.
    #[error("{name} has a header row and no samples: export the recording again")]
    NoRows {
        /// The file.
        name: String,
    },
    /// Not UTF-8 text.
    #[error(
        "{name}, row {row}: this is not UTF-8 text (a spreadsheet or a binary file?): save it as CSV, UTF-8"
    )]
    NotText {
        /// The file.
        name: String,
        /// Line.
        row: u64,
    },
    /// Another separator than a comma.
    #[error(
        "{name}, row 1: the columns are separated by {separator:?}: save the file with commas between columns and \
         points in numbers"
    )]
    Separator {
        /// The file.
        name: String,
        /// What stands there.
        separator: char,
    },
    /// A needed column is not there.
    #[error("{name}, row 1: column {column} is missing; there are {found}: name the column so")]
    MissingColumn {
        /// The file.
        name: String,
        /// The column needed.
        column: &'static str,
        /// What is there.
        found: String,
    },
    /// The quantity is there in another unit.
    #[error(
        "{name}, row 1: column {found} has the wrong unit, {column} is needed: multiply it by {factor} and name it \
         {column}"
    )]
    WrongUnit {
        /// The file.
        name: String,
        /// The column needed.
        column: &'static str,
        /// The column that is there.
        found: String,
        /// From the found unit to the needed one.
        factor: f64,
    },
    /// Two columns of one name.
    #[error("{name}, row 1: column {column} stands there twice: rename or remove one")]
    DuplicateColumn {
        /// The file.
        name: String,
        /// The column.
        column: String,
    },
    /// A row with more or fewer cells than the header.
    #[error(
        "{name}, row {row}: {found} cells where the header has {expected}: complete or remove the row (decimal commas \
         also do this: use points)"
    )]
    Ragged {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Cells in the header.
        expected: u64,
        /// Cells in the row.
        found: u64,
    },
    /// A cell that needs a value has none.
    #[error("{name}, row {row}, column {column}: the cell is empty: remove the row or enter the value")]
    EmptyCell {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Column.
        column: &'static str,
    },
    /// A comma within a number.
    #[error("{name}, row {row}, column {column}: {text:?} has a decimal comma: use a point")]
    DecimalComma {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Column.
        column: &'static str,
        /// The cell.
        text: String,
    },
    /// No number at all.
    #[error(
        "{name}, row {row}, column {column}: {text:?} is not {wanted}: correct the cell or remove the row"
    )]
    NotANumber {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Column.
        column: &'static str,
        /// The cell, shortened.
        text: String,
        /// "a number", "a whole number".
        wanted: &'static str,
    },
    /// NaN or infinite.
    #[error("{name}, row {row}, column {column}: {text:?} is not a finite number: remove the row")]
    NotFinite {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Column.
        column: &'static str,
        /// The cell.
        text: String,
    },
    /// Time stands still or runs back.
    #[error(
        "{name}, row {row}, column time_s: {time_s} s comes after {before_s} s: time must rise from row to row; sort \
         the rows or remove the repeated ones"
    )]
    TimeNotRising {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// This row's time.
        time_s: f64,
        /// The row before.
        before_s: f64,
    },
    /// A line that no recording has.
    #[error(
        "{name}, row {row}: the line is longer than {limit} bytes: this is no recording, or a quote is not closed"
    )]
    LineTooLong {
        /// The file.
        name: String,
        /// Line.
        row: u64,
        /// Most bytes of a line.
        limit: usize,
    },
    /// More rows than fit in memory.
    #[error("{name}: more than {limit} rows: split the recording or export every n-th sample")]
    TooManyRows {
        /// The file.
        name: String,
        /// Most rows.
        limit: usize,
    },
}
