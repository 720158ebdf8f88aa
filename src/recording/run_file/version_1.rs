//! Reads files of version 1 of the format and closes those that were left open. The writer makes version 2.
//!
//! Version 1 has no table of totals and no checksums of events and ticks: a changed text of an event cannot be found there.
//! What can be compared is compared: the first tick with the first block, the counts with the outcome, the order of events.

use rusqlite::{Connection, params};

use super::layout::{self, Totals};
use crate::recording::{Event, EventKind, Outcome};

/// The `user_version` of these files.
pub(super) const VERSION: i32 = 1;

/// The totals as far as the row of table `run` has them; the number of samples and events is counted by the caller.
pub(super) fn totals(database: &Connection) -> rusqlite::Result<(Totals, Option<u64>)> {
    database.query_row(
        "SELECT first_tick, last_tick, block_count, outcome_json IS NOT NULL FROM run",
        [],
        |row| {
            let number = |column| row.get::<_, Option<i64>>(column).map(|n| n.map(|n| n as u64));
            let totals = Totals {
                zero_tick: number(0)?,
                first_tick: number(0)?,
                last_tick: number(1)?,
                closed: row.get(3)?,
                ..Totals::default()
            };
            Ok((totals, number(2)?))
        },
    )
}

/// The events in order, and the number of those that are known to be missing or not readable.
pub(super) fn events(database: &Connection) -> (Vec<Event>, u64) {
    let mut events = Vec::new();
    let mut damaged = 0;
    let mut next_seq = 1;
    let Ok(mut statement) = database.prepare("SELECT seq, tick, time_s, kind, text FROM events ORDER BY seq")
    else {
        return (events, 1);
    };
    let rows = statement.query_map([], |row| {
        let kind = layout::kind_of(&row.get::<_, String>(3)?);
        let event = Event {
            tick: row.get::<_, i64>(1)? as u64,
            time_s: row.get(2)?,
            kind: kind.unwrap_or(EventKind::Host),
            text: row.get(4)?,
        };
        Ok((row.get::<_, i64>(0)?, kind.is_some(), event))
    });
    let Ok(rows) = rows else { return (events, 1) };
    for row in rows {
        // After an error SQLite gives no more rows.
        let Ok((seq, known, event)) = row else {
            return (events, damaged + 1);
        };
        damaged += seq.abs_diff(next_seq).min(1) + u64::from(!known);
        next_seq = seq.saturating_add(1);
        events.push(event);
    }
    (events, damaged)
}

/// Writes the outcome, the last tick and the number of blocks.
pub(super) fn write_outcome(
    database: &Connection,
    outcome: &Outcome,
    last_tick: Option<u64>,
    blocks: u64,
) -> rusqlite::Result<()> {
    layout::write_outcome(database, outcome)?;
    database.execute(
        "UPDATE run SET last_tick = ?1, block_count = ?2",
        params![last_tick.map(|tick| tick as i64), blocks as i64],
    )?;
    Ok(())
}
