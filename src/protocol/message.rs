//! The messages, both directions, in counts and ticks. Layouts: firmware-protocol.md.

/// Node number of a rig on the bus, 1 to 126.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct NodeId(pub u8);

/// Full scale of an 18-bit channel: counts run from -`COUNTS_MAX` to `COUNTS_MAX`.
pub const COUNTS_MAX: i32 = 131_071;
/// The reserved 18-bit pattern for "no valid reading" (sensor open or at its rail).
pub const COUNTS_INVALID: i32 = -131_072;
/// Nominal newtons a count of the load cell.
pub const FORCE_N_PER_COUNT: f64 = 0.1;
/// Nominal millimetres a count of the LVDT.
pub const DISPLACEMENT_MM_PER_COUNT: f64 = 0.0005;
/// Samples, and command slots, a second.
pub const SAMPLE_RATE_HZ: u32 = 1000;
/// Version that this program speaks, major << 16 | minor. Another major is refused before arming.
pub const PROTOCOL_VERSION: u32 = 0x0001_0000;

/// NMT commands (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtCommand {
    /// Start the process data.
    Start = 0x01,
    /// Stop: the rig unloads (S2). The abort frame, top priority on the bus.
    Stop = 0x02,
    /// Back to pre-operational.
    PreOperational = 0x80,
    /// Reset the node; refused while the pressure is on.
    ResetNode = 0x81,
}

/// NMT state in the heartbeat (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// Just booted.
    BootUp = 0x00,
    /// Stopped.
    Stopped = 0x04,
    /// Process data flow.
    Operational = 0x05,
    /// Only configuration and heartbeat.
    PreOperational = 0x7F,
}

/// State of the rig's firmware (4 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum RigState {
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

/// First cause of a latched state (8 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Cause {
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

/// What a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum RequestCode {
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

/// Answer to a request, carried in the status (4 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum RequestResult {
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

/// Why a configuration access was refused (CiA 301 abort codes).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ConfigAbort {
    /// No such object.
    NoObject = 0x0602_0000,
    /// No such sub-index.
    NoSubIndex = 0x0609_0011,
    /// Read only.
    ReadOnly = 0x0601_0002,
    /// Value out of range.
    Range = 0x0609_0030,
    /// Not in this state (pressure is on).
    State = 0x0800_0022,
    /// Malformed request.
    Command = 0x0504_0001,
}

/// Objects of the configuration that both sides know (index, sub-index).
pub mod object {
    /// Device type (ro).
    pub const DEVICE_TYPE: (u16, u8) = (0x1000, 0);
    /// Vendor id (ro).
    pub const VENDOR: (u16, u8) = (0x1018, 1);
    /// Product code (ro).
    pub const PRODUCT: (u16, u8) = (0x1018, 2);
    /// Firmware revision (ro).
    pub const REVISION: (u16, u8) = (0x1018, 3);
    /// Serial number (ro).
    pub const SERIAL: (u16, u8) = (0x1018, 4);
    /// Protocol version (ro).
    pub const PROTOCOL: (u16, u8) = (0x2000, 0);
    /// Boot id, another one after each boot (ro).
    pub const BOOT_ID: (u16, u8) = (0x2001, 0);
    /// Sample rate in Hz (ro).
    pub const SAMPLE_RATE: (u16, u8) = (0x2002, 0);
    /// Hash of the sensors' calibration: first four bytes of its SHA-256, big endian (rw in Off).
    pub const CALIBRATION_HASH: (u16, u8) = (0x2003, 0);
    /// CRC-32 (ISO-HDLC) over the limits 0x2100:1.. as little-endian i32 in order (ro).
    pub const CONFIGURATION_CRC: (u16, u8) = (0x2004, 0);
    /// Index of the limits; sub-index n is `LIMITS[n - 1]` (rw in Off and Tripped).
    pub const LIMITS: u16 = 0x2100;
}

/// The limits that the firmware holds, in the order of their sub-indices at 0x2100. All are i32 on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// 1: upper force, counts.
    pub force_max_counts: i32,
    /// 2: lower force, counts.
    pub force_min_counts: i32,
    /// 3: upper displacement, counts.
    pub displacement_max_counts: i32,
    /// 4: lower displacement, counts.
    pub displacement_min_counts: i32,
    /// 5: speed, counts a second.
    pub velocity_max_counts_s: i32,
    /// 6: following error in displacement control, counts (persistence 20 ms).
    pub following_error_displacement_counts: i32,
    /// 7: following error in force control, counts (persistence 20 ms).
    pub following_error_force_counts: i32,
    /// 8: lease, ms.
    pub lease_ms: i32,
    /// 9: time after which Hold becomes Unload, ms.
    pub hold_timeout_ms: i32,
    /// 10: speed of the unload ramp, counts a second.
    pub unload_velocity_counts_s: i32,
    /// 11: queue level below which the rig slows to Hold, ms.
    pub queue_low_ms: i32,
    /// 12: force at or below which the specimen counts as unloaded, counts.
    pub unloaded_force_counts: i32,
    /// 13: displacement that the unload ramp ends at when the force did not fall before, counts.
    pub retract_counts: i32,
}

/// Number of limits.
pub const LIMIT_COUNT: usize = 13;

impl Limits {
    /// As they stand at sub-indices 1 to 13.
    pub fn to_array(&self) -> [i32; LIMIT_COUNT] {
        [
            self.force_max_counts,
            self.force_min_counts,
            self.displacement_max_counts,
            self.displacement_min_counts,
            self.velocity_max_counts_s,
            self.following_error_displacement_counts,
            self.following_error_force_counts,
            self.lease_ms,
            self.hold_timeout_ms,
            self.unload_velocity_counts_s,
            self.queue_low_ms,
            self.unloaded_force_counts,
            self.retract_counts,
        ]
    }

    /// From sub-indices 1 to 13.
    pub fn from_array(a: [i32; LIMIT_COUNT]) -> Self {
        Limits {
            force_max_counts: a[0],
            force_min_counts: a[1],
            displacement_max_counts: a[2],
            displacement_min_counts: a[3],
            velocity_max_counts_s: a[4],
            following_error_displacement_counts: a[5],
            following_error_force_counts: a[6],
            lease_ms: a[7],
            hold_timeout_ms: a[8],
            unload_velocity_counts_s: a[9],
            queue_low_ms: a[10],
            unloaded_force_counts: a[11],
            retract_counts: a[12],
        }
    }
}

/// Mode of a command on the wire (2 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum WireMode {
    /// Counts are LVDT counts.
    Displacement = 1,
    /// Counts are load-cell counts.
    Force = 2,
}

/// Host to rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToRig {
    /// COB-ID 0x000. `node` 0 = all.
    Nmt {
        /// What to do.
        command: NmtCommand,
        /// Whom; 0 = all.
        node: u8,
    },
    /// RPDO1, 0x200 + N: one slot of the command queue.
    Command {
        /// 0 to 14, wraps.
        counter: u8,
        /// Session, 1 to 255.
        session: u8,
        /// Low 16 bits of the tick at which it is due.
        tick: u16,
        /// Which channel.
        mode: WireMode,
        /// Set point in that channel's counts, 18 bit signed.
        counts: i32,
        /// The last slot of a motion: the queue may run dry after it without a fault; the rig keeps the value.
        last: bool,
    },
    /// RPDO2, 0x300 + N: the lease, every 10 ms from the control loop.
    Lease {
        /// 0 to 14, wraps.
        counter: u8,
        /// Session, 1 to 255.
        session: u8,
        /// Low 16 bits of the newest sample tick that control has processed: a stuck control loop shows.
        control_tick: u16,
    },
    /// RPDO3, 0x400 + N.
    Request {
        /// 0 to 14, wraps; a repeat with the same counter is answered again, not done again.
        counter: u8,
        /// Session, 1 to 255.
        session: u8,
        /// What.
        code: RequestCode,
        /// Argument; 0 where none.
        argument: u32,
    },
    /// SDO, 0x600 + N: read an object of at most 4 bytes.
    ConfigRead {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// SDO, 0x600 + N: write an object of 4 bytes.
    ConfigWrite {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value; signed ones as their two's complement.
        value: u32,
    },
}

/// Rig to host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FromRig {
    /// 0x700 + N, every 100 ms and at boot.
    Heartbeat {
        /// NMT state.
        state: NmtState,
    },
    /// EMCY, 0x080 + N, at once on a trip.
    Emergency {
        /// CiA 301 error code.
        code: u16,
        /// Error register (0x1001).
        register: u8,
        /// Our first cause.
        cause: Cause,
        /// State that the rig chose.
        state: RigState,
        /// Low 16 bits of the tick.
        tick: u16,
    },
    /// TPDO1, 0x180 + N, every tick.
    Sample {
        /// 0 to 14, wraps.
        counter: u8,
        /// Low 16 bits of the rig's tick.
        tick: u16,
        /// Load cell, 18 bit signed; `COUNTS_INVALID` = no valid reading.
        force_counts: i32,
        /// LVDT, 18 bit signed; `COUNTS_INVALID` = no valid reading.
        displacement_counts: i32,
    },
    /// TPDO2, 0x280 + N, every 10 ms and at once on a change of state.
    Status {
        /// 0 to 14, wraps.
        counter: u8,
        /// State.
        state: RigState,
        /// First cause of the latched state.
        cause: Cause,
        /// Commands in the queue that are still due, ms (255 = 255 or more).
        queue_ms: u8,
        /// Session that owns the rig; 0 = none.
        session: u8,
        /// Counter of the newest request handled; 15 = none since boot.
        ack_counter: u8,
        /// Its result.
        ack_result: RequestResult,
        /// Low 8 bits of the boot id.
        boot: u8,
        /// Bits 16 to 23 of the tick of the sample before.
        tick_high: u8,
    },
    /// SDO answer, 0x580 + N, to a read.
    ConfigValue {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Value.
        value: u32,
    },
    /// SDO answer, 0x580 + N, to a write.
    ConfigWritten {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
    },
    /// SDO answer, 0x580 + N: refused.
    ConfigRefused {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Why.
        abort: ConfigAbort,
    },
}

/// Why a frame has no meaning. Counted by kind; never shown as data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// An identifier that is none of ours.
    #[error("identifier {0:#05x} is not one of this protocol")]
    ForeignId(u16),
    /// Right identifier, wrong length.
    #[error("frame {id:#05x} has {len} bytes instead of {expected}")]
    Length {
        /// COB-ID.
        id: u16,
        /// As received.
        len: u8,
        /// As specified.
        expected: u8,
    },
    /// CRC-8 differs.
    #[error("CRC-8 of frame {id:#05x} is {found:#04x}, expected {expected:#04x}")]
    Crc {
        /// COB-ID.
        id: u16,
        /// In the frame.
        found: u8,
        /// Computed.
        expected: u8,
    },
    /// A field holds a value that means nothing.
    #[error("field {field} of frame {id:#05x} holds {value}")]
    Field {
        /// COB-ID.
        id: u16,
        /// Field's name in the document.
        field: &'static str,
        /// Its value.
        value: u32,
    },
}

/// Size of the alternating counter: it counts 0 to 14 and wraps; 15 is never sent.
pub const COUNTER_MODULO: u8 = 15;

/// The counter after `counter`.
pub fn next_counter(counter: u8) -> u8 {
    (counter + 1) % COUNTER_MODULO
}
