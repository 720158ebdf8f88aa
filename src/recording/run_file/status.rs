//! How a run file fares, readable while its writer is busy on another thread.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// What others may ask about a run file while its writer is busy on another thread.
#[derive(Debug, Default)]
pub(crate) struct RunFileStatus {
    pub(super) saved: AtomicU64,
    pub(super) in_memory: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) out_of_order: AtomicU64,
    pub(super) complete: AtomicBool,
    pub(super) failure: OnceLock<String>,
}

impl RunFileStatus {
    /// Samples committed to the file.
    pub(crate) fn saved(&self) -> u64 {
        self.saved.load(Ordering::Relaxed)
    }

    /// Samples that came after the file failed and are still in memory.
    pub(crate) fn in_memory(&self) -> u64 {
        self.in_memory.load(Ordering::Relaxed)
    }

    /// Samples that came after the file failed and fell out of memory: lost.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Samples refused because their tick was not later than the one before.
    pub(crate) fn out_of_order(&self) -> u64 {
        self.out_of_order.load(Ordering::Relaxed)
    }

    /// The first write error; final for this file.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    /// True once the outcome is in the file, the log is folded in and all of it is on the disk.
    pub(crate) fn complete(&self) -> bool {
        self.complete.load(Ordering::Acquire)
    }
}
