//! The virtual twin: steps a model beside the run and writes its force into each sample.
//!
//! It is a recorder in front of the next recorder. `dry_run` predicts a whole profile before anything moves; `mismatch` watches
//! the difference between measurement and model. None of them uses the load frame, and the twin never delays the recording.

mod dry_run;
mod lost_motion;
mod mismatch;
mod moving_mean;

#[cfg(test)]
pub(crate) use dry_run::dry_run;
pub(crate) use dry_run::{Margin, Predicted, dry_run_with};
pub(crate) use mismatch::{Mismatch, MismatchWatch, Noise};

use crate::model::Plant;
use crate::recording::play::Play;
use crate::recording::{Event, EventKind, Flags, Header, Outcome, Recorder, Sample};
use lost_motion::TwinStep;

/// A recorder that steps a model at the measured displacement and fills `twin_force_n`.
pub(crate) struct Twin {
    plant: Box<dyn Plant>,
    play: Play,
    next: Box<dyn Recorder + Send>,
    behind: Box<dyn Fn() -> bool + Send>,
    sample_rate_hz: f64,
    last_tick: Option<u64>,
    watch: Option<MismatchWatch>,
    mismatch: Option<Mismatch>,
}

impl Twin {
    /// Passes everything on to `next`. `noise_mm` is the standard deviation of the LVDT; a play of that width keeps the noise
    /// from the model. `behind` is true while samples pile up: the twin then leaves its column empty.
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
            sample_rate_hz: 1.0,
            last_tick: None,
            watch: None,
            mismatch: None,
        }
    }

    /// Watches the residual against this noise and records a mismatch as an event of the run.
    pub(crate) fn watching(mut self, noise: Noise) -> Self {
        self.watch = Some(MismatchWatch::new(noise));
        self
    }

    fn force_n(&mut self, sample: &Sample) -> Option<f64> {
        let usable =
            sample.displacement_mm.is_finite() && !sample.flags.contains(Flags::DISPLACEMENT_INVALID);
        if !usable || (self.behind)() {
            return None;
        }
        // After skipped samples the model goes straight to the present displacement, in the time that has passed.
        let ticks = self
            .last_tick
            .map_or(1, |last| sample.tick.saturating_sub(last).max(1));
        self.last_tick = Some(sample.tick);
        let displacement_mm = self.play.pass(sample.displacement_mm);
        let force_n = self
            .plant
            .step(displacement_mm, ticks as f64 / self.sample_rate_hz);
        if sample.force_n.is_finite() && !sample.flags.contains(Flags::FORCE_INVALID) {
            // Samples outside the profile, such as the unloading after the run, are no test of the model.
            let watch = self.watch.as_mut().filter(|_| sample.segment > 0);
            let step = TwinStep {
                measured_mm: sample.displacement_mm,
                twin_mm: displacement_mm,
                twin_n: force_n,
            };
            self.mismatch = watch.and_then(|w| w.sample(&step, sample.force_n, self.plant.as_ref()));
        }
        Some(force_n)
    }
}

impl Recorder for Twin {
    fn begin(&mut self, header: &Header) {
        self.plant.reset();
        self.play.reset();
        self.sample_rate_hz = header.sample_rate_hz;
        self.last_tick = None;
        self.mismatch = None;
        if let Some(watch) = &mut self.watch {
            watch.begin(header.sample_rate_hz);
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
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, Mutex};

    /// Force = 10 N/mm plus 1 N for each step since reset, so that resets and steps can be counted.
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
    fn the_column_is_empty_where_the_twin_is_behind_or_the_displacement_invalid() {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let late = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&late);
        let next = Box::new(Keep(Arc::clone(&kept)));
        let mut twin = Twin::new(Box::new(Counting(0.0)), 0.0, next, move || {
            asked.load(Ordering::Relaxed)
        });
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
    }
}
