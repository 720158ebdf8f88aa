//! Drives a rig over a link: session, lease, command queue, tare, runs. Knows no model, no file and no clock: the caller
//! polls it about once a millisecond with the time, so that a real rig and virtual time run the same code.
//!
//! The firmware closes the servo loop and has the last word on safety. Control streams time-tagged commands ahead of
//! time, keeps the lease alive from this very loop, and accounts for every sample by the rig's own tick.

pub mod channel;
pub mod limits;
pub mod realtime;
pub mod rig_clock;
pub mod run;
pub mod session;
pub mod status;
pub mod ticks;

use crate::link::Link;
use crate::protocol::message::{
    Cause, FromRig, Limits, NmtCommand, RequestCode, RigState, ToRig, WireMode, next_counter,
};
use crate::protocol::protection::CounterCheck;
use crate::recording::{Ending, Event, EventKind, Flags, Recorder, Sample};
use crate::units::{Command, Mode};

use channel::{Channels, Reading, Stillness};
use limits::{Action, DetectorLimits, Detectors};
use rig_clock::RigClock;
use run::{Run, RunOrder};
use session::{Answered, Session};
pub use status::{Counters, Phase, Refusal, RigStatus, TareReport};
use ticks::{Place, Ticks};

const MS: u64 = 1_000_000;
/// The lease goes out this often, from the control loop itself.
const LEASE_PERIOD_NS: u64 = 10 * MS;
/// NMT start is repeated this often until samples come.
const NMT_START_PERIOD_NS: u64 = 500 * MS;
/// A stop that has not unloaded by then is closed as it is.
const UNLOAD_TIMEOUT_NS: u64 = 20_000 * MS;
/// Without a sample for this long a stopped run is closed.
const DEAD_STREAM_NS: u64 = 500 * MS;

/// Figures that control needs of a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct RigConfig {
    /// Node of the rig, 1 to 126.
    pub node: u8,
    /// Number of this host's session, 1 to 255; another one after each start of the program.
    pub session: u8,
    /// Scaling of both channels.
    pub channels: Channels,
    /// Limits that the firmware holds.
    pub limits: Limits,
    /// First four bytes of the calibration's hash.
    pub calibration_hash: u32,
    /// Commands are queued this far ahead.
    pub queue_lead_ms: u64,
    /// Most commands sent in one poll: bounds the bus load while the queue fills.
    pub commands_per_poll: u32,
    /// A request that is not acknowledged by then is sent once more, then given up.
    pub ack_timeout_ms: u64,
    /// The host's detectors.
    pub detectors: DetectorLimits,
    /// Largest tare.
    pub tare_limit_n: f64,
    /// Largest tare.
    pub tare_limit_mm: f64,
    /// A channel noisier than this is not still.
    pub still_sigma_n: f64,
    /// A channel noisier than this is not still.
    pub still_sigma_mm: f64,
}

/// What control is busy with.
enum Activity {
    Idle,
    /// Pressure is asked for; the run begins once the rig is armed.
    Arming(Box<RunOrder>),
    Running(Box<Run>),
    /// The rig unloads; samples are still recorded.
    Stopping {
        run: Box<Run>,
        ending: Ending,
        cause: String,
        since_ns: u64,
    },
    /// The run is closed, the rig unloads.
    Unloading,
}

/// One rig, driven from here.
pub struct Rig {
    config: RigConfig,
    channels: Channels,
    session: Session,
    ticks: Ticks,
    clock: RigClock,
    sample_counter: CounterCheck,
    status_counter: CounterCheck,
    detectors: Detectors,
    stillness: Stillness,
    activity: Activity,
    state: Option<RigState>,
    cause: Cause,
    boot: Option<u8>,
    queue_ms: u8,
    reading: Option<Reading>,
    command_counter: u8,
    lease_counter: u8,
    lease_sent_ns: Option<u64>,
    nmt_sent_ns: Option<u64>,
    unsent: Option<crate::protocol::frame::Frame>,
    ask: Option<RequestCode>,
    counters: Counters,
    notice: String,
    last_poll_ns: Option<u64>,
}

impl Rig {
    /// A rig that has not been heard of yet.
    pub fn new(config: RigConfig) -> Self {
        Rig {
            channels: config.channels,
            session: Session::new(
                config.node,
                config.session,
                config.limits,
                config.calibration_hash,
                config.ack_timeout_ms,
            ),
            ticks: Ticks::default(),
            clock: RigClock::default(),
            sample_counter: CounterCheck::default(),
            status_counter: CounterCheck::default(),
            detectors: Detectors::new(config.detectors),
            stillness: Stillness::default(),
            activity: Activity::Idle,
            state: None,
            cause: Cause::None,
            boot: None,
            queue_ms: 0,
            reading: None,
            command_counter: 0,
            lease_counter: 0,
            lease_sent_ns: None,
            nmt_sent_ns: None,
            unsent: None,
            ask: None,
            counters: Counters::default(),
            notice: String::new(),
            last_poll_ns: None,
            config,
        }
    }

    /// Does everything that is due at `now_ns` (monotonic): takes frames, watches, sends lease and commands, and hands
    /// samples and events to `recorder`. Never waits.
    pub fn poll(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        self.note_lateness(now_ns);
        while let Some(arrival) = link.receive() {
            match FromRig::decode(&arrival.frame, self.config.node) {
                Ok(message) => self.on_message(message, now_ns, link, recorder),
                Err(_) => self.counters.frames_refused += 1,
            }
        }
        self.watch(now_ns, link, recorder);
        self.send_due(now_ns, link, recorder);
    }

    fn note_lateness(&mut self, now_ns: u64) {
        if let Some(last) = self.last_poll_ns {
            let gap_ms = now_ns.saturating_sub(last) / MS;
            self.counters.worst_poll_gap_ms = self.counters.worst_poll_gap_ms.max(gap_ms);
            self.counters.late_polls += u64::from(gap_ms > 5);
        }
        self.last_poll_ns = Some(now_ns);
    }

    fn on_message(&mut self, message: FromRig, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        match message {
            FromRig::Sample { counter, tick, force_counts, displacement_counts } => {
                if !self.sample_counter.check(counter).is_usable() {
                    self.counters.frames_out_of_sequence += 1;
                    return;
                }
                match self.ticks.place(tick) {
                    Place::Next { tick, lost } => {
                        self.on_sample(tick, lost, (force_counts, displacement_counts), now_ns, link, recorder);
                    }
                    Place::Old => self.counters.frames_out_of_sequence += 1,
                }
            }
            FromRig::Status { counter, state, cause, queue_ms, ack_counter, ack_result, boot, .. } => {
                if !self.status_counter.check(counter).is_usable() {
                    self.counters.frames_out_of_sequence += 1;
                    return;
                }
                self.queue_ms = queue_ms;
                if self.boot.replace(boot).is_some_and(|before| before != boot) {
                    self.on_reboot(now_ns, recorder);
                }
                match self.session.on_status(ack_counter, ack_result, now_ns) {
                    Some(Answered::Refused(code, result)) => {
                        self.give_up(format!("the rig refused {code:?}: {result:?}"), recorder);
                    }
                    Some(Answered::Done(_)) | None => {}
                }
                self.on_state(state, cause, now_ns, recorder);
            }
            FromRig::Emergency { code, cause, state, .. } => {
                self.counters.emergencies += 1;
                self.event(recorder, EventKind::Limit, format!("emergency {code:#06x}: {cause:?}, the rig went to {state:?}"));
            }
            FromRig::Heartbeat { .. } => {}
            FromRig::ConfigValue { index, sub, value } => self.session.on_value(index, sub, value, now_ns),
            FromRig::ConfigWritten { index, sub } => self.session.on_written(index, sub),
            FromRig::ConfigRefused { index, sub, abort } => self.session.on_refused(index, sub, abort, now_ns),
        }
    }

    fn on_sample(
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
            reading.flags.set(Flags::LATE);
        }
        self.counters.samples += 1;
        self.counters.lost += lost;
        if reading.flags.0 == 0 && lost == 0 {
            self.stillness.push(&reading);
        } else {
            self.stillness.clear();
        }
        self.reading = Some(reading);
        let action = self.detectors.on_sample(now_ns, if fresh_stream { 0 } else { lost });
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
    fn record(
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
            flags.set(Flags::AFTER_GAP);
        }
        match (on_profile, slot) {
            (false, _) => flags.set(Flags::NOT_PROFILE),
            (true, None) => flags.set(Flags::NO_COMMAND),
            _ => {}
        }
        let time_s = run.time_s(tick);
        if lost > 0 && run.samples() > 0 {
            let text = format!("{lost} samples missing before {time_s:.3} s");
            recorder.event(&Event { tick, time_s, kind: EventKind::Gap, text });
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
            recorder.event(&Event { tick, time_s, kind: EventKind::Correction, text });
        }
        (ended.cycle > 0)
            .then(|| self.detectors.on_cycle(ended.cycle, ended.target.amplitude, ended.measured.amplitude()))
            .flatten()
    }

    fn begin_run(&mut self, tick: u64, now_ns: u64, recorder: &mut dyn Recorder) {
        let Activity::Arming(order) = std::mem::replace(&mut self.activity, Activity::Idle) else { return };
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
                let text = format!("run {} of profile {} starts", run.header.run_id, run.header.profile_name);
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

    fn finish_run_at(&mut self, tick: u64, recorder: &mut dyn Recorder) {
        let Activity::Running(run) = &self.activity else { return };
        if run.is_finished(tick) && !run.is_held() {
            self.close(Ending::Completed, "", recorder);
            self.activity = Activity::Unloading;
            self.ask = Some(RequestCode::Unload);
        }
    }

    /// Ends the recording of the run under way.
    fn close(&mut self, ending: Ending, cause: &str, recorder: &mut dyn Recorder) {
        let text = if cause.is_empty() { "run completed".to_owned() } else { cause.to_owned() };
        self.event(recorder, EventKind::End, text);
        if let Activity::Running(run) | Activity::Stopping { run, .. } = &self.activity {
            recorder.end(&run.outcome(ending, cause));
        }
        if !cause.is_empty() {
            self.notice = cause.to_owned();
        }
        self.activity = Activity::Idle;
    }

    fn on_state(&mut self, state: RigState, cause: Cause, now_ns: u64, recorder: &mut dyn Recorder) {
        let before = self.state.replace(state);
        self.cause = cause;
        if before == Some(state) {
            return;
        }
        self.event(recorder, EventKind::RigState, format!("rig {state:?}, cause {cause:?}"));
        let newest = self.ticks.newest().unwrap_or(0);
        match (&mut self.activity, state) {
            (Activity::Running(run), RigState::Hold) => {
                run.hold(newest);
                self.notice = format!("the rig holds ({cause:?}): resume or stop");
            }
            (Activity::Running(run), RigState::Armed) if run.is_held() => {
                let level = self.reading.map_or(0.0, |r| Channels::feedback(run.mode(), &r));
                if let Err(error) = run.resume(newest + self.config.queue_lead_ms, level) {
                    let text = format!("the run cannot resume: {error}");
                    self.ask = Some(RequestCode::Unload);
                    self.wind_down(Ending::Stopped, text, now_ns);
                }
            }
            (Activity::Running(_), RigState::Unload | RigState::Tripped | RigState::Off) => {
                let text = format!("the rig ended the run: {cause:?}");
                self.wind_down(Ending::Aborted, text, now_ns);
            }
            (Activity::Stopping { ending, cause: text, .. }, RigState::Off | RigState::Tripped) => {
                let (ending, text) = (*ending, std::mem::take(text));
                self.close(ending, &text, recorder);
            }
            (Activity::Arming(_), RigState::Tripped | RigState::Unload) => {
                self.notice = format!("the rig did not arm: {cause:?}");
                self.activity = Activity::Idle;
            }
            (Activity::Unloading, RigState::Off | RigState::Tripped) => self.activity = Activity::Idle,
            _ => {}
        }
    }

    fn on_reboot(&mut self, now_ns: u64, recorder: &mut dyn Recorder) {
        self.session.restart(now_ns);
        self.forget_stream();
        let text = "the rig's firmware restarted: check the rig, then start again";
        self.event(recorder, EventKind::RigState, text.to_owned());
        if let Activity::Running(_) | Activity::Stopping { .. } = self.activity {
            self.close(Ending::Aborted, text, recorder);
        }
        self.activity = Activity::Idle;
    }

    fn forget_stream(&mut self) {
        self.ticks.restart();
        self.clock.restart();
        self.sample_counter.reset();
        self.stillness.clear();
    }

    /// Keeps recording while the rig unloads, then closes the run.
    fn wind_down(&mut self, ending: Ending, cause: String, now_ns: u64) {
        if let Activity::Running(run) = std::mem::replace(&mut self.activity, Activity::Idle) {
            self.notice.clone_from(&cause);
            self.activity = Activity::Stopping { run, ending, cause, since_ns: now_ns };
        }
    }

    fn act(&mut self, action: Action, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        if !matches!(self.activity, Activity::Running(_)) {
            return;
        }
        match action {
            Action::Hold(why) => {
                self.event(recorder, EventKind::Limit, why.clone());
                self.notice = why;
                self.ask = Some(RequestCode::Hold);
            }
            Action::Abort(why) => {
                self.event(recorder, EventKind::Limit, why.clone());
                self.abort(link);
                self.wind_down(Ending::Aborted, why, now_ns);
            }
        }
    }

    fn abort(&mut self, link: &mut Link) {
        let stop = ToRig::Nmt { command: NmtCommand::Stop, node: self.config.node };
        link.send_urgent(stop.encode(self.config.node));
    }

    /// Watches what no frame tells: a closed link, a silent stream, an unload that does not end.
    fn watch(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        let bus_errors = link.health.bus_errors.load(std::sync::atomic::Ordering::Relaxed);
        if bus_errors > self.counters.bus_errors && matches!(self.activity, Activity::Running(_)) {
            let text = format!("{} bus errors more, {bus_errors} in all", bus_errors - self.counters.bus_errors);
            self.event(recorder, EventKind::Link, text);
        }
        self.counters.bus_errors = bus_errors;
        if let Some(action) = self.detectors.silence(now_ns) {
            self.act(action, now_ns, link, recorder);
        }
        let silent_ns = self.detectors.age_ms(now_ns).unwrap_or(0) * MS;
        if silent_ns > DEAD_STREAM_NS && self.session.is_open() {
            self.session.restart(now_ns);
            self.forget_stream();
            self.state = None;
            self.nmt_sent_ns = None;
        }
        let overdue = match &self.activity {
            Activity::Stopping { since_ns, .. } => {
                silent_ns > DEAD_STREAM_NS || now_ns.saturating_sub(*since_ns) > UNLOAD_TIMEOUT_NS
            }
            _ => false,
        };
        if overdue && let Activity::Stopping { ending, cause, .. } = &mut self.activity {
            let (ending, text) = (*ending, std::mem::take(cause));
            self.close(ending, &text, recorder);
        }
        if matches!(self.activity, Activity::Arming(_) | Activity::Unloading) && silent_ns > DEAD_STREAM_NS {
            self.activity = Activity::Idle;
        }
    }

    fn send_due(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        if let Some(given_up) = self.session.poll(now_ns, link) {
            self.on_unanswered(given_up, now_ns, link, recorder);
        }
        if self.nmt_sent_ns.is_none_or(|at| now_ns.saturating_sub(at) >= NMT_START_PERIOD_NS)
            && self.detectors.age_ms(now_ns).is_none_or(|age| age * MS > DEAD_STREAM_NS)
        {
            let start = ToRig::Nmt { command: NmtCommand::Start, node: self.config.node };
            link.send(start.encode(self.config.node));
            self.nmt_sent_ns = Some(now_ns);
        }
        if !self.session.is_open() {
            return;
        }
        if self.lease_sent_ns.is_none_or(|at| now_ns.saturating_sub(at) >= LEASE_PERIOD_NS) {
            self.lease_counter = next_counter(self.lease_counter);
            let lease = ToRig::Lease {
                counter: self.lease_counter,
                session: self.session.id(),
                control_tick: self.ticks.newest().unwrap_or(0) as u16,
            };
            link.send(lease.encode(self.config.node));
            self.lease_sent_ns = Some(now_ns);
        }
        if !self.session.awaits_answer()
            && let Some(code) = self.ask.take()
        {
            let argument = if code == RequestCode::Arm { self.session.configuration_crc() } else { 0 };
            self.session.request(code, argument, now_ns, link);
        }
        self.send_commands(link);
    }

    fn on_unanswered(&mut self, code: RequestCode, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        let why = format!("the rig did not answer {code:?}, asked twice: check the link");
        if matches!(self.activity, Activity::Running(_)) {
            self.act(Action::Abort(why), now_ns, link, recorder);
        } else {
            if code == RequestCode::Unload {
                self.abort(link);
            }
            self.give_up(why, recorder);
        }
    }

    /// A request came to nothing: an arming run is dropped, anything else is said.
    fn give_up(&mut self, why: String, recorder: &mut dyn Recorder) {
        self.event(recorder, EventKind::RigState, why.clone());
        self.notice = why;
        if matches!(self.activity, Activity::Arming(_)) {
            self.activity = Activity::Idle;
        }
    }

    fn send_commands(&mut self, link: &mut Link) {
        let Some(newest) = self.ticks.newest() else { return };
        if let Some(frame) = self.unsent.take()
            && !link.send(frame)
        {
            self.unsent = Some(frame);
            return;
        }
        let Activity::Running(run) = &mut self.activity else { return };
        for _ in 0..self.config.commands_per_poll {
            let Some((tick, slot)) = run.next_command(newest + self.config.queue_lead_ms) else { return };
            self.command_counter = next_counter(self.command_counter);
            let message = ToRig::Command {
                counter: self.command_counter,
                session: self.session.id(),
                tick: tick as u16,
                mode: match slot.command {
                    Command::Displacement(_) => WireMode::Displacement,
                    Command::Force(_) => WireMode::Force,
                },
                counts: self.channels.command_counts(slot.command),
                last: slot.last,
            };
            let frame = message.encode(self.config.node);
            if !link.send(frame) {
                self.counters.send_failures += 1;
                self.unsent = Some(frame);
                return;
            }
        }
    }

    fn event(&self, recorder: &mut dyn Recorder, kind: EventKind, text: String) {
        let (Activity::Running(run) | Activity::Stopping { run, .. }) = &self.activity else { return };
        let tick = self.ticks.newest().unwrap_or(0);
        recorder.event(&Event { tick, time_s: run.time_s(tick), kind, text });
    }
}
