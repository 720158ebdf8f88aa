//! One row of the table: what is checked, and how it went.

use super::probe::Probe;

/// One check of the table.
pub(crate) struct CheckRow {
    /// Short name, unique in the table.
    pub id: &'static str,
    /// Section of `firmware-protocol.md` that it holds the firmware to.
    pub section: &'static str,
    /// What is checked, in words.
    pub title: &'static str,
    /// The row switches the pressure on and may move the rig.
    pub moves: bool,
    /// The check: what was seen, or what is wrong.
    pub check: fn(&mut Probe) -> Result<String, String>,
}

/// How a row went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RowVerdict {
    /// As the document says.
    Pass,
    /// Not as the document says.
    Fail,
    /// Not checked: it moves the rig, and motion was not asked for.
    Skipped,
}

/// A row with its result.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub(crate) struct RowReport {
    /// Short name of the row.
    pub id: &'static str,
    /// Section of `firmware-protocol.md`.
    pub section: &'static str,
    /// What was checked.
    pub title: &'static str,
    /// What was seen, or what is wrong.
    pub seen: String,
    /// How it went.
    pub verdict: RowVerdict,
}
