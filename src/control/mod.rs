//! Drives a rig over a link: session, lease, command queue, tare, runs. Knows no model, no file and no clock: the caller
//! polls it about once a millisecond with the time, so that a real rig and virtual time run the same code.
//!
//! The firmware closes the servo loop and has the last word on safety. Control streams time-tagged commands ahead of
//! time, keeps the lease alive from this very loop, and accounts for every sample by the rig's own tick.

pub(crate) mod channel;
pub(crate) mod limits;
pub(crate) mod realtime;
pub(crate) mod rig_clock;
pub(crate) mod run;
mod sampling;
mod sending;
pub(crate) mod session;
pub(crate) mod status;
pub(crate) mod ticks;
mod transitions;

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
pub(crate) use status::{Counters, Phase, Refusal, RigStatus, TareReport};
use ticks::{TickOrder, Ticks};

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
pub(crate) struct RigConfig {
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
    /// Most commands sent a tick: bounds the bus load while the queue fills.
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
pub(crate) struct Rig {
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
    /// Tick at which commands were sent last.
    fed_at_tick: u64,
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
    pub(crate) fn new(config: RigConfig) -> Self {
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
            fed_at_tick: 0,
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
    pub(crate) fn poll(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
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
            FromRig::Sample {
                counter,
                tick,
                force_counts,
                displacement_counts,
            } => {
                if !self.sample_counter.check(counter).is_usable() {
                    self.counters.frames_out_of_sequence += 1;
                    return;
                }
                match self.ticks.place(tick) {
                    TickOrder::Next { tick, lost } => {
                        self.on_sample(
                            tick,
                            lost,
                            (force_counts, displacement_counts),
                            now_ns,
                            link,
                            recorder,
                        );
                    }
                    TickOrder::Old => self.counters.frames_out_of_sequence += 1,
                }
            }
            FromRig::Status {
                counter,
                state,
                cause,
                queue_ms,
                session,
                ack_counter,
                ack_result,
                boot,
                ..
            } => {
                if !self.status_counter.check(counter).is_usable() {
                    self.counters.frames_out_of_sequence += 1;
                    return;
                }
                self.queue_ms = queue_ms;
                if self.boot.replace(boot).is_some_and(|before| before != boot) {
                    self.on_reboot(now_ns, recorder);
                }
                self.session.on_owner(session);
                match self.session.on_status(ack_counter, ack_result, now_ns) {
                    Some(Answered::Refused(code, result)) => {
                        self.give_up(format!("the rig refused {code:?}: {result:?}"), recorder);
                    }
                    Some(Answered::Done(_)) | None => {}
                }
                self.on_state(state, cause, now_ns, recorder);
            }
            FromRig::Emergency {
                code, cause, state, ..
            } => {
                self.counters.emergencies += 1;
                self.event(
                    recorder,
                    EventKind::Limit,
                    format!("emergency {code:#06x}: {cause:?}, the rig went to {state:?}"),
                );
            }
            FromRig::Heartbeat { .. } => {}
            FromRig::ConfigValue { index, sub, value } => self.session.on_value(index, sub, value, now_ns),
            FromRig::ConfigWritten { index, sub } => self.session.on_written(index, sub),
            FromRig::ConfigRefused { index, sub, abort } => {
                self.session.on_refused(index, sub, abort, now_ns)
            }
        }
    }

    fn event(&self, recorder: &mut dyn Recorder, kind: EventKind, text: String) {
        let (Activity::Running(run) | Activity::Stopping { run, .. }) = &self.activity else {
            return;
        };
        let tick = self.ticks.newest().unwrap_or(0);
        recorder.event(&Event {
            tick,
            time_s: run.time_s(tick),
            kind,
            text,
        });
    }
}
