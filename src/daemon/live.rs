//! The live view of a run: a recorder at the end of the chain that thins the samples out and hands them to whoever
//! watches. Each watcher has its own place in one bounded ring; one that is too slow loses the oldest, alone. A new one
//! gets what the last seconds had, so that a page that is opened in mid-run shows a loop at once.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast;

use crate::recording::{Event, Header, Outcome, Recorder, Sample};
use crate::units::Mode;

/// Points a second that a watcher gets: 80 on a loop at 2.5 Hz.
const POINTS_PER_S: f64 = 200.0;
/// Points that travel together: 25 messages a second.
const POINTS_A_BATCH: usize = 8;
/// Batches that a watcher may lag behind: about 2.5 s.
const RING_BATCHES: usize = 64;

/// Batches that a new watcher gets: the last 20 s.
const RECENT_BATCHES: usize = 500;

/// Thinned samples, columns of equal length.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub(crate) struct Batch {
    /// The run.
    pub run_id: String,
    /// Seconds in the run.
    pub time_s: Vec<f64>,
    /// Displacement in mm.
    pub displacement_mm: Vec<f64>,
    /// Force in N.
    pub force_n: Vec<f64>,
    /// Command in the run's unit; `null` where there was none.
    pub command: Vec<Option<f64>>,
    /// What the newest command controls.
    pub control: Option<Mode>,
    /// Twin's force in N; `null` where it was off or behind.
    pub twin_force_n: Vec<Option<f64>>,
    /// Counted cycle of the newest point; 0 outside.
    pub cycle: u32,
}

/// Where watchers come to.
#[derive(Debug, Clone)]
pub(crate) struct Live {
    batches: broadcast::Sender<Arc<Batch>>,
    recent: Arc<Mutex<VecDeque<Arc<Batch>>>>,
}

impl Default for Live {
    fn default() -> Self {
        Live {
            batches: broadcast::channel(RING_BATCHES).0,
            recent: Arc::default(),
        }
    }
}

impl Live {
    /// What the last seconds had, and what comes from now on. A receiver that lags is told by how many batches.
    pub(crate) fn watch(&self) -> (Vec<Arc<Batch>>, broadcast::Receiver<Arc<Batch>>) {
        let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        (recent.iter().cloned().collect(), self.batches.subscribe())
    }

    /// The recording thread hands a batch on. The lock is held for as long as a copy of pointers takes.
    fn send(&self, batch: Arc<Batch>) {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if recent.back().is_some_and(|last| last.run_id != batch.run_id) {
            recent.clear();
        }
        if recent.len() == RECENT_BATCHES {
            recent.pop_front();
        }
        recent.push_back(Arc::clone(&batch));
        // Fails where nobody watches.
        let _ = self.batches.send(batch);
    }

    /// The recorder that feeds the watchers of one run.
    pub(crate) fn tap(&self) -> LiveTap {
        LiveTap {
            live: self.clone(),
            every: 1,
            seen: 0,
            batch: Batch::default(),
        }
    }
}

/// Points that `batches` lost batches had.
pub(crate) fn points_in(batches: u64) -> u64 {
    batches * POINTS_A_BATCH as u64
}

/// Feeds one run to the watchers.
pub(crate) struct LiveTap {
    live: Live,
    every: u64,
    seen: u64,
    batch: Batch,
}

impl LiveTap {
    fn send(&mut self) {
        if self.batch.time_s.is_empty() {
            return;
        }
        let next = Batch {
            run_id: self.batch.run_id.clone(),
            control: self.batch.control,
            ..Batch::default()
        };
        self.live.send(Arc::new(std::mem::replace(&mut self.batch, next)));
    }
}

impl Recorder for LiveTap {
    fn begin(&mut self, header: &Header) {
        self.every = ((header.sample_rate_hz / POINTS_PER_S) as u64).max(1);
        self.batch.run_id = header.run_id.clone();
    }

    fn sample(&mut self, sample: &Sample) {
        self.seen += 1;
        if !(self.seen - 1).is_multiple_of(self.every) {
            return;
        }
        let b = &mut self.batch;
        b.time_s.push(sample.time_s);
        b.displacement_mm.push(sample.displacement_mm);
        b.force_n.push(sample.force_n);
        b.command.push(sample.command.map(|c| c.value()));
        b.twin_force_n.push(sample.twin_force_n);
        b.cycle = sample.cycle;
        b.control = sample.command.map(|c| c.mode()).or(b.control);
        if b.time_s.len() >= POINTS_A_BATCH {
            self.send();
        }
    }

    fn event(&mut self, _: &Event) {}

    fn end(&mut self, _: &Outcome) {
        self.send();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Flags;
    use tokio::sync::broadcast::error::TryRecvError;

    fn sample(tick: u64) -> Sample {
        Sample {
            tick,
            time_s: tick as f64 / 1000.0,
            force_n: 1.0,
            displacement_mm: 2.0,
            force_counts: 0,
            displacement_counts: 0,
            command: None,
            cycle: 0,
            segment: 1,
            twin_force_n: None,
            flags: Flags::default(),
        }
    }

    fn tap(live: &Live) -> LiveTap {
        let mut tap = live.tap();
        tap.every = 5;
        tap
    }

    #[test]
    fn a_watcher_gets_every_fifth_sample_of_a_kilohertz() {
        let live = Live::default();
        let (_, mut watcher) = live.watch();
        let mut tap = tap(&live);
        (0..40).for_each(|tick| tap.sample(&sample(tick)));
        let batch = watcher.try_recv().expect("a batch");
        assert_eq!(batch.time_s, [0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035]);
    }

    #[test]
    fn a_watcher_that_never_reads_loses_the_oldest_and_nobody_else_does() {
        let live = Live::default();
        let ((_, mut slow), (_, mut quick)) = (live.watch(), live.watch());
        let mut tap = tap(&live);
        let mut got = 0;
        for tick in 0..40_000 {
            tap.sample(&sample(tick));
            while quick.try_recv().is_ok() {
                got += 1;
            }
        }
        assert_eq!(got, 1000);
        assert!(
            matches!(slow.try_recv(), Err(TryRecvError::Lagged(936))),
            "64 of 1000 are kept"
        );
        assert!(slow.try_recv().is_ok());
        assert_eq!(
            live.watch().0.len(),
            RECENT_BATCHES,
            "a new watcher gets the last seconds and no more"
        );
    }
}
