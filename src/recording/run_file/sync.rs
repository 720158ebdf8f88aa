//! The thread that syncs the write-ahead log of a live run to the disk, so that no commit waits for an fsync.
//!
//! It syncs the log every 100 ms, so a power cut costs about 100 ms of samples. When the log is long, it copies most of it into
//! the run file and requests that the writer copies the small rest, because only the writer can do so between two commits.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rusqlite::Connection;

const SYNC_PERIOD: Duration = Duration::from_millis(100);
/// Length at which the log is copied into the run file: about 100 s of a live run at 1 kHz.
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
    failed: AtomicBool,
}

impl Syncer {
    /// Starts the thread for the run file at `path`. Its log must exist.
    pub(super) fn spawn(path: &Path) -> std::io::Result<Syncer> {
        let shared = Arc::new(SyncState::default());
        let mut worker = Worker {
            path: path.to_owned(),
            log: None,
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

    /// True once after most of a long log is in the run file: the writer must copy the rest now.
    pub(super) fn take_finish_request(&self) -> bool {
        self.shared.finish_checkpoint.swap(false, Ordering::AcqRel)
    }

    /// True if a sync failed. The kernel may have dropped the bytes, so a second try would prove nothing.
    pub(super) fn failed(&self) -> bool {
        self.shared.failed.load(Ordering::Acquire)
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
    log: Option<File>,
    shared: Arc<SyncState>,
}

impl Worker {
    fn run(&mut self) {
        loop {
            thread::park_timeout(SYNC_PERIOD);
            if self.shared.stop.load(Ordering::Acquire) {
                return;
            }
            if self.sync_log().is_err() {
                self.shared.failed.store(true, Ordering::Release);
                return;
            }
        }
    }

    /// Opens the log only: closing a second handle on the run file itself would drop SQLite's locks.
    fn sync_log(&mut self) -> std::io::Result<()> {
        let log = match &self.log {
            Some(log) => log,
            None => self.log.insert(File::open(log_path(&self.path))?),
        };
        log.sync_data()?;
        let waiting = self.shared.finish_checkpoint.load(Ordering::Acquire);
        if !waiting && log.metadata()?.len() > LONG_LOG_BYTES && self.copy_bulk().is_ok() {
            self.shared.finish_checkpoint.store(true, Ordering::Release);
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

/// Path of SQLite's write-ahead log of `path`.
pub(super) fn log_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push("-wal");
    PathBuf::from(name)
}
