//! Counts the samples that control has recorded and those that the recording thread has taken. The difference is the
//! backlog. While it is long the twin is skipped and its column stays empty.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{Event, Header, Outcome, Recorder, Sample, StreamEvent};

/// A backlog longer than this skips the twin: half a second of samples. The ring holds more than a minute.
const LONG_SAMPLES: u64 = SAMPLE_RATE_HZ as u64 / 2;

/// Samples that wait between control and the recording thread. Clones share the counts.
#[derive(Debug, Clone, Default)]
pub(super) struct Backlog {
    recorded: Arc<AtomicU64>,
    taken: Arc<AtomicU64>,
}

impl Backlog {
    /// Counts the samples that control puts into `next`, the ring.
    pub(super) fn count_recorded<R: Recorder>(&self, next: R) -> Counted<R> {
        Counted {
            next,
            count: Arc::clone(&self.recorded),
        }
    }

    /// Counts the samples that the recording thread takes from the ring and gives to `next`.
    pub(super) fn count_taken<R: Recorder>(&self, next: R) -> Counted<R> {
        Counted {
            next,
            count: Arc::clone(&self.taken),
        }
    }

    /// Samples that control has recorded so far.
    pub(super) fn recorded(&self) -> u64 {
        self.recorded.load(Ordering::Relaxed)
    }

    /// More than half a second of samples waits.
    pub(super) fn is_long(&self) -> bool {
        let taken = self.taken.load(Ordering::Relaxed);
        self.recorded.load(Ordering::Relaxed).saturating_sub(taken) > LONG_SAMPLES
    }
}

/// A recorder that counts the samples it passes on to `next`.
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

    fn stream_event(&mut self, event: &StreamEvent) {
        self.next.stream_event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        self.next.end(outcome);
    }

    fn flush(&mut self) {
        self.next.flush();
    }
}
