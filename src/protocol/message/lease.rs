//! LEASE: RPDO2, 0x300 + N, host to rig, every 10 ms from the control loop. Without it the rig unloads.

use super::DecodeError;
use crate::protocol::bits::{Bits, Field, SESSION, seal};
use crate::protocol::frame::Frame;
use crate::protocol::protection::FrameKind;

/// Keeps a session alive while the host's control loop runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LeaseMessage {
    /// Alternating counter, 0 to 14.
    pub counter: u8,
    /// Session of the host, 1 to 255.
    pub session: u8,
    /// Low 16 bits of the newest sample tick that control has processed. It does not change if the control loop is stuck.
    pub control_tick: u16,
}

const CONTROL_TICK: Field = Field::new("control_tick", 48, 16);
const RESERVED: [Field; 2] = [Field::reserved(12, 4), Field::reserved(24, 24)];

impl LeaseMessage {
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = SESSION.put(self.session) | CONTROL_TICK.put(self.control_tick);
        seal(FrameKind::Lease, node, self.counter, bits)
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::unseal(frame, FrameKind::Lease, node)?;
        bits.expect_zero(&RESERVED)?;
        Ok(LeaseMessage {
            counter: bits.counter()?,
            session: bits.session()?,
            control_tick: bits.u16(&CONTROL_TICK),
        })
    }
}
