//! The messages, both directions, in counts and ticks. Layouts: firmware-protocol.md.

pub(crate) use super::dictionary::{ConfigAbort, LIMIT_COUNT, Limits, object};
pub(crate) use super::state::{Cause, NmtCommand, NmtState, RequestCode, RequestResult, RigState};

/// Node number of a rig on the bus, 1 to 126.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct NodeId(pub u8);

/// Full scale of an 18-bit channel: counts run from -`COUNTS_MAX` to `COUNTS_MAX`.
pub(crate) const COUNTS_MAX: i32 = 131_071;
/// The reserved 18-bit pattern for "no valid reading" (sensor open or at its rail).
pub(crate) const COUNTS_INVALID: i32 = -131_072;
/// Nominal newtons a count of the load cell.
pub(crate) const FORCE_N_PER_COUNT: f64 = 0.1;
/// Nominal millimetres a count of the LVDT.
pub(crate) const DISPLACEMENT_MM_PER_COUNT: f64 = 0.0005;
/// Samples, and command slots, a second.
pub(crate) const SAMPLE_RATE_HZ: u32 = 1000;
/// Version that this program speaks, major << 16 | minor. Another major is refused before arming.
pub(crate) const PROTOCOL_VERSION: u32 = 0x0001_0000;

/// Size of the alternating counter: it counts 0 to 14 and wraps; 15 is never sent.
pub(crate) const COUNTER_MODULO: u8 = 15;

/// The counter after `counter`.
pub(crate) fn next_counter(counter: u8) -> u8 {
    (counter + 1) % COUNTER_MODULO
}

/// Mode of a command on the wire (2 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum WireMode {
    /// Counts are LVDT counts.
    Displacement = 1,
    /// Counts are load-cell counts.
    Force = 2,
}

impl WireMode {
    /// All modes, in the order of their wire values from 1.
    pub(crate) const ALL: [WireMode; 2] = [WireMode::Displacement, WireMode::Force];

    /// The one that `value` stands for on the wire.
    pub(crate) fn from_wire(value: u8) -> Option<Self> {
        Self::ALL.get(usize::from(value).checked_sub(1)?).copied()
    }
}

/// Host to rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ToRig {
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
pub(crate) enum FromRig {
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
pub(crate) enum DecodeError {
    /// An identifier that is none of ours, or an NMT command for another node. No fault: just not for us.
    #[error("identifier {0:#05x} is not one of this protocol, or not for this node")]
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
