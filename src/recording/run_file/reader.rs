//! Opens a run file that is closed, still being written, or damaged. Everything with a correct checksum is read; the survey
//! tells what is not as it was written.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::layout::{self, APPLICATION_ID, FORMAT_VERSION, Totals};
use super::part;
use super::samples::{Blocks, SampleReader};
use super::survey::Survey;
use super::{RunFileError, block, version_1};
use crate::recording::{Ending, Event, Header, Outcome};

/// Longest run id in a file, in bytes.
const RUN_ID_BYTES: usize = 100;

/// A run file, opened for reading.
#[derive(Debug)]
pub(crate) struct RunFile {
    path: PathBuf,
    version: i32,
    blocks: Blocks,
    outcome: Option<Outcome>,
    /// Damage that was found when the file was opened, one sentence each.
    damage: Vec<String>,
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
        let version = read_version(path, &database)?;
        let row = read_run_row(&database).map_err(|source| RunFileError::Damaged {
            path: path.to_owned(),
            part: "header",
            reason: source.to_string(),
        })?;
        let header: Header = checked_json(path, "header", &row.header_json, row.header_crc32)?;
        check_run_id(path, &header.run_id)?;
        let mut damage = Vec::new();
        let outcome: Option<Outcome> = match (&row.outcome_json, row.outcome_crc32) {
            (None, None) => None,
            (json, crc32) => {
                let json = json.as_deref().unwrap_or_default();
                let outcome = checked_json(path, "outcome", json, crc32.unwrap_or(-1)).ok();
                if outcome.is_none() {
                    damage.push("the outcome of the run is damaged".to_owned());
                }
                outcome
            }
        };
        let mut blocks = Blocks {
            database,
            header,
            totals: None,
            count: None,
            unsaved: outcome.as_ref().and_then(|o| o.unsaved.clone()),
        };
        match version {
            version_1::VERSION => damage.extend(add_totals_of_version_1(&mut blocks)),
            _ => damage.extend(add_totals(&mut blocks, outcome.is_some() || !damage.is_empty())),
        }
        Ok(RunFile {
            path: path.to_owned(),
            version,
            blocks,
            outcome,
            damage,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn header(&self) -> &Header {
        &self.blocks.header
    }

    /// How the run ended; `None` while it is live, if its daemon could not close it, or if it is damaged.
    pub(crate) fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref()
    }

    /// Tick of time 0: the first sample of the run.
    pub(crate) fn zero_tick(&self) -> u64 {
        let totals = self.blocks.totals.unwrap_or_default();
        totals.zero_tick.unwrap_or(0)
    }

    /// Events in order. Damaged events are left out; the survey counts them.
    pub(crate) fn events(&self) -> Vec<Event> {
        self.checked_events().0
    }

    /// The readable events, and the number of those that are missing or damaged.
    fn checked_events(&self) -> (Vec<Event>, u64) {
        let database = &self.blocks.database;
        if self.version == version_1::VERSION {
            return version_1::events(database);
        }
        let indexed = || {
            let largest = "SELECT coalesce(max(seq), 0) FROM events";
            database
                .query_row(largest, [], |row| row.get::<_, i64>(0))
                .unwrap_or(0) as u64
        };
        let count = self.blocks.totals.map_or_else(indexed, |totals| totals.events);
        let events: Vec<Event> = (1..=count)
            .filter_map(|seq| layout::read_event(database, seq))
            .collect();
        let damaged = count - events.len() as u64;
        (events, damaged)
    }

    /// All readable samples in the order of ticks, with one block at a time in memory.
    pub(crate) fn samples(&self) -> SampleReader<'_> {
        self.blocks.samples()
    }

    /// Reads the whole file once: counts, gaps, cycles, and everything that is not as it was written.
    pub(crate) fn survey(&self) -> Survey {
        let mut survey = Survey::of(self.samples(), self.outcome());
        survey.damage = self.damage.clone();
        if survey.damaged > 0 {
            survey.damage.push(format!(
                "{} samples are in damaged blocks and cannot be read",
                survey.damaged
            ));
        }
        let (_, damaged_events) = self.checked_events();
        if damaged_events > 0 {
            survey
                .damage
                .push(format!("{damaged_events} events are damaged or missing"));
        }
        survey.damage.extend(self.contradiction(&survey));
        survey
    }

    /// A difference between what was read and what outcome or totals say, if nothing else explains it.
    fn contradiction(&self, survey: &Survey) -> Option<String> {
        if !survey.damage.is_empty() {
            return None;
        }
        let wanted = match (&self.outcome, self.version, &self.blocks.totals) {
            (Some(outcome), ..) => outcome.samples,
            (None, FORMAT_VERSION, Some(totals)) => totals.samples,
            _ => return None,
        };
        let recorded_missing = self.outcome.as_ref().map(|o| o.lost + o.unsaved_samples());
        let missing = survey.missing();
        let mut differs =
            survey.samples != wanted || recorded_missing.is_some_and(|recorded| recorded != missing);
        if self.outcome.is_some() {
            let last_tick = self.blocks.totals.and_then(|totals| totals.last_tick);
            let read_last = survey.ticks.map(|(_, last)| last);
            differs |= self.blocks.unsaved.is_none() && last_tick != read_last;
            differs |= self.blocks.indexed() != self.blocks.last();
        }
        differs.then(|| {
            format!(
                "{} samples can be read and {missing} are missing, but the run recorded {wanted} and missed {}",
                survey.samples,
                recorded_missing.unwrap_or(0)
            )
        })
    }

    /// Closes a run that its daemon left open: writes an outcome with the number of samples and the cause.
    pub(crate) fn close_as_aborted(self, cause: &str) -> Result<Outcome, RunFileError> {
        let survey = self.survey();
        let RunFile {
            path,
            version,
            blocks,
            outcome,
            ..
        } = self;
        if outcome.is_some() {
            return Err(RunFileError::Closed { path });
        }
        let Some(totals) = blocks.totals else {
            return Err(RunFileError::Damaged {
                path,
                part: "count of its content",
                reason: "its checksum is wrong".into(),
            });
        };
        let outcome = Outcome {
            ending: Ending::Aborted,
            cause: cause.to_owned(),
            samples: survey.samples,
            lost: survey.missing(),
            late: survey.late,
            cycles_completed: survey.cycles_completed(),
            unsaved: None,
            punctuality: None,
        };
        let last_block = blocks.last().unwrap_or(0);
        drop(blocks);
        let close = || -> rusqlite::Result<()> {
            let mut database = Connection::open_with_flags(&path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
            let transaction = database.transaction()?;
            if version == version_1::VERSION {
                let last_tick = survey.ticks.map(|(_, last)| last);
                version_1::write_outcome(&transaction, &outcome, last_tick, last_block)?;
            } else {
                layout::write_outcome(&transaction, &outcome)?;
                Totals {
                    closed: true,
                    ..totals
                }
                .write(&transaction)?;
            }
            transaction.commit()?;
            part::merge_log(&database)
        };
        part::free_reserve(&path);
        close().map_err(|source| RunFileError::database(&path, "closing", source))?;
        Ok(outcome)
    }
}

/// The version of the format, if this is a run file of a version that this program reads.
fn read_version(path: &Path, database: &Connection) -> Result<i32, RunFileError> {
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
    if version != FORMAT_VERSION && version != version_1::VERSION {
        return Err(RunFileError::Version {
            path: path.to_owned(),
            found: version,
        });
    }
    Ok(version)
}

/// Adds the totals to `blocks`; returns a sentence if they are damaged. `has_outcome`: the row of the run has one, good or not.
fn add_totals(blocks: &mut Blocks, has_outcome: bool) -> Option<String> {
    let Some(totals) = Totals::read(&blocks.database) else {
        return Some("the count of the file's content is damaged".to_owned());
    };
    blocks.totals = Some(totals);
    blocks.count = Some(totals.blocks);
    (totals.closed != has_outcome).then(|| "the outcome of the run is missing".to_owned())
}

/// The same for version 1, whose first tick has no checksum: the first block is right if they differ.
fn add_totals_of_version_1(blocks: &mut Blocks) -> Option<String> {
    let Ok((mut totals, count)) = version_1::totals(&blocks.database) else {
        return Some("the count of the file's content is damaged".to_owned());
    };
    blocks.count = blocks.indexed().max(count);
    let read = blocks.read(1).map(|(first_tick, _)| first_tick);
    let differs = read.is_some() && read != totals.zero_tick;
    if differs {
        totals.zero_tick = read;
        totals.first_tick = read;
    }
    blocks.totals = Some(totals);
    differs.then(|| "the time of the first sample is damaged, the first block replaces it".to_owned())
}

/// The row of table `run`, as far as both versions have it.
struct RunRow {
    header_json: String,
    header_crc32: i64,
    outcome_json: Option<String>,
    outcome_crc32: Option<i64>,
}

fn read_run_row(database: &Connection) -> rusqlite::Result<RunRow> {
    let sql = "SELECT header_json, header_crc32, outcome_json, outcome_crc32 FROM run";
    database.query_row(sql, [], |row| {
        Ok(RunRow {
            header_json: row.get(0)?,
            header_crc32: row.get(1)?,
            outcome_json: row.get(2)?,
            outcome_crc32: row.get(3)?,
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

/// Names of exported files are made from the run id, so a file from elsewhere must not have a path in its place.
fn check_run_id(path: &Path, run_id: &str) -> Result<(), RunFileError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let good =
        (1..=RUN_ID_BYTES).contains(&run_id.len()) && run_id.chars().all(allowed) && !run_id.starts_with('.');
    match good {
        true => Ok(()),
        false => Err(RunFileError::RunId {
            path: path.to_owned(),
        }),
    }
}
