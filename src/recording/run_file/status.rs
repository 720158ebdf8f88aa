//! State of the files of a run for other threads, while the writer works on the recording thread.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What other threads may read about the files of a run, and the one thing that they may ask of the writer.
#[derive(Debug, Default)]
pub(crate) struct RunFileStatus {
    /// Samples that are known to be on the disk, and repeated ones that are not stored at all.
    settled: AtomicU64,
    /// Samples that are not on the disk and never will be.
    not_saved: AtomicU64,
    give_up: AtomicBool,
    over: AtomicBool,
    words: Mutex<Words>,
}

/// The files, and the problem in words.
#[derive(Debug, Default)]
struct Words {
    problem: String,
    paths: Vec<PathBuf>,
}

impl RunFileStatus {
    fn words(&self) -> MutexGuard<'_, Words> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Why samples are not on the disk, where they are, and what to do; `None` as long as all is well.
    pub(crate) fn problem(&self) -> Option<String> {
        Some(self.words().problem.clone()).filter(|problem| !problem.is_empty())
    }

    /// The files of the run in order: one, or more if the disk reported an error.
    pub(crate) fn paths(&self) -> Vec<PathBuf> {
        self.words().paths.clone()
    }

    /// Number of samples that need no more work: on the disk, or repeated.
    pub(crate) fn settled(&self) -> u64 {
        self.settled.load(Ordering::Relaxed)
    }

    /// Number of samples of an ended run that are not on the disk.
    pub(crate) fn not_saved(&self) -> u64 {
        self.not_saved.load(Ordering::Relaxed)
    }

    /// Asks the writer not to wait for a disk that cannot be written after the end of the run.
    pub(crate) fn give_up(&self) {
        self.give_up.store(true, Ordering::Relaxed);
    }

    /// The writer has ended: nothing more gets to the disk.
    pub(crate) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    pub(super) fn set_over(&self) {
        self.over.store(true, Ordering::Relaxed);
    }

    /// The writer was asked not to wait.
    pub(super) fn is_given_up(&self) -> bool {
        self.give_up.load(Ordering::Relaxed)
    }

    pub(super) fn settle(&self, samples: u64) {
        self.settled.fetch_add(samples, Ordering::Relaxed);
    }

    pub(super) fn set_not_saved(&self, samples: u64) {
        self.not_saved.store(samples, Ordering::Relaxed);
    }

    pub(super) fn set_problem(&self, problem: String) {
        self.words().problem = problem;
    }

    pub(super) fn add_path(&self, path: &Path) {
        self.words().paths.push(path.to_owned());
    }
}
