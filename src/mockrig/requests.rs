//! The firmware's handling of messages from the host: session and lease, commands, requests with their acknowledgement,
//! network management, configuration objects.

use super::firmware::Firmware;
use super::guard::Reaction;
use super::queue::SetPoint;
use crate::detector;
use crate::protocol::message::{
    Cause, CommandMessage, ConfigAbort, FromRig, LIMIT_COUNT, LIMITS, LeaseMessage, Limits, NmtCommand,
    NmtState, PROTOCOL_VERSION, RequestCode, RequestMessage, RequestResult, RigState, SAMPLE_RATE_HZ, ToRig,
    WireMode, object,
};
use crate::protocol::protection::Sequence;
use crate::protocol::tick::ticks_in_ms;

impl Firmware {
    /// Handles a decoded message.
    pub(crate) fn handle(&mut self, message: ToRig) {
        let process_data = self.has_process_data();
        match message {
            ToRig::Nmt { command, node } if node == 0 || node == self.identity.node => self.network(command),
            ToRig::ConfigRead { index, sub } => {
                let answer = match self.read(index, sub) {
                    Ok(value) => FromRig::ConfigValue { index, sub, value },
                    Err(abort) => FromRig::ConfigRefused { index, sub, abort },
                };
                self.outbox.push(answer);
            }
            ToRig::ConfigWrite { index, sub, value } => {
                let answer = match self.write(index, sub, value) {
                    Ok(()) => FromRig::ConfigWritten { index, sub },
                    Err(abort) => FromRig::ConfigRefused { index, sub, abort },
                };
                self.outbox.push(answer);
            }
            ToRig::Request(request) if process_data => self.request(request),
            ToRig::Lease(lease) if process_data && self.owns(lease.session) => self.lease(lease),
            ToRig::Command(command) if process_data && self.owns(command.session) => self.command(command),
            ToRig::Nmt { .. } | ToRig::Request(_) | ToRig::Lease(_) | ToRig::Command(_) => {}
        }
    }

    /// Answers a request whose code the firmware does not know.
    pub(crate) fn refuse_request(&mut self, counter: u8) {
        if self.has_process_data() {
            self.host.last_request = None;
            self.host.ack = Some((counter, RequestResult::Unknown));
            self.status_due = true;
        }
    }

    /// Answers a malformed configuration request.
    pub(crate) fn refuse_access(&mut self, index: u16, sub: u8) {
        let abort = ConfigAbort::Command;
        self.outbox.push(FromRig::ConfigRefused { index, sub, abort });
    }

    /// True if samples and status are sent, and requests, leases and commands taken.
    pub(super) fn has_process_data(&self) -> bool {
        matches!(self.nmt, NmtState::Operational | NmtState::Stopped)
    }

    /// Counts a corrupt frame (CRC or field) or one out of sequence.
    pub(crate) fn note_corrupt(&mut self) {
        self.host.dropped.refused = self.host.dropped.refused.wrapping_add(1);
        if self.host.corrupt.hit(self.tick) && detector::acts("L6 firmware") {
            self.trip(Cause::CorruptFrames, Reaction::Unload);
        }
    }

    /// Checks the lease in each tick.
    pub(super) fn watch_host(&mut self) {
        if self.host.session != 0 && !self.lease_alive() && detector::acts("D1") {
            self.trip(Cause::LeaseLapsed, Reaction::Unload);
            self.host.session = 0;
            self.status_due = true;
        }
    }

    fn lease_alive(&self) -> bool {
        self.tick - self.host.renewed_at < ticks_in_ms(self.limits.lease_ms as u64)
    }

    /// True if `session` owns the rig. Frames of other sessions are counted, and too many trip.
    fn owns(&mut self, session: u8) -> bool {
        let own = session != 0 && session == self.host.session;
        if !own && self.host.session != 0 {
            self.host.dropped.foreign = self.host.dropped.foreign.wrapping_add(1);
            if self.host.foreign.hit(self.tick) && detector::acts("L10 firmware") {
                self.trip(Cause::ForeignSession, Reaction::Unload);
            }
        }
        own
    }

    /// True if the frame is usable. A wrong sequence counts as a corrupt frame.
    fn in_order(&mut self, sequence: Sequence) -> bool {
        if sequence == Sequence::Wrong {
            self.note_corrupt();
        }
        sequence == Sequence::Usable
    }

    /// Renews the lease if the host's control loop has processed a newer sample since the last lease.
    fn lease(&mut self, lease: LeaseMessage) {
        let sequence = self.host.leases.check(lease.counter);
        let is_newer = self
            .host
            .control_tick
            .is_none_or(|last| lease.control_tick.wrapping_sub(last) as i16 > 0);
        if self.in_order(sequence) && (is_newer || !detector::acts("D4")) {
            self.host.control_tick = Some(lease.control_tick);
            self.host.renewed_at = self.tick;
        }
    }

    fn command(&mut self, command: CommandMessage) {
        let sequence = self.host.commands.check(command.counter);
        if !self.in_order(sequence) {
            return;
        }
        if !matches!(self.state, RigState::Armed | RigState::Running) {
            return self.drop_command();
        }
        let point = SetPoint {
            mode: command.mode,
            counts: f64::from(command.counts),
            last: command.last,
        };
        let (low, high) = match point.mode {
            WireMode::Displacement => (
                self.limits.displacement_min_counts,
                self.limits.displacement_max_counts,
            ),
            WireMode::Force => (self.limits.force_min_counts, self.limits.force_max_counts),
        };
        let within = point.counts >= f64::from(low) && point.counts <= f64::from(high);
        if !within || self.queue_mode.is_some_and(|mode| mode != point.mode) {
            self.trip(Cause::BadCommand, Reaction::Hold);
            return;
        }
        // A command that is too late or too far ahead is dropped; its slot is then missing in the queue.
        if self.queue.push(command.tick, self.tick, point) {
            self.queue_mode = Some(point.mode);
        } else {
            self.drop_command();
        }
    }

    fn drop_command(&mut self) {
        self.host.dropped.commands = self.host.dropped.commands.wrapping_add(1);
    }

    fn request(&mut self, request: RequestMessage) {
        self.status_due = true;
        // A repeat is answered again and not carried out again.
        if self.host.last_request != Some(request) {
            self.host.last_request = Some(request);
            let result = self.carry_out(request);
            self.host.ack = Some((request.counter, result));
        }
    }

    fn carry_out(&mut self, request: RequestMessage) -> RequestResult {
        let RequestMessage {
            session,
            code,
            argument,
            ..
        } = request;
        if code == RequestCode::OpenSession {
            return self.open_session(session);
        }
        if session == 0 || session != self.host.session {
            return RequestResult::Busy;
        }
        match (code, self.state) {
            // Whoever stopped the rig must start it before it can move again.
            (RequestCode::Arm, _) if self.nmt == NmtState::Stopped => return RequestResult::WrongState,
            (RequestCode::Arm, RigState::Off) => {
                if argument != self.limits.crc32() || !self.limits.is_consistent() {
                    return RequestResult::WrongConfiguration;
                }
                if self.cause_stands() {
                    return RequestResult::CauseStands;
                }
                self.arm();
            }
            (RequestCode::Hold, RigState::Armed | RigState::Running) => self.brake(RigState::Hold),
            (RequestCode::Hold, RigState::Hold) => {}
            (RequestCode::Resume, RigState::Hold) => {
                self.cause = Cause::None;
                self.rebase();
                self.enter(RigState::Armed);
            }
            (RequestCode::Unload, RigState::Armed | RigState::Running | RigState::Hold) => {
                if self.cause == Cause::None {
                    self.cause = Cause::Requested;
                }
                self.brake(RigState::Unload);
            }
            (RequestCode::Unload, RigState::Unload | RigState::Off) => {}
            (RequestCode::Reset, RigState::Tripped) => {
                if self.cause_stands() {
                    return RequestResult::CauseStands;
                }
                self.cause = Cause::None;
                self.enter(RigState::Off);
            }
            (RequestCode::ClearQueue, RigState::Armed | RigState::Hold) => self.rebase(),
            _ => return RequestResult::WrongState,
        }
        RequestResult::Done
    }

    fn open_session(&mut self, session: u8) -> RequestResult {
        if session == 0 {
            return RequestResult::Unknown;
        }
        if self.host.session != 0 && self.host.session != session && self.lease_alive() {
            return RequestResult::Busy;
        }
        self.host.session = session;
        self.host.renewed_at = self.tick;
        self.host.control_tick = None;
        self.host.leases.reset();
        self.host.commands.reset();
        RequestResult::Done
    }

    fn network(&mut self, command: NmtCommand) {
        self.status_due = true;
        match command {
            NmtCommand::Start => self.nmt = NmtState::Operational,
            // Samples and status go on in Stopped, so that the host records the unload.
            NmtCommand::Stop => {
                self.nmt = NmtState::Stopped;
                self.trip(Cause::HostAbort, Reaction::Unload);
            }
            NmtCommand::PreOperational if !self.pressure_on() => self.nmt = NmtState::PreOperational,
            NmtCommand::ResetNode if !self.pressure_on() => self.reboot(),
            NmtCommand::PreOperational | NmtCommand::ResetNode => {}
        }
    }

    fn read(&self, index: u16, sub: u8) -> Result<u32, ConfigAbort> {
        match (index, sub) {
            object::DEVICE_TYPE => Ok(0),
            object::VENDOR => Ok(0),
            object::PRODUCT => Ok(PRODUCT_MOCK),
            object::REVISION => Ok(0x0001_0000),
            object::SERIAL => Ok(self.identity.serial),
            object::PROTOCOL => Ok(PROTOCOL_VERSION),
            object::BOOT_ID => Ok(self.identity.boot_id),
            object::SAMPLE_RATE => Ok(SAMPLE_RATE_HZ),
            object::CALIBRATION_HASH => Ok(self.identity.calibration_hash),
            object::CONFIGURATION_CRC => Ok(self.limits.crc32()),
            object::FRAMES_REFUSED => Ok(self.host.dropped.refused),
            object::COMMANDS_DROPPED => Ok(self.host.dropped.commands),
            object::FRAMES_FOREIGN => Ok(self.host.dropped.foreign),
            (object::LIMITS, 0) => Ok(LIMIT_COUNT as u32),
            (object::LIMITS, n) => {
                let at = usize::from(n - 1);
                self.limits
                    .to_array()
                    .get(at)
                    .map(|&value| value as u32)
                    .ok_or(ConfigAbort::NoSubIndex)
            }
            _ if is_index(index) => Err(ConfigAbort::NoSubIndex),
            _ => Err(ConfigAbort::NoObject),
        }
    }

    fn write(&mut self, index: u16, sub: u8, value: u32) -> Result<(), ConfigAbort> {
        self.read(index, sub)?;
        match (index, sub) {
            object::CALIBRATION_HASH if self.state == RigState::Off => self.identity.calibration_hash = value,
            (object::LIMITS, n) if n > 0 && !self.pressure_on() => {
                let mut limits = self.limits.to_array();
                let at = usize::from(n - 1);
                let entry = LIMITS.get(at).ok_or(ConfigAbort::NoSubIndex)?;
                let value = value as i32;
                if !(entry.lowest..=entry.highest).contains(&value) {
                    return Err(ConfigAbort::Range);
                }
                if let Some(slot) = limits.get_mut(at) {
                    *slot = value;
                }
                self.limits = Limits::from_array(limits);
            }
            object::CALIBRATION_HASH => return Err(ConfigAbort::State),
            (object::LIMITS, n) if n > 0 => return Err(ConfigAbort::State),
            _ => return Err(ConfigAbort::ReadOnly),
        }
        Ok(())
    }
}

/// Product code of the mock rig: "MOCK".
const PRODUCT_MOCK: u32 = 0x4D4F_434B;

fn is_index(index: u16) -> bool {
    [
        object::DEVICE_TYPE.0,
        object::VENDOR.0,
        object::PROTOCOL.0,
        object::BOOT_ID.0,
        object::SAMPLE_RATE.0,
        object::CALIBRATION_HASH.0,
        object::CONFIGURATION_CRC.0,
        object::FRAMES_REFUSED.0,
    ]
    .contains(&index)
}
