//! The thread that syncs the write-ahead log of a live run to the disk, so that no commit waits for an fsync.
//!
//! It syncs the log every 100 ms, so a power cut costs about 100 ms of samples. When the log is long, it copies most of it into
//! the run file and requests that the writer copies the small rest, because only the writer can do so between two commits.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode};

const SYNC_PERIOD: Duration = Duration::from_millis(100);
/// Length at which the log is copied into the run file: about 60 s of a live run at 1 kHz.
const LONG_LOG_BYTES: u64 = 64 << 20;

/// Handle of the thread. Dropping it stops and joins the thread.
pub(super) struct Syncer {
    shared: Arc<SyncState>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct SyncState {
    stop: AtomicBool,
    finish_checkpoint: AtomicBool,
    /// Number of commits in the log.
    committed: AtomicU64,
    /// Number of commits that are known to be on the disk.
    synced: AtomicU64,
    /// The first error. The kernel may have dropped the bytes, so a second try would prove nothing.
    failure: OnceLock<String>,
}

impl Syncer {
    /// Starts the thread for the run file at `path`. Its log must exist.
    pub(super) fn spawn(path: &Path) -> std::io::Result<Syncer> {
        let shared = Arc::new(SyncState::default());
        let mut worker = Worker {
            path: path.to_owned(),
            log: File::open(log_path(path))?,
            shared: shared.clone(),
        };
        let thread = thread::Builder::new()
            .name("run-file-sync".into())
            .spawn(move || worker.run())?;
        Ok(Syncer {
            shared,
            thread: Some(thread),
        })
    }

    /// Tells the thread how many commits the log has.
    pub(super) fn note_commits(&self, commits: u64) {
        self.shared.committed.store(commits, Ordering::Release);
    }

    /// Number of commits that are on the disk, or why a sync failed.
    pub(super) fn synced(&self) -> Result<u64, String> {
        match self.shared.failure.get() {
            Some(cause) => Err(cause.clone()),
            None => Ok(self.shared.synced.load(Ordering::Acquire)),
        }
    }

    /// True once after most of a long log is in the run file: the writer must copy the rest now.
    pub(super) fn take_finish_request(&self) -> bool {
        self.shared.finish_checkpoint.swap(false, Ordering::AcqRel)
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // The worker returns nothing and does not panic.
            let _ = thread.join();
        }
    }
}

struct Worker {
    path: PathBuf,
    /// Opened once: the kernel reports a failed write-back to every handle that was open at that time.
    log: File,
    shared: Arc<SyncState>,
}

impl Worker {
    fn run(&mut self) {
        while !self.shared.stop.load(Ordering::Acquire) {
            thread::park_timeout(SYNC_PERIOD);
            if let Err(cause) = self.sync_log() {
                // Only this thread writes it, and it ends here.
                let _ = self.shared.failure.set(cause);
                return;
            }
        }
    }

    /// Uses the log only: closing a second handle on the run file itself would drop SQLite's locks.
    fn sync_log(&mut self) -> Result<(), String> {
        let committed = self.shared.committed.load(Ordering::Acquire);
        let failed = |error: std::io::Error| format!("syncing it to the disk failed: {error}");
        self.log.sync_data().map_err(failed)?;
        self.shared.synced.store(committed, Ordering::Release);
        let waiting = self.shared.finish_checkpoint.load(Ordering::Acquire);
        if !waiting && self.log.metadata().map_err(failed)?.len() > LONG_LOG_BYTES {
            match self.copy_bulk() {
                Ok(()) => self.shared.finish_checkpoint.store(true, Ordering::Release),
                Err(error) if can_wait(&error) => {}
                Err(error) => return Err(format!("copying its log into it failed: {error}")),
            }
        }
        Ok(())
    }

    /// A passive checkpoint never blocks the writer. What is committed meanwhile is left for the writer to copy.
    fn copy_bulk(&self) -> rusqlite::Result<()> {
        let connection = Connection::open(&self.path)?;
        connection.pragma_update(None, "wal_autocheckpoint", 0)?;
        connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()))
    }
}

/// True for an error of a checkpoint that harms nothing, because the log keeps everything: a reader is at work, or the disk is
/// full.
pub(super) fn can_wait(error: &rusqlite::Error) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked | ErrorCode::DiskFull)
    )
}

/// Path of SQLite's write-ahead log of `path`.
pub(super) fn log_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push("-wal");
    PathBuf::from(name)
}
