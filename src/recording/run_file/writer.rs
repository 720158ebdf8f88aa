//! Writes the file of one run: a block of samples at least every 10 ms, so that a kill costs at most the last 20 ms. The
//! layout of a block is in `block`; `sync` brings the data to the disk.
//!
//! The first write error is final for the file: it stays as it is, and the status has the cause and counts the samples that
//! are not in the file.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rusqlite::{Connection, OpenFlags, params};

use super::block::{self, RECORD_BYTES};
use super::status::RunFileStatus;
use super::sync::Syncer;
use super::{APPLICATION_ID, FORMAT_VERSION, RunFileError, SCHEMA};
use crate::recording::{Event, Header, Outcome, Recorder, Sample, atomic_file};

/// Number of samples in the largest block: a run in virtual time commits this many at once.
const BLOCK_SAMPLES: usize = 2048;
/// A block is committed at the latest this long after the one before it.
const COMMIT_PERIOD: Duration = Duration::from_millis(10);
/// Number of samples between two looks at the clock, because reading it costs more than packing a sample.
const SAMPLES_PER_CLOCK_LOOK: usize = 8;

/// A [`Recorder`] that writes one run file.
pub(crate) struct RunFileWriter {
    path: PathBuf,
    /// `None` after a failure or the end.
    database: Option<Connection>,
    syncer: Option<Syncer>,
    pending: Vec<Sample>,
    events: Vec<Event>,
    packed: Vec<u8>,
    blocks: u64,
    first_tick: Option<u64>,
    last_tick: Option<u64>,
    last_commit: Instant,
    /// Number of samples in the file.
    saved: u64,
    status: Arc<RunFileStatus>,
}

impl RunFileWriter {
    /// Makes the file with its header and syncs it, so that a disk that cannot be written is found before the run.
    pub(crate) fn create(path: &Path, header: &Header) -> Result<RunFileWriter, RunFileError> {
        if path.exists() {
            return Err(RunFileError::Exists {
                path: path.to_owned(),
            });
        }
        let database = create_database(path, header)
            .map_err(|source| RunFileError::database(path, "making the run file", source))?;
        let io = |doing| {
            move |source| RunFileError::Io {
                path: path.to_owned(),
                doing,
                source,
            }
        };
        atomic_file::sync_folder(path).map_err(io("syncing the folder of"))?;
        let syncer = Syncer::spawn(path).map_err(io("starting the sync thread of"))?;
        Ok(RunFileWriter {
            path: path.to_owned(),
            database: Some(database),
            syncer: Some(syncer),
            pending: Vec::with_capacity(BLOCK_SAMPLES),
            events: Vec::new(),
            packed: Vec::with_capacity(BLOCK_SAMPLES * RECORD_BYTES),
            blocks: 0,
            first_tick: None,
            last_tick: None,
            last_commit: Instant::now(),
            saved: 0,
            status: Arc::default(),
        })
    }

    /// The state of the file, for other threads.
    pub(crate) fn status(&self) -> Arc<RunFileStatus> {
        self.status.clone()
    }

    /// Commits what is pending; a failure is final.
    fn commit(&mut self) {
        self.last_commit = Instant::now();
        if self.pending.is_empty() && self.events.is_empty() {
            return;
        }
        if self.syncer.as_ref().is_some_and(Syncer::failed) {
            return self.fail("syncing the run file to the disk failed".into());
        }
        match self.try_commit() {
            Ok(()) => {
                self.saved += self.pending.len() as u64;
                self.pending.clear();
                self.events.clear();
                self.finish_checkpoint_if_requested();
            }
            Err(error) => self.fail(error.to_string()),
        }
    }

    fn try_commit(&mut self) -> rusqlite::Result<()> {
        let Some(database) = self.database.as_mut() else {
            return Ok(());
        };
        let transaction = database.transaction()?;
        let mut blocks = self.blocks;
        let mut rest = self.pending.as_slice();
        while let Some(first) = rest.first() {
            // A block's ticks are 32-bit offsets; only a gap of seven weeks splits one.
            let fits = rest
                .iter()
                .position(|s| s.tick - first.tick > u64::from(u32::MAX))
                .unwrap_or(rest.len());
            let (now, later) = rest.split_at(fits);
            self.packed.clear();
            for sample in now {
                block::pack(sample, first.tick, &mut self.packed);
            }
            blocks += 1;
            if blocks == 1 {
                transaction.execute("UPDATE run SET first_tick = ?1", [first.tick as i64])?;
            }
            let crc32 = block::block_crc32(blocks, first.tick, now.len() as u64, &self.packed);
            transaction
                .prepare_cached("INSERT INTO blocks VALUES (?1, ?2, ?3, ?4, ?5)")?
                .execute(params![
                    blocks as i64,
                    first.tick as i64,
                    now.len() as i64,
                    crc32,
                    self.packed
                ])?;
            rest = later;
        }
        for event in &self.events {
            let kind = serde_json::to_value(event.kind).unwrap_or_default();
            transaction
                .prepare_cached("INSERT INTO events (tick, time_s, kind, text) VALUES (?1, ?2, ?3, ?4)")?
                .execute(params![
                    event.tick as i64,
                    event.time_s,
                    kind.as_str().unwrap_or_default(),
                    event.text
                ])?;
        }
        transaction.commit()?;
        self.blocks = blocks;
        Ok(())
    }

    /// The sync thread has copied most of a long log; the few frames since then are copied here, between two commits.
    fn finish_checkpoint_if_requested(&mut self) {
        let (Some(database), Some(syncer)) = (&self.database, &self.syncer) else {
            return;
        };
        if syncer.take_finish_request() {
            // A reader of the live run can prevent this. The log then grows and the thread requests it again.
            let _ = database.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
        }
    }

    /// Closes the file as it is. From here on samples are only counted.
    fn fail(&mut self, cause: String) {
        tracing::error!(path = %self.path.display(), cause, "the run file failed: the samples from here on are not saved");
        // Only the first cause is kept: later ones follow from it.
        let _ = self.status.failure.set(cause);
        self.syncer = None;
        self.database = None;
        self.events.clear();
        self.drop_pending();
    }

    fn drop_pending(&mut self) {
        let dropped = self.pending.drain(..).count() as u64;
        self.status.unsaved.fetch_add(dropped, Ordering::Relaxed);
    }

    /// Writes the outcome, merges the log, leaves one file and syncs it.
    fn close(&mut self, outcome: &Outcome) -> Result<(), String> {
        self.syncer = None;
        let Some(database) = self.database.take() else {
            return Ok(());
        };
        let last = self.last_tick.map(|tick| tick as i64);
        write_outcome(&database, outcome, last, self.blocks)
            .and_then(|()| merge_log(&database))
            .map_err(|error| error.to_string())?;
        database.close().map_err(|(_, error)| error.to_string())?;
        atomic_file::sync_folder(&self.path).map_err(|error| error.to_string())
    }

    /// The outcome with the counts of this file: samples + lost = ticks from the first to the last sample.
    fn with_own_counts(&self, outcome: &Outcome) -> Outcome {
        let samples = self.saved;
        let span = match (self.first_tick, self.last_tick) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        };
        Outcome {
            samples,
            lost: span.saturating_sub(samples),
            ..outcome.clone()
        }
    }

    #[cfg(test)]
    pub(super) fn limit_pages(&mut self, pages: u32) {
        if let Some(database) = &self.database {
            let set = database.query_row(&format!("PRAGMA max_page_count = {pages}"), [], |_| Ok(()));
            set.expect("the pragma takes any number");
        }
    }
}

impl Recorder for RunFileWriter {
    /// Writes the header again: a tare since `create` has changed it.
    fn begin(&mut self, header: &Header) {
        if let Some(database) = &self.database
            && let Err(error) = write_header(database, header)
        {
            self.fail(error.to_string());
        }
    }

    fn sample(&mut self, sample: &Sample) {
        if self.last_tick.is_some_and(|last| sample.tick <= last) {
            return;
        }
        self.first_tick.get_or_insert(sample.tick);
        self.last_tick = Some(sample.tick);
        self.pending.push(*sample);
        if self.database.is_none() {
            return self.drop_pending();
        }
        let pending = self.pending.len();
        let look = pending.is_multiple_of(SAMPLES_PER_CLOCK_LOOK);
        if pending >= BLOCK_SAMPLES || (look && self.last_commit.elapsed() >= COMMIT_PERIOD) {
            self.commit();
        }
    }

    fn event(&mut self, event: &Event) {
        if self.database.is_some() {
            self.events.push(event.clone());
        }
    }

    fn end(&mut self, outcome: &Outcome) {
        self.commit();
        if self.database.is_none() {
            return;
        }
        let outcome = self.with_own_counts(outcome);
        if let Err(cause) = self.close(&outcome) {
            self.fail(cause);
        }
    }

    fn flush(&mut self) {
        self.commit();
    }
}

impl Drop for RunFileWriter {
    /// A writer that is dropped without an end leaves an open run with all samples so far.
    fn drop(&mut self) {
        self.commit();
    }
}

/// Makes the tables under another name first: a kill in between leaves a file that is not listed as a run.
fn create_database(path: &Path, header: &Header) -> rusqlite::Result<Connection> {
    let unfinished = path.with_extension("making");
    let _ = std::fs::remove_file(&unfinished);
    make_tables(&unfinished, header)?;
    std::fs::rename(&unfinished, path)
        .map_err(|error| rusqlite::Error::ToSqlConversionFailure(Box::new(error)))?;
    let database = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
    // A commit goes to the log without an fsync. The log is merged only when the sync thread requests it.
    database.query_row("PRAGMA journal_mode = WAL", [], |_| Ok(()))?;
    database.pragma_update(None, "synchronous", "NORMAL")?;
    database.query_row("PRAGMA wal_autocheckpoint = 0", [], |_| Ok(()))?;
    database.busy_timeout(Duration::ZERO)?;
    // The first write makes the log, which the sync thread opens by name.
    database.execute("UPDATE run SET first_tick = NULL", [])?;
    Ok(database)
}

fn make_tables(path: &Path, header: &Header) -> rusqlite::Result<()> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE;
    let database = Connection::open_with_flags(path, flags)?;
    database.pragma_update(None, "application_id", APPLICATION_ID)?;
    database.pragma_update(None, "user_version", FORMAT_VERSION)?;
    database.execute_batch(&format!("BEGIN; {SCHEMA} COMMIT;"))?;
    write_header(&database, header)?;
    database.close().map_err(|(_, error)| error)
}

fn write_header(database: &Connection, header: &Header) -> rusqlite::Result<()> {
    let json = to_json(header)?;
    database.execute(
        "INSERT INTO run (id, header_json, header_crc32) VALUES (1, ?1, ?2)
         ON CONFLICT (id) DO UPDATE SET header_json = ?1, header_crc32 = ?2",
        params![json, block::crc32(json.as_bytes())],
    )?;
    Ok(())
}

/// Writes the outcome, and the last tick and number of blocks, which the reader needs if the file is damaged.
pub(super) fn write_outcome(
    database: &Connection,
    outcome: &Outcome,
    last_tick: Option<i64>,
    blocks: u64,
) -> rusqlite::Result<()> {
    let json = to_json(outcome)?;
    database.execute(
        "UPDATE run SET outcome_json = ?1, outcome_crc32 = ?2, last_tick = ?3, block_count = ?4",
        params![json, block::crc32(json.as_bytes()), last_tick, blocks as i64],
    )?;
    Ok(())
}

/// Merges the write-ahead log into the file, so that one plain file is left, and syncs it.
pub(super) fn merge_log(database: &Connection) -> rusqlite::Result<()> {
    // The page of a live run may be reading at this moment.
    database.busy_timeout(Duration::from_secs(2))?;
    database.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
    match database.query_row("PRAGMA journal_mode = DELETE", [], |_| Ok(())) {
        // Everything is in the file. A reader that has it open only keeps an empty log beside it.
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::DatabaseBusy) => Ok(()),
        other => other,
    }
}

fn to_json<T: serde::Serialize>(value: &T) -> rusqlite::Result<String> {
    serde_json::to_string(value).map_err(|error| rusqlite::Error::ToSqlConversionFailure(Box::new(error)))
}

#[cfg(test)]
mod tests {
    use super::super::test_support::{header, outcome, sample};
    use super::super::{RunFile, check_space};
    use super::*;
    use crate::recording::EventKind;

    fn event(tick: u64) -> Event {
        Event {
            tick,
            time_s: tick as f64 / 1000.0,
            kind: EventKind::Start,
            text: "started".into(),
        }
    }

    #[test]
    fn a_run_comes_back_bit_for_bit_from_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        writer.begin(&header());
        writer.event(&event(0));
        let samples: Vec<Sample> = (0..5000).filter(|tick| tick % 1700 != 7).map(sample).collect();
        for s in &samples {
            writer.sample(s);
        }
        writer.end(&outcome(1));
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            1,
            "no log beside the file"
        );

        let run = RunFile::open(&path).unwrap();
        assert_eq!(run.header(), &header());
        assert_eq!(run.events(), vec![event(0)]);
        let ended = run.outcome().unwrap();
        assert_eq!(
            (ended.samples, ended.lost),
            (4997, 3),
            "ticks 7, 1707 and 3407 are missing"
        );
        let back: Vec<Sample> = run
            .samples()
            .map(|s| Sample {
                flags: samples[0].flags,
                ..s
            })
            .collect();
        assert_eq!(back, samples);
    }

    #[test]
    fn late_and_repeated_samples_are_not_stored() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        for tick in [5, 6, 6, 4, 7] {
            writer.sample(&sample(tick));
        }
        writer.end(&outcome(0));
        let run = RunFile::open(&path).unwrap();
        assert_eq!(run.samples().map(|s| s.tick).collect::<Vec<_>>(), [5, 6, 7]);
    }

    /// Fault K1: what is in the file stays, and every other sample is counted as not saved.
    #[test]
    fn a_full_disk_keeps_the_file_and_the_samples() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.leafrun");
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        writer.limit_pages(60);
        let status = writer.status();
        for tick in 0..100_000 {
            writer.sample(&sample(tick));
        }
        writer.end(&outcome(100_000));

        let run = RunFile::open(&path).unwrap();
        assert!(run.outcome().is_none(), "the run was not closed, so it is open");
        let back: Vec<Sample> = run.samples().collect();
        let saved = back.len() as u64;
        assert!(saved > 0);
        assert_eq!(back, (0..saved).map(sample).collect::<Vec<_>>());
        assert_eq!(status.unsaved.load(Ordering::Relaxed), 100_000 - saved);
        let problem = status.problem().unwrap();
        assert!(
            problem.ends_with(&format!("; {} samples are not in the file", 100_000 - saved)),
            "{problem}"
        );
    }

    #[test]
    fn a_run_file_is_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.leafrun");
        std::fs::write(&path, "mine").unwrap();
        assert!(matches!(
            RunFileWriter::create(&path, &header()),
            Err(RunFileError::Exists { .. })
        ));
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    }

    #[test]
    fn a_run_that_would_fill_the_disk_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        // A million hours at 1 kHz are 460 TB: more than the disk of any test machine.
        let refused = check_space(folder.path(), 3.6e9, 1000.0);
        assert!(matches!(refused, Err(RunFileError::NoSpace { .. })));
    }
}
