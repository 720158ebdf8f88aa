//! A run that walks a rig's firmware through `firmware-protocol.md`, one row for each rule, first without motion. It acts as
//! the host: it sends frames and judges what comes back. How the rows are shown is left to `cli`.
//!
//! `probe` hears the rig and keeps its time, `asking` and `moving` lead it to a state, and each other file holds the rows of
//! one subject. A new row is a function and an entry in the `ROWS` of its file.

mod asking;
mod calibration_hash;
mod faults;
mod motion;
mod moving;
mod network;
mod objects;
mod probe;
mod queue;
mod row;
mod session;
mod stream;
mod whole;

pub(crate) use asking::Reach;
pub(crate) use probe::{Probe, ProbeClock};
use row::CheckRow;
pub(crate) use row::{RowReport, RowVerdict};

use crate::protocol::message::Limits;

/// All rows, in the order in which they are checked: those that move the rig come last.
static TABLE: &[&[CheckRow]] = &[
    objects::ROWS,
    network::ROWS,
    stream::ROWS,
    session::ROWS,
    motion::ROWS,
    queue::ROWS,
    faults::ROWS,
];

/// A failed row is repeated if this computer did not look at the link for longer, ms: then the host was too slow.
const PAUSE_MAX_MS: u64 = 15;
/// Times that such a row is tried.
const TRIES: u32 = 4;

/// Rows of one walk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WalkPart {
    /// The rows without motion.
    Still,
    /// The rows that move the rig.
    Moving,
    /// The rows that move the rig are reported as skipped.
    Skipped,
    /// The rows about the whole run, last of all.
    Whole,
}

/// Checks the rows of one part. `on_row` gets each result at once. Afterwards the rig is at rest, with the default limits.
pub(crate) fn walk(probe: &mut Probe, part: WalkPart, mut on_row: impl FnMut(&RowReport)) -> Vec<RowReport> {
    let rows = match part {
        WalkPart::Whole => &[whole::ROWS],
        _ => TABLE,
    };
    let in_part = rows.iter().copied().flatten().filter(|row| match part {
        WalkPart::Still => !row.moves,
        WalkPart::Moving | WalkPart::Skipped => row.moves,
        WalkPart::Whole => true,
    });
    let mut reports = Vec::new();
    for row in in_part {
        let (verdict, seen) = match part {
            WalkPart::Skipped => (RowVerdict::Skipped, "moves the rig, see --motion".to_owned()),
            _ => checked(row, probe),
        };
        let report = RowReport {
            id: row.id,
            section: row.section,
            title: row.title,
            seen,
            verdict,
        };
        on_row(&report);
        reports.push(report);
    }
    if matches!(part, WalkPart::Still | WalkPart::Moving) {
        probe.begin_row();
        // Where this fails, a row has said why.
        let _ = probe
            .rest()
            .and_then(|()| probe.write_limits(&Limits::defaults()));
    }
    reports
}

fn checked(row: &CheckRow, probe: &mut Probe) -> (RowVerdict, String) {
    let mut tries = 1;
    loop {
        probe.begin_row();
        match (row.check)(probe) {
            Ok(seen) => return (RowVerdict::Pass, seen),
            Err(_) if probe.longest_pause_ms() > PAUSE_MAX_MS && tries < TRIES => tries += 1,
            Err(wrong) => return (RowVerdict::Fail, wrong),
        }
    }
}
