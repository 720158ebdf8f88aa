//! Drives a rig over a link: session, lease, command queue, tare, runs. Models, files and clocks are left to others: the
//! caller polls about once per tick and gives the time, so that a real rig and virtual time run the same code.
//!
//! The firmware closes the servo loop and decides about safety. Control sends commands for ticks ahead, renews the lease
//! from its own loop, and accounts for every sample by the rig's tick.
//!
//! | file | content |
//! |---|---|
//! | `sampling` | one sample: its place in time, its flags, its record |
//! | `life_cycle` | begin and end of a run |
//! | `transitions` | reactions to states of the rig and to its restart |
//! | `watch` | reactions to the detectors, to the link, and to what does not end |
//! | `detectors` | the second layer of limits behind the firmware's |
//! | `abort` | the abort, until the rig confirms it |
//! | `physical_limits` | the limits in N and mm, and in the counts of the firmware |
//! | `requests` | start, stop, hold, resume, reset and tare, as people ask for them |
//! | `motion` | return to zero and jog: slow motions without a recording |
//! | `sending` | requests, lease and commands to the rig |
//! | `session` | hello, configuration and acknowledgements |
//! | `realtime`, `pace` | the control thread, the time of a rig in memory |

mod abort;
pub(crate) mod channel;
pub(crate) mod detectors;
mod life_cycle;
mod motion;
mod pace;
pub(crate) mod physical_limits;
pub(crate) mod realtime;
mod requests;
mod rig_clock;
pub(crate) mod run;
mod sampling;
mod sending;
mod session;
mod status;
mod ticks;
mod transitions;
mod watch;

use crate::detector;
use crate::link::Link;
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    Cause, DecodeError, EmergencyMessage, FromRig, NmtState, RequestCode, RequestResult, RigState,
    StatusMessage,
};
use crate::protocol::protection::{CounterCheck, Sequence};
use crate::protocol::tick::ticks_in_ms;
use crate::recording::{Ending, Event, EventKind, Recorder};
use crate::units::NS_PER_MS;

use abort::Abort;
use channel::{Channels, Reading, Stillness};
use detectors::{Damage, DetectorLimits, Detectors};
use physical_limits::PhysicalLimits;
pub(crate) use requests::{Refusal, TareReport};
use rig_clock::RigClock;
pub(crate) use run::SlowMotion;
use run::{Run, RunOrder};
use session::Session;
pub(crate) use status::{Counters, Phase, RigStatus, ZeroRemedy};
use ticks::Ticks;

/// A poll later than this after the one before is counted as late, ms.
const LATE_POLL_MS: u64 = 5;
/// Without a sample for this long the rig counts as disconnected, ns: a stopped run is closed and the hello starts again.
const DEAD_STREAM_NS: u64 = 500 * NS_PER_MS;

/// The settings of a bench that control needs.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RigConfig {
    /// Node of the rig, 1 to 126.
    pub node: u8,
    /// Number of this host's session, 1 to 255; different after each start of the program.
    pub session: u8,
    /// Scaling of both channels.
    pub channels: Channels,
    /// Limits that the firmware enforces, and the host behind it.
    pub limits: PhysicalLimits,
    /// First four bytes of the hash of the calibration.
    pub calibration_hash: u32,
    /// Commands are sent this far ahead, ms.
    pub queue_lead_ms: u64,
    /// Most commands sent per tick. It bounds the bus load while the queue fills.
    pub commands_per_poll: u32,
    /// A request without acknowledgement is sent again after this time, ms; after the same time again it has failed.
    pub ack_timeout_ms: u64,
    /// Limits of the host's detectors.
    pub detectors: DetectorLimits,
    /// Largest tare of the load cell, N.
    pub tare_limit_n: f64,
    /// Largest tare of the LVDT, mm.
    pub tare_limit_mm: f64,
    /// Largest standard deviation of the load cell for a tare, N.
    pub still_sigma_n: f64,
    /// Largest standard deviation of the LVDT for a tare, mm.
    pub still_sigma_mm: f64,
}

/// What control is doing.
enum Activity {
    Idle,
    /// The rig is asked to arm; the run begins once it is armed.
    Arming {
        order: Box<RunOrder>,
        /// What the motion is for, if it is not recorded.
        motion: Option<SlowMotion>,
        since_ns: u64,
    },
    Running(Box<Run>),
    /// The rig unloads; samples are still recorded.
    Stopping {
        run: Box<Run>,
        ending: Ending,
        cause: String,
        since_ns: u64,
    },
    /// No run is recorded, the rig unloads.
    Unloading {
        since_ns: u64,
    },
}

/// One rig under control.
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
    /// State in the newest status; `None` while none is known.
    state: Option<RigState>,
    cause: Cause,
    /// NMT state in the newest heartbeat.
    nmt: Option<NmtState>,
    /// An abort that is not over.
    abort: Option<Abort>,
    /// A fault that the host found. A person clears it by a reset, as the rig's own.
    fault: Option<String>,
    /// The CAN controller reports that it is error passive.
    error_passive: bool,
    /// The clocks of rig and host drift apart too fast.
    clock_drifts: bool,
    boot: Option<u8>,
    queue_ms: u8,
    reading: Option<Reading>,
    /// Commands are sent this far ahead, ticks.
    lead_ticks: u64,
    /// Newest sample tick when commands were last sent.
    commands_sent_at: u64,
    command_counter: u8,
    lease_counter: u8,
    lease_sent_ns: Option<u64>,
    nmt_sent_ns: Option<u64>,
    /// A command that the link refused; it is sent before the next one.
    refused_command: Option<Frame>,
    /// Since when the link refuses it.
    refused_since_ns: Option<u64>,
    /// The request to send once the one before is answered.
    next_request: Option<RequestCode>,
    counters: Counters,
    notice: String,
    last_poll_ns: Option<u64>,
    /// Time and length in ms of the last long pause between two polls.
    long_gap: Option<(u64, u64)>,
}

/// What one poll works with.
struct Turn<'a> {
    /// Time of the poll on the caller's monotonic clock.
    now_ns: u64,
    link: &'a mut Link,
    recorder: &'a mut dyn Recorder,
}

impl Rig {
    /// A rig from which nothing has been received yet.
    pub(crate) fn new(config: RigConfig) -> Self {
        Rig {
            channels: config.channels,
            session: Session::new(
                config.node,
                config.session,
                config.limits.in_counts(&config.channels),
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
            nmt: None,
            abort: None,
            fault: None,
            error_passive: false,
            clock_drifts: false,
            boot: None,
            queue_ms: 0,
            reading: None,
            lead_ticks: ticks_in_ms(config.queue_lead_ms),
            commands_sent_at: 0,
            command_counter: 0,
            lease_counter: 0,
            lease_sent_ns: None,
            nmt_sent_ns: None,
            refused_command: None,
            refused_since_ns: None,
            next_request: None,
            counters: Counters::default(),
            notice: String::new(),
            last_poll_ns: None,
            long_gap: None,
            config,
        }
    }

    /// Does everything that is due at `now_ns` (monotonic): takes frames, checks the stream, sends requests, lease and
    /// commands, and gives samples and events to `recorder`. Never waits.
    pub(crate) fn poll(&mut self, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        let turn = &mut Turn {
            now_ns,
            link,
            recorder,
        };
        self.note_lateness(now_ns);
        self.clock.begin_poll(now_ns);
        while let Some(frame) = turn.link.receive() {
            match FromRig::decode(&frame, self.config.node) {
                Ok(message) => self.on_message(message, turn),
                Err(error) => {
                    self.counters.frames_refused += 1;
                    let damaged = !matches!(error, DecodeError::ForeignId(_) | DecodeError::Length { .. });
                    if damaged {
                        self.on_damaged_frame(Damage::Content, turn);
                    }
                }
            }
        }
        self.watch(turn);
        self.send_due(turn);
        turn.link.flush(now_ns);
    }

    fn note_lateness(&mut self, now_ns: u64) {
        if let Some(last) = self.last_poll_ns {
            let gap_ms = now_ns.saturating_sub(last) / NS_PER_MS;
            self.counters.worst_poll_gap_ms = self.counters.worst_poll_gap_ms.max(gap_ms);
            self.counters.late_polls += u64::from(gap_ms > LATE_POLL_MS);
            if let Activity::Running(run) = &mut self.activity
                && gap_ms > LATE_POLL_MS
            {
                run.late_turns.count(gap_ms);
            }
            // A shorter gap within the time in which it counts does not hide the longer one before.
            if gap_ms > LATE_POLL_MS && gap_ms >= self.recent_gap_ms() {
                self.long_gap = Some((now_ns, gap_ms));
            }
        }
        self.last_poll_ns = Some(now_ns);
    }

    fn on_message(&mut self, message: FromRig, turn: &mut Turn) {
        match message {
            FromRig::Sample(sample) => self.on_sample_message(sample, turn),
            FromRig::Status(status) => self.on_status(status, turn),
            FromRig::Emergency(emergency) => self.on_emergency(emergency, turn),
            FromRig::Heartbeat { state } => self.on_heartbeat(state, turn),
            FromRig::ConfigValue { index, sub, value } => {
                self.session.on_value(index, sub, value, turn.now_ns);
            }
            FromRig::ConfigWritten { index, sub } => self.session.on_written(index, sub),
            FromRig::ConfigRefused { index, sub, abort } => {
                self.session.on_refused(index, sub, abort, turn.now_ns);
            }
        }
    }

    fn on_status(&mut self, status: StatusMessage, turn: &mut Turn) {
        let sequence = self.status_counter.check(status.counter);
        if sequence != Sequence::Usable {
            self.on_out_of_sequence(sequence, turn);
            return;
        }
        self.detectors.on_status();
        self.queue_ms = status.queue_ms;
        if self
            .boot
            .replace(status.boot)
            .is_some_and(|before| before != status.boot)
        {
            self.on_reboot(turn);
        }
        self.session.on_owner(status.session, turn.now_ns);
        if let Some((code, result)) =
            self.session
                .on_acknowledgement(status.ack_counter, status.ack_result, turn.now_ns)
        {
            let why = format!("the rig refused {code} ({result}): {}", remedy(result));
            self.give_up(why, turn);
        }
        // Not by an emergency: that says what the rig chose when it was sent.
        self.confirm_abort_by_state(status.state);
        self.on_state(status.state, status.cause, turn);
        self.check_progress(turn);
    }

    /// Counts a frame whose counter does not fit. A repeated one is harmless, any other may be damaged or foreign.
    fn on_out_of_sequence(&mut self, sequence: Sequence, turn: &mut Turn) {
        self.counters.frames_out_of_sequence += 1;
        if sequence == Sequence::Wrong || !detector::acts("L7") {
            self.on_damaged_frame(Damage::Sequence, turn);
        }
    }

    /// An emergency tells at once what the next status repeats. Code 0 only says that the cause is gone.
    fn on_emergency(&mut self, emergency: EmergencyMessage, turn: &mut Turn) {
        let EmergencyMessage {
            code, cause, state, ..
        } = emergency;
        self.counters.emergencies += 1;
        let text = format!("emergency {code:#06x}: {cause}, the rig went to {state}");
        self.event(turn, EventKind::Limit, text);
        if code != 0 && detector::acts("F3") {
            if matches!(self.activity, Activity::Idle) {
                // Between runs no event is written: the operator must see it all the same.
                self.notice =
                    format!("the rig reports {cause} and went to {state}: remove the cause, then reset");
            }
            self.on_state(state, cause, turn);
        }
    }

    /// Records what an operator did beside the motion.
    pub(crate) fn note(&self, text: String, now_ns: u64, link: &mut Link, recorder: &mut dyn Recorder) {
        let turn = &mut Turn {
            now_ns,
            link,
            recorder,
        };
        self.event(turn, EventKind::Operator, text);
    }

    /// Records an event of the run under way.
    fn event(&self, turn: &mut Turn, kind: EventKind, text: String) {
        let (Activity::Running(run) | Activity::Stopping { run, .. }) = &self.activity else {
            return;
        };
        if run.motion.is_some() {
            return;
        }
        // After a restart of the rig no tick is known until its first sample.
        let tick = self.ticks.newest().unwrap_or(run.newest_tick());
        turn.recorder.event(&Event {
            tick,
            time_s: run.time_s(tick),
            kind,
            text,
        });
    }
}

/// True if `period_ns` has passed since `sent_ns`, or nothing was sent yet.
fn is_due(sent_ns: Option<u64>, now_ns: u64, period_ns: u64) -> bool {
    sent_ns.is_none_or(|at| now_ns.saturating_sub(at) >= period_ns)
}

/// What to do after a refused request.
fn remedy(result: RequestResult) -> &'static str {
    match result {
        RequestResult::None | RequestResult::Done => "try again",
        RequestResult::Busy => "end the other program that owns the session of this rig",
        RequestResult::WrongState => "wait until the rig is at rest, then try again",
        RequestResult::WrongConfiguration => "restart the daemon, which then writes the limits again",
        RequestResult::CauseStands => {
            "remove the cause (sensor without reading, displacement beyond its limit, emergency stop), then try again"
        }
        RequestResult::Unknown => "install the firmware of this protocol version",
    }
}
