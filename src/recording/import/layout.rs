//! Where the table is in a foreign text: separator, header, first row of numbers. Lines before the header are the preamble.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::error::ImportError;
use super::number::looks_numeric;
use super::unit::{self, ForeignUnit};

/// Characters that may separate columns, the likeliest first.
const SEPARATORS: [char; 4] = ['\t', ';', '|', ','];
/// Number of lines from which separator and width are taken.
const LOOKED_AT: usize = 400;
/// The table begins where so many rows in a row have its width.
const ROWS_ALIKE: usize = 3;
/// Fewest columns with numbers: displacement and force.
const LEAST_NUMBERS: usize = 2;
/// Messages show at most this many characters of a cell.
const SHOWN_CHARS: usize = 40;

/// A column of the table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ForeignColumn {
    /// The name as `--map` takes it; a unit from a row of its own is behind it in brackets.
    pub name: String,
    /// The name without its unit.
    pub bare: String,
    pub unit: Option<&'static ForeignUnit>,
}

/// Where the table is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TableLayout {
    pub separator: char,
    /// Line of the header, from 1; `None` if the first row has numbers already.
    pub header_row: Option<usize>,
    /// Line of the first sample, from 1.
    pub first_row: usize,
    pub columns: Vec<ForeignColumn>,
    /// Number of cells of a line above the numbers that looks like a header and has another width.
    pub other_header: Option<usize>,
}

impl TableLayout {
    /// Names of all columns with their places: `#1 Zeit [s], #2 Weg [mm]`.
    pub(super) fn names(&self) -> String {
        let named = self.columns.iter().enumerate();
        let names: Vec<String> = named.map(|(i, c)| format!("#{} {}", i + 1, c.name)).collect();
        names.join(", ")
    }
}

/// The cells of a line. A cell in quotes may have separators in it.
pub(super) fn cells(line: &str, separator: char) -> Vec<Cow<'_, str>> {
    if !line.contains('"') {
        return line.split(separator).map(|cell| cell.trim().into()).collect();
    }
    let (mut cells, mut cell, mut quoted) = (Vec::new(), String::new(), false);
    let mut rest = line.chars().peekable();
    while let Some(c) = rest.next() {
        match c {
            '"' if quoted && rest.peek() == Some(&'"') => {
                cell.push('"');
                rest.next();
            }
            '"' => quoted = !quoted,
            c if c == separator && !quoted => cells.push(std::mem::take(&mut cell).trim().to_owned().into()),
            c => cell.push(c),
        }
    }
    cells.push(cell.trim().to_owned().into());
    cells
}

/// Number of cells without the empty ones at the end, and how many of them are numbers.
fn measure(line: &str, separator: char) -> (usize, usize) {
    let cells = cells(line, separator);
    let width = cells
        .iter()
        .rposition(|cell| !cell.is_empty())
        .map_or(0, |i| i + 1);
    let numbers = cells.iter().filter(|cell| looks_numeric(cell)).count();
    (width, numbers)
}

/// Finds the table of a text.
pub(super) fn find(name: &str, text: &str) -> Result<TableLayout, ImportError> {
    let lines: Vec<(usize, &str)> = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
        .take(LOOKED_AT)
        .map(|(i, line)| (i + 1, line))
        .collect();
    let best = SEPARATORS
        .into_iter()
        .filter_map(|separator| Some((table_with(&lines, separator)?, separator)))
        // Of equals the first one.
        .rev()
        .max_by_key(|((_, numbers), _)| *numbers);
    let ((at, _), separator) = best.ok_or_else(|| ImportError::NoTable {
        name: name.to_owned(),
    })?;
    let above: Vec<(usize, &str)> = lines.iter().take(at).rev().copied().collect();
    let first_row = lines.get(at).map_or(1, |(row, _)| *row);
    let widths = lines.iter().skip(at).map(|(_, line)| measure(line, separator).0);
    let width = most_common(widths);
    let (header_row, columns) = header(&above, separator, width);
    let line_above = above
        .first()
        .filter(|(row, _)| header_row.is_none() && row + 1 == first_row);
    let header_cells = line_above.map(|(_, line)| measure(line, separator).0);
    Ok(TableLayout {
        separator,
        header_row,
        first_row,
        columns,
        other_header: header_cells.filter(|cells| *cells >= LEAST_NUMBERS),
    })
}

/// The value that occurs most often; of several the largest.
fn most_common(values: impl Iterator<Item = usize>) -> usize {
    let mut counts = BTreeMap::new();
    for value in values {
        *counts.entry(value).or_insert(0_usize) += 1;
    }
    let best = counts.into_iter().max_by_key(|(_, count)| *count);
    best.map_or(0, |(value, _)| value)
}

/// Index of the first row of the table, and the total of its numbers; `None` if the separator gives no table.
fn table_with(lines: &[(usize, &str)], separator: char) -> Option<(usize, usize)> {
    let sizes: Vec<(usize, usize)> = lines.iter().map(|(_, line)| measure(line, separator)).collect();
    let is_row = |&(width, numbers): &(usize, usize)| width >= LEAST_NUMBERS && numbers >= LEAST_NUMBERS;
    let alike = |rows: &[(usize, usize)]| {
        rows.iter().all(is_row) && rows.windows(2).all(|two| two[0].0.abs_diff(two[1].0) <= 1)
    };
    let begins = |at: &usize| {
        let end = (at + ROWS_ALIKE).min(sizes.len());
        alike(&sizes[*at..end])
    };
    let at = (0..sizes.len()).find(begins)?;
    let numbers = sizes[at..].iter().filter(|size| is_row(size)).map(|(_, n)| n);
    Some((at, numbers.sum()))
}

/// Row and columns of the header: the line above the numbers, or the two lines above them if the lower one has the units.
fn header(above: &[(usize, &str)], separator: char, width: usize) -> (Option<usize>, Vec<ForeignColumn>) {
    let names_in = |place: usize| {
        let (row, line) = above.get(place)?;
        let mut names: Vec<String> = cells(line, separator).iter().map(|c| c.to_string()).collect();
        // A header may be written as a comment.
        if let Some(first) = names.first_mut() {
            *first = first.trim_start_matches(['#', '%']).trim().to_owned();
        }
        let filled = names.iter().rposition(|n| !n.is_empty()).map_or(0, |i| i + 1);
        (filled >= LEAST_NUMBERS && filled.abs_diff(width) <= 1).then_some((*row, names))
    };
    let units_in = |names: &[String]| -> Option<Vec<Option<&'static ForeignUnit>>> {
        let units: Vec<_> = names.iter().map(|n| unit::in_brackets_or_bare(n)).collect();
        let known = units.iter().flatten().count();
        // `s;F` is a header of names and `s;kN` one of units: every cell is a unit, is in brackets, or is empty.
        let rest_is_unit = names.iter().zip(&units).all(|(name, unit)| {
            unit.is_some() || name.is_empty() || name.starts_with(['[', '(']) || name == "-" || name == "%"
        });
        (known >= LEAST_NUMBERS && rest_is_unit).then_some(units)
    };
    let padded = |mut names: Vec<String>| {
        let filled = names.iter().rposition(|n| !n.is_empty()).map_or(0, |i| i + 1);
        names.resize(width.max(filled), String::new());
        for (i, name) in names.iter_mut().enumerate().filter(|(_, name)| name.is_empty()) {
            *name = format!("column {}", i + 1);
        }
        names
    };
    match (names_in(0), names_in(1)) {
        (Some((_, below)), Some((row, names))) if units_in(&below).is_some() => {
            let mut units = units_in(&below).unwrap_or_default();
            let names = padded(names);
            units.resize(names.len(), None);
            let columns = names.iter().zip(units).map(|(name, unit)| column(name, unit));
            (Some(row), columns.collect())
        }
        (Some((row, names)), _) => {
            let columns = padded(names).iter().map(|name| column(name, None)).collect();
            (Some(row), columns)
        }
        _ => (
            None,
            padded(Vec::new()).iter().map(|name| column(name, None)).collect(),
        ),
    }
}

/// A column from its name; a unit of a row below the names is added to it.
fn column(name: &str, below: Option<&'static ForeignUnit>) -> ForeignColumn {
    let (bare, own) = unit::split_name(name);
    let full = match (below, own) {
        (Some(unit), None) => format!("{name} [{}]", unit.name),
        _ => name.to_owned(),
    };
    ForeignColumn {
        name: full,
        bare: bare.to_owned(),
        unit: own.or(below),
    }
}

/// A cell for a message, cut after [`SHOWN_CHARS`] characters.
pub(super) fn shown(cell: &str) -> String {
    let mut short: String = cell.chars().take(SHOWN_CHARS).collect();
    if short.len() < cell.len() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> TableLayout {
        find("f.csv", text).expect("a table")
    }

    #[test]
    fn the_separator_is_the_one_that_gives_the_most_numbers() {
        for (text, separator, first_row) in [
            ("t;x;F\n0,0;1,5;2\n0,1;1,6;3\n", ';', 2),
            ("t\tx\tF\n0,0\t1,5\t2\n0,1\t1,6\t3\n", '\t', 2),
            ("t,x,F\n0.0,1.5,2\n0.1,1.6,3\n", ',', 2),
            ("t,x,F\n\"0,0\",\"1,5\",2\n\"0,1\",\"1,6\",3\n", ',', 2),
            ("0.0|1.5|2\n0.1|1.6|3\n", '|', 1),
        ] {
            let layout = found(text);
            assert_eq!(
                (layout.separator, layout.first_row),
                (separator, first_row),
                "{text}"
            );
            assert_eq!(layout.columns.len(), 3, "{text}");
        }
    }

    #[test]
    fn a_preamble_and_a_row_of_units_are_not_samples() {
        let text = "Bench 7\nRate;1000\nDate;2024;11\n\nTime;Weg;Kraft\ns;mm;kN\n0;1;2\n1;2;3\n2;3;4\n";
        let layout = found(text);
        assert_eq!((layout.header_row, layout.first_row), (Some(5), 7));
        assert_eq!(layout.names(), "#1 Time [s], #2 Weg [mm], #3 Kraft [kN]");
        assert_eq!(layout.columns[2].bare, "Kraft");
        let comment = found("# made by hand\n# time_s, x\n0,1\n1,2\n");
        assert_eq!(comment.names(), "#1 time_s, #2 x");
        assert_eq!(comment.columns[0].unit.map(|u| u.name), Some("s"));
    }

    #[test]
    fn a_table_without_a_header_has_numbered_columns() {
        let layout = found("0;1;2\n1;2;3\n");
        assert_eq!(layout.header_row, None);
        assert_eq!(layout.names(), "#1 column 1, #2 column 2, #3 column 3");
    }

    #[test]
    fn text_without_numbers_is_no_table() {
        for text in ["", "a;b\nc;d\n", "1\n2\n3\n"] {
            assert!(
                matches!(find("f", text), Err(ImportError::NoTable { .. })),
                "{text:?}"
            );
        }
    }
}
