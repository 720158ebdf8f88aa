//! Reads the mapped columns of a foreign table into a recording.

use super::error::ImportError;
use super::layout::{TableLayout, cells, shown};
use super::mapping::{MapTarget, MappedColumn};
use super::number::{self, DecimalSign, SignEvidence};
use crate::recording::Recording;

/// Digits that a product keeps: 1.234 kN becomes 1234 N, not 1233.9999999999998 N.
const PRODUCT_DIGITS: usize = 12;

/// The decimal sign of a table, and whether a cell proves it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FoundSign {
    pub sign: DecimalSign,
    /// False where every cell is a number with both signs, such as 1,234.
    pub proven: bool,
}

/// The rows of the table with their line numbers; blank lines are left out.
fn rows<'a>(text: &'a str, layout: &TableLayout) -> impl Iterator<Item = (usize, &'a str)> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line));
    numbered
        .skip(layout.first_row - 1)
        .filter(|(_, line)| !line.trim().is_empty())
}

/// The decimal sign of the mapped columns.
pub(super) fn decimal_sign(
    name: &str,
    text: &str,
    layout: &TableLayout,
    mapped: &[MappedColumn],
) -> Result<FoundSign, ImportError> {
    let mut certain: [Option<(String, usize)>; 2] = [None, None];
    let mut either = None;
    for (row, line) in rows(text, layout) {
        let cells = cells(line, layout.separator);
        for cell in mapped.iter().filter_map(|m| cells.get(m.index)) {
            // Of a clock time the seconds count.
            let cell = cell.rsplit(':').next().unwrap_or(cell);
            match number::evidence(cell) {
                SignEvidence::Certain(sign) => {
                    certain[usize::from(sign == DecimalSign::Comma)]
                        .get_or_insert_with(|| (shown(cell), row));
                }
                SignEvidence::Either { comma } => {
                    either.get_or_insert(comma);
                }
                SignEvidence::Nothing => {}
            }
        }
    }
    let found = |sign, proven| Ok(FoundSign { sign, proven });
    match (certain, either) {
        ([Some((point, point_row)), Some((comma, comma_row))], _) => Err(ImportError::MixedDecimals {
            name: name.to_owned(),
            point,
            point_row,
            comma,
            comma_row,
        }),
        ([Some(_), None], _) => found(DecimalSign::Point, true),
        ([None, Some(_)], _) => found(DecimalSign::Comma, true),
        // Whole numbers only: both signs give the same.
        ([None, None], None) => found(DecimalSign::Point, true),
        // 1,234 between semicolons: programs that write commas between the columns write points in numbers.
        ([None, None], Some(comma)) if comma && layout.separator != ',' => found(DecimalSign::Comma, false),
        ([None, None], Some(_)) => found(DecimalSign::Point, false),
    }
}

/// What is needed to read the cells.
pub(super) struct ValueReader<'a> {
    pub name: &'a str,
    pub layout: &'a TableLayout,
    pub mapped: &'a [MappedColumn],
    pub sign: DecimalSign,
    /// Time between two samples in s, where there is no column of time.
    pub interval_s: Option<f64>,
}

impl ValueReader<'_> {
    /// The recording, and the number of rows without any value, which are left out.
    pub(super) fn read(&self, text: &str) -> Result<(Recording, u64), ImportError> {
        let has_cycles = self.mapped.iter().any(|m| m.target == MapTarget::Cycle);
        let mut recording = Recording {
            name: self.name.to_owned(),
            cycle: has_cycles.then(Vec::new),
            ..Recording::default()
        };
        let mut empty_rows = 0;
        for (row, line) in rows(text, self.layout) {
            let cells = cells(line, self.layout.separator);
            let is_empty = |m: &MappedColumn| cells.get(m.index).is_none_or(|cell| cell.is_empty());
            if self.mapped.iter().all(is_empty) {
                empty_rows += 1;
                continue;
            }
            let filled = cells.iter().rposition(|c| !c.is_empty()).map_or(0, |i| i + 1);
            if filled > self.layout.columns.len() {
                return Err(ImportError::LongRow {
                    name: self.name.to_owned(),
                    row,
                    found: filled,
                    expected: self.layout.columns.len(),
                });
            }
            if let Some(interval_s) = self.interval_s {
                recording.time_s.push(time_of(recording.time_s.len(), interval_s));
            }
            for column in self.mapped {
                let cell = cells.get(column.index).ok_or_else(|| ImportError::ShortRow {
                    name: self.name.to_owned(),
                    row,
                    column: column.column.clone(),
                })?;
                self.push(column, cell, row, &mut recording)?;
            }
        }
        if recording.is_empty() {
            return Err(ImportError::NoRows {
                name: self.name.to_owned(),
            });
        }
        Ok((recording, empty_rows))
    }

    /// Adds one cell to its column of the recording.
    fn push(
        &self,
        column: &MappedColumn,
        cell: &str,
        row: usize,
        recording: &mut Recording,
    ) -> Result<(), ImportError> {
        let refused = |wanted| ImportError::Cell {
            name: self.name.to_owned(),
            row,
            column: column.column.clone(),
            text: shown(cell),
            wanted,
        };
        let clock = || number::clock_s(cell, self.sign).filter(|_| column.target == MapTarget::Time);
        let value = number::parse(cell, self.sign)
            .or_else(clock)
            .ok_or_else(|| refused(self.sign.wanted()))?;
        let value = scaled(value, column.factor);
        if !value.is_finite() {
            return Err(refused("a number that is finite in s, mm or N"));
        }
        match column.target {
            MapTarget::Time => {
                if let Some(&before_s) = recording.time_s.last()
                    && value <= before_s
                {
                    return Err(ImportError::TimeNotRising {
                        name: self.name.to_owned(),
                        row,
                        column: column.column.clone(),
                        time_s: value,
                        before_s,
                    });
                }
                recording.time_s.push(value);
            }
            MapTarget::Displacement => recording.displacement_mm.push(value),
            MapTarget::Force => recording.force_n.push(value),
            MapTarget::Cycle => {
                if value.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&value) {
                    return Err(refused("a whole number from 0"));
                }
                if let Some(cycle) = &mut recording.cycle {
                    cycle.push(value as u32);
                }
            }
        }
        Ok(())
    }
}

/// The value times the factor, without the digits that only the arithmetic of doubles makes.
fn scaled(value: f64, factor: f64) -> f64 {
    if factor == 1.0 {
        return value;
    }
    rounded(value * factor)
}

fn rounded(value: f64) -> f64 {
    let text = format!("{value:.*e}", PRODUCT_DIGITS - 1);
    text.parse().unwrap_or(value)
}

/// Time of a sample in s: a division keeps 0.001 s at three digits.
fn time_of(index: usize, interval_s: f64) -> f64 {
    rounded(index as f64 * interval_s)
}
