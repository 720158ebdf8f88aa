//! What the rig is in, why, and what it can be asked for: the words of the state diagram in firmware-protocol.md.
//! Which change is allowed when is the firmware's business (`mockrig`).

/// NMT commands (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum NmtCommand {
    /// Start the process data.
    Start = 0x01,
    /// Stop: the rig unloads (S2). The abort frame, top priority on the bus.
    Stop = 0x02,
    /// Back to pre-operational.
    PreOperational = 0x80,
    /// Reset the node; refused while the pressure is on.
    ResetNode = 0x81,
}

impl NmtCommand {
    /// All commands.
    pub(crate) const ALL: [NmtCommand; 4] = [
        NmtCommand::Start,
        NmtCommand::Stop,
        NmtCommand::PreOperational,
        NmtCommand::ResetNode,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|&one| one as u8 == value)
    }
}

/// NMT state in the heartbeat (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum NmtState {
    /// Just booted.
    BootUp = 0x00,
    /// Stopped.
    Stopped = 0x04,
    /// Process data flow.
    Operational = 0x05,
    /// Only configuration and heartbeat.
    PreOperational = 0x7F,
}

impl NmtState {
    /// All states.
    pub(crate) const ALL: [NmtState; 4] = [
        NmtState::BootUp,
        NmtState::Stopped,
        NmtState::Operational,
        NmtState::PreOperational,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|&one| one as u8 == value)
    }
}

/// State of the rig's firmware (4 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub(crate) enum RigState {
    /// S3: pump off, blocking valve closed. After boot and after an unload without fault. Arming is allowed.
    Off = 0,
    /// Pressure on, servo keeps the displacement that it was armed at; follows the queue once commands are due.
    Armed = 1,
    /// Follows the command queue.
    Running = 2,
    /// S1: keeps the position, pressure on; lapses to Unload after the hold time-out.
    Hold = 3,
    /// S2: ramps to zero load on its own, then Off (asked for) or Tripped (fault).
    Unload = 4,
    /// S3, latched by a fault: needs a Reset request. Reset never resumes motion.
    Tripped = 5,
}

impl RigState {
    /// All states, in the order of their wire values from 0.
    pub(crate) const ALL: [RigState; 6] = [
        RigState::Off,
        RigState::Armed,
        RigState::Running,
        RigState::Hold,
        RigState::Unload,
        RigState::Tripped,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.get(usize::from(value)).copied()
    }
}

/// First cause of a latched state (8 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub(crate) enum Cause {
    /// Nothing latched.
    None = 0,
    /// The host's lease lapsed.
    LeaseLapsed = 1,
    /// NMT stop from the host.
    HostAbort = 2,
    /// Unload request of an operator.
    Requested = 3,
    /// Force beyond its limit.
    ForceLimit = 4,
    /// Displacement beyond its limit.
    DisplacementLimit = 5,
    /// Displacement faster than its limit.
    VelocityLimit = 6,
    /// Following error too large for too long.
    FollowingError = 7,
    /// Command queue ran dry.
    QueueDry = 8,
    /// Too many corrupt or out-of-sequence frames.
    CorruptFrames = 9,
    /// Load cell open or at its rail.
    ForceSensor = 10,
    /// LVDT open or at its rail.
    DisplacementSensor = 11,
    /// A channel is stuck.
    SensorStuck = 12,
    /// Force fell by more than half within 10 ms.
    SpecimenBreak = 13,
    /// Firmware watchdog.
    Watchdog = 14,
    /// Nobody came back from a hold.
    HoldTimeout = 15,
    /// Emergency stop.
    EmergencyStop = 16,
    /// Supply pressure lost.
    SupplyPressure = 17,
    /// Frames of a foreign session.
    ForeignSession = 18,
    /// A command beyond the limits, or of the wrong mode.
    BadCommand = 19,
}

impl Cause {
    /// All causes, in the order of their wire values from 0.
    pub(crate) const ALL: [Cause; 20] = [
        Cause::None,
        Cause::LeaseLapsed,
        Cause::HostAbort,
        Cause::Requested,
        Cause::ForceLimit,
        Cause::DisplacementLimit,
        Cause::VelocityLimit,
        Cause::FollowingError,
        Cause::QueueDry,
        Cause::CorruptFrames,
        Cause::ForceSensor,
        Cause::DisplacementSensor,
        Cause::SensorStuck,
        Cause::SpecimenBreak,
        Cause::Watchdog,
        Cause::HoldTimeout,
        Cause::EmergencyStop,
        Cause::SupplyPressure,
        Cause::ForeignSession,
        Cause::BadCommand,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.get(usize::from(value)).copied()
    }
}

impl Cause {
    /// CiA 301 emergency code and error register (0x1001) that announce it. Register: bit 0 generic, bit 4
    /// communication, bit 7 ours; codes from 0xFF00 on are ours, the others are CiA 301's and 402's.
    pub(crate) fn emergency(self) -> (u16, u8) {
        match self {
            Cause::None => (0x0000, 0x00),
            Cause::LeaseLapsed => (0x8130, 0x11),
            Cause::HostAbort => (0xFF02, 0x81),
            Cause::Requested => (0xFF03, 0x81),
            Cause::ForceLimit => (0xFF10, 0x81),
            Cause::DisplacementLimit => (0xFF11, 0x81),
            Cause::VelocityLimit => (0xFF12, 0x81),
            Cause::FollowingError => (0x8611, 0x81),
            Cause::QueueDry => (0xFF20, 0x11),
            Cause::CorruptFrames => (0x8100, 0x11),
            Cause::ForceSensor => (0xFF30, 0x81),
            Cause::DisplacementSensor => (0xFF31, 0x81),
            Cause::SensorStuck => (0xFF32, 0x81),
            Cause::SpecimenBreak => (0xFF40, 0x81),
            Cause::Watchdog => (0x6010, 0x01),
            Cause::HoldTimeout => (0xFF21, 0x81),
            Cause::EmergencyStop => (0x9000, 0x81),
            Cause::SupplyPressure => (0xFF50, 0x81),
            Cause::ForeignSession => (0xFF22, 0x11),
            Cause::BadCommand => (0xFF23, 0x11),
        }
    }
}

/// What a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum RequestCode {
    /// Take the session named in the frame. Refused while another session's lease is alive.
    OpenSession = 1,
    /// Pressure on. Argument: CRC-32 of the configuration that the host believes in.
    Arm = 2,
    /// Stop following, keep the position (S1).
    Hold = 3,
    /// From Hold back to Armed; the queue starts empty.
    Resume = 4,
    /// Unload (S2), then Off.
    Unload = 5,
    /// Clear the latch; from Tripped to Off. Refused while the cause stands.
    Reset = 6,
    /// Empty the command queue and re-base on the feedback (change of mode). Only in Armed and Hold.
    ClearQueue = 7,
}

impl RequestCode {
    /// All requests, in the order of their wire values from 1.
    pub(crate) const ALL: [RequestCode; 7] = [
        RequestCode::OpenSession,
        RequestCode::Arm,
        RequestCode::Hold,
        RequestCode::Resume,
        RequestCode::Unload,
        RequestCode::Reset,
        RequestCode::ClearQueue,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.get(usize::from(value).checked_sub(1)?).copied()
    }
}

/// Answer to a request, carried in the status (4 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum RequestResult {
    /// No request yet.
    None = 0,
    /// Done.
    Done = 1,
    /// Another session owns the rig.
    Busy = 2,
    /// Not in this state.
    WrongState = 3,
    /// Configuration CRC differs.
    WrongConfiguration = 4,
    /// The cause of the trip still stands.
    CauseStands = 5,
    /// Unknown request.
    Unknown = 6,
}

impl RequestResult {
    /// All results, in the order of their wire values from 0.
    pub(crate) const ALL: [RequestResult; 7] = [
        RequestResult::None,
        RequestResult::Done,
        RequestResult::Busy,
        RequestResult::WrongState,
        RequestResult::WrongConfiguration,
        RequestResult::CauseStands,
        RequestResult::Unknown,
    ];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.get(usize::from(value)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_has_an_emergency_code_of_its_own() {
        let codes: std::collections::BTreeSet<u16> =
            Cause::ALL.iter().map(|cause| cause.emergency().0).collect();
        assert_eq!(codes.len(), Cause::ALL.len());
        for cause in Cause::ALL {
            // CiA 301: code 0 and register 0 mean "no error", and only they do.
            let (code, register) = cause.emergency();
            assert_eq!(code == 0, cause == Cause::None);
            assert_eq!(register & 1 == 0, cause == Cause::None);
        }
    }
}
