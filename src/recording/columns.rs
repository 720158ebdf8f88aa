//! The columns that exports write: name, type of number, unit and description, for CSV, Parquet and MDF alike.

use super::csv::NEEDED;

/// Type of the numbers in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColumnKind {
    /// A double of 64 bits.
    Number,
    /// A whole number of 32 bits, at least 0.
    Whole32,
    /// A whole number of 16 bits, at least 0.
    Whole16,
}

impl ColumnKind {
    /// The type of Table Schema.
    pub(crate) fn json_type(self) -> &'static str {
        match self {
            ColumnKind::Number => "number",
            ColumnKind::Whole32 | ColumnKind::Whole16 => "integer",
        }
    }
}

/// What a row has in one column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Cell {
    /// A finite number.
    Number(f64),
    Whole(u32),
    /// No value, only in a column that may be empty.
    Empty,
}

impl Cell {
    /// A number; empty if there is none or if it is not finite.
    pub(crate) fn finite(value: Option<f64>) -> Cell {
        value.filter(|v| v.is_finite()).map_or(Cell::Empty, Cell::Number)
    }
}

/// A column of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Column {
    pub name: &'static str,
    pub kind: ColumnKind,
    /// The unit; `1` for a pure number.
    pub unit: &'static str,
    pub description: &'static str,
}

impl Column {
    /// True if a row may have no value in this column.
    pub(crate) fn may_be_empty(&self) -> bool {
        self.kind == ColumnKind::Number && !NEEDED.contains(&self.name)
    }
}

/// The column of this name.
pub(crate) fn find(name: &str) -> Option<&'static Column> {
    COLUMNS.iter().find(|column| column.name == name)
}

const fn column(
    name: &'static str,
    kind: ColumnKind,
    unit: &'static str,
    description: &'static str,
) -> Column {
    Column {
        name,
        kind,
        unit,
        description,
    }
}

/// All columns that exports write.
const COLUMNS: &[Column] = &[
    column(
        "time_s",
        ColumnKind::Number,
        "s",
        "Time since the run's first sample, from the rig's tick",
    ),
    column(
        "displacement_mm",
        ColumnKind::Number,
        "mm",
        "Displacement of the specimen (LVDT)",
    ),
    column(
        "force_n",
        ColumnKind::Number,
        "N",
        "Force on the specimen (load cell)",
    ),
    column(
        "command_mm",
        ColumnKind::Number,
        "mm",
        "Commanded displacement; empty where none was commanded",
    ),
    column(
        "command_n",
        ColumnKind::Number,
        "N",
        "Commanded force; empty where none was commanded",
    ),
    column(
        "cycle",
        ColumnKind::Whole32,
        "1",
        "Counted cycle from 1; 0 outside the counted cycles",
    ),
    column(
        "segment",
        ColumnKind::Whole32,
        "1",
        "Segment of the profile from 1; 0 outside the profile",
    ),
    column(
        "twin_force_n",
        ColumnKind::Number,
        "N",
        "Force of the virtual twin; empty where it was off",
    ),
    column(
        "flags",
        ColumnKind::Whole16,
        "1",
        "Quality, 0 = good; sum of 1 after a gap, 2 late, 4 force invalid, 8 displacement invalid, 16 stuck, 32 spike, \
         64 no command, 128 not the motion of the profile",
    ),
    column(
        "cycles_averaged",
        ColumnKind::Whole32,
        "1",
        "Number of cycles averaged in this row",
    ),
];
