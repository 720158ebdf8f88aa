//! The thread that brings a live run's write-ahead log to the disk, so that no commit waits for an fsync.
//!
//! Every 100 ms it syncs the log: a power cut costs about that much. When the log has grown long it copies the bulk into the
//! run file and asks the writer to finish the small rest, which only the writer can do between two of its commits.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rusqlite::Connection;

const SYNC_PERIOD: Duration = Duration::from_millis(100);
/// About 100 s of a live run at 1 kHz.
const LONG_LOG_BYTES: u64 = 64 << 20;

/// Handle of the thread; dropping it stops and joins.
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
    /// Starts the thread for the run file at `path`, whose log is there already.
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

    /// True once after the bulk of a long log is in the run file: the writer should finish the rest now.
    pub(super) fn take_finish_request(&self) -> bool {
        self.shared.finish_checkpoint.swap(false, Ordering::AcqRel)
    }

    /// True where a sync failed. The kernel may have dropped the bytes, so it is no use to try again.
    pub(super) fn failed(&self) -> bool {
        self.shared.failed.load(Ordering::Acquire)
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // The worker returns nothing and does not panic; there is nothing to pass on.
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

    /// Only the log is opened beside SQLite: closing a second handle on the run file itself would drop SQLite's locks.
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

    /// A passive checkpoint never blocks the writer; what is committed meanwhile is left for the writer to finish.
    fn copy_bulk(&self) -> rusqlite::Result<()> {
        let connection = Connection::open(&self.path)?;
        connection.pragma_update(None, "wal_autocheckpoint", 0)?;
        connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()))
    }
}

/// Where SQLite keeps the write-ahead log of `path`.
pub(super) fn log_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push("-wal");
    PathBuf::from(name)
}
