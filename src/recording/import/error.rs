//! Reasons why a foreign table is refused: each says what is wrong, where, and what to do.

/// Why a foreign table cannot be read as a recording. `name` is the name of the file; rows are lines of the file, from 1.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ImportError {
    /// The bytes are no text in UTF-8, UTF-16 or Windows-1252.
    #[error(
        "{name}, row {row}: this is not text (a spreadsheet or a binary file?): save it as CSV or text in the program that wrote it"
    )]
    Binary { name: String, row: usize },
    /// No separator gives rows with two numbers or more.
    #[error(
        "{name}: no rows with numbers between tabs, semicolons, commas or bars were found: save the table as CSV with one row for \
         each sample"
    )]
    NoTable { name: String },
    /// Columns that cannot be mapped without the user's word.
    #[error(
        "{name}: {problem}. The columns are: {columns}. Type what they are, with the factor to s, mm and N where the unit is another \
         (force_n*1000 for kN): --map \"{proposal}\"{more}"
    )]
    Unmapped {
        name: String,
        /// What cannot be decided.
        problem: String,
        /// Names of all columns with their place, `#1 Weg [mm]`.
        columns: String,
        /// Text for `--map`.
        proposal: String,
        /// Further options that are needed, with a blank before them; may be empty.
        more: String,
    },
    /// `--map` names a column that the file does not have, or that several columns match.
    #[error("{name}: --map {column}: {problem}: use one of {columns}, or #1 for the first column")]
    Column {
        name: String,
        column: String,
        /// What is wrong with the name.
        problem: &'static str,
        columns: String,
    },
    /// The unit in the header is of another quantity than the target.
    #[error(
        "{name}: --map {column}={target}: the unit of the column is {unit}: choose another column, or write the factor behind it, \
         such as {target}*1"
    )]
    WrongQuantity {
        name: String,
        column: String,
        target: &'static str,
        unit: &'static str,
    },
    /// Two columns, or `--dt` and a column, for the same target.
    #[error("{name}: {target} is given twice: leave one of the two out")]
    Twice { name: String, target: &'static str },
    /// Neither a column of time nor a sample interval.
    #[error(
        "{name}: there is no column of time: give the time between two samples in s, such as --dt 0.001. The columns are: {columns}"
    )]
    NoTime { name: String, columns: String },
    /// Decimal points in one place and decimal commas in another.
    #[error(
        "{name}: {point:?} in row {point_row} has a decimal point and {comma:?} in row {comma_row} a decimal comma: say which one is \
         right with --decimal point or --decimal comma, or correct the cells"
    )]
    MixedDecimals {
        name: String,
        point: String,
        point_row: usize,
        comma: String,
        comma_row: usize,
    },
    #[error(
        "{name}, row {row}, column {column}: {text:?} is not {wanted}: correct the cell or remove the row"
    )]
    Cell {
        name: String,
        row: usize,
        column: String,
        /// The cell, shortened.
        text: String,
        /// "a number with a decimal comma".
        wanted: &'static str,
    },
    #[error(
        "{name}, row {row}: the row ends before column {column}: complete or remove the row (a decimal comma also splits a cell \
         where commas separate the columns)"
    )]
    ShortRow {
        name: String,
        row: usize,
        column: String,
    },
    #[error(
        "{name}, row {row}: {found} cells, and the header has {expected}: complete or remove the row (a decimal comma also splits a \
         cell where commas separate the columns)"
    )]
    LongRow {
        name: String,
        row: usize,
        found: usize,
        expected: usize,
    },
    #[error(
        "{name}, row {row}, column {column}: {time_s} s comes after {before_s} s, but time must rise from row to row: sort the rows, \
         or give the time between two samples instead, such as --dt 0.001"
    )]
    TimeNotRising {
        name: String,
        row: usize,
        column: String,
        time_s: f64,
        before_s: f64,
    },
    #[error("{name}: there are no samples below the header: export the recording again")]
    NoRows { name: String },
}
