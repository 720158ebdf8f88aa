//! EMERGENCY: EMCY, 0x080 + N, rig to host, at once on a fault. CiA 301 fixes bytes 0 to 2; the CRC-8 is in byte 7.

use super::{Cause, DecodeError, RigState};
use crate::protocol::bits::{Bits, Field, check_crc, frame_of};
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::protection::{FrameKind, crc8, data_id};

/// A fault and the state that the rig chose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EmergencyMessage {
    /// CiA 301 error code; 0 = cleared.
    pub code: u16,
    /// Error register, object 0x1001.
    pub register: u8,
    /// First cause of the latched state.
    pub cause: Cause,
    /// State that the rig chose.
    pub state: RigState,
    /// Low 16 bits of the tick of the fault.
    pub tick: u16,
}

const CODE: Field = Field::new("error_code", 0, 16);
const REGISTER: Field = Field::new("error_register", 16, 8);
const CAUSE: Field = Field::new("cause", 24, 8);
const STATE: Field = Field::new("state", 32, 8);
const TICK_OF_FAULT: Field = Field::new("tick", 40, 16);

impl EmergencyMessage {
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = CODE.put(self.code)
            | REGISTER.put(self.register)
            | CAUSE.put(self.cause as u8)
            | STATE.put(self.state as u8)
            | TICK_OF_FAULT.put(self.tick);
        let mut frame = frame_of(cob::EMERGENCY, node, bits);
        frame.data[7] = crc(&frame, node);
        frame
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::of(frame)?;
        check_crc(frame.id, frame.data[7], crc(frame, node))?;
        Ok(EmergencyMessage {
            code: bits.u16(&CODE),
            register: bits.u8(&REGISTER),
            cause: bits.known(&CAUSE, Cause::from_wire)?,
            state: bits.known(&STATE, RigState::from_wire)?,
            tick: bits.u16(&TICK_OF_FAULT),
        })
    }
}

/// CRC-8 over the data id and bytes 0 to 6.
fn crc(frame: &Frame, node: u8) -> u8 {
    crc8(data_id(FrameKind::Emergency, node), &frame.data[..7])
}
