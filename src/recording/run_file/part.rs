//! One file that takes the samples of a run. A run has one, unless the disk reports an error: then the next one continues it.
//!
//! A full disk or a locked file leaves the file sound, and the same commit may be tried again. Any other error is final for
//! the file: after it nobody knows which of the bytes that were not synced are on the disk.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags, params};

use super::RunFileError;
use super::block::{self, RECORD_BYTES};
use super::layout::{self, APPLICATION_ID, FORMAT_VERSION, SCHEMA, Totals};
use super::sync::{self, Syncer};
use crate::recording::{Event, Header, Outcome, Sample, atomic_file};

/// Disk space that is kept for the outcome, so that a run that filled the disk can still be closed.
const RESERVE_BYTES: usize = 256 << 10;

/// Why a commit is not in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum WriteError {
    /// The disk is full. The file is as before, and the commit can be tried again. With the words of the error.
    Full(String),
    /// Another program has locked the file, for example to recover its log. As for a full disk.
    Busy(String),
    /// Any other error, which is final for the file.
    Failed(String),
}

impl From<rusqlite::Error> for WriteError {
    fn from(error: rusqlite::Error) -> Self {
        match error.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => WriteError::Full(error.to_string()),
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => WriteError::Busy(error.to_string()),
            _ => WriteError::Failed(error.to_string()),
        }
    }
}

/// A file that takes samples, or a test in its place.
pub(super) trait Part: Send {
    /// Writes the header again, before the first commit.
    fn rewrite_header(&mut self, header: &Header) -> Result<(), WriteError>;
    /// Writes samples and events in one transaction, whole or not at all.
    fn commit(&mut self, samples: &[Sample], events: &[Event]) -> Result<(), WriteError>;
    /// Number of commits that are known to be on the disk.
    fn synced(&mut self) -> Result<u64, WriteError>;
    /// Waits until all commits are on the disk.
    fn sync(&mut self) -> Result<(), WriteError>;
    /// Writes the outcome and syncs it with all commits. After an error the same call may be tried again.
    fn close(&mut self, outcome: &Outcome) -> Result<(), WriteError>;
}

/// Makes the files of a run, or stands for the disk in a test.
pub(super) trait Disk: Send {
    /// Makes a file with its header. `zero_tick` is the tick of time 0, if samples came before this file.
    fn make(
        &mut self,
        path: &Path,
        header: &Header,
        zero_tick: Option<u64>,
    ) -> Result<Box<dyn Part>, RunFileError>;
}

/// The file system.
pub(super) struct FileSystem;

impl Disk for FileSystem {
    fn make(
        &mut self,
        path: &Path,
        header: &Header,
        zero_tick: Option<u64>,
    ) -> Result<Box<dyn Part>, RunFileError> {
        Ok(Box::new(PartFile::create(path, header, zero_tick)?))
    }
}

/// A run file that is being written.
pub(super) struct PartFile {
    path: PathBuf,
    database: Connection,
    /// `None` after the outcome is written.
    syncer: Option<Syncer>,
    totals: Totals,
    commits: u64,
    packed: Vec<u8>,
}

impl PartFile {
    /// Makes the file with its header and syncs it, so that a disk that cannot be written is found before the run.
    pub(super) fn create(
        path: &Path,
        header: &Header,
        zero_tick: Option<u64>,
    ) -> Result<PartFile, RunFileError> {
        if path.exists() {
            return Err(RunFileError::Exists {
                path: path.to_owned(),
            });
        }
        let io = |doing| {
            move |source| RunFileError::Io {
                path: path.to_owned(),
                doing,
                source,
            }
        };
        let totals = Totals {
            zero_tick,
            ..Totals::default()
        };
        make_tables(path, header, &totals).map_err(|source| match source {
            MakeError::Io(source) => io("making")(source),
            MakeError::Database(source) => RunFileError::database(path, "making", source),
        })?;
        let database =
            open_with_log(path, &totals).map_err(|source| RunFileError::database(path, "making", source))?;
        keep_reserve(path).map_err(io("reserving space for the end of"))?;
        atomic_file::sync_folder(path).map_err(io("syncing the folder of"))?;
        let syncer = Syncer::spawn(path).map_err(io("starting the sync thread of"))?;
        Ok(PartFile {
            path: path.to_owned(),
            database,
            syncer: Some(syncer),
            totals,
            commits: 0,
            packed: Vec::new(),
        })
    }

    /// The sync thread has copied most of a long log; the few frames since then are copied here, between two commits.
    fn finish_checkpoint_if_requested(&mut self) -> Result<(), WriteError> {
        if !self.syncer.as_ref().is_some_and(Syncer::take_finish_request) {
            return Ok(());
        }
        match self
            .database
            .query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))
        {
            // The log then grows and the thread requests it again.
            Err(error) if !sync::can_wait(&error) => Err(WriteError::Failed(error.to_string())),
            _ => Ok(()),
        }
    }

    #[cfg(test)]
    pub(super) fn limit_pages(&mut self, pages: u32) {
        let set = self
            .database
            .query_row(&format!("PRAGMA max_page_count = {pages}"), [], |_| Ok(()));
        set.expect("the pragma takes any number");
    }
}

impl Part for PartFile {
    fn rewrite_header(&mut self, header: &Header) -> Result<(), WriteError> {
        Ok(layout::write_header(&self.database, header)?)
    }

    fn commit(&mut self, samples: &[Sample], events: &[Event]) -> Result<(), WriteError> {
        let transaction = self.database.transaction()?;
        let mut totals = self.totals;
        let mut rest = samples;
        while let Some(first) = rest.first() {
            // A block's ticks are 32-bit offsets; only a gap of seven weeks splits one.
            let fits = rest
                .iter()
                .position(|s| s.tick - first.tick > u64::from(u32::MAX))
                .unwrap_or(rest.len());
            let (now, later) = rest.split_at(fits);
            self.packed.clear();
            self.packed.reserve(now.len() * RECORD_BYTES);
            for sample in now {
                block::pack(sample, first.tick, &mut self.packed);
            }
            totals.blocks += 1;
            write_block(
                &transaction,
                totals.blocks,
                first.tick,
                now.len() as u64,
                &self.packed,
            )?;
            totals.zero_tick.get_or_insert(first.tick);
            totals.first_tick.get_or_insert(first.tick);
            totals.last_tick = now.last().map(|s| s.tick);
            totals.samples += now.len() as u64;
            rest = later;
        }
        for event in events {
            totals.events += 1;
            layout::write_event(&transaction, totals.events, event)?;
        }
        totals.write(&transaction)?;
        transaction.commit()?;
        self.totals = totals;
        self.commits += 1;
        if let Some(syncer) = &self.syncer {
            syncer.note_commits(self.commits);
        }
        self.finish_checkpoint_if_requested()
    }

    fn synced(&mut self) -> Result<u64, WriteError> {
        match &self.syncer {
            Some(syncer) => syncer.synced().map_err(WriteError::Failed),
            None => Ok(self.commits),
        }
    }

    fn sync(&mut self) -> Result<(), WriteError> {
        let failed =
            |error: std::io::Error| WriteError::Failed(format!("syncing it to the disk failed: {error}"));
        // A sync that failed in the thread may not fail again here.
        self.synced()?;
        let log = File::open(sync::log_path(&self.path)).map_err(failed)?;
        log.sync_data().map_err(failed)?;
        self.synced()?;
        Ok(())
    }

    fn close(&mut self, outcome: &Outcome) -> Result<(), WriteError> {
        free_reserve(&self.path);
        // With FULL the commit itself syncs the log, with everything that was committed before.
        self.database.pragma_update(None, "synchronous", "FULL")?;
        let closed = Totals {
            closed: true,
            ..self.totals
        };
        let transaction = self.database.transaction()?;
        layout::write_outcome(&transaction, outcome)?;
        closed.write(&transaction)?;
        transaction.commit()?;
        self.sync()?;
        self.totals = closed;
        self.syncer = None;
        if let Err(error) = merge_log(&self.database) {
            // Everything is on the disk, in the file and the log beside it, and any reader takes both.
            tracing::warn!(path = %self.path.display(), "the log of the run file stays beside it: {error}");
        }
        Ok(())
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        free_reserve(&self.path);
    }
}

/// Why the tables could not be made.
enum MakeError {
    Io(std::io::Error),
    Database(rusqlite::Error),
}

impl From<std::io::Error> for MakeError {
    fn from(error: std::io::Error) -> Self {
        MakeError::Io(error)
    }
}

impl From<rusqlite::Error> for MakeError {
    fn from(error: rusqlite::Error) -> Self {
        MakeError::Database(error)
    }
}

/// Makes the tables under another name first: a kill in between leaves a file that is not listed as a run.
fn make_tables(path: &Path, header: &Header, totals: &Totals) -> Result<(), MakeError> {
    let unfinished = path.with_extension("making");
    // What a killed process left there.
    let _ = std::fs::remove_file(&unfinished);
    // SQLite gives its log the access rights of the file.
    drop(atomic_file::create_private(&unfinished)?);
    let made = || -> Result<(), MakeError> {
        let database = Connection::open_with_flags(&unfinished, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
        database.pragma_update(None, "application_id", APPLICATION_ID)?;
        database.pragma_update(None, "user_version", FORMAT_VERSION)?;
        database.execute_batch(&format!("BEGIN; {SCHEMA} COMMIT;"))?;
        layout::write_header(&database, header)?;
        totals.write(&database)?;
        database.close().map_err(|(_, error)| error)?;
        Ok(std::fs::rename(&unfinished, path)?)
    };
    let made = made();
    if made.is_err() {
        // On a full disk every attempt would leave one.
        let _ = std::fs::remove_file(&unfinished);
    }
    made
}

/// Opens the file for a live run.
fn open_with_log(path: &Path, totals: &Totals) -> rusqlite::Result<Connection> {
    let database = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
    // A commit goes to the log without an fsync. The log is merged only when the sync thread requests it.
    database.query_row("PRAGMA journal_mode = WAL", [], |_| Ok(()))?;
    database.pragma_update(None, "synchronous", "NORMAL")?;
    database.query_row("PRAGMA wal_autocheckpoint = 0", [], |_| Ok(()))?;
    database.busy_timeout(Duration::ZERO)?;
    // The first write makes the log, which the sync thread opens by name.
    totals.write(&database)?;
    Ok(database)
}

fn write_block(
    database: &Connection,
    seq: u64,
    first_tick: u64,
    count: u64,
    data: &[u8],
) -> rusqlite::Result<()> {
    let crc32 = block::block_crc32(seq, first_tick, count, data);
    database
        .prepare_cached("INSERT INTO blocks VALUES (?1, ?2, ?3, ?4, ?5)")?
        .execute(params![seq as i64, first_tick as i64, count as i64, crc32, data])?;
    Ok(())
}

/// Merges the write-ahead log into the file, so that one plain file is left, and syncs it.
pub(super) fn merge_log(database: &Connection) -> rusqlite::Result<()> {
    // The page of a live run may be reading at this moment.
    database.busy_timeout(Duration::from_secs(2))?;
    database.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
    match database.query_row("PRAGMA journal_mode = DELETE", [], |_| Ok(())) {
        // Everything is in the file. A reader that has it open only keeps an empty log beside it.
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) => Ok(()),
        other => other,
    }
}

/// Path of the reserve of a run file.
fn reserve_path(path: &Path) -> PathBuf {
    path.with_extension("reserve")
}

/// Takes the space that the end of the run will need.
fn keep_reserve(path: &Path) -> std::io::Result<()> {
    let reserve = reserve_path(path);
    // What a killed process left there.
    let _ = std::fs::remove_file(&reserve);
    let mut file = atomic_file::create_private(&reserve)?;
    file.write_all(&vec![0x55; RESERVE_BYTES])
}

/// Gives the reserved space back; also for the file of a killed daemon.
pub(super) fn free_reserve(path: &Path) {
    // Usually it is there once; a second call finds nothing.
    let _ = std::fs::remove_file(reserve_path(path));
}
