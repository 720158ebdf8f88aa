//! STATUS: TPDO2, 0x280 + N, rig to host, every 10 ms and at once on a change of state or on a request.

use super::{Cause, DecodeError, RequestResult, RigState};
use crate::protocol::bits::{Bits, Field, seal};
use crate::protocol::frame::Frame;
use crate::protocol::protection::FrameKind;

/// What the rig does and which request it answered last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct StatusMessage {
    /// Alternating counter, 0 to 14.
    pub counter: u8,
    /// State of the firmware.
    pub state: RigState,
    /// First cause of the latched state.
    pub cause: Cause,
    /// Commands in the queue that are not yet due, ms; 255 = 255 or more.
    pub queue_ms: u8,
    /// Session that owns the rig; 0 = none.
    pub session: u8,
    /// Counter of the newest request handled; 15 = none since boot.
    pub ack_counter: u8,
    /// Result of that request.
    pub ack_result: RequestResult,
    /// Low 8 bits of the boot id.
    pub boot: u8,
    /// Bits 16 to 23 of the tick of the newest sample.
    pub tick_high: u8,
}

const STATE: Field = Field::new("state", 12, 4);
const CAUSE: Field = Field::new("cause", 16, 8);
const QUEUE: Field = Field::new("queue", 24, 8);
/// Unlike in frames from the host, 0 is allowed.
const OWNER: Field = Field::new("session", 32, 8);
const ACK_COUNTER: Field = Field::new("ack_counter", 40, 4);
const ACK_RESULT: Field = Field::new("ack_result", 44, 4);
const BOOT: Field = Field::new("boot", 48, 8);
const TICK_HIGH: Field = Field::new("tick_high", 56, 8);

impl StatusMessage {
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = STATE.put(self.state as u8)
            | CAUSE.put(self.cause as u8)
            | QUEUE.put(self.queue_ms)
            | OWNER.put(self.session)
            | ACK_COUNTER.put(self.ack_counter)
            | ACK_RESULT.put(self.ack_result as u8)
            | BOOT.put(self.boot)
            | TICK_HIGH.put(self.tick_high);
        seal(FrameKind::Status, node, self.counter, bits)
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::unseal(frame, FrameKind::Status, node)?;
        Ok(StatusMessage {
            counter: bits.counter()?,
            state: bits.known(&STATE, RigState::from_wire)?,
            cause: bits.known(&CAUSE, Cause::from_wire)?,
            queue_ms: bits.u8(&QUEUE),
            session: bits.u8(&OWNER),
            ack_counter: bits.u8(&ACK_COUNTER),
            ack_result: bits.known(&ACK_RESULT, RequestResult::from_wire)?,
            boot: bits.u8(&BOOT),
            tick_high: bits.u8(&TICK_HIGH),
        })
    }
}
