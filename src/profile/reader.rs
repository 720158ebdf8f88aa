//! The text of a profile file with the line and column of a place in it, for errors. `file` and `keys` read the values.

use std::ops::Range;

use super::ProfileError;

/// Line and column, both from 1, of a byte in `text`.
pub(crate) fn line_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(i, _)| *i < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

/// The text of a profile file, for errors with line and column.
pub(super) struct Reader<'a> {
    pub(super) text: &'a str,
    pub(super) name: &'a str,
}

impl Reader<'_> {
    pub(super) fn refuse(&self, span: Range<usize>, reason: impl Into<String>) -> ProfileError {
        let (line, column) = line_column(self.text, span.start);
        ProfileError::File {
            name: self.name.to_owned(),
            line,
            column,
            reason: reason.into(),
        }
    }
}
