//! A recorder that keeps a run in memory.

#[cfg(test)]
use std::sync::{Arc, Mutex};

use super::{Event, Header, Outcome, Recorder, Recording, Sample};
use crate::units::Command;

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

impl Memory {
    /// The samples of the profile as a recording; those before and after it are left out.
    pub(crate) fn recording(&self, name: &str) -> Recording {
        let samples = || self.samples.iter().filter(|s| s.segment > 0);
        let column = |value: fn(&Sample) -> f64| samples().map(value).collect();
        Recording {
            name: name.to_owned(),
            time_s: column(|s| s.time_s),
            displacement_mm: column(|s| s.displacement_mm),
            force_n: column(|s| s.force_n),
            command: Some(column(|s| s.command.map_or(f64::NAN, Command::value))),
            command_mode: samples().find_map(|s| s.command).map(Command::mode),
            cycle: Some(samples().map(|s| s.cycle).collect()),
            flags: Some(samples().map(|s| s.flags.bits()).collect()),
        }
    }
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
#[cfg(test)]
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
