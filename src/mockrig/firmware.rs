//! The firmware: states, motion, trips, and what is sent each tick. It knows messages, counts and ticks; no bytes, no link.
//! What a message from the host does is in `requests`, the detectors in `guard`, the loop in `servo`.
//!
//! ```text
//! Off --Arm--> Armed <--commands due / last slot--> Running
//! Armed, Running --Hold, queue low, bad command--> Hold --Resume--> Armed
//! any with pressure --Unload, NMT stop, lease, faults--> Unload --> Off (asked for) or Tripped (fault)
//! any with pressure --doubtful displacement, limit of travel, emergency stop--> Tripped;   Tripped --Reset--> Off
//! ```

use super::guard::{Following, Reaction, SafetyGuard, SensorReading};
use super::queue::{CommandQueue, SetPoint};
use super::servo::{Servo, ServoConfig, ServoTarget};
use crate::protocol::message::{
    Cause, DISPLACEMENT_MM_PER_COUNT, FORCE_N_PER_COUNT, FromRig, Limits, NmtState, RequestResult, RigState,
    WireMode, next_counter,
};
use crate::units::Mode;

/// What the firmware knows about itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Identity {
    /// Node on the bus.
    pub node: u8,
    /// Serial number.
    pub serial: u32,
    /// Boot id.
    pub boot_id: u32,
    /// Calibration hash.
    pub calibration_hash: u32,
}

/// What the firmware does to the hydraulics after a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drive {
    /// Servo valve, -1 to 1.
    pub valve: f64,
    /// Pump on and blocking valve open.
    pub open: bool,
}

/// Messages to send, in order; full only if the host asks faster than any bus can carry, and then the oldest stay.
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

    /// True where nothing is to be sent.
    pub(crate) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Takes all messages out, in order.
    pub(crate) fn drain(&mut self) -> impl Iterator<Item = FromRig> {
        let len = std::mem::take(&mut self.len);
        std::mem::take(&mut self.messages).into_iter().take(len).flatten()
    }
}

/// Speed changes by this much a ms where the firmware moves on its own: 5 m/s2 in LVDT counts a ms.
const BRAKE_COUNTS_PER_MS2: f64 = 5.0 / 1000.0 / DISPLACEMENT_MM_PER_COUNT;
/// Ticks in a row at which the force must be below the unloaded level.
const UNLOADED_TICKS: u32 = 5;
/// An unload that takes longer than this has failed, ticks.
const UNLOAD_TICKS_MAX: u64 = 60_000;
/// Status period in ticks.
const STATUS_TICKS: u64 = 10;
/// Heartbeat period in ticks.
const HEARTBEAT_TICKS: u64 = 100;

/// The firmware.
#[derive(Debug, Clone)]
pub(crate) struct Firmware {
    pub(super) identity: Identity,
    pub(super) limits: Limits,
    pub(super) nmt: NmtState,
    pub(super) tick: u64,
    pub(super) state: RigState,
    pub(super) cause: Cause,
    pub(super) host: super::requests::HostSide,
    pub(super) queue: CommandQueue,
    /// Mode of the commands since the queue was last based on the feedback.
    pub(super) queue_mode: Option<WireMode>,
    pub(super) guard: SafetyGuard,
    servo_config: ServoConfig,
    servo: Servo,
    /// Set point of this tick.
    point: SetPoint,
    /// Its rate, counts a ms.
    rate_counts_ms: f64,
    state_since: u64,
    pressure_since: u64,
    unloaded: u32,
    last_reading: Option<SensorReading>,
    pub(super) status_due: bool,
    sample_counter: u8,
    status_counter: u8,
    pub(super) outbox: Outbox,
}

impl Firmware {
    /// Just booted: Off, no session, limits at their defaults.
    pub(crate) fn new(identity: Identity, servo: &ServoConfig) -> Self {
        let mut outbox = Outbox::default();
        outbox.push(FromRig::Heartbeat {
            state: NmtState::BootUp,
        });
        Firmware {
            identity,
            limits: DEFAULT_LIMITS,
            nmt: NmtState::PreOperational,
            tick: 0,
            state: RigState::Off,
            cause: Cause::None,
            host: super::requests::HostSide::default(),
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
            rate_counts_ms: 0.0,
            state_since: 0,
            pressure_since: 0,
            unloaded: 0,
            last_reading: None,
            status_due: true,
            sample_counter: 0,
            status_counter: 0,
            outbox,
        }
    }

    /// Starts again with the next boot id: Off, no session, default limits, nothing resumed.
    pub(crate) fn reboot(&mut self) {
        let identity = Identity {
            boot_id: self.identity.boot_id.wrapping_add(1),
            ..self.identity
        };
        *self = Firmware::new(identity, &self.servo_config.clone());
    }

    /// State.
    pub(crate) fn state(&self) -> RigState {
        self.state
    }

    /// First cause of the latched state.
    pub(crate) fn cause(&self) -> Cause {
        self.cause
    }

    /// Ticks since boot.
    pub(crate) fn ticks(&self) -> u64 {
        self.tick
    }

    /// What is to be sent now.
    pub(crate) fn outbox(&mut self) -> &mut Outbox {
        &mut self.outbox
    }

    /// Pump on, oil moving.
    pub(crate) fn pressure_on(&self) -> bool {
        !matches!(self.state, RigState::Off | RigState::Tripped)
    }

    /// One sample period: reads, judges, moves, and leaves the messages in the outbox.
    pub(crate) fn tick(&mut self, reading: &SensorReading) -> Drive {
        self.tick += 1;
        self.guard.observe(reading);
        self.last_reading = Some(*reading);
        self.watch_host();
        if self.pressure_on() {
            let following = self.following();
            if let Some((cause, reaction)) = self.guard.check(reading, &self.limits, &following) {
                // In Unload the loop that should follow already does the mildest thing: nothing is left but S3.
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

    /// A fault: reacts, latches the first cause and says so at once. Milder than what is under way changes nothing.
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

    /// Once a latched cause; what follows from it later shows in the status.
    fn announce(&mut self) {
        let (code, register) = self.cause.emergency();
        self.outbox.push(FromRig::Emergency {
            code,
            register,
            cause: self.cause,
            state: self.state,
            tick: self.tick as u16,
        });
    }

    /// A fault is latched: the unload under way ends in Tripped.
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

    /// Pressure on, at the displacement where the rig stands.
    pub(super) fn arm(&mut self) {
        self.cause = Cause::None;
        self.guard.restart();
        self.servo.engage();
        self.pressure_since = self.tick;
        self.rebase();
        self.enter(RigState::Armed);
    }

    /// The set point becomes the feedback, the queue starts empty and takes either mode.
    pub(super) fn rebase(&mut self) {
        self.queue.clear();
        self.queue_mode = None;
        self.rate_counts_ms = 0.0;
        self.point = SetPoint {
            mode: WireMode::Displacement,
            counts: f64::from(self.guard.displacement_counts()),
            last: true,
        };
    }

    /// Leaves the queue for the firmware's own motion in displacement control, with the speed that the rig has.
    pub(super) fn brake(&mut self, state: RigState) {
        let (set_point, rate) = (self.point, self.rate_counts_ms);
        self.rebase();
        let near = f64::from(self.limits.following_error_displacement_counts);
        if set_point.mode == WireMode::Displacement && (set_point.counts - self.point.counts).abs() <= near {
            self.point.counts = set_point.counts;
            self.rate_counts_ms = rate;
        } else {
            self.rate_counts_ms = self.guard.velocity_counts_s() * 1e-3;
        }
        self.enter(state);
    }

    /// How well the loop followed the set point of the tick before.
    fn following(&self) -> Following {
        let feedback = match self.point.mode {
            WireMode::Displacement => self.guard.displacement_counts(),
            WireMode::Force => self.guard.force_counts(),
        };
        Following {
            mode: self.point.mode,
            error_counts: self.point.counts - f64::from(feedback),
            rate_counts_s: self.rate_counts_ms * 1e3,
            speed_mm_s: self.servo.speed_mm_s(),
            pressure_ticks: self.tick - self.pressure_since,
        }
    }

    /// Moves the set point on and closes the loop.
    fn drive(&mut self) -> Drive {
        match self.state {
            RigState::Off | RigState::Tripped => {}
            RigState::Armed | RigState::Running => self.follow_queue(),
            RigState::Hold => {
                self.move_towards(0.0);
                if self.tick - self.state_since >= self.limits.hold_timeout_ms as u64 {
                    self.trip(Cause::HoldTimeout, Reaction::Unload);
                }
            }
            RigState::Unload => self.unload(),
        }
        if !self.pressure_on() {
            return Drive {
                valve: 0.0,
                open: false,
            };
        }
        let (mode, scale) = match self.point.mode {
            WireMode::Displacement => (Mode::Displacement, DISPLACEMENT_MM_PER_COUNT),
            WireMode::Force => (Mode::Force, FORCE_N_PER_COUNT),
        };
        let target = ServoTarget {
            mode,
            value: self.point.counts * scale,
            rate: self.rate_counts_ms * 1e3 * scale,
            rate_ahead: self.rate_ahead() * 1e3 * scale,
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
                return; // A motion begins with a command that was sent, not with a guess towards one.
            }
            self.rate_counts_ms = if next.mode == self.point.mode {
                next.counts - self.point.counts
            } else {
                0.0
            };
            self.point = next;
            if self.state == RigState::Armed {
                self.enter(RigState::Running);
            }
        } else {
            self.rate_counts_ms = 0.0;
        }
        if self.state == RigState::Running {
            let level = self.queue.level_ms(self.tick);
            let ends = self.queue.newest().map_or(self.point.last, |newest| newest.last);
            if ends && level == 0 {
                self.enter(RigState::Armed);
            } else if !ends && level < self.limits.queue_low_ms as u64 {
                self.trip(Cause::QueueDry, Reaction::Hold);
            }
        }
    }

    /// Rate of the commands `lead_ms` ahead, counts a ms; the present rate where they are not known.
    fn rate_ahead(&self) -> f64 {
        if self.state != RigState::Running {
            return self.rate_counts_ms;
        }
        let lead = u64::from(self.servo.lead_ms());
        let end = self.tick + self.queue.level_ms(self.tick);
        // Beyond the end of a motion the set point stays.
        let known = |ahead: u64| self.queue.at((self.tick + ahead).min(end));
        match (known(lead + 1), known(lead.saturating_sub(1))) {
            (Some(late), Some(early)) => {
                (late.counts - early.counts) / (lead + 1 - lead.saturating_sub(1)) as f64
            }
            _ => self.rate_counts_ms,
        }
    }

    /// The firmware's own motion: the speed goes to `rate` counts a ms at the braking rate.
    fn move_towards(&mut self, rate: f64) {
        let change = (rate - self.rate_counts_ms).clamp(-BRAKE_COUNTS_PER_MS2, BRAKE_COUNTS_PER_MS2);
        self.rate_counts_ms += change;
        let (low, high) = (
            self.limits.displacement_min_counts,
            self.limits.displacement_max_counts,
        );
        self.point.counts =
            (self.point.counts + self.rate_counts_ms).clamp(f64::from(low.min(high)), f64::from(high));
    }

    fn unload(&mut self) {
        let rate = -f64::from(self.limits.unload_velocity_counts_s) * 1e-3;
        self.move_towards(rate);
        let force_gone =
            !self.guard.force_invalid() && self.guard.force_counts() <= self.limits.unloaded_force_counts;
        self.unloaded = if force_gone { self.unloaded + 1 } else { 0 };
        let retracted = self.guard.displacement_counts() <= self.limits.retract_counts;
        let steady = self.rate_counts_ms == rate;
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

    /// Sample each tick, status each 10 ms and at once on a change, heartbeat each 100 ms.
    fn report(&mut self, reading: &SensorReading) {
        if matches!(self.nmt, NmtState::Operational | NmtState::Stopped) {
            self.outbox.push(FromRig::Sample {
                counter: self.sample_counter,
                tick: self.tick as u16,
                force_counts: reading.force_counts,
                displacement_counts: reading.displacement_counts,
            });
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
        self.outbox.push(FromRig::Status {
            counter: self.status_counter,
            state: self.state,
            cause: self.cause,
            queue_ms: self.queue.level_ms(self.tick).min(255) as u8,
            session: self.host.session,
            ack_counter,
            ack_result,
            boot: self.identity.boot_id as u8,
            tick_high: (self.tick >> 16) as u8,
        });
        self.status_counter = next_counter(self.status_counter);
    }

    /// The cause of a trip is still there: a sensor without reading, the emergency stop pressed.
    pub(super) fn cause_stands(&self) -> bool {
        self.guard.sensors_bad() || self.last_reading.is_some_and(|reading| reading.emergency_stop)
    }
}

/// Limits after boot, in the rig's nominal counts: 10 kN, 49 mm, 300 mm/s; the host writes its bench's before arming.
pub(crate) const DEFAULT_LIMITS: Limits = Limits {
    force_max_counts: 100_000,
    force_min_counts: -5_000,
    displacement_max_counts: 98_000,
    displacement_min_counts: -98_000,
    velocity_max_counts_s: 600_000,
    following_error_displacement_counts: 2_000,
    following_error_force_counts: 5_000,
    lease_ms: 50,
    hold_timeout_ms: 30_000,
    unload_velocity_counts_s: 10_000,
    queue_low_ms: 30,
    unloaded_force_counts: 100,
    retract_counts: -10_000,
};
