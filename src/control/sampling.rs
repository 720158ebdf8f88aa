//! One sample of the rig: its place in time, its flags, the detectors on it, and its record in the run under way.

use super::detectors::{Action, JudgedSample};
use super::run::EndedCycle;
use super::ticks::TickOrder;
use super::{Activity, Channels, Reading, Rig, Turn};
use crate::profile::{Correction, Slot};
use crate::protocol::message::{RigState, SAMPLE_RATE_HZ, SampleMessage};
use crate::protocol::protection::Sequence;
use crate::protocol::tick::ticks_in_ms;
use crate::recording::{Flags, Sample, StreamEvent, StreamFinding};

/// A tick that is further ahead than the time since the last sample explains, by more than this, is of another rig, ms.
const JUMP_MS: u64 = 1000;
/// Half of the range of a tick on the wire: more than that ahead counts as behind.
const WRAP_TICKS: u64 = 0x7FFF;
const WRAP_MS: u64 = 40_000;

/// A sample with its place in the stream.
struct PlacedSample {
    /// Tick of the sample, unfolded to 64 bits.
    tick: u64,
    /// Samples missing before it.
    lost: u64,
    force_counts: i32,
    displacement_counts: i32,
    reading: Reading,
}

impl Rig {
    pub(super) fn on_sample_message(&mut self, message: SampleMessage, turn: &mut Turn) {
        let sequence = self.sample_counter.check(message.counter);
        if sequence != Sequence::Usable {
            self.on_out_of_sequence(sequence, turn);
            return;
        }
        // A second rig may hit the counter, but not the tick: no link loses a second of samples between two that arrive together.
        let silent_ms = self.detectors.age_ms(turn.now_ns).unwrap_or(u64::MAX / 2);
        let ahead = self.ticks.ahead(message.tick);
        if (ticks_in_ms(silent_ms.min(WRAP_MS) + JUMP_MS)..=WRAP_TICKS).contains(&ahead) {
            self.on_out_of_sequence(Sequence::Wrong, turn);
            return;
        }
        let TickOrder::Next { tick, lost } = self.ticks.place(message.tick) else {
            // A new frame with an old tick: the rig's clock went back, or the frame is not of this rig.
            self.on_out_of_sequence(Sequence::Wrong, turn);
            return;
        };
        let reading = self
            .channels
            .reading(message.force_counts, message.displacement_counts);
        let sample = PlacedSample {
            tick,
            lost,
            force_counts: message.force_counts,
            displacement_counts: message.displacement_counts,
            reading,
        };
        self.on_sample(sample, turn);
    }

    fn on_sample(&mut self, mut sample: PlacedSample, turn: &mut Turn) {
        let first_of_stream = self.clock.take(sample.tick);
        let age_ms = self.clock.age_ms(sample.tick);
        if age_ms > self.config.detectors.silence_ms {
            sample.reading.flags.insert(Flags::LATE);
            self.counters.late += 1;
        }
        let of_sensors = self.judge(&mut sample, turn.now_ns);
        let invalid = [Flags::FORCE_INVALID, Flags::DISPLACEMENT_INVALID];
        let is_invalid = invalid
            .into_iter()
            .any(|flag| sample.reading.flags.contains(flag));
        self.counters.flagged += u64::from(is_invalid);
        self.counters.samples += 1;
        self.counters.lost += sample.lost;
        if sample.reading.flags.is_empty() && sample.lost == 0 {
            self.stillness.push(&sample.reading);
        } else {
            self.stillness.clear();
        }
        self.reading = Some(sample.reading);
        let lost = if first_of_stream { 0 } else { sample.lost };
        let of_stream =
            self.detectors
                .on_sample(turn.now_ns, lost, age_ms, &sample.reading, &self.config.limits);
        if let Activity::Arming { .. } = self.activity
            && self.state == Some(RigState::Armed)
        {
            self.begin_run(sample.tick, turn);
        }
        self.show(&sample, turn);
        let of_cycle = self.record(&sample, turn);
        for action in [of_stream, of_sensors, of_cycle].into_iter().flatten() {
            self.act(action, turn);
        }
        self.finish_run_at(sample.tick, turn);
    }

    /// Marks a sample that cannot be right. Returns what is to be done.
    fn judge(&mut self, sample: &mut PlacedSample, now_ns: u64) -> Option<Action> {
        let command = match &self.activity {
            Activity::Running(run) if !run.is_held() => run.due(sample.tick).map(|slot| slot.command),
            _ => None,
        };
        let judged = JudgedSample {
            reading: &sample.reading,
            counts: [sample.force_counts, sample.displacement_counts],
            lost: sample.lost,
            command,
            limits: &self.config.limits,
            noise_max: [self.config.still_sigma_n, self.config.still_sigma_mm],
        };
        let (flags, action) = self.detectors.judge(now_ns, &judged);
        sample.reading.flags.insert(flags);
        action
    }

    /// Shows a sample that no run records to those who watch the rig.
    fn show(&self, sample: &PlacedSample, turn: &mut Turn) {
        let (run, on_profile) = match &self.activity {
            Activity::Running(run) => (Some(run), !run.is_held()),
            Activity::Stopping { run, .. } => (Some(run), false),
            _ => (None, false),
        };
        let recorded = run.is_some_and(|run| run.motion.is_none() && sample.tick >= run.first_tick());
        if recorded {
            return;
        }
        let slot = run.filter(|_| on_profile).and_then(|run| run.due(sample.tick));
        let time_s = sample.tick as f64 / f64::from(SAMPLE_RATE_HZ);
        turn.recorder
            .watch(&recorded_as(sample, slot.as_ref(), on_profile, time_s));
    }

    /// Writes one sample of the run under way. Returns the action of the detectors on a cycle that ended.
    fn record(&mut self, sample: &PlacedSample, turn: &mut Turn) -> Option<Action> {
        let (run, on_profile) = match &mut self.activity {
            Activity::Running(run) => {
                let held = run.is_held();
                (run, !held)
            }
            Activity::Stopping { run, .. } => (run, false),
            _ => return None,
        };
        if sample.tick < run.first_tick() {
            return None;
        }
        let slot = if on_profile { run.due(sample.tick) } else { None };
        let record = recorded_as(sample, slot.as_ref(), on_profile, run.time_s(sample.tick));
        let is_recorded = run.motion.is_none();
        // Samples missing before the first one are not of this run.
        let lost = if run.samples() > 0 { sample.lost } else { 0 };
        if lost > 0 && is_recorded {
            turn.recorder.stream_event(&gap(&record, lost));
        }
        if record.flags.contains(Flags::LATE) {
            run.count_late();
        }
        // A spike must not become the peak of its cycle.
        let usable = !sample.reading.flags.intersects(Flags::UNUSABLE);
        let feedback = usable.then(|| Channels::feedback(run.mode(), &sample.reading));
        let ended = run.on_sample(sample.tick, slot.as_ref(), feedback, lost);
        if is_recorded {
            turn.recorder.sample(&record);
        }
        let ended = ended?;
        if let Some(next) = run.correct(&ended) {
            turn.recorder.stream_event(&correction(&record, &ended, next));
        }
        if ended.cycle == 0 {
            return None;
        }
        self.detectors
            .on_cycle(ended.cycle, ended.target.amplitude, ended.measured.amplitude())
    }
}

/// The sample as it is recorded. `on_profile` is false while the rig holds or unloads.
fn recorded_as(sample: &PlacedSample, slot: Option<&Slot>, on_profile: bool, time_s: f64) -> Sample {
    let mut flags = sample.reading.flags;
    if sample.lost > 0 {
        flags.insert(Flags::AFTER_GAP);
    }
    match (on_profile, slot) {
        (false, _) => flags.insert(Flags::NOT_PROFILE),
        (true, None) => flags.insert(Flags::NO_COMMAND),
        (true, Some(_)) => {}
    }
    Sample {
        tick: sample.tick,
        time_s,
        force_n: sample.reading.force_n,
        displacement_mm: sample.reading.displacement_mm,
        force_counts: sample.force_counts,
        displacement_counts: sample.displacement_counts,
        command: slot.map(|s| s.command),
        cycle: slot.map_or(0, |s| s.cycle),
        segment: slot.map_or(0, |s| s.segment),
        twin_force_n: None,
        flags,
    }
}

/// The event of `lost` samples before `at`.
fn gap(at: &Sample, lost: u64) -> StreamEvent {
    StreamEvent {
        tick: at.tick,
        time_s: at.time_s,
        finding: StreamFinding::Gap { lost },
    }
}

/// The event of a new correction after `ended`.
fn correction(at: &Sample, ended: &EndedCycle, next: Correction) -> StreamEvent {
    StreamEvent {
        tick: at.tick,
        time_s: at.time_s,
        finding: StreamFinding::Correction {
            cycle: ended.cycle,
            peak: ended.measured.peak,
            valley: ended.measured.valley,
            amplitude_factor: next.amplitude_factor,
            mean_offset: next.mean_offset,
        },
    }
}
