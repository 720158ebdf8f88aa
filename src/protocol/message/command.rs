//! COMMAND: RPDO1, 0x200 + N, host to rig: one slot of the rig's command queue.

use super::{COUNTS_INVALID, COUNTS_MAX, DecodeError};
use crate::protocol::bits::{Bits, Field, SESSION, TICK, seal};
use crate::protocol::frame::Frame;
use crate::protocol::protection::FrameKind;
use crate::protocol::wire_enum::wire_enum;

wire_enum! {
    /// Channel of a command (2 bits).
    pub(crate) enum WireMode: u8 {
        /// The counts are LVDT counts.
        Displacement = 1,
        /// The counts are load-cell counts.
        Force = 2,
    }
}

/// The set point of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CommandMessage {
    /// Alternating counter, 0 to 14.
    pub counter: u8,
    /// Session of the host, 1 to 255.
    pub session: u8,
    /// Low 16 bits of the tick at which the command is due.
    pub tick: u16,
    /// Channel that the set point is for.
    pub mode: WireMode,
    /// Set point in that channel's counts, 18 bit signed.
    pub counts: i32,
    /// The motion ends here: the queue may run empty after it without a fault, and the rig keeps the value.
    pub last: bool,
}

const MODE: Field = Field::new("mode", 12, 2);
const LAST: Field = Field::new("last", 14, 1);
const COUNTS: Field = Field::new("counts", 24, 18);
const RESERVED: [Field; 2] = [Field::reserved(15, 1), Field::reserved(42, 6)];

impl CommandMessage {
    /// Counts beyond 18 bits are limited to full scale, so that a set point never wraps to the other side.
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = MODE.put(self.mode as u8)
            | LAST.put(self.last)
            | SESSION.put(self.session)
            | COUNTS.put_signed(self.counts.clamp(-COUNTS_MAX, COUNTS_MAX))
            | TICK.put(self.tick);
        seal(FrameKind::Command, node, self.counter, bits)
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::unseal(frame, FrameKind::Command, node)?;
        bits.expect_zero(&RESERVED)?;
        let counts = bits.signed(&COUNTS);
        if counts == COUNTS_INVALID {
            return Err(bits.refused(&COUNTS));
        }
        Ok(CommandMessage {
            counter: bits.counter()?,
            session: bits.session()?,
            tick: bits.u16(&TICK),
            mode: bits.known(&MODE, WireMode::from_wire)?,
            counts,
            last: bits.flag(&LAST),
        })
    }
}
