//! Samples and events that are not yet known to be on the disk, in memory and in order.

use std::collections::VecDeque;

use crate::recording::{Event, Sample, Unsaved};

/// Samples that fit: two minutes at 1 kHz. The run is stopped after one minute, and unloading must fit as well.
pub(super) const ROOM_SAMPLES: usize = 120_000;

/// One commit that is in a file and perhaps not yet on the disk.
#[derive(Debug)]
struct Commit {
    samples: Vec<Sample>,
    events: Vec<Event>,
}

/// What waits for the disk.
#[derive(Debug)]
pub(super) struct Waiting {
    /// Not in a file.
    samples: VecDeque<Sample>,
    events: Vec<Event>,
    /// In the file, oldest first.
    commits: VecDeque<Commit>,
    /// Number of samples in `commits`.
    committed: usize,
    /// Number of commits of the file that are on the disk.
    synced: u64,
    room: usize,
    /// Samples that found no room.
    dropped: u64,
    dropped_ticks: Option<(u64, u64)>,
}

impl Waiting {
    /// Nothing, with room for this many samples.
    pub(super) fn with_room(samples: usize) -> Waiting {
        Waiting {
            samples: VecDeque::new(),
            events: Vec::new(),
            commits: VecDeque::new(),
            committed: 0,
            synced: 0,
            room: samples,
            dropped: 0,
            dropped_ticks: None,
        }
    }

    /// Adds a sample. Without room it is dropped and counted.
    pub(super) fn push(&mut self, sample: &Sample) {
        if self.in_memory() < self.room {
            self.samples.push_back(*sample);
            return;
        }
        self.dropped += 1;
        let first = self.dropped_ticks.map_or(sample.tick, |(first, _)| first);
        self.dropped_ticks = Some((first, sample.tick));
    }

    /// Adds an event; there are few of them.
    pub(super) fn push_event(&mut self, event: Event) {
        self.events.push(event);
    }

    /// Samples in memory: not in a file, or not known to be on the disk.
    pub(super) fn in_memory(&self) -> usize {
        self.samples.len() + self.committed
    }

    /// Samples in memory that are in a file already.
    pub(super) fn committed(&self) -> usize {
        self.committed
    }

    /// Samples that are not in a file.
    pub(super) fn uncommitted(&self) -> usize {
        self.samples.len()
    }

    /// Everything is in a file.
    pub(super) fn is_committed(&self) -> bool {
        self.samples.is_empty() && self.events.is_empty()
    }

    /// The oldest `most` samples that are not in a file, and all such events.
    pub(super) fn next_commit(&mut self, most: usize) -> (&[Sample], &[Event]) {
        let samples = self.samples.make_contiguous();
        (samples.get(..most).unwrap_or(samples), &self.events)
    }

    /// The result of `next_commit` is in the file.
    pub(super) fn commit_done(&mut self, most: usize) {
        let samples: Vec<Sample> = self.samples.drain(..most.min(self.samples.len())).collect();
        self.committed += samples.len();
        self.commits.push_back(Commit {
            samples,
            events: std::mem::take(&mut self.events),
        });
    }

    /// The first `commits` commits of the file are on the disk. Returns how many more samples are.
    pub(super) fn synced_up_to(&mut self, commits: u64) -> u64 {
        let mut samples = 0;
        while self.synced < commits {
            self.synced += 1;
            samples += self.commits.pop_front().map_or(0, |commit| commit.samples.len());
        }
        self.committed -= samples;
        samples as u64
    }

    /// All commits are on the disk.
    pub(super) fn all_synced(&mut self) {
        self.synced += self.commits.len() as u64;
        self.commits.clear();
        self.committed = 0;
    }

    /// Number of samples that fit.
    pub(super) fn room(&self) -> usize {
        self.room
    }

    /// The file failed: what is not known to be on the disk goes into the next file.
    pub(super) fn take_back(&mut self) {
        for commit in std::mem::take(&mut self.commits).into_iter().rev() {
            for sample in commit.samples.into_iter().rev() {
                self.samples.push_front(sample);
            }
            self.events.splice(0..0, commit.events);
        }
        self.committed = 0;
        self.synced = 0;
    }

    /// All samples that are not in a file, those in memory and those that found no room.
    pub(super) fn unsaved(&self, cause: &str) -> Option<Unsaved> {
        let waiting = self.samples.front().zip(self.samples.back());
        let waiting = waiting.map(|(first, last)| (first.tick, last.tick));
        let ranges = [waiting, self.dropped_ticks];
        let first = ranges.iter().flatten().map(|range| range.0).min()?;
        let last = ranges.iter().flatten().map(|range| range.1).max()?;
        Some(Unsaved {
            samples: self.samples.len() as u64 + self.dropped,
            from_tick: first,
            to_tick: last,
            cause: cause.to_owned(),
        })
    }

    /// Samples that found no room.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::sample;
    use super::*;

    fn ticks(waiting: &mut Waiting) -> Vec<u64> {
        waiting.next_commit(usize::MAX).0.iter().map(|s| s.tick).collect()
    }

    #[test]
    fn what_is_not_on_the_disk_is_taken_back_in_order() {
        let mut waiting = Waiting::with_room(100);
        for tick in 0..30 {
            waiting.push(&sample(tick));
            if tick % 10 == 9 && tick < 29 {
                waiting.commit_done(usize::MAX);
            }
        }
        assert_eq!(waiting.synced_up_to(1), 10);
        assert_eq!((waiting.in_memory(), waiting.committed()), (20, 10));
        waiting.take_back();
        assert_eq!(ticks(&mut waiting), (10..30).collect::<Vec<_>>());
        assert_eq!(
            waiting.synced_up_to(0),
            0,
            "the count of commits begins again with the next file"
        );
    }

    #[test]
    fn samples_without_room_are_counted_with_their_ticks() {
        let mut waiting = Waiting::with_room(3);
        for tick in 0..5 {
            waiting.push(&sample(tick));
        }
        let unsaved = waiting.unsaved("full").unwrap();
        assert_eq!((unsaved.samples, unsaved.from_tick, unsaved.to_tick), (5, 0, 4));
        waiting.commit_done(usize::MAX);
        let unsaved = waiting.unsaved("full").unwrap();
        assert_eq!((unsaved.samples, unsaved.from_tick, unsaved.to_tick), (2, 3, 4));
    }
}
