//! The tables of version 2 of the format, and the row that counts what is in them.
//!
//! Every row is under a checksum. The row of `totals` is written with each commit, so a row that vanished from any table is
//! missed, in a closed run and in one that its daemon left open.

use rusqlite::{Connection, OptionalExtension, Row, params};

use super::block::{self, Digest};
use crate::recording::{Event, EventKind, Header, Outcome};

/// SQLite's application id of a run file: the letters `LEAF`.
pub(super) const APPLICATION_ID: i32 = 0x4C45_4146;
/// Version of the tables and of the block layout.
pub(super) const FORMAT_VERSION: i32 = 2;

/// The tables of an empty run file.
pub(super) const SCHEMA: &str = "
CREATE TABLE run (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    header_json TEXT NOT NULL,
    header_crc32 INTEGER NOT NULL,
    outcome_json TEXT,
    outcome_crc32 INTEGER
);
CREATE TABLE totals (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    zero_tick INTEGER,
    first_tick INTEGER,
    last_tick INTEGER,
    samples INTEGER NOT NULL,
    blocks INTEGER NOT NULL,
    events INTEGER NOT NULL,
    closed INTEGER NOT NULL,
    crc32 INTEGER NOT NULL
);
CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    tick INTEGER NOT NULL,
    time_s REAL NOT NULL,
    kind TEXT NOT NULL,
    text TEXT NOT NULL,
    crc32 INTEGER NOT NULL
);
CREATE TABLE blocks (
    seq INTEGER PRIMARY KEY,
    first_tick INTEGER NOT NULL,
    sample_count INTEGER NOT NULL,
    crc32 INTEGER NOT NULL,
    data BLOB NOT NULL
);
";

/// What a run file has, according to its own count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Totals {
    /// Tick of time 0: the first sample of the run. It differs from `first_tick` in a file that continues another one.
    pub zero_tick: Option<u64>,
    /// Tick of the first sample in this file.
    pub first_tick: Option<u64>,
    /// Tick of the last sample in this file.
    pub last_tick: Option<u64>,
    /// Number of samples.
    pub samples: u64,
    /// Number of blocks.
    pub blocks: u64,
    /// Number of events.
    pub events: u64,
    /// The run has an outcome.
    pub closed: bool,
}

impl Totals {
    fn crc32(&self) -> u32 {
        // No tick of a rig reaches the largest number of 64 bits.
        let tick = |tick: Option<u64>| tick.unwrap_or(u64::MAX);
        let mut digest = Digest::new();
        for word in [
            tick(self.zero_tick),
            tick(self.first_tick),
            tick(self.last_tick),
            self.samples,
            self.blocks,
            self.events,
            u64::from(self.closed),
        ] {
            digest.word(word);
        }
        digest.finish()
    }

    /// Writes the row.
    pub(super) fn write(&self, database: &Connection) -> rusqlite::Result<()> {
        let tick = |tick: Option<u64>| tick.map(|t| t as i64);
        database
            .prepare_cached("INSERT OR REPLACE INTO totals VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)")?
            .execute(params![
                tick(self.zero_tick),
                tick(self.first_tick),
                tick(self.last_tick),
                self.samples as i64,
                self.blocks as i64,
                self.events as i64,
                self.closed,
                self.crc32()
            ])?;
        Ok(())
    }

    /// The row, if there is one with the correct checksum.
    pub(super) fn read(database: &Connection) -> Option<Totals> {
        let sql = "SELECT zero_tick, first_tick, last_tick, samples, blocks, events, closed, crc32 FROM totals WHERE id = 1";
        let word = |row: &Row, column| row.get::<_, i64>(column).map(|word| word as u64);
        let tick = |row: &Row, column| row.get::<_, Option<i64>>(column).map(|t| t.map(|t| t as u64));
        let (totals, crc32) = database
            .query_row(sql, [], |row| {
                let totals = Totals {
                    zero_tick: tick(row, 0)?,
                    first_tick: tick(row, 1)?,
                    last_tick: tick(row, 2)?,
                    samples: word(row, 3)?,
                    blocks: word(row, 4)?,
                    events: word(row, 5)?,
                    closed: row.get(6)?,
                };
                Ok((totals, row.get::<_, i64>(7)?))
            })
            .optional()
            .ok()
            .flatten()?;
        (i64::from(totals.crc32()) == crc32).then_some(totals)
    }
}

/// Writes the header, or writes it again.
pub(super) fn write_header(database: &Connection, header: &Header) -> rusqlite::Result<()> {
    let json = to_json(header)?;
    database.execute(
        "INSERT INTO run (id, header_json, header_crc32) VALUES (1, ?1, ?2)
         ON CONFLICT (id) DO UPDATE SET header_json = ?1, header_crc32 = ?2",
        params![json, block::crc32(json.as_bytes())],
    )?;
    Ok(())
}

/// Writes the outcome; the totals must be written in the same transaction.
pub(super) fn write_outcome(database: &Connection, outcome: &Outcome) -> rusqlite::Result<()> {
    let json = to_json(outcome)?;
    database.execute(
        "UPDATE run SET outcome_json = ?1, outcome_crc32 = ?2",
        params![json, block::crc32(json.as_bytes())],
    )?;
    Ok(())
}

/// Writes one event; `seq` counts from 1.
pub(super) fn write_event(database: &Connection, seq: u64, event: &Event) -> rusqlite::Result<()> {
    let kind = event.kind.word();
    database
        .prepare_cached("INSERT INTO events VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?
        .execute(params![
            seq as i64,
            event.tick as i64,
            event.time_s,
            kind,
            event.text,
            event_crc32(seq, event, &kind)
        ])?;
    Ok(())
}

/// The event of this number, if it is there with the correct checksum.
pub(super) fn read_event(database: &Connection, seq: u64) -> Option<Event> {
    let sql = "SELECT tick, time_s, kind, text, crc32 FROM events WHERE seq = ?1";
    let mut statement = database.prepare_cached(sql).ok()?;
    let row = statement.query_row([seq as i64], |row| {
        let kind: String = row.get(2)?;
        let event = Event {
            tick: row.get::<_, i64>(0)? as u64,
            time_s: row.get(1)?,
            kind: kind_of(&kind).unwrap_or(EventKind::Host),
            text: row.get(3)?,
        };
        Ok((event, kind, row.get::<_, i64>(4)?))
    });
    let (event, kind, crc32) = row.optional().ok().flatten()?;
    (i64::from(event_crc32(seq, &event, &kind)) == crc32 && kind_of(&kind).is_some()).then_some(event)
}

fn event_crc32(seq: u64, event: &Event, kind: &str) -> u32 {
    let mut digest = Digest::new();
    for word in [seq, event.tick, event.time_s.to_bits(), kind.len() as u64] {
        digest.word(word);
    }
    digest.bytes(kind.as_bytes());
    digest.bytes(event.text.as_bytes());
    digest.finish()
}

/// The kind that a stable word names.
pub(super) fn kind_of(word: &str) -> Option<EventKind> {
    serde_json::from_value(word.into()).ok()
}

fn to_json<T: serde::Serialize>(value: &T) -> rusqlite::Result<String> {
    serde_json::to_string(value).map_err(|error| rusqlite::Error::ToSqlConversionFailure(Box::new(error)))
}
