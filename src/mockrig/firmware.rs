//! The firmware: states, motion, trips, and the messages of each tick, in counts and ticks. Messages from the host are handled
//! in `requests`, the detectors are in `guard`, the servo loop in `servo`; frames and links are left to `MockRig`.
//!
//! ```text
//! Off --Arm--> Armed <--first command due / last command done--> Running
//! Armed, Running --Hold, queue low, bad command--> Hold --Resume--> Armed
//! any with pressure --Unload, NMT stop, lease, faults--> Unload --> Off (on request) or Tripped (after a fault)
//! any with pressure --LVDT fault, limit of travel, emergency stop--> Tripped;   Tripped --Reset--> Off
//! ```

use super::guard::{Following, Reaction, SafetyGuard, SensorReading};
use super::host_side::HostSide;
use super::queue::{CommandQueue, SetPoint};
use super::servo::{Servo, ServoConfig, ServoTarget};
use crate::detector;
use crate::protocol::message::{
    Cause, DISPLACEMENT_MM_PER_COUNT, EmergencyMessage, FORCE_N_PER_COUNT, FromRig, Limits, NmtState,
    RequestResult, RigState, SampleMessage, StatusMessage, WireMode, next_counter,
};
use crate::protocol::tick::{TICK_S, TICKS_PER_S, ms_in_ticks, ticks_in_ms};
use crate::units::Mode;

/// Identity of the firmware, as the host reads it at the hello.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Identity {
    /// Node on the bus, 1 to 126.
    pub node: u8,
    /// Serial number, object 0x1018:4.
    pub serial: u32,
    /// Boot id, object 0x2001.
    pub boot_id: u32,
    /// Calibration hash, object 0x2003.
    pub calibration_hash: u32,
}

/// Outputs of the firmware to the hydraulics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drive {
    /// Command to the servo valve, -1 to 1.
    pub valve: f64,
    /// Pump on and blocking valve open.
    pub open: bool,
}

impl Drive {
    /// Servo valve centred, pump off, blocking valve closed.
    pub(super) const OFF: Drive = Drive {
        valve: 0.0,
        open: false,
    };
}

/// Messages to send, in order. If it is full, further messages are dropped; no bus carries requests that fast.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outbox {
    messages: [Option<FromRig>; 8],
    len: usize,
}

impl Outbox {
    pub(super) fn push(&mut self, message: FromRig) {
        if let Some(slot) = self.messages.get_mut(self.len) {
            *slot = Some(message);
            self.len += 1;
        }
    }

    /// True if nothing is to be sent.
    pub(crate) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Takes all messages out, in order.
    pub(crate) fn drain(&mut self) -> impl Iterator<Item = FromRig> {
        let len = std::mem::take(&mut self.len);
        std::mem::take(&mut self.messages).into_iter().take(len).flatten()
    }
}

/// Acceleration of the firmware's own motions, mm/s2.
const BRAKE_MM_S2: f64 = 5000.0;
/// The same in LVDT counts per tick, per tick.
const BRAKE_PER_TICK: f64 = BRAKE_MM_S2 / TICKS_PER_S / TICKS_PER_S / DISPLACEMENT_MM_PER_COUNT;
/// Ticks in a row at which the force must be at most the unloaded level: 5 ms.
const UNLOADED_TICKS: u64 = ticks_in_ms(5);
/// An unload that takes longer than this has failed: 60 s.
const UNLOAD_TICKS_MAX: u64 = ticks_in_ms(60_000);
/// Period of the status: 10 ms.
const STATUS_TICKS: u64 = ticks_in_ms(10);
/// Period of the heartbeat: 100 ms.
const HEARTBEAT_TICKS: u64 = ticks_in_ms(100);

/// The firmware with its whole state.
#[derive(Debug, Clone)]
pub(crate) struct Firmware {
    pub(super) identity: Identity,
    pub(super) limits: Limits,
    pub(super) nmt: NmtState,
    pub(super) tick: u64,
    pub(super) state: RigState,
    pub(super) cause: Cause,
    pub(super) host: HostSide,
    pub(super) queue: CommandQueue,
    /// Mode of the commands since the queue was last emptied.
    pub(super) queue_mode: Option<WireMode>,
    pub(super) guard: SafetyGuard,
    servo_config: ServoConfig,
    servo: Servo,
    /// Set point of this tick.
    point: SetPoint,
    /// Rate of the set point, counts per tick.
    rate: f64,
    state_since: u64,
    pressure_since: u64,
    /// Ticks in a row with the force at most at the unloaded level.
    unloaded: u64,
    last_reading: Option<SensorReading>,
    pub(super) status_due: bool,
    /// Injected fault: no limit is enforced and no fault of a sensor found.
    pub limits_ignored: bool,
    sample_counter: u8,
    status_counter: u8,
    pub(super) outbox: Outbox,
}

impl Firmware {
    /// The state after a boot: Off, no session, limits at their defaults.
    pub(crate) fn new(identity: Identity, servo: &ServoConfig) -> Self {
        let mut outbox = Outbox::default();
        outbox.push(FromRig::Heartbeat {
            state: NmtState::BootUp,
        });
        Firmware {
            identity,
            limits: Limits::defaults(),
            nmt: NmtState::PreOperational,
            tick: 0,
            state: RigState::Off,
            cause: Cause::None,
            host: HostSide::default(),
            queue: CommandQueue::default(),
            queue_mode: None,
            guard: SafetyGuard::default(),
            servo_config: servo.clone(),
            servo: Servo::new(servo),
            point: SetPoint {
                mode: WireMode::Displacement,
                counts: 0.0,
                last: true,
            },
            rate: 0.0,
            state_since: 0,
            pressure_since: 0,
            unloaded: 0,
            last_reading: None,
            status_due: true,
            limits_ignored: false,
            sample_counter: 0,
            status_counter: 0,
            outbox,
        }
    }

    /// Boots again with the next boot id: Off, no session, default limits, nothing resumed.
    pub(crate) fn reboot(&mut self) {
        let identity = Identity {
            boot_id: self.identity.boot_id.wrapping_add(1),
            ..self.identity
        };
        *self = Firmware::new(identity, &self.servo_config.clone());
    }

    /// The messages to send now.
    pub(crate) fn outbox(&mut self) -> &mut Outbox {
        &mut self.outbox
    }

    /// True while the pump is on and the blocking valve is open.
    pub(crate) fn pressure_on(&self) -> bool {
        !matches!(self.state, RigState::Off | RigState::Tripped)
    }

    /// One tick: takes the reading, runs the detectors and the servo loop, and puts the messages into the outbox.
    pub(crate) fn tick(&mut self, reading: &SensorReading) -> Drive {
        self.tick += 1;
        self.guard.observe(reading);
        self.last_reading = Some(*reading);
        self.watch_host();
        if self.pressure_on() {
            let following = self.following();
            let found = self.guard.check(reading, &self.limits, &following);
            if let Some((cause, reaction)) = found.filter(|_| !self.limits_ignored) {
                // An unload that does not follow its ramp cannot be answered by an unload.
                let failed = self.state == RigState::Unload && cause == Cause::FollowingError;
                self.trip(cause, if failed { Reaction::Off } else { reaction });
            }
        } else if reading.emergency_stop && self.state == RigState::Off {
            self.latch(Cause::EmergencyStop);
            self.enter(RigState::Tripped);
            self.announce();
        }
        let drive = self.drive();
        self.report(reading);
        drive
    }

    /// Reacts to a fault, latches the first cause and announces it. A reaction milder than the one under way changes nothing.
    pub(super) fn trip(&mut self, cause: Cause, reaction: Reaction) {
        if !self.pressure_on() {
            return;
        }
        let known = self.latched();
        match (reaction, self.state) {
            (Reaction::Off, _) => {
                self.latch(cause);
                self.enter(RigState::Tripped);
            }
            (Reaction::Unload, RigState::Unload) => self.latch(cause),
            (Reaction::Unload, _) => {
                self.latch(cause);
                self.brake(RigState::Unload);
            }
            (Reaction::Hold, RigState::Armed | RigState::Running) => {
                self.latch(cause);
                self.brake(RigState::Hold);
            }
            (Reaction::Hold, _) => return,
        }
        if !known {
            self.announce();
        }
    }

    /// Sends the emergency message, once per latched cause. Later changes of state are in the status only.
    fn announce(&mut self) {
        let (code, register) = self.cause.emergency();
        self.outbox.push(FromRig::Emergency(EmergencyMessage {
            code,
            register,
            cause: self.cause,
            state: self.state,
            tick: self.tick as u16,
        }));
    }

    /// True if a fault is latched; an unload under way then ends in Tripped.
    fn latched(&self) -> bool {
        !matches!(self.cause, Cause::None | Cause::Requested)
    }

    fn latch(&mut self, cause: Cause) {
        if !self.latched() {
            self.cause = cause;
        }
        self.status_due = true;
    }

    pub(super) fn enter(&mut self, state: RigState) {
        self.state = state;
        self.state_since = self.tick;
        self.status_due = true;
        self.unloaded = 0;
        if !self.pressure_on() {
            self.queue.clear();
            self.queue_mode = None;
        }
    }

    /// Switches the pressure on, with the present displacement as set point.
    pub(super) fn arm(&mut self) {
        self.cause = Cause::None;
        self.guard.restart();
        self.servo.engage();
        self.pressure_since = self.tick;
        self.rebase();
        self.enter(RigState::Armed);
    }

    /// Makes the present displacement the set point and empties the queue, which then accepts either mode.
    pub(super) fn rebase(&mut self) {
        self.queue.clear();
        self.queue_mode = None;
        self.rate = 0.0;
        self.point = SetPoint {
            mode: WireMode::Displacement,
            counts: f64::from(self.guard.displacement_counts()),
            last: true,
        };
    }

    /// Goes from the queue to the firmware's own motion in displacement control, starting with the present speed.
    pub(super) fn brake(&mut self, state: RigState) {
        let (set_point, rate) = (self.point, self.rate);
        self.rebase();
        let near = f64::from(self.limits.following_error_displacement_counts);
        if set_point.mode == WireMode::Displacement && (set_point.counts - self.point.counts).abs() <= near {
            self.point.counts = set_point.counts;
            self.rate = rate;
        } else {
            self.rate = self.guard.velocity_counts_s() * TICK_S;
        }
        self.enter(state);
    }

    /// The following error of the set point of the tick before.
    fn following(&self) -> Following {
        let feedback = match self.point.mode {
            WireMode::Displacement => self.guard.displacement_counts(),
            WireMode::Force => self.guard.force_counts(),
        };
        Following {
            mode: self.point.mode,
            error_counts: self.point.counts - f64::from(feedback),
            rate_counts_s: self.rate * TICKS_PER_S,
            speed_mm_s: self.servo.speed_mm_s(),
            pressure_ticks: self.tick - self.pressure_since,
            holds: self.state == RigState::Hold && self.rate == 0.0,
        }
    }

    /// Moves the set point by one tick and runs the servo loop.
    fn drive(&mut self) -> Drive {
        match self.state {
            RigState::Off | RigState::Tripped => {}
            RigState::Armed | RigState::Running => self.follow_queue(),
            RigState::Hold => {
                self.move_towards(0.0);
                if self.tick - self.state_since >= ticks_in_ms(self.limits.hold_timeout_ms as u64) {
                    self.trip(Cause::HoldTimeout, Reaction::Unload);
                }
            }
            RigState::Unload => self.unload(),
        }
        if !self.pressure_on() {
            return Drive::OFF;
        }
        let (mode, scale) = match self.point.mode {
            WireMode::Displacement => (Mode::Displacement, DISPLACEMENT_MM_PER_COUNT),
            WireMode::Force => (Mode::Force, FORCE_N_PER_COUNT),
        };
        let target = ServoTarget {
            mode,
            value: self.point.counts * scale,
            rate: self.rate * TICKS_PER_S * scale,
            rate_ahead: self.rate_ahead() * TICKS_PER_S * scale,
        };
        let displacement_mm = f64::from(self.guard.displacement_counts()) * DISPLACEMENT_MM_PER_COUNT;
        let force_n = f64::from(self.guard.force_counts()) * FORCE_N_PER_COUNT;
        Drive {
            valve: self.servo.step(target, displacement_mm, force_n),
            open: true,
        }
    }

    fn follow_queue(&mut self) {
        if let Some(next) = self.queue.set_point(self.tick, Some(self.point)) {
            if self.state == RigState::Armed && self.queue.at(self.tick).is_none() {
                return; // A motion begins with a command that was sent, not with an interpolated one.
            }
            self.rate = if next.mode == self.point.mode {
                next.counts - self.point.counts
            } else {
                0.0
            };
            self.point = next;
            if self.state == RigState::Armed {
                self.enter(RigState::Running);
            }
        } else {
            self.rate = 0.0;
        }
        if self.state == RigState::Running {
            let level = self.queue.level(self.tick);
            let ends = self.queue.newest().map_or(self.point.last, |newest| newest.last);
            if ends && level == 0 {
                self.enter(RigState::Armed);
            } else if !ends && level < ticks_in_ms(self.limits.queue_low_ms as u64) && detector::acts("F6") {
                self.trip(Cause::QueueDry, Reaction::Hold);
            }
        }
    }

    /// Rate of the commands ahead of the tick by the servo's lead, counts per tick; the present rate where they are unknown.
    fn rate_ahead(&self) -> f64 {
        if self.state != RigState::Running {
            return self.rate;
        }
        let lead = self.servo.lead_ticks();
        let end = self.tick + self.queue.level(self.tick);
        // After the end of a motion the set point is constant.
        let known = |ahead: u64| self.queue.at((self.tick + ahead).min(end));
        match (known(lead + 1), known(lead.saturating_sub(1))) {
            (Some(late), Some(early)) => {
                (late.counts - early.counts) / (lead + 1 - lead.saturating_sub(1)) as f64
            }
            _ => self.rate,
        }
    }

    /// The firmware's own motion: changes the speed towards `rate` counts per tick.
    fn move_towards(&mut self, rate: f64) {
        let change = (rate - self.rate).clamp(-BRAKE_PER_TICK, BRAKE_PER_TICK);
        self.rate += change;
        let (low, high) = (
            self.limits.displacement_min_counts,
            self.limits.displacement_max_counts,
        );
        self.point.counts = (self.point.counts + self.rate).clamp(f64::from(low.min(high)), f64::from(high));
    }

    fn unload(&mut self) {
        let rate = -f64::from(self.limits.unload_velocity_counts_s) * TICK_S;
        self.move_towards(rate);
        let is_unloaded =
            !self.guard.force_invalid() && self.guard.force_counts() <= self.limits.unloaded_force_counts;
        self.unloaded = if is_unloaded { self.unloaded + 1 } else { 0 };
        let retracted = self.guard.displacement_counts() <= self.limits.retract_counts;
        let steady = self.rate == rate;
        if steady && (self.unloaded >= UNLOADED_TICKS || retracted) {
            if self.latched() {
                self.enter(RigState::Tripped);
            } else {
                self.cause = Cause::None;
                self.enter(RigState::Off);
            }
        } else if self.tick - self.state_since > UNLOAD_TICKS_MAX {
            self.trip(Cause::FollowingError, Reaction::Off);
        }
    }

    /// Sends the sample of each tick, the status and the heartbeat in their periods, and the status at once on a change.
    fn report(&mut self, reading: &SensorReading) {
        if self.has_process_data() {
            self.outbox.push(FromRig::Sample(SampleMessage {
                counter: self.sample_counter,
                tick: self.tick as u16,
                force_counts: reading.force_counts,
                displacement_counts: reading.displacement_counts,
            }));
            self.sample_counter = next_counter(self.sample_counter);
            if self.status_due || self.tick.is_multiple_of(STATUS_TICKS) {
                self.push_status();
            }
        }
        if self.tick.is_multiple_of(HEARTBEAT_TICKS) {
            self.outbox.push(FromRig::Heartbeat { state: self.nmt });
        }
    }

    fn push_status(&mut self) {
        self.status_due = false;
        let (ack_counter, ack_result) = self.host.ack.unwrap_or((15, RequestResult::None));
        self.outbox.push(FromRig::Status(StatusMessage {
            counter: self.status_counter,
            state: self.state,
            cause: self.cause,
            queue_ms: ms_in_ticks(self.queue.level(self.tick)).min(255) as u8,
            session: self.host.session,
            ack_counter,
            ack_result,
            boot: self.identity.boot_id as u8,
            tick_high: (self.tick >> 16) as u8,
        }));
        self.status_counter = next_counter(self.status_counter);
    }

    /// True while a sensor has no reading, the emergency stop is pressed, or the displacement is beyond its limits.
    pub(super) fn cause_stands(&self) -> bool {
        let travel = self.limits.displacement_min_counts..=self.limits.displacement_max_counts;
        self.guard.sensors_bad()
            || !travel.contains(&self.guard.displacement_counts())
            || self.last_reading.is_some_and(|reading| reading.emergency_stop)
    }
}
