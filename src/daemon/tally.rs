//! What the runs of this daemon came to: how many ended how, and how far the twin is from the measurement. The recording thread
//! writes it, `metrics` reads it.

use std::sync::{Arc, Mutex, PoisonError};

use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::{Ending, Event, EventKind, Flags, Header, Outcome, Recorder, Sample};

/// Samples over which the error of the twin is averaged: one second.
const ERROR_SAMPLES: u32 = SAMPLE_RATE_HZ;

/// The runs of this daemon. Clones share the same counts.
#[derive(Debug, Clone, Default)]
pub(super) struct Tally(Arc<Mutex<TallyCounts>>);

/// The counts at one moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct TallyCounts {
    /// Runs that completed.
    pub completed: u64,
    /// Runs that were stopped.
    pub stopped: u64,
    /// Runs that a fault ended.
    pub aborted: u64,
    /// Reports that the measurement left the band of the twin.
    pub mismatches: u64,
    /// Root mean square of measured force less force of the twin over the last second of a run, N; `None` without a run or a
    /// twin.
    pub twin_error_n: Option<f64>,
}

impl Tally {
    /// The counts now.
    pub(super) fn counts(&self) -> TallyCounts {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut TallyCounts)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// A recorder that counts the next run.
    pub(super) fn recorder(&self) -> TallyRecorder {
        TallyRecorder {
            tally: self.clone(),
            samples: 0,
            squares_n2: 0.0,
        }
    }
}

/// Counts one run.
pub(super) struct TallyRecorder {
    tally: Tally,
    /// Samples in the sum.
    samples: u32,
    squares_n2: f64,
}

impl TallyRecorder {
    fn add(&mut self, sample: &Sample) {
        let measured = !sample.flags.contains(Flags::FORCE_INVALID) && sample.force_n.is_finite();
        let Some(twin_n) = sample.twin_force_n.filter(|_| measured) else {
            return;
        };
        self.squares_n2 += (sample.force_n - twin_n).powi(2);
        self.samples += 1;
        if self.samples == ERROR_SAMPLES {
            let error_n = (self.squares_n2 / f64::from(self.samples)).sqrt();
            self.tally.change(|counts| counts.twin_error_n = Some(error_n));
            (self.samples, self.squares_n2) = (0, 0.0);
        }
    }
}

impl Recorder for TallyRecorder {
    fn begin(&mut self, _: &Header) {}

    fn sample(&mut self, sample: &Sample) {
        self.add(sample);
    }

    fn event(&mut self, event: &Event) {
        if event.kind == EventKind::ModelMismatch {
            self.tally.change(|counts| counts.mismatches += 1);
        }
    }

    fn end(&mut self, outcome: &Outcome) {
        self.tally.change(|counts| {
            counts.twin_error_n = None;
            *match outcome.ending {
                Ending::Completed => &mut counts.completed,
                Ending::Stopped => &mut counts.stopped,
                Ending::Aborted => &mut counts.aborted,
            } += 1;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::run_file::test_support;

    #[test]
    fn the_error_of_the_twin_is_that_of_the_last_second_and_the_end_of_the_run_is_counted() {
        let tally = Tally::default();
        let mut recorder = tally.recorder();
        let mut sample = test_support::sample(0);
        sample.flags = Flags::default();
        (sample.force_n, sample.twin_force_n) = (103.0, Some(100.0));
        for _ in 0..ERROR_SAMPLES - 1 {
            recorder.sample(&sample);
        }
        assert_eq!(tally.counts().twin_error_n, None, "less than a second");
        recorder.sample(&sample);
        assert_eq!(tally.counts().twin_error_n, Some(3.0));
        recorder.end(&test_support::outcome(0));
        let counts = tally.counts();
        assert_eq!(counts.twin_error_n, None);
        assert_eq!(counts.completed + counts.stopped + counts.aborted, 1);
    }
}
