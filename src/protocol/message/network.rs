//! NMT (0x000, host to all rigs) and HEARTBEAT (0x700 + N, rig to host): network management of CiA 301.

use super::{DecodeError, FromRig, ToRig};
use crate::protocol::bits::expect_length;
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::wire_enum::wire_enum;

wire_enum! {
    /// NMT commands (CiA 301).
    pub(crate) enum NmtCommand: u8 {
        /// Start the process data.
        Start = 0x01,
        /// Stop: the rig unloads (S2). This is the abort, with the top priority on the bus.
        Stop = 0x02,
        /// Back to pre-operational; ignored while the pressure is on.
        PreOperational = 0x80,
        /// Reset the node; ignored while the pressure is on.
        ResetNode = 0x81,
    }
}

wire_enum! {
    /// NMT state in the heartbeat (CiA 301).
    pub(crate) enum NmtState: u8 {
        /// The node has just booted; sent once.
        BootUp = 0x00,
        /// After an NMT stop; samples and status go on.
        Stopped = 0x04,
        /// Samples, status and commands flow.
        Operational = 0x05,
        /// Only configuration, heartbeat and emergency.
        PreOperational = 0x7F,
    }
}

/// A heartbeat's state; bit 7 is the toggle of the older node guarding.
const HEARTBEAT_STATE: u8 = 0x7F;

pub(super) fn encode_nmt(command: NmtCommand, node: u8) -> Frame {
    Frame::new(cob::NMT, &[command as u8, node])
}

/// NMT has no CRC-8. It can only stop the rig or change what the rig reports, and CAN has its own CRC-15.
pub(super) fn decode_nmt(frame: &Frame, own: u8) -> Result<ToRig, DecodeError> {
    expect_length(frame, 2)?;
    let [value, node, ..] = frame.data;
    if node != 0 && node != own {
        return Err(DecodeError::ForeignId(frame.id));
    }
    let command = NmtCommand::from_wire(value).ok_or(DecodeError::Field {
        id: frame.id,
        field: "command",
        value: u32::from(value),
    })?;
    Ok(ToRig::Nmt { command, node })
}

pub(super) fn encode_heartbeat(state: NmtState, node: u8) -> Frame {
    Frame::new(cob::id(cob::HEARTBEAT, node), &[state as u8])
}

pub(super) fn decode_heartbeat(frame: &Frame) -> Result<FromRig, DecodeError> {
    expect_length(frame, 1)?;
    let value = frame.data[0] & HEARTBEAT_STATE;
    let state = NmtState::from_wire(value).ok_or(DecodeError::Field {
        id: frame.id,
        field: "state",
        value: u32::from(value),
    })?;
    Ok(FromRig::Heartbeat { state })
}
