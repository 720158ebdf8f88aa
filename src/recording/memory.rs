//! A recorder that keeps a run in memory, for tests.

use std::sync::{Arc, Mutex};

use super::{Event, Header, Outcome, Recorder, Sample};

/// All that a run passed to its recorder.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Memory {
    /// The header, after `begin`.
    pub header: Option<Header>,
    pub samples: Vec<Sample>,
    pub events: Vec<Event>,
    /// The outcome, after `end`.
    pub outcome: Option<Outcome>,
}

impl Recorder for Memory {
    fn begin(&mut self, header: &Header) {
        self.header = Some(header.clone());
    }

    fn sample(&mut self, sample: &Sample) {
        self.samples.push(*sample);
    }

    fn event(&mut self, event: &Event) {
        self.events.push(event.clone());
    }

    fn end(&mut self, outcome: &Outcome) {
        self.outcome = Some(outcome.clone());
    }
}

/// A memory that a test can still read after the recorders that held it are dropped.
impl Recorder for Arc<Mutex<Memory>> {
    fn begin(&mut self, header: &Header) {
        self.lock().expect("one thread").begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        self.lock().expect("one thread").sample(sample);
    }

    fn event(&mut self, event: &Event) {
        self.lock().expect("one thread").event(event);
    }

    fn end(&mut self, outcome: &Outcome) {
        self.lock().expect("one thread").end(outcome);
    }
}
