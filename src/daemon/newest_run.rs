//! The run under way, or the newest one of this daemon: how far it is, and whether its file is closed. The recording thread
//! writes it, the HTTP interface reads it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::client_types::{RunProgress, RunState};
use super::store;
use crate::recording::run_file::{self, RunFileStatus};

/// The newest run of this daemon. Clones share the same run.
#[derive(Clone, Default)]
pub(super) struct NewestRun(Arc<Mutex<Option<TrackedRun>>>);

struct TrackedRun {
    progress: RunProgress,
    path: PathBuf,
    disk: Arc<RunFileStatus>,
    /// The recording thread has ended, so the file no longer changes.
    closed: bool,
}

impl NewestRun {
    fn lock(&self) -> MutexGuard<'_, Option<TrackedRun>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A run that is about to start takes the place of the one before it, which no longer waits for its disk.
    pub(super) fn begin(&self, run_id: String, profile: String, path: PathBuf, disk: Arc<RunFileStatus>) {
        self.give_up_waiting();
        *self.lock() = Some(TrackedRun {
            progress: RunProgress::arming(run_id, profile),
            path,
            disk,
            closed: false,
        });
    }

    /// How far the run is; `None` before the first run of this daemon.
    pub(super) fn progress(&self) -> Option<RunProgress> {
        self.lock().as_ref().map(|run| RunProgress {
            disk_problem: run.disk.problem().unwrap_or_default(),
            samples_not_saved: run.disk.not_saved(),
            ..run.progress.clone()
        })
    }

    /// The writer of the run does not wait for a disk that cannot be written after the end of the run.
    pub(super) fn give_up_waiting(&self) {
        if let Some(run) = self.lock().as_ref() {
            run.disk.give_up();
        }
    }

    /// Changes the progress of the run, if there is one.
    pub(super) fn update(&self, change: impl FnOnce(&mut RunProgress)) {
        if let Some(run) = self.lock().as_mut() {
            change(&mut run.progress);
        }
    }

    /// No recording thread is at work.
    pub(super) fn is_closed(&self) -> bool {
        self.lock().as_ref().is_none_or(|run| run.closed)
    }

    /// The recording thread of the run at `path` has ended. A run that never started leaves no file; `notice` says why the
    /// rig did not arm.
    pub(super) fn close(&self, path: &Path, notice: impl FnOnce() -> String) {
        let mut newest = self.lock();
        let Some(run) = newest.as_mut().filter(|run| run.path == path) else {
            return;
        };
        if run.progress.state == RunState::Arming {
            run.progress.state = RunState::NeverStarted;
            run.progress.cause = notice();
            run.disk.paths().iter().for_each(|path| run_file::remove(path));
        } else if run.progress.state == RunState::Running {
            tracing::error!(
                "the recording of run {} ended before the run",
                run.progress.run_id
            );
        }
        run.closed = true;
    }

    /// Closes the file that a recording thread left open when the daemon ends. Returns what was done, for the log.
    pub(super) fn close_unfinished(&self, cause: &str) -> Option<String> {
        let newest = self.lock();
        let open = newest
            .as_ref()
            .filter(|run| run.progress.state == RunState::Running || !run.closed);
        open.map(|run| {
            let paths = run.disk.paths();
            let path = paths.last().unwrap_or(&run.path);
            store::close_as_aborted(path, &run.progress.run_id, cause)
        })
    }
}
