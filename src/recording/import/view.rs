//! The table as it stands in the file, before a column is taken for anything: for a page that asks what is what.

use super::error::ImportError;
use super::layout::{self, TableLayout};
use super::text::{self, TextEncoding};

/// Rows that are shown.
const SHOWN_ROWS: usize = 8;

/// What a foreign file has in it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TableView {
    /// How the bytes were read as text.
    pub encoding: TextEncoding,
    /// Character between the columns.
    pub separator: char,
    /// Line of the header, from 1; `None` if there is none.
    pub header_row: Option<usize>,
    /// Line of the first sample, from 1.
    pub first_row: usize,
    /// Names of the columns, with their units.
    pub columns: Vec<String>,
    /// The first rows, a text for each cell.
    pub rows: Vec<Vec<String>>,
}

/// Looks at a foreign table. `name` is for messages.
pub(crate) fn view(name: &str, bytes: &[u8]) -> Result<TableView, ImportError> {
    let (text, encoding) = text::decode(name, bytes)?;
    let layout = layout::find(name, &text)?;
    Ok(TableView {
        encoding,
        separator: layout.separator,
        header_row: layout.header_row,
        first_row: layout.first_row,
        rows: first_rows(&text, &layout),
        columns: layout.columns.into_iter().map(|column| column.name).collect(),
    })
}

fn first_rows(text: &str, layout: &TableLayout) -> Vec<Vec<String>> {
    text.lines()
        .skip(layout.first_row - 1)
        .filter(|line| !line.trim().is_empty())
        .take(SHOWN_ROWS)
        .map(|line| {
            let cells = layout::cells(line, layout.separator);
            cells
                .iter()
                .take(layout.columns.len())
                .map(|cell| layout::shown(cell))
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_cannot_be_mapped_is_shown_all_the_same() {
        let text = "Bench 7\nWeg;Kraft;T1\n0,1;1,5;20\n0,2;3,0;20\n0,3;4,5;20\n";
        assert!(
            super::super::import("a.csv", text.as_bytes(), &super::super::ImportOptions::default()).is_err()
        );
        let seen = view("a.csv", text.as_bytes()).expect("a table");
        assert_eq!(
            (seen.separator, seen.header_row, seen.first_row),
            (';', Some(2), 3)
        );
        assert_eq!(seen.columns, ["Weg", "Kraft", "T1"]);
        assert_eq!(seen.rows[2], ["0,3", "4,5", "20"]);
    }
}
