//! State of a run file for other threads, while its writer works on the recording thread.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// What other threads may read about a run file.
#[derive(Debug, Default)]
pub(crate) struct RunFileStatus {
    /// Samples that came after the file failed.
    pub(super) unsaved: AtomicU64,
    /// The first error, which is final for the file.
    pub(super) failure: OnceLock<String>,
}

impl RunFileStatus {
    /// Why the file is not complete, and how many samples it lacks; `None` as long as everything is saved.
    pub(crate) fn problem(&self) -> Option<String> {
        let cause = self.failure.get()?;
        Some(match self.unsaved.load(Ordering::Relaxed) {
            0 => cause.clone(),
            unsaved => format!("{cause}; {unsaved} samples are not in the file"),
        })
    }
}
