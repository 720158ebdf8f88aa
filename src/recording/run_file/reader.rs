//! Opens a run file that is closed, still being written, or damaged. Every block with a correct checksum is read, the rest is
//! a gap.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension};

use super::block::{self, RECORD_BYTES};
use super::writer;
use super::{APPLICATION_ID, FORMAT_VERSION, RunFileError};
use crate::recording::{Ending, Event, EventKind, Flags, Header, Outcome, Sample};
use crate::units::{Command, Mode};

/// If the index of blocks is damaged, blocks are looked up one by one until this many in a row are missing.
const MISSING_BLOCKS_AT_END: u64 = 4096;

/// A run file, opened for reading.
#[derive(Debug)]
pub(crate) struct RunFile {
    path: PathBuf,
    database: Connection,
    header: Header,
    outcome: Option<Outcome>,
    first_tick: Option<u64>,
    last_tick: Option<u64>,
    block_count: Option<u64>,
}

/// Why ticks have no sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum GapCause {
    /// The sample did not arrive from the rig.
    Lost,
    /// The sample was recorded; its block is damaged.
    Damaged,
}

/// A range of ticks without a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Gap {
    /// First tick without a sample.
    pub from_tick: u64,
    /// Last tick without a sample. At the damaged end of an open run only a lower bound is known.
    pub to_tick: u64,
    pub cause: GapCause,
}

impl Gap {
    /// Number of ticks in the gap.
    pub(crate) fn ticks(&self) -> u64 {
        (self.to_tick + 1).saturating_sub(self.from_tick)
    }
}

/// Ticks of one counted cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CycleSpan {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Tick of its first sample.
    pub first_tick: u64,
    /// Tick of its last sample.
    pub last_tick: u64,
    /// True if the run went on after it: it ran to its end.
    pub complete: bool,
}

/// Result of one pass over all samples. `samples + lost + damaged` = ticks from first to last.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Survey {
    /// Number of readable samples.
    pub samples: u64,
    /// Number of ticks whose sample did not arrive.
    pub lost: u64,
    /// Number of samples that the link delivered too late.
    pub late: u64,
    /// Number of ticks in damaged blocks.
    pub damaged: u64,
    /// Number of samples with any flag except [`Flags::AFTER_GAP`].
    pub flagged: u64,
    /// First and last tick of the run.
    pub ticks: Option<(u64, u64)>,
    /// Lost and damaged ranges in order.
    pub gaps: Vec<Gap>,
    /// Counted cycles in order.
    pub cycles: Vec<CycleSpan>,
    /// Control modes of the commands, in the order of first use.
    pub modes: Vec<Mode>,
}

impl Survey {
    /// Counted cycles that ran to their end.
    pub(crate) fn cycles_completed(&self) -> u32 {
        self.cycles.iter().filter(|cycle| cycle.complete).count() as u32
    }

    fn add(&mut self, sample: &Sample) {
        self.samples += 1;
        let other_bits = sample.flags.difference(Flags::AFTER_GAP);
        self.flagged += u64::from(!other_bits.is_empty());
        self.late += u64::from(sample.flags.contains(Flags::LATE));
        if let Some(mode) = sample.command.map(Command::mode)
            && !self.modes.contains(&mode)
        {
            self.modes.push(mode);
        }
        match self.cycles.last_mut() {
            Some(span) if span.cycle == sample.cycle => {
                span.last_tick = sample.tick;
                return;
            }
            Some(span) => span.complete = true,
            None => {}
        }
        if sample.cycle > 0 {
            self.cycles.push(CycleSpan {
                cycle: sample.cycle,
                first_tick: sample.tick,
                last_tick: sample.tick,
                complete: false,
            });
        }
    }
}

impl RunFile {
    /// Opens a file for reading. File and log stay unchanged, unless SQLite must first recover them after a kill or power cut.
    pub(crate) fn open(path: &Path) -> Result<RunFile, RunFileError> {
        let failed = |source| RunFileError::database(path, "opening", source);
        if !path.is_file() {
            return Err(RunFileError::NotARun {
                path: path.to_owned(),
                reason: "the file does not exist".into(),
            });
        }
        let plain = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let recovering = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut database = Connection::open_with_flags(path, plain).map_err(failed)?;
        let version: rusqlite::Result<i32> = database.query_row("PRAGMA user_version", [], |row| row.get(0));
        if version.is_err_and(|error| error.sqlite_error_code() == Some(ErrorCode::ReadOnly)) {
            database = Connection::open_with_flags(path, recovering).map_err(failed)?;
        }
        RunFile::from_database(path, database)
    }

    fn from_database(path: &Path, database: Connection) -> Result<RunFile, RunFileError> {
        // Without this SQLite refuses a file that is cut off, although its other blocks are readable.
        let tolerant = database.pragma_update(None, "writable_schema", true);
        let (application_id, version) = tolerant
            .and_then(|()| {
                let id: i32 = database.query_row("PRAGMA application_id", [], |row| row.get(0))?;
                let version: i32 = database.query_row("PRAGMA user_version", [], |row| row.get(0))?;
                Ok((id, version))
            })
            .map_err(|source| RunFileError::NotARun {
                path: path.to_owned(),
                reason: source.to_string(),
            })?;
        if application_id != APPLICATION_ID {
            return Err(RunFileError::NotARun {
                path: path.to_owned(),
                reason: format!("its application id is {application_id:#x}"),
            });
        }
        if version != FORMAT_VERSION {
            return Err(RunFileError::Version {
                path: path.to_owned(),
                found: version,
            });
        }
        let row = read_run_row(&database).map_err(|source| RunFileError::Damaged {
            path: path.to_owned(),
            part: "header",
            reason: source.to_string(),
        })?;
        let header = checked_json(path, "header", &row.header_json, row.header_crc32)?;
        let outcome = match (&row.outcome_json, row.outcome_crc32) {
            (Some(json), Some(crc32)) => Some(checked_json(path, "outcome", json, crc32)?),
            _ => None,
        };
        Ok(RunFile {
            path: path.to_owned(),
            database,
            header,
            outcome,
            first_tick: row.first_tick.map(|tick| tick as u64),
            last_tick: row.last_tick.map(|tick| tick as u64),
            block_count: row.block_count.map(|count| count as u64),
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn header(&self) -> &Header {
        &self.header
    }

    /// How the run ended; `None` while it is live, or if its daemon was killed.
    pub(crate) fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref()
    }

    /// Events in order. Events that cannot be read are left out.
    pub(crate) fn events(&self) -> Vec<Event> {
        let mut events = Vec::new();
        let Ok(mut statement) = self
            .database
            .prepare("SELECT tick, time_s, kind, text FROM events ORDER BY seq")
        else {
            return events;
        };
        let rows = statement.query_map([], |row| {
            let kind: String = row.get(2)?;
            Ok(Event {
                tick: row.get::<_, i64>(0)? as u64,
                time_s: row.get(1)?,
                kind: serde_json::from_value(kind.into()).unwrap_or(EventKind::Host),
                text: row.get(3)?,
            })
        });
        if let Ok(rows) = rows {
            // A damaged page gives one error and then ends, so this loop ends too.
            events.extend(rows.map_while(Result::ok));
        }
        events
    }

    /// All readable samples in the order of ticks, with one block at a time in memory.
    pub(crate) fn samples(&self) -> SampleReader<'_> {
        SampleReader {
            run: self,
            next_block: 1,
            last_block: self.last_block(),
            missing: 0,
            data: Vec::new(),
            block_first_tick: 0,
            at: 0,
            next_tick: self.first_tick,
            run_first_tick: self.first_tick,
            unreadable: false,
            gaps: Vec::new(),
        }
    }

    /// Reads all samples once and returns counts, gaps and cycles.
    pub(crate) fn survey(&self) -> Survey {
        let mut survey = Survey::default();
        let mut reader = self.samples();
        let mut ticks: Option<(u64, u64)> = None;
        for sample in reader.by_ref() {
            survey.add(&sample);
            ticks = Some((ticks.map_or(sample.tick, |(first, _)| first), sample.tick));
        }
        survey.gaps = reader.gaps;
        for gap in &survey.gaps {
            match gap.cause {
                GapCause::Lost => survey.lost += gap.ticks(),
                GapCause::Damaged => survey.damaged += gap.ticks(),
            }
            let (first, last) = ticks.unwrap_or((gap.from_tick, gap.to_tick));
            ticks = Some((first.min(gap.from_tick), last.max(gap.to_tick)));
        }
        survey.ticks = ticks;
        if let (Some(outcome), Some(span)) = (&self.outcome, survey.cycles.last_mut()) {
            // If the profile ends with a counted cycle, only the outcome says that it is complete.
            span.complete |= outcome.ending == Ending::Completed;
        }
        survey
    }

    /// Closes a run that its daemon left open: writes an outcome with the number of samples and the cause.
    pub(crate) fn close_as_aborted(self, cause: &str) -> Result<Outcome, RunFileError> {
        if self.outcome.is_some() {
            return Err(RunFileError::Closed { path: self.path });
        }
        let survey = self.survey();
        let blocks = self.last_block().unwrap_or(0);
        let outcome = Outcome {
            ending: Ending::Aborted,
            cause: cause.to_owned(),
            samples: survey.samples,
            lost: survey.lost + survey.damaged,
            late: survey.late,
            cycles_completed: survey.cycles_completed(),
        };
        let RunFile { path, database, .. } = self;
        let last_tick = survey.ticks.map(|(_, last)| last as i64);
        drop(database);
        let close = || -> rusqlite::Result<()> {
            let database = Connection::open_with_flags(&path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
            writer::write_outcome(&database, &outcome, last_tick, blocks)?;
            writer::merge_log(&database)
        };
        close().map_err(|source| RunFileError::database(&path, "closing", source))?;
        Ok(outcome)
    }

    /// Number of the last block, if the file still has it.
    fn last_block(&self) -> Option<u64> {
        let indexed: Option<i64> = self
            .database
            .query_row("SELECT max(seq) FROM blocks", [], |row| row.get(0))
            .unwrap_or(None);
        let empty = || {
            let count = self
                .database
                .query_row("SELECT count(*) FROM blocks", [], |row| row.get(0));
            (count == Ok(0)).then_some(0)
        };
        indexed.map(|seq| seq as u64).max(self.block_count).or_else(empty)
    }
}

/// Samples of a run file one by one. Blocks that cannot be read and lost ticks are noted in `gaps`.
pub(crate) struct SampleReader<'a> {
    run: &'a RunFile,
    next_block: u64,
    last_block: Option<u64>,
    missing: u64,
    data: Vec<u8>,
    block_first_tick: u64,
    at: usize,
    /// Tick of the next sample if none is missing.
    next_tick: Option<u64>,
    run_first_tick: Option<u64>,
    /// A block since the last good one could not be read.
    unreadable: bool,
    /// Gaps up to the last sample returned; complete after the end of the iterator.
    pub(super) gaps: Vec<Gap>,
}

impl SampleReader<'_> {
    /// Loads the next good block; false at the end.
    fn load(&mut self) -> bool {
        loop {
            match self.last_block {
                Some(last) if self.next_block > last => return false,
                None if self.missing >= MISSING_BLOCKS_AT_END => return false,
                _ => {}
            }
            let seq = self.next_block;
            self.next_block += 1;
            if let Some((first_tick, data)) = self.read_block(seq) {
                self.missing = 0;
                self.block_first_tick = first_tick;
                self.data = data;
                self.at = 0;
                return true;
            }
            self.missing += 1;
            self.unreadable = true;
        }
    }

    /// A block, if its checksum is correct. It is looked up by its number alone, so that damage to other blocks does not matter.
    fn read_block(&self, seq: u64) -> Option<(u64, Vec<u8>)> {
        let sql = "SELECT first_tick, sample_count, crc32, data FROM blocks WHERE seq = ?1";
        let row = self
            .run
            .database
            .prepare_cached(sql)
            .and_then(|mut statement| {
                statement
                    .query_row([seq as i64], |row| {
                        Ok((
                            row.get::<_, i64>(0)?,
                            row.get::<_, i64>(1)?,
                            row.get::<_, i64>(2)?,
                            row.get::<_, Vec<u8>>(3)?,
                        ))
                    })
                    .optional()
            })
            .ok()
            .flatten();
        let (first_tick, count, crc32, data) = row?;
        let (first_tick, count) = (first_tick as u64, count as u64);
        let good = block::block_crc32(seq, first_tick, count, &data) as i64 == crc32
            && count.checked_mul(RECORD_BYTES as u64) == Some(data.len() as u64);
        good.then_some((first_tick, data))
    }

    /// Notes the missing ticks between the last sample and `tick`; true if there are any.
    fn note_gap(&mut self, tick: u64) -> bool {
        let unreadable = std::mem::take(&mut self.unreadable);
        let from_tick = self.next_tick.unwrap_or(tick);
        if tick <= from_tick {
            return false;
        }
        self.gaps.push(Gap {
            from_tick,
            to_tick: tick - 1,
            cause: if unreadable {
                GapCause::Damaged
            } else {
                GapCause::Lost
            },
        });
        true
    }

    /// Notes damage at the end: up to the last tick of the run, if the file has it.
    fn note_end(&mut self) {
        let end = match (self.run.last_tick, self.next_tick) {
            (Some(last), _) => last + 1,
            (None, Some(next)) if self.last_block.is_some() => next + 1,
            _ => return,
        };
        if self.unreadable {
            self.note_gap(end);
        }
    }
}

impl Iterator for SampleReader<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        loop {
            if let Some(record) = self
                .data
                .get(self.at..)
                .and_then(<[u8]>::first_chunk::<RECORD_BYTES>)
            {
                let run_first = *self.run_first_tick.get_or_insert(self.block_first_tick);
                let mut sample = block::unpack(record, self.block_first_tick, run_first, &self.run.header);
                self.at += RECORD_BYTES;
                if self.note_gap(sample.tick) {
                    sample.flags.insert(Flags::AFTER_GAP);
                }
                self.next_tick = Some(sample.tick + 1);
                return Some(sample);
            }
            if !self.load() {
                self.note_end();
                return None;
            }
        }
    }
}

/// The row of table `run`.
struct RunRow {
    header_json: String,
    header_crc32: i64,
    first_tick: Option<i64>,
    outcome_json: Option<String>,
    outcome_crc32: Option<i64>,
    last_tick: Option<i64>,
    block_count: Option<i64>,
}

fn read_run_row(database: &Connection) -> rusqlite::Result<RunRow> {
    let sql = "SELECT header_json, header_crc32, first_tick, outcome_json, outcome_crc32, last_tick, block_count FROM run";
    database.query_row(sql, [], |row| {
        Ok(RunRow {
            header_json: row.get(0)?,
            header_crc32: row.get(1)?,
            first_tick: row.get(2)?,
            outcome_json: row.get(3)?,
            outcome_crc32: row.get(4)?,
            last_tick: row.get(5)?,
            block_count: row.get(6)?,
        })
    })
}

/// Content of a JSON column, if its checksum is correct.
fn checked_json<T>(path: &Path, part: &'static str, json: &str, crc32: i64) -> Result<T, RunFileError>
where
    T: serde::de::DeserializeOwned,
{
    let damaged = |reason: String| RunFileError::Damaged {
        path: path.to_owned(),
        part,
        reason,
    };
    if i64::from(block::crc32(json.as_bytes())) != crc32 {
        return Err(damaged("its checksum is wrong".into()));
    }
    serde_json::from_str(json).map_err(|error| damaged(error.to_string()))
}
