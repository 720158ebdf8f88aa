//! The hello, the configuration and the requests: everything between host and firmware except samples, commands and the
//! lease. One access is under way at a time. An access without answer is repeated, then given up.

use crate::detector;
use crate::link::Link;
use crate::protocol::message::{
    COUNTER_MODULO, ConfigAbort, LIMIT_COUNT, Limits, PROTOCOL_VERSION, RequestCode, RequestMessage,
    RequestResult, SAMPLE_RATE_HZ, ToRig, next_counter, object,
};
use crate::recording::FirmwareIdentity;
use crate::units::NS_PER_MS;

/// A configuration access without answer is repeated after this time.
const CONFIG_TIMEOUT_NS: u64 = 50 * NS_PER_MS;
/// Tries of one configuration access before the hello starts over.
const CONFIG_TRIES: u32 = 4;
/// Pause before a session that was lost is opened again, ns.
const REOPEN_PAUSE_NS: u64 = 100 * NS_PER_MS;
/// Pause before the hello starts over, ns.
const HELLO_PAUSE_NS: u64 = 500 * NS_PER_MS;

/// Objects that the hello reads, in order.
const HELLO: [(u16, u8); 8] = [
    object::PROTOCOL,
    object::VENDOR,
    object::PRODUCT,
    object::REVISION,
    object::SERIAL,
    object::BOOT_ID,
    object::SAMPLE_RATE,
    object::CALIBRATION_HASH,
];

/// Why the rig cannot be used, found at the hello. Nothing moves until it is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum HelloError {
    /// The rig has another major version of the protocol.
    #[error(
        "the rig has protocol {}.{}, this program {}.{}: install the matching firmware or program",
        .0 >> 16, .0 & 0xFFFF, PROTOCOL_VERSION >> 16, PROTOCOL_VERSION & 0xFFFF
    )]
    Protocol(u32),
    /// The rig has another sample rate.
    #[error(
        "the rig samples at {0} Hz, this program expects {SAMPLE_RATE_HZ} Hz: install the matching firmware"
    )]
    SampleRate(u32),
    /// The sensors of the rig were calibrated with other figures than the bench config has.
    #[error(
        "the rig's calibration hash is {rig:#010x}, the bench file's {bench:#010x}: use the bench file of these sensors, or store the new hash in the rig"
    )]
    Calibration {
        /// Hash that the rig holds.
        rig: u32,
        /// Hash of the bench config.
        bench: u32,
    },
    /// The rig refused an access.
    #[error(
        "the rig refused object {index:#06x}:{sub} ({abort}): check the limit in the bench file, and that the firmware follows this version of firmware-protocol.md"
    )]
    Refused {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
        /// The rig's abort code.
        abort: ConfigAbort,
    },
    /// The CRC-32 of the limits in the rig differs from that of the limits that were sent.
    #[error(
        "the limits in the rig differ from the limits that were sent (CRC {rig:#010x}, expected {bench:#010x}): power-cycle the rig and start again"
    )]
    Limits {
        /// CRC-32 from the rig.
        rig: u32,
        /// CRC-32 of the bench config's limits.
        bench: u32,
    },
    /// Another program owns the rig.
    #[error("another program owns the session of this rig: stop that daemon first")]
    Busy,
}

/// Step of the hello. Numbers are indices into [`HELLO`] and into the limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SessionStage {
    Reading(usize),
    Writing(usize),
    Verifying,
    Opening,
    Open,
}

/// A request that waits for its acknowledgement.
#[derive(Debug, Clone, Copy)]
struct Pending {
    message: RequestMessage,
    sent_ns: u64,
    tries: u32,
}

/// The session with one rig.
#[derive(Debug)]
pub(crate) struct Session {
    node: u8,
    id: u8,
    limits: Limits,
    calibration_hash: u32,
    ack_timeout_ns: u64,
    stage: SessionStage,
    /// The rig belongs to this session, also while its limits are written again after a tare.
    owned: bool,
    identity: FirmwareIdentity,
    sent_ns: Option<u64>,
    tries: u32,
    resume_at_ns: u64,
    error: Option<HelloError>,
    request_counter: u8,
    pending: Option<Pending>,
}

impl Session {
    /// A session before its hello. `id` is the session number on the wire, 1 to 255.
    pub(crate) fn new(node: u8, id: u8, limits: Limits, calibration_hash: u32, ack_timeout_ms: u64) -> Self {
        Session {
            node,
            id: id.max(1),
            limits,
            calibration_hash,
            ack_timeout_ns: ack_timeout_ms * NS_PER_MS,
            stage: SessionStage::Reading(0),
            owned: false,
            identity: FirmwareIdentity::default(),
            sent_ns: None,
            tries: 0,
            resume_at_ns: 0,
            error: None,
            request_counter: id % COUNTER_MODULO,
            pending: None,
        }
    }

    /// Session number on the wire.
    pub(crate) fn id(&self) -> u8 {
        self.id
    }

    /// True once the hello is complete, the rig belongs to this session and holds its limits.
    pub(crate) fn is_open(&self) -> bool {
        self.stage == SessionStage::Open
    }

    /// True while the rig belongs to this session, also while its limits are written again.
    pub(crate) fn is_owned(&self) -> bool {
        self.owned
    }

    /// Why the hello fails.
    pub(crate) fn error(&self) -> Option<HelloError> {
        self.error
    }

    /// Identity of the firmware, as far as it is read.
    pub(crate) fn identity(&self) -> FirmwareIdentity {
        self.identity.clone()
    }

    /// CRC-32 of the limits, the argument of the Arm request.
    pub(crate) fn configuration_crc(&self) -> u32 {
        self.limits.crc32()
    }

    /// Other limits than at the hello, because a tare moved them: they are written and verified before the next request.
    pub(crate) fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
        // A hello that has not come to the limits yet writes the new ones anyway.
        if !matches!(self.stage, SessionStage::Reading(_)) {
            self.advance(SessionStage::Writing(0));
        }
    }

    /// Drops the request that waits for its answer, so that it is not repeated.
    pub(crate) fn forget_request(&mut self) {
        self.pending = None;
    }

    /// Starts over: link lost, or the firmware rebooted.
    pub(crate) fn restart(&mut self, now_ns: u64) {
        self.stage = SessionStage::Reading(0);
        self.owned = false;
        self.sent_ns = None;
        self.tries = 0;
        self.pending = None;
        self.resume_at_ns = now_ns;
    }

    /// True while an answer to a request is awaited.
    pub(crate) fn awaits_answer(&self) -> bool {
        self.pending.is_some()
    }

    /// Sends a request. A second request replaces one that is not answered yet.
    pub(crate) fn request(&mut self, code: RequestCode, argument: u32, now_ns: u64, link: &mut Link) {
        self.request_counter = next_counter(self.request_counter);
        let message = RequestMessage {
            counter: self.request_counter,
            session: self.id,
            code,
            argument,
        };
        link.send(ToRig::Request(message).encode(self.node));
        self.pending = Some(Pending {
            message,
            sent_ns: now_ns,
            tries: 1,
        });
    }

    /// Takes the session that owns the rig. If the lease lapsed, the session is opened again and nothing else is repeated.
    pub(crate) fn on_owner(&mut self, owner: u8, now_ns: u64) {
        if self.owned && owner != self.id {
            self.owned = false;
            self.pending = None;
            if self.stage == SessionStage::Open {
                self.stage = SessionStage::Opening;
            }
            self.resume_at_ns = now_ns + REOPEN_PAUSE_NS;
        }
    }

    /// Takes the acknowledgement of a status. Returns the request and the result if the rig refused it.
    pub(crate) fn on_acknowledgement(
        &mut self,
        ack_counter: u8,
        result: RequestResult,
        now_ns: u64,
    ) -> Option<(RequestCode, RequestResult)> {
        let RequestMessage { counter, code, .. } = self.pending?.message;
        if counter != ack_counter || result == RequestResult::None {
            return None;
        }
        self.pending = None;
        if code == RequestCode::OpenSession && self.stage == SessionStage::Opening {
            if result == RequestResult::Done {
                self.stage = SessionStage::Open;
                self.owned = true;
                self.error = None;
            } else {
                self.fail(HelloError::Busy, now_ns);
            }
        }
        (result != RequestResult::Done).then_some((code, result))
    }

    /// Sends what is due. Returns a request that was sent twice without an answer.
    /// `started`: the node takes requests, not only the configuration.
    pub(crate) fn poll(&mut self, started: bool, now_ns: u64, link: &mut Link) -> Option<RequestCode> {
        self.poll_hello(started, now_ns, link);
        let pending = self.pending?;
        if now_ns.saturating_sub(pending.sent_ns) < self.ack_timeout_ns {
            return None;
        }
        if pending.tries >= 2 {
            self.pending = None;
            if pending.message.code == RequestCode::OpenSession {
                self.restart(now_ns + HELLO_PAUSE_NS);
            }
            return Some(pending.message.code);
        }
        link.send(ToRig::Request(pending.message).encode(self.node));
        self.pending = Some(Pending {
            sent_ns: now_ns,
            tries: pending.tries + 1,
            ..pending
        });
        None
    }

    fn poll_hello(&mut self, started: bool, now_ns: u64, link: &mut Link) {
        if self.stage == SessionStage::Open || now_ns < self.resume_at_ns {
            return;
        }
        if self.stage == SessionStage::Opening {
            if self.pending.is_none() && started {
                self.request(RequestCode::OpenSession, 0, now_ns, link);
            }
            return;
        }
        if self
            .sent_ns
            .is_some_and(|at| now_ns.saturating_sub(at) < CONFIG_TIMEOUT_NS)
        {
            return;
        }
        if self.tries >= CONFIG_TRIES {
            self.restart(now_ns + HELLO_PAUSE_NS);
            return;
        }
        link.send(self.next_access().encode(self.node));
        self.sent_ns = Some(now_ns);
        self.tries += 1;
    }

    /// The configuration access of this step of the hello.
    fn next_access(&self) -> ToRig {
        match self.stage {
            SessionStage::Reading(i) => ToRig::ConfigRead {
                index: HELLO[i].0,
                sub: HELLO[i].1,
            },
            SessionStage::Writing(i) => ToRig::ConfigWrite {
                index: object::LIMITS,
                sub: i as u8 + 1,
                value: self.limits.to_array()[i] as u32,
            },
            _ => ToRig::ConfigRead {
                index: object::CONFIGURATION_CRC.0,
                sub: object::CONFIGURATION_CRC.1,
            },
        }
    }

    fn advance(&mut self, stage: SessionStage) {
        self.stage = stage;
        self.sent_ns = None;
        self.tries = 0;
    }

    fn fail(&mut self, error: HelloError, now_ns: u64) {
        self.error = Some(error);
        self.restart(now_ns + HELLO_PAUSE_NS);
    }

    /// Takes the value of an object that was read.
    pub(crate) fn on_value(&mut self, index: u16, sub: u8, value: u32, now_ns: u64) {
        match self.stage {
            SessionStage::Reading(i) if HELLO[i] == (index, sub) => {
                if let Err(error) = self.identify((index, sub), value)
                    && detector::acts("L14")
                {
                    return self.fail(error, now_ns);
                }
                self.advance(if i + 1 < HELLO.len() {
                    SessionStage::Reading(i + 1)
                } else {
                    SessionStage::Writing(0)
                });
            }
            SessionStage::Verifying if (index, sub) == object::CONFIGURATION_CRC => {
                let bench = self.limits.crc32();
                if value == bench {
                    self.advance(match self.owned {
                        true => SessionStage::Open,
                        false => SessionStage::Opening,
                    });
                } else {
                    self.fail(HelloError::Limits { rig: value, bench }, now_ns);
                }
            }
            _ => {}
        }
    }

    /// Keeps the value of an object of the hello, or refuses it.
    fn identify(&mut self, object: (u16, u8), value: u32) -> Result<(), HelloError> {
        match object {
            object::PROTOCOL => {
                self.identity.protocol = value;
                if value >> 16 != PROTOCOL_VERSION >> 16 {
                    return Err(HelloError::Protocol(value));
                }
            }
            object::VENDOR => self.identity.vendor = value,
            object::PRODUCT => self.identity.product = value,
            object::REVISION => self.identity.revision = value,
            object::SERIAL => self.identity.serial = value,
            object::BOOT_ID => self.identity.boot_id = value,
            object::SAMPLE_RATE if value != SAMPLE_RATE_HZ => {
                return Err(HelloError::SampleRate(value));
            }
            object::CALIBRATION_HASH => {
                self.identity.calibration_hash = value;
                if value != self.calibration_hash {
                    return Err(HelloError::Calibration {
                        rig: value,
                        bench: self.calibration_hash,
                    });
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes the confirmation of a write.
    pub(crate) fn on_written(&mut self, index: u16, sub: u8) {
        if let SessionStage::Writing(i) = self.stage
            && index == object::LIMITS
            && usize::from(sub) == i + 1
        {
            self.advance(if i + 1 < LIMIT_COUNT {
                SessionStage::Writing(i + 1)
            } else {
                SessionStage::Verifying
            });
        }
    }

    /// Takes a refusal. A rig with pressure on accepts no limits: the hello then starts over later, without an error.
    pub(crate) fn on_refused(&mut self, index: u16, sub: u8, abort: ConfigAbort, now_ns: u64) {
        if abort == ConfigAbort::State {
            self.restart(now_ns + HELLO_PAUSE_NS);
        } else if !self.is_open() {
            self.fail(HelloError::Refused { index, sub, abort }, now_ns);
        }
    }
}
