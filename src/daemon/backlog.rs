//! Counts what control records and what the recording thread has taken up: a twin that is behind leaves its column empty.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::recording::{Event, Header, Outcome, Recorder, Sample};

/// Samples that may wait before the twin is left out: half a second, of the minute that the ring holds.
const BEHIND_SAMPLES: u64 = 500;

/// Both counts.
#[derive(Debug, Clone, Default)]
pub(super) struct Backlog {
    recorded: Arc<AtomicU64>,
    taken: Arc<AtomicU64>,
}

impl Backlog {
    /// To stand before the ring, in control.
    pub(super) fn before<R: Recorder>(&self, next: R) -> Counted<R> {
        Counted {
            next,
            count: Arc::clone(&self.recorded),
        }
    }

    /// To stand behind the ring, in the recording thread.
    pub(super) fn behind<R: Recorder>(&self, next: R) -> Counted<R> {
        Counted {
            next,
            count: Arc::clone(&self.taken),
        }
    }

    /// Samples pile up.
    pub(super) fn is_long(&self) -> bool {
        let taken = self.taken.load(Ordering::Relaxed);
        self.recorded.load(Ordering::Relaxed).saturating_sub(taken) > BEHIND_SAMPLES
    }
}

/// Counts the samples that pass.
pub(super) struct Counted<R> {
    next: R,
    count: Arc<AtomicU64>,
}

impl<R: Recorder> Recorder for Counted<R> {
    fn begin(&mut self, header: &Header) {
        self.next.begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        self.count.fetch_add(1, Ordering::Relaxed);
        self.next.sample(sample);
    }

    fn event(&mut self, event: &Event) {
        self.next.event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        self.next.end(outcome);
    }

    fn flush(&mut self) {
        self.next.flush();
    }
}
