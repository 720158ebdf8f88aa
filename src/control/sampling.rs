//! A sample that came in: its place in time, its run, its flags; begin and end of a recording.

use super::*;

impl Rig {
    pub(super) fn on_sample(
        &mut self,
        tick: u64,
        lost: u64,
        counts: (i32, i32),
        now_ns: u64,
        link: &mut Link,
        recorder: &mut dyn Recorder,
    ) {
        let mut reading = self.channels.reading(counts.0, counts.1);
        let fresh_stream = self.clock.take(tick, now_ns);
        if self.clock.age_ms(tick, now_ns) > self.config.detectors.silence_ms {
            reading.flags.insert(Flags::LATE);
        }
        self.counters.samples += 1;
        self.counters.lost += lost;
        if reading.flags.is_empty() && lost == 0 {
            self.stillness.push(&reading);
        } else {
            self.stillness.clear();
        }
        self.reading = Some(reading);
        let action = self
            .detectors
            .on_sample(now_ns, if fresh_stream { 0 } else { lost });
        if let Activity::Arming(_) = self.activity
            && self.state == Some(RigState::Armed)
        {
            self.begin_run(tick, now_ns, recorder);
        }
        let action = self.record(tick, lost, counts, &reading, recorder).or(action);
        if let Some(action) = action {
            self.act(action, now_ns, link, recorder);
        }
        self.finish_run_at(tick, recorder);
    }

    /// Writes one sample of the run under way; returns what its cycle detectors ask for.
    pub(super) fn record(
        &mut self,
        tick: u64,
        lost: u64,
        counts: (i32, i32),
        reading: &Reading,
        recorder: &mut dyn Recorder,
    ) -> Option<Action> {
        let (run, on_profile) = match &mut self.activity {
            Activity::Running(run) => {
                let held = run.is_held();
                (run, !held)
            }
            Activity::Stopping { run, .. } => (run, false),
            _ => return None,
        };
        if tick < run.first_tick() {
            return None;
        }
        let slot = if on_profile { run.due(tick) } else { None };
        let mut flags = reading.flags;
        if lost > 0 {
            flags.insert(Flags::AFTER_GAP);
        }
        match (on_profile, slot) {
            (false, _) => flags.insert(Flags::NOT_PROFILE),
            (true, None) => flags.insert(Flags::NO_COMMAND),
            _ => {}
        }
        let time_s = run.time_s(tick);
        if lost > 0 && run.samples() > 0 {
            let text = format!("{lost} samples missing before {time_s:.3} s");
            recorder.event(&Event {
                tick,
                time_s,
                kind: EventKind::Gap,
                text,
            });
        }
        let ended = run.on_sample(
            slot.as_ref(),
            Channels::feedback(run.mode(), reading),
            if run.samples() > 0 { lost } else { 0 },
        );
        recorder.sample(&Sample {
            tick,
            time_s,
            force_n: reading.force_n,
            displacement_mm: reading.displacement_mm,
            force_counts: counts.0,
            displacement_counts: counts.1,
            command: slot.map(|s| s.command),
            cycle: slot.map_or(0, |s| s.cycle),
            segment: slot.map_or(0, |s| s.segment),
            twin_force_n: None,
            flags,
        });
        let ended = ended?;
        if let Some(c) = run.correct(&ended) {
            let text = format!(
                "after cycle {} (peak {:.4}, valley {:.4}): amplitude x {:.5}, mean {:+.4}",
                ended.cycle, ended.measured.peak, ended.measured.valley, c.amplitude_factor, c.mean_offset
            );
            recorder.event(&Event {
                tick,
                time_s,
                kind: EventKind::Correction,
                text,
            });
        }
        (ended.cycle > 0)
            .then(|| {
                self.detectors
                    .on_cycle(ended.cycle, ended.target.amplitude, ended.measured.amplitude())
            })
            .flatten()
    }

    pub(super) fn begin_run(&mut self, tick: u64, now_ns: u64, recorder: &mut dyn Recorder) {
        let Activity::Arming(order) = std::mem::replace(&mut self.activity, Activity::Idle) else {
            return;
        };
        let (mode, mut order) = (order.profile.mode, *order);
        let level = match (self.stillness.measure(), &self.reading, mode) {
            (Some(still), _, Mode::Force) => still.force_n,
            (Some(still), _, Mode::Displacement) => still.displacement_mm,
            (None, Some(reading), _) => Channels::feedback(mode, reading),
            (None, None, _) => 0.0,
        };
        order.header.firmware = self.session.identity();
        order.header.force_channel = self.channels.force;
        order.header.displacement_channel = self.channels.displacement;
        let first_tick = tick + self.config.queue_lead_ms;
        match Run::new(order, level, first_tick) {
            Ok(run) => {
                recorder.begin(&run.header);
                let text = format!(
                    "run {} of profile {} starts",
                    run.header.run_id, run.header.profile_name
                );
                self.detectors.begin_run(now_ns);
                self.activity = Activity::Running(Box::new(run));
                self.event(recorder, EventKind::Start, text);
            }
            Err(error) => {
                self.notice = error.to_string();
                self.activity = Activity::Unloading;
                self.ask = Some(RequestCode::Unload);
            }
        }
    }

    pub(super) fn finish_run_at(&mut self, tick: u64, recorder: &mut dyn Recorder) {
        let Activity::Running(run) = &self.activity else {
            return;
        };
        if run.is_finished(tick) && !run.is_held() {
            self.close(Ending::Completed, "", recorder);
            self.activity = Activity::Unloading;
            self.ask = Some(RequestCode::Unload);
        }
    }

    /// Ends the recording of the run under way.
    pub(super) fn close(&mut self, ending: Ending, cause: &str, recorder: &mut dyn Recorder) {
        let text = if cause.is_empty() {
            "run completed".to_owned()
        } else {
            cause.to_owned()
        };
        self.event(recorder, EventKind::End, text);
        if let Activity::Running(run) | Activity::Stopping { run, .. } = &self.activity {
            recorder.end(&run.outcome(ending, cause));
        }
        if !cause.is_empty() {
            self.notice = cause.to_owned();
        }
        self.activity = Activity::Idle;
    }
}
