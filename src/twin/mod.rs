//! The virtual twin: a recorder that steps a plant beside the run and passes each sample on with the model's force.
//! `dry_run` asks the same plant before anything moves. Neither knows the rig; the twin never delays who feeds it.

mod dry_run;
mod mismatch;

pub(crate) use dry_run::{Margin, Predicted, dry_run, dry_run_with};
pub(crate) use mismatch::{Mismatch, MismatchWatch, Noise};

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::model::Plant;
use crate::recording::play::Play;
use crate::recording::{Event, EventKind, Flags, Header, Outcome, Recorder, Sample};

/// How well twin and measurement agree so far; written by the twin, read by anyone.
#[derive(Debug, Default)]
pub(crate) struct TwinScore {
    nrmse_bits: AtomicU64,
    compared: AtomicU64,
    skipped: AtomicU64,
}

impl TwinScore {
    /// rms(measured - model) / (max - min of measured force); `None` before the force has moved.
    pub(crate) fn nrmse(&self) -> Option<f64> {
        let nrmse = f64::from_bits(self.nrmse_bits.load(Ordering::Relaxed));
        (self.compared() > 0 && nrmse.is_finite()).then_some(nrmse)
    }

    /// Samples compared.
    pub(crate) fn compared(&self) -> u64 {
        self.compared.load(Ordering::Relaxed)
    }

    /// Samples left empty because the twin was behind or the displacement was not valid.
    pub(crate) fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }
}

/// Sums of the running NRMSE.
#[derive(Debug, Clone, Copy)]
struct Sums {
    squares: f64,
    lowest_n: f64,
    highest_n: f64,
}

impl Sums {
    const EMPTY: Sums = Sums {
        squares: 0.0,
        lowest_n: f64::INFINITY,
        highest_n: f64::NEG_INFINITY,
    };
}

/// Steps a plant at the measured displacement and fills `twin_force_n`.
pub(crate) struct Twin {
    plant: Box<dyn Plant>,
    play: Play,
    next: Box<dyn Recorder + Send>,
    behind: Box<dyn Fn() -> bool + Send>,
    score: Arc<TwinScore>,
    sums: Sums,
    sample_rate_hz: f64,
    last_tick: Option<u64>,
    watch: Option<MismatchWatch>,
    mismatch: Option<Mismatch>,
}

impl Twin {
    /// Passes everything on to `next`. `noise_mm` is the LVDT's standard deviation, which must not look like motion to
    /// the plant. `behind` says that samples pile up: the twin then leaves its column empty.
    pub(crate) fn new(
        plant: Box<dyn Plant>,
        noise_mm: f64,
        next: Box<dyn Recorder + Send>,
        behind: impl Fn() -> bool + Send + 'static,
    ) -> Self {
        Twin {
            plant,
            play: Play::for_noise(noise_mm),
            next,
            behind: Box::new(behind),
            score: Arc::default(),
            sums: Sums::EMPTY,
            sample_rate_hz: 1.0,
            last_tick: None,
            watch: None,
            mismatch: None,
        }
    }

    /// Watches the residual against this noise and tells of a mismatch as an event of the run.
    pub(crate) fn watching(mut self, noise: Noise) -> Self {
        self.watch = Some(MismatchWatch::new(noise));
        self
    }

    /// The score, to be read while the run goes on.
    pub(crate) fn score(&self) -> Arc<TwinScore> {
        Arc::clone(&self.score)
    }

    fn force_n(&mut self, sample: &Sample) -> Option<f64> {
        let usable = sample.displacement_mm.is_finite() && !sample.flags.has(Flags::DISPLACEMENT_INVALID);
        if !usable || (self.behind)() {
            self.score.skipped.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        // After samples that were skipped the plant is led straight to where the rig is now, in the time that it took.
        let ticks = self
            .last_tick
            .map_or(1, |last| sample.tick.saturating_sub(last).max(1));
        self.last_tick = Some(sample.tick);
        let displacement_mm = self.play.pass(sample.displacement_mm);
        let force_n = self
            .plant
            .step(displacement_mm, ticks as f64 / self.sample_rate_hz);
        if sample.force_n.is_finite() && !sample.flags.has(Flags::FORCE_INVALID) {
            self.compare(sample.force_n, force_n);
            // The unloading after the run is no test of the model.
            let watch = self.watch.as_mut().filter(|_| sample.segment > 0);
            self.mismatch = watch.and_then(|w| w.sample(displacement_mm, sample.force_n, force_n));
        }
        Some(force_n)
    }

    fn compare(&mut self, measured_n: f64, model_n: f64) {
        let sums = &mut self.sums;
        sums.squares += (measured_n - model_n).powi(2);
        sums.lowest_n = sums.lowest_n.min(measured_n);
        sums.highest_n = sums.highest_n.max(measured_n);
        let compared = self.score.compared.fetch_add(1, Ordering::Relaxed) + 1;
        let nrmse = (sums.squares / compared as f64).sqrt() / (sums.highest_n - sums.lowest_n);
        self.score.nrmse_bits.store(nrmse.to_bits(), Ordering::Relaxed);
    }
}

impl Recorder for Twin {
    fn begin(&mut self, header: &Header) {
        self.plant.reset();
        self.play.reset();
        self.sums = Sums::EMPTY;
        self.sample_rate_hz = header.sample_rate_hz;
        self.last_tick = None;
        self.mismatch = None;
        if let Some(watch) = &mut self.watch {
            watch.begin(header.sample_rate_hz);
        }
        for counter in [&self.score.compared, &self.score.skipped, &self.score.nrmse_bits] {
            counter.store(0, Ordering::Relaxed);
        }
        self.next.begin(header);
    }

    fn sample(&mut self, sample: &Sample) {
        let twin_force_n = self.force_n(sample);
        self.next.sample(&Sample {
            twin_force_n,
            ..*sample
        });
        if let Some(mismatch) = self.mismatch.take() {
            self.next.event(&Event {
                tick: sample.tick,
                time_s: sample.time_s,
                kind: EventKind::ModelMismatch,
                text: mismatch.to_string(),
            });
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::sync::atomic::AtomicBool;

    /// Force = 10 N/mm plus 1 N for each step since reset: shows resets and steps.
    #[derive(Clone)]
    struct Counting(f64);

    impl Plant for Counting {
        fn reset(&mut self) {
            self.0 = 0.0;
        }
        fn step(&mut self, displacement_mm: f64, _dt_s: f64) -> f64 {
            self.0 += 1.0;
            10.0 * displacement_mm + self.0
        }
        fn boxed_clone(&self) -> Box<dyn Plant> {
            Box::new(self.clone())
        }
    }

    struct Keep(Arc<Mutex<Vec<Option<f64>>>>);

    impl Recorder for Keep {
        fn begin(&mut self, _: &Header) {}
        fn sample(&mut self, sample: &Sample) {
            self.0.lock().unwrap().push(sample.twin_force_n);
        }
        fn event(&mut self, _: &Event) {}
        fn end(&mut self, _: &Outcome) {}
    }

    fn sample(tick: u64, flags: Flags) -> Sample {
        Sample {
            tick,
            time_s: 0.0,
            force_n: 10.0 * tick as f64,
            displacement_mm: tick as f64,
            force_counts: 0,
            displacement_counts: 0,
            command: None,
            cycle: 0,
            segment: 0,
            twin_force_n: None,
            flags,
        }
    }

    #[test]
    fn fills_the_column_and_leaves_it_empty_when_behind_or_blind() {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let late = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&late);
        let next = Box::new(Keep(Arc::clone(&kept)));
        let mut twin = Twin::new(Box::new(Counting(0.0)), 0.0, next, move || {
            asked.load(Ordering::Relaxed)
        });
        let score = twin.score();
        assert_eq!(score.nrmse(), None);
        twin.sample(&sample(1, Flags::default()));
        late.store(true, Ordering::Relaxed);
        twin.sample(&sample(2, Flags::default()));
        late.store(false, Ordering::Relaxed);
        twin.sample(&sample(3, Flags::DISPLACEMENT_INVALID));
        twin.sample(&sample(4, Flags::FORCE_INVALID));
        twin.sample(&sample(5, Flags::default()));
        assert_eq!(
            *kept.lock().unwrap(),
            [Some(11.0), None, None, Some(42.0), Some(53.0)]
        );
        assert_eq!((score.compared(), score.skipped()), (2, 2));
        // Residuals 1 and 3 N over a range of 40 N.
        assert!((score.nrmse().unwrap() - 5.0_f64.sqrt() / 40.0).abs() < 1e-12);
    }
}
