//! What a foreign table becomes, with everything that was decided on the way.

use super::mapping::MappedColumn;
use super::number::DecimalSign;
use super::text::TextEncoding;
use crate::recording::Recording;

/// A recording from a foreign table, with all that was decided on the way.
#[derive(Debug, Clone, serde::Serialize)]
pub(crate) struct Imported {
    #[serde(skip)]
    pub recording: Recording,
    /// How the bytes were read as text.
    pub encoding: TextEncoding,
    /// Character between the columns.
    pub separator: char,
    /// Decimal sign of the numbers.
    pub decimal: DecimalSign,
    /// Line of the header, from 1; `None` if there is none.
    pub header_row: Option<usize>,
    /// Line of the first sample, from 1.
    pub first_row: usize,
    /// The columns that were read.
    pub mapped: Vec<MappedColumn>,
    /// True where names and units decided, false where the user did.
    pub guessed: bool,
    /// Names of the columns that were not read.
    pub unused: Vec<String>,
    /// Time between two samples in s, where there is no column of time.
    pub interval_s: Option<f64>,
    /// Columns whose sign was turned.
    pub flipped: Vec<&'static str>,
    /// What the user should look at, one sentence each.
    pub notes: Vec<String>,
}

impl Imported {
    /// The text for `--map` that gives the same columns again.
    pub(crate) fn map_text(&self) -> String {
        let entries = self.mapped.iter().map(|m| match m.factor {
            1.0 => format!("{}={}", m.column, m.target.name()),
            factor => format!("{}={}*{factor}", m.column, m.target.name()),
        });
        entries.collect::<Vec<_>>().join(",")
    }
}
