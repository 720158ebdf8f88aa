//! REQUEST: RPDO3, 0x400 + N, host to rig. The next STATUS carries the answer.

use super::DecodeError;
use crate::protocol::bits::{Bits, Field, SESSION, seal};
use crate::protocol::frame::Frame;
use crate::protocol::protection::FrameKind;
use crate::protocol::wire_enum::wire_enum;

wire_enum! {
    /// Kind of request.
    pub(crate) enum RequestCode: u8 {
        /// Take the session named in the frame. Refused while another session's lease is alive.
        OpenSession = 1,
        /// Switch the pressure on. Argument: CRC-32 of the limits that the host wrote.
        Arm = 2,
        /// Stop following the queue, keep the position (S1).
        Hold = 3,
        /// From Hold back to Armed; the queue starts empty.
        Resume = 4,
        /// Unload (S2), then Off.
        Unload = 5,
        /// Clear the latch; from Tripped to Off. Refused while the cause is still present.
        Reset = 6,
        /// Empty the command queue and take the feedback as set point (change of mode). Only in Armed and Hold.
        ClearQueue = 7,
    }
}

wire_enum! {
    /// Answer to a request, carried in the status (4 bits).
    pub(crate) enum RequestResult: u8 {
        /// No request since boot.
        None = 0,
        /// The request is carried out.
        Done = 1,
        /// Another session owns the rig.
        Busy = 2,
        /// The request is not allowed in this state.
        WrongState = 3,
        /// The CRC-32 of the limits differs.
        WrongConfiguration = 4,
        /// The cause of the trip is still present.
        CauseStands = 5,
        /// The firmware has no such request.
        Unknown = 6,
    }
}

/// One request of the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RequestMessage {
    /// Counter, 0 to 14. A repeat with all fields equal is answered again and not carried out again.
    pub counter: u8,
    /// Session of the host, 1 to 255.
    pub session: u8,
    /// Kind of request.
    pub code: RequestCode,
    /// Argument of the code; 0 where it has none.
    pub argument: u32,
}

const CODE: Field = Field::new("code", 24, 8);
const ARGUMENT: Field = Field::new("argument", 32, 32);
const RESERVED: [Field; 1] = [Field::reserved(12, 4)];

impl RequestMessage {
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = SESSION.put(self.session) | CODE.put(self.code as u8) | ARGUMENT.put(self.argument);
        seal(FrameKind::Request, node, self.counter, bits)
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::unseal(frame, FrameKind::Request, node)?;
        bits.expect_zero(&RESERVED)?;
        let (counter, session, code) = (bits.counter()?, bits.session()?, bits.u8(&CODE));
        Ok(RequestMessage {
            counter,
            session,
            code: RequestCode::from_wire(code).ok_or(DecodeError::RequestCode { counter, code })?,
            argument: bits.u32(&ARGUMENT),
        })
    }
}
