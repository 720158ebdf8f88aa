//! Firmwares that do one thing otherwise than the document says: the mock rig behind a change of its frames.

use crate::link::{Link, loopback};
use crate::mockrig::MockRig;
use crate::protocol::frame::Frame;
use crate::protocol::message::*;
use crate::protocol::protection::{CounterCheck, Sequence};

pub const NODE: u8 = 1;

/// The one thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deviation {
    LimitsTakeAnyValue,
    StatusEvery50Ms,
    RepeatsAreNotAnswered,
    LateCommandsAreExecuted,
    ForeignCommandsAreTaken,
    SessionsKeepTheCounters,
    WrongCrc32,
    LeaseNeverLapses,
    AbortIsConfirmedLate,
    CauseIsForgotten,
    TicksAreSkipped,
    RefusedFramesAreNotCounted,
}

/// The deviation, and the row that must find it, alone.
pub const DEVIATIONS: [(Deviation, &str); 12] = [
    (Deviation::LimitsTakeAnyValue, "limit-ranges"),
    (Deviation::StatusEvery50Ms, "status-period"),
    (Deviation::RepeatsAreNotAnswered, "request-repeated"),
    (Deviation::LateCommandsAreExecuted, "command-late"),
    (Deviation::ForeignCommandsAreTaken, "foreign-frames"),
    (Deviation::SessionsKeepTheCounters, "session-restarts-counters"),
    (Deviation::WrongCrc32, "crc-32"),
    (Deviation::LeaseNeverLapses, "lease-lapse"),
    (Deviation::AbortIsConfirmedLate, "abort"),
    (Deviation::CauseIsForgotten, "cause-latched"),
    (Deviation::TicksAreSkipped, "sample-ticks"),
    (Deviation::RefusedFramesAreNotCounted, "corrupt-ignored"),
];

/// A rig with a deviation, between the link of the host and the link of the mock rig.
pub struct DeviantRig {
    deviation: Deviation,
    rig: MockRig,
    rig_end: Link,
    inner: Link,
    outer: Link,
    tick: u16,
    status: Option<StatusMessage>,
    sent_counters: [u8; 4],
    leases: CounterCheck,
    last_request: Option<RequestMessage>,
    lease_age: u32,
    state_age: u32,
    stop_age: u32,
    /// A frame of the host is not answered by a STATUS yet.
    owes_status: bool,
}

/// Indices of `sent_counters`.
const COMMANDS: usize = 0;
const LEASES: usize = 1;
const SAMPLES: usize = 2;
const STATUSES: usize = 3;

impl DeviantRig {
    /// The rig and the host's end of its link.
    pub fn new(deviation: Deviation, rig: MockRig) -> (Self, Link) {
        let (inner, rig_end) = loopback::pair();
        let (host, outer) = loopback::pair();
        let deviant = DeviantRig {
            deviation,
            rig,
            rig_end,
            inner,
            outer,
            tick: 0,
            status: None,
            sent_counters: [0; 4],
            leases: CounterCheck::default(),
            last_request: None,
            lease_age: 0,
            state_age: 0,
            stop_age: u32::MAX,
            owes_status: false,
        };
        (deviant, host)
    }

    /// One tick of the rig.
    pub fn step(&mut self) {
        self.lease_age += 1;
        self.state_age += 1;
        self.stop_age = self.stop_age.saturating_add(1);
        while let Some(frame) = self.outer.receive() {
            if let Some(frame) = self.frame_to_rig(frame) {
                self.inner.send(frame);
            }
        }
        self.keep_the_lease();
        self.rig.tick(&mut self.rig_end);
        while let Some(frame) = self.inner.receive() {
            if let Some(frame) = self.frame_to_host(frame) {
                self.outer.send(frame);
            }
        }
    }

    fn count(&mut self, stream: usize) -> u8 {
        self.sent_counters[stream] = next_counter(self.sent_counters[stream]);
        self.sent_counters[stream]
    }

    fn owner(&self) -> u8 {
        self.status.map_or(0, |status| status.session)
    }

    /// What the rig gets instead of a frame of the host.
    fn frame_to_rig(&mut self, frame: Frame) -> Option<Frame> {
        let Ok(mut message) = ToRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        let deviation = self.deviation;
        self.owes_status |= matches!(message, ToRig::Nmt { .. } | ToRig::Request(_));
        match &mut message {
            ToRig::Request(request) => {
                let repeated = self.last_request.replace(*request) == Some(*request);
                if repeated && deviation == Deviation::RepeatsAreNotAnswered {
                    return None;
                }
            }
            ToRig::Command(command) if deviation == Deviation::LateCommandsAreExecuted => {
                let late = command.tick.wrapping_sub(self.tick) as i16 <= 1;
                command.tick = if late {
                    self.tick.wrapping_add(5)
                } else {
                    command.tick
                };
            }
            ToRig::Command(command) if deviation == Deviation::ForeignCommandsAreTaken => {
                (command.session, command.counter) = (self.owner().max(1), self.count(COMMANDS));
            }
            ToRig::Lease(lease)
                if deviation == Deviation::SessionsKeepTheCounters
                    && self.leases.check(lease.counter) != Sequence::Usable =>
            {
                return None;
            }
            ToRig::Lease(lease) if deviation == Deviation::LeaseNeverLapses => {
                self.lease_age = 0;
                lease.counter = self.count(LEASES);
            }
            ToRig::Nmt { command, .. } if *command == NmtCommand::Stop && self.stop_age > 1_000 => {
                self.stop_age = 0
            }
            _ => {}
        }
        Some(message.encode(NODE))
    }

    /// A lease of its own while the pressure is on and the host sends none.
    fn keep_the_lease(&mut self) {
        let on = self
            .status
            .is_some_and(|s| !matches!(s.state, RigState::Off | RigState::Tripped));
        if self.deviation == Deviation::LeaseNeverLapses && on && self.lease_age > 20 {
            self.lease_age = 10;
            let lease = LeaseMessage {
                counter: self.count(LEASES),
                session: self.owner(),
                control_tick: self.tick,
            };
            self.inner.send(ToRig::Lease(lease).encode(NODE));
        }
    }

    /// What the host gets instead of a frame of the rig.
    fn frame_to_host(&mut self, frame: Frame) -> Option<Frame> {
        let message = FromRig::decode(&frame, NODE).expect("the mock rig sends valid frames");
        let message = match message {
            FromRig::Sample(sample) => {
                self.tick = sample.tick;
                let skipped = self.deviation == Deviation::TicksAreSkipped && sample.tick % 400 == 5;
                let counter = (!skipped).then(|| self.count(SAMPLES))?;
                FromRig::Sample(SampleMessage { counter, ..sample })
            }
            FromRig::Status(status) => FromRig::Status(self.status(status)?),
            FromRig::ConfigRefused {
                index,
                sub,
                abort: ConfigAbort::Range,
            } if self.deviation == Deviation::LimitsTakeAnyValue => FromRig::ConfigWritten { index, sub },
            FromRig::ConfigValue { index, sub, value } => FromRig::ConfigValue {
                index,
                sub,
                value: self.value((index, sub), value),
            },
            other => other,
        };
        Some(message.encode(NODE))
    }

    fn value(&self, object: (u16, u8), value: u32) -> u32 {
        match self.deviation {
            Deviation::WrongCrc32 if object == object::CONFIGURATION_CRC => value.swap_bytes(),
            Deviation::RefusedFramesAreNotCounted if object == object::FRAMES_REFUSED => 0,
            _ => value,
        }
    }

    fn status(&mut self, status: StatusMessage) -> Option<StatusMessage> {
        let before = self.status.replace(status);
        let key = |s: StatusMessage| (s.state, s.cause, s.session, s.ack_counter);
        let changed = before.map(key) != Some(key(status));
        if before.is_none_or(|before| before.state != status.state) {
            self.state_age = 0;
        }
        let rare = self.deviation == Deviation::StatusEvery50Ms;
        let owed = std::mem::take(&mut self.owes_status);
        if rare && !changed && !owed && self.tick.is_multiple_of(10) && !self.tick.is_multiple_of(50) {
            return None;
        }
        let mut shown = StatusMessage {
            counter: self.count(STATUSES),
            ..status
        };
        match self.deviation {
            Deviation::AbortIsConfirmedLate if self.stop_age < 40 && status.state == RigState::Unload => {
                (shown.state, shown.cause) = (RigState::Armed, Cause::None);
            }
            Deviation::CauseIsForgotten if status.state == RigState::Tripped && self.state_age > 500 => {
                shown.cause = Cause::None;
            }
            _ => {}
        }
        Some(shown)
    }
}
