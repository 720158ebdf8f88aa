//! The live view of a run, and of the idle rig: a recorder at the end of the chain thins out the samples and sends them to all viewers. Each
//! viewer has its own position in one bounded ring: a slow viewer loses its oldest samples and does not affect the others.
//! A new viewer first gets the samples of the last seconds, so that a page opened during a run shows a loop at once.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast;

use super::reading::Readings;
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::recorder::RecorderInput;
use crate::recording::{Event, Flags, Header, Outcome, Recorder, Sample};
use crate::units::Mode;

/// Samples per second that a viewer gets: 80 for each loop at 2.5 Hz.
const POINTS_PER_S: f64 = 200.0;
/// Samples in one message: 40 messages per second, because the page draws at each, and 30 drawings per second look smooth.
const POINTS_A_BATCH: usize = 5;
/// Batches that a viewer may lag behind: about 3 s.
const RING_BATCHES: usize = 128;
/// Batches that a new viewer gets: the last 20 s.
const RECENT_BATCHES: usize = 800;

/// Thinned samples of one run, as columns of equal length.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub(super) struct LiveBatch {
    /// Id of the run; empty between two runs.
    pub run_id: String,
    /// Time in s since the start of the run; between two runs the tick of the rig in s.
    pub time_s: Vec<f64>,
    /// Displacement in mm; `null` without a valid reading.
    pub displacement_mm: Vec<Option<f64>>,
    /// Force in N; `null` without a valid reading.
    pub force_n: Vec<Option<f64>>,
    /// Lowest and highest displacement in mm of all samples of this batch, also of those that were thinned out.
    pub displacement_range_mm: Option<[f64; 2]>,
    /// Lowest and highest force in N, in the same way.
    pub force_range_n: Option<[f64; 2]>,
    /// Command in mm or N, see `control`; `null` while there is none.
    pub command: Vec<Option<f64>>,
    /// Quantity that the newest command controls.
    #[schema(value_type = Option<String>, example = "displacement")]
    pub control: Option<Mode>,
    /// Force of the twin in N; `null` while the twin is off or skipped.
    pub twin_force_n: Vec<Option<f64>>,
    /// Counted cycle of the newest sample; 0 outside counted cycles.
    pub cycle: u32,
}

/// Distributes the batches to the viewers.
#[derive(Debug, Clone)]
pub(super) struct Live {
    batches: broadcast::Sender<Arc<LiveBatch>>,
    recent: Arc<Mutex<VecDeque<Arc<LiveBatch>>>>,
    /// Uncorrected readings of the last second.
    pub readings: Readings,
}

impl Default for Live {
    fn default() -> Self {
        Live {
            batches: broadcast::channel(RING_BATCHES).0,
            recent: Arc::default(),
            readings: Readings::default(),
        }
    }
}

impl Live {
    /// The batches of the last seconds, and a receiver for those to come. A receiver that lags is told how many it lost.
    pub(super) fn subscribe(&self) -> (Vec<Arc<LiveBatch>>, broadcast::Receiver<Arc<LiveBatch>>) {
        let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        (recent.iter().cloned().collect(), self.batches.subscribe())
    }

    /// Number of viewers.
    pub(super) fn viewers(&self) -> usize {
        self.batches.receiver_count()
    }

    /// Called by the recording thread. The lock is held only while pointers are copied.
    fn send(&self, batch: Arc<LiveBatch>) {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if recent.back().is_some_and(|last| last.run_id != batch.run_id) {
            recent.clear();
        }
        if recent.len() == RECENT_BATCHES {
            recent.pop_front();
        }
        recent.push_back(Arc::clone(&batch));
        // Fails if there is no viewer.
        let _ = self.batches.send(batch);
    }

    /// The recorder that sends one run to the viewers.
    pub(super) fn recorder(&self) -> LiveRecorder {
        LiveRecorder {
            live: self.clone(),
            every: 1,
            seen: 0,
            batch: LiveBatch::default(),
        }
    }

    /// The recorder that sends the samples between two runs to the viewers.
    pub(super) fn idle_recorder(&self) -> LiveRecorder {
        LiveRecorder {
            every: thinning(f64::from(SAMPLE_RATE_HZ)),
            ..self.recorder()
        }
    }
}

/// One of so many samples is sent.
fn thinning(sample_rate_hz: f64) -> u64 {
    ((sample_rate_hz / POINTS_PER_S) as u64).max(1)
}

/// Passes the samples between two runs on. Control never waits for it.
pub(super) struct Watcher(pub RecorderInput);

impl Recorder for Watcher {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, _: &Sample) {}
    fn event(&mut self, _: &Event) {}
    fn end(&mut self, _: &Outcome) {}

    fn watch(&mut self, sample: &Sample) {
        self.0.sample(sample);
    }
}

fn widen(range: &mut Option<[f64; 2]>, value: Option<f64>) {
    let Some(value) = value else { return };
    let [low, high] = range.unwrap_or([value, value]);
    *range = Some([low.min(value), high.max(value)]);
}

/// Number of samples in `batches` batches.
pub(super) fn points_in(batches: u64) -> u64 {
    batches * POINTS_A_BATCH as u64
}

/// Sends one run to the viewers.
pub(super) struct LiveRecorder {
    live: Live,
    /// One of so many samples is sent.
    every: u64,
    seen: u64,
    batch: LiveBatch,
}

impl LiveRecorder {
    fn send(&mut self) {
        if self.batch.time_s.is_empty() {
            return;
        }
        let next = LiveBatch {
            run_id: self.batch.run_id.clone(),
            control: self.batch.control,
            ..LiveBatch::default()
        };
        self.live.send(Arc::new(std::mem::replace(&mut self.batch, next)));
    }
}

impl Recorder for LiveRecorder {
    fn begin(&mut self, header: &Header) {
        self.every = thinning(header.sample_rate_hz);
        self.batch.run_id = header.run_id.clone();
    }

    fn sample(&mut self, sample: &Sample) {
        self.seen += 1;
        self.live.readings.push(sample);
        let valid = |value: f64, invalid| (!sample.flags.contains(invalid)).then_some(value);
        let force_n = valid(sample.force_n, Flags::FORCE_INVALID);
        let displacement_mm = valid(sample.displacement_mm, Flags::DISPLACEMENT_INVALID);
        widen(&mut self.batch.force_range_n, force_n);
        widen(&mut self.batch.displacement_range_mm, displacement_mm);
        if !(self.seen - 1).is_multiple_of(self.every) {
            return;
        }
        let b = &mut self.batch;
        b.time_s.push(sample.time_s);
        b.displacement_mm.push(displacement_mm);
        b.force_n.push(force_n);
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
    use tokio::sync::broadcast::error::TryRecvError;

    fn sample(tick: u64) -> Sample {
        Sample {
            tick,
            time_s: tick as f64 / f64::from(SAMPLE_RATE_HZ),
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

    fn recorder(live: &Live) -> LiveRecorder {
        let mut recorder = live.recorder();
        recorder.every = 5;
        recorder
    }

    #[test]
    fn a_viewer_gets_every_fifth_sample_of_a_kilohertz() {
        let live = Live::default();
        let (_, mut viewer) = live.subscribe();
        let mut recorder = recorder(&live);
        (0..25).for_each(|tick| recorder.sample(&sample(tick)));
        let batch = viewer.try_recv().expect("a batch");
        assert_eq!(batch.time_s, [0.0, 0.005, 0.01, 0.015, 0.02]);
    }

    #[test]
    fn a_peak_between_two_points_is_in_the_range_and_an_invalid_value_is_in_nothing() {
        let live = Live::default();
        let (_, mut viewer) = live.subscribe();
        let mut recorder = live.idle_recorder();
        for tick in 0..40 {
            let mut sample = sample(tick);
            if tick == 7 {
                sample.force_n = 900.0;
            }
            if tick == 10 {
                sample.force_n = -13_107.2;
                sample.flags.insert(Flags::FORCE_INVALID);
            }
            recorder.sample(&sample);
        }
        let batch = viewer.try_recv().expect("a batch");
        assert_eq!(batch.run_id, "");
        assert_eq!(batch.force_range_n, Some([1.0, 900.0]));
        assert_eq!(batch.force_n[2], None, "tick 10");
        assert!(
            batch.force_n.iter().flatten().all(|f| *f == 1.0),
            "tick 7 is not sent"
        );
    }

    #[test]
    fn d6_a_viewer_that_never_reads_loses_its_oldest_batches_and_the_others_lose_none() {
        let live = Live::default();
        let ((_, mut slow), (_, mut quick)) = (live.subscribe(), live.subscribe());
        let mut recorder = recorder(&live);
        let mut got = 0;
        for tick in 0..40_000 {
            recorder.sample(&sample(tick));
            while quick.try_recv().is_ok() {
                got += 1;
            }
        }
        assert_eq!(got, 1600);
        assert!(
            matches!(slow.try_recv(), Err(TryRecvError::Lagged(1472))),
            "128 of 1600 are kept"
        );
        assert!(slow.try_recv().is_ok());
        assert_eq!(
            live.subscribe().0.len(),
            RECENT_BATCHES,
            "a new viewer gets the last seconds and no more"
        );
    }
}
