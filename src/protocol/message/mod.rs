//! The messages of both directions, in counts and ticks, and their frames: a frame is either exactly what
//! `firmware-protocol.md` says or a [`DecodeError`]. One file per message holds its fields, their bits, `encode` and
//! `decode`. The order of counters, states and limits are checked by the receiver (`control`, firmware).

mod command;
mod emergency;
mod lease;
mod network;
mod request;
mod sample;
mod sdo;
mod status;

pub(crate) use super::bits::DecodeError;
pub(crate) use super::dictionary::{ConfigAbort, LIMIT_COUNT, LIMITS, Limits, object};
pub(crate) use super::protection::{COUNTER_MODULO, next_counter};
pub(crate) use super::state::{Cause, RigState};
pub(crate) use super::tick::SAMPLE_RATE_HZ;
use super::{cob, frame::Frame};
pub(crate) use command::{CommandMessage, WireMode};
pub(crate) use emergency::EmergencyMessage;
pub(crate) use lease::LeaseMessage;
pub(crate) use network::{NmtCommand, NmtState};
pub(crate) use request::{RequestCode, RequestMessage, RequestResult};
pub(crate) use sample::SampleMessage;
pub(crate) use status::StatusMessage;

/// Full scale of an 18-bit channel: counts run from -`COUNTS_MAX` to `COUNTS_MAX`.
pub(crate) const COUNTS_MAX: i32 = 131_071;
/// The reserved 18-bit pattern for "no valid reading" (sensor open or at its rail).
pub(crate) const COUNTS_INVALID: i32 = -131_072;
/// Nominal newtons per count of the load cell.
pub(crate) const FORCE_N_PER_COUNT: f64 = 0.1;
/// Nominal millimetres per count of the LVDT.
pub(crate) const DISPLACEMENT_MM_PER_COUNT: f64 = 0.0005;
/// Protocol version of this program, major << 16 | minor. A rig with another major is refused before arming.
pub(crate) const PROTOCOL_VERSION: u32 = 0x0001_0000;

/// Messages from the host to the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ToRig {
    /// NMT, identifier 0x000.
    Nmt {
        /// What to do.
        command: NmtCommand,
        /// Node that it is for; 0 = all.
        node: u8,
    },
    /// RPDO1, 0x200 + N: one slot of the command queue.
    Command(CommandMessage),
    /// RPDO2, 0x300 + N: the lease, every 10 ms.
    Lease(LeaseMessage),
    /// RPDO3, 0x400 + N: arm, hold, unload and so on.
    Request(RequestMessage),
    /// SDO, 0x600 + N: read an object of 4 bytes.
    ConfigRead {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
    },
    /// SDO, 0x600 + N: write an object of 4 bytes.
    ConfigWrite {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
        /// New value; signed values in two's complement.
        value: u32,
    },
}

/// Messages from the rig to the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FromRig {
    /// 0x700 + N, every 100 ms and at boot.
    Heartbeat {
        /// NMT state of the node.
        state: NmtState,
    },
    /// EMCY, 0x080 + N, at once on a fault.
    Emergency(EmergencyMessage),
    /// TPDO1, 0x180 + N, every tick.
    Sample(SampleMessage),
    /// TPDO2, 0x280 + N, every 10 ms and at once on a change of state or on a request.
    Status(StatusMessage),
    /// SDO answer, 0x580 + N, to a read.
    ConfigValue {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
        /// Value of the object; signed values in two's complement.
        value: u32,
    },
    /// SDO answer, 0x580 + N, to a write.
    ConfigWritten {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
    },
    /// SDO answer, 0x580 + N: the access is refused.
    ConfigRefused {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
        /// CiA 301 abort code.
        abort: ConfigAbort,
    },
}

impl ToRig {
    /// The frame for the rig `node`.
    pub(crate) fn encode(&self, node: u8) -> Frame {
        match self {
            ToRig::Nmt { command, node } => network::encode_nmt(*command, *node),
            ToRig::Command(command) => command.encode(node),
            ToRig::Lease(lease) => lease.encode(node),
            ToRig::Request(request) => request.encode(node),
            ToRig::ConfigRead { index, sub } => sdo::encode_read(node, *index, *sub),
            ToRig::ConfigWrite { index, sub, value } => sdo::encode_write(node, *index, *sub, *value),
        }
    }

    /// The message in `frame` for the rig `node`.
    pub(crate) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        if frame.id == cob::NMT {
            return network::decode_nmt(frame, node);
        }
        match cob::function(frame.id, node) {
            Some(cob::COMMAND) => CommandMessage::decode(frame, node).map(ToRig::Command),
            Some(cob::LEASE) => LeaseMessage::decode(frame, node).map(ToRig::Lease),
            Some(cob::REQUEST) => RequestMessage::decode(frame, node).map(ToRig::Request),
            Some(cob::CONFIG_REQUEST) => sdo::decode_request(frame),
            _ => Err(DecodeError::ForeignId(frame.id)),
        }
    }
}

impl FromRig {
    /// The frame from the rig `node`.
    pub(crate) fn encode(&self, node: u8) -> Frame {
        match self {
            FromRig::Heartbeat { state } => network::encode_heartbeat(*state, node),
            FromRig::Emergency(emergency) => emergency.encode(node),
            FromRig::Sample(sample) => sample.encode(node),
            FromRig::Status(status) => status.encode(node),
            FromRig::ConfigValue { index, sub, value } => sdo::encode_value(node, *index, *sub, *value),
            FromRig::ConfigWritten { index, sub } => sdo::encode_written(node, *index, *sub),
            FromRig::ConfigRefused { index, sub, abort } => sdo::encode_refused(node, *index, *sub, *abort),
        }
    }

    /// The message in `frame` from the rig `node`.
    pub(crate) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        match cob::function(frame.id, node) {
            Some(cob::SAMPLE) => SampleMessage::decode(frame, node).map(FromRig::Sample),
            Some(cob::STATUS) => StatusMessage::decode(frame, node).map(FromRig::Status),
            Some(cob::EMERGENCY) => EmergencyMessage::decode(frame, node).map(FromRig::Emergency),
            Some(cob::HEARTBEAT) => network::decode_heartbeat(frame),
            Some(cob::CONFIG_ANSWER) => sdo::decode_answer(frame),
            _ => Err(DecodeError::ForeignId(frame.id)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::bits::seal;
    use crate::protocol::protection::FrameKind;

    const NODE: u8 = 5;

    fn lease() -> ToRig {
        ToRig::Lease(LeaseMessage {
            counter: 0,
            session: 1,
            control_tick: 0,
        })
    }

    #[test]
    fn extremes_of_a_sample_come_back() {
        for (force, displacement) in [
            (COUNTS_MAX, COUNTS_INVALID),
            (COUNTS_INVALID, COUNTS_MAX),
            (-1, 1),
            (0, -COUNTS_MAX),
        ] {
            let sample = FromRig::Sample(SampleMessage {
                counter: 14,
                tick: 0xFFFF,
                force_counts: force,
                displacement_counts: displacement,
            });
            assert_eq!(FromRig::decode(&sample.encode(NODE), NODE), Ok(sample));
        }
    }

    #[test]
    fn a_set_point_beyond_full_scale_saturates() {
        let command = |counts| {
            ToRig::Command(CommandMessage {
                counter: 0,
                session: 1,
                tick: 0,
                mode: WireMode::Force,
                counts,
                last: false,
            })
        };
        assert_eq!(command(i32::MAX).encode(NODE), command(COUNTS_MAX).encode(NODE));
        assert_eq!(command(i32::MIN).encode(NODE), command(-COUNTS_MAX).encode(NODE));
    }

    #[test]
    fn the_length_is_checked_before_the_content() {
        let mut frame = lease().encode(NODE);
        frame.len = 7;
        let expected = DecodeError::Length {
            id: 0x305,
            len: 7,
            expected: 8,
        };
        assert_eq!(ToRig::decode(&frame, NODE), Err(expected));
    }

    #[test]
    fn the_other_direction_and_other_nodes_are_foreign() {
        let lease = lease().encode(NODE);
        assert_eq!(FromRig::decode(&lease, NODE), Err(DecodeError::ForeignId(0x305)));
        assert_eq!(ToRig::decode(&lease, 6), Err(DecodeError::ForeignId(0x305)));
        let stop = ToRig::Nmt {
            command: NmtCommand::Stop,
            node: 6,
        };
        assert_eq!(
            ToRig::decode(&stop.encode(6), NODE),
            Err(DecodeError::ForeignId(0))
        );
        assert_eq!(ToRig::decode(&stop.encode(6), 6), Ok(stop));
    }

    #[test]
    fn a_frame_renamed_to_another_node_is_refused() {
        let mut frame = FromRig::Sample(SampleMessage {
            counter: 0,
            tick: 0,
            force_counts: 0,
            displacement_counts: 0,
        })
        .encode(NODE);
        frame.id = 0x186;
        assert!(matches!(
            FromRig::decode(&frame, 6),
            Err(DecodeError::Crc { id: 0x186, .. })
        ));
    }

    #[test]
    fn unknown_values_are_refused_with_their_field() {
        let field = |frame: Frame| match ToRig::decode(&frame, NODE) {
            Err(DecodeError::Field { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        let command = |counter, bits| field(seal(FrameKind::Command, NODE, counter, bits));
        assert_eq!(command(0, 1 << 16), "mode");
        assert_eq!(command(0, 1 << 12), "session");
        assert_eq!(command(15, 1 << 12 | 1 << 16), "counter");
        assert_eq!(command(0, 1 << 15), "reserved");
        assert_eq!(command(0, 1 << 47), "reserved");
        assert_eq!(command(0, 0x2_0000 << 24), "counts");
        assert_eq!(
            ToRig::decode(&seal(FrameKind::Request, NODE, 3, 1 << 16), NODE),
            Err(DecodeError::RequestCode { counter: 3, code: 0 })
        );
        assert_eq!(
            field(seal(FrameKind::Lease, NODE, 0, 1 << 16 | 1 << 30)),
            "reserved"
        );
        assert_eq!(field(Frame::new(cob::NMT, &[0x82, 0])), "command");
    }

    #[test]
    fn a_heartbeat_with_the_toggle_bit_is_a_heartbeat() {
        let beat = FromRig::decode(&Frame::new(0x705, &[0x85]), NODE);
        assert_eq!(
            beat,
            Ok(FromRig::Heartbeat {
                state: NmtState::Operational
            })
        );
    }

    #[test]
    fn every_enumeration_has_exactly_its_wire_values() {
        fn check<T: Copy + PartialEq + std::fmt::Debug>(
            all: &[T],
            wire: fn(T) -> u8,
            back: fn(u8) -> Option<T>,
        ) {
            for &one in all {
                assert_eq!(back(wire(one)), Some(one));
            }
            let known = (0..=255).filter(|&value| back(value).is_some()).count();
            assert_eq!(known, all.len());
        }
        check(&NmtCommand::ALL, |v| v as u8, NmtCommand::from_wire);
        check(&NmtState::ALL, |v| v as u8, NmtState::from_wire);
        check(&RigState::ALL, |v| v as u8, RigState::from_wire);
        check(&Cause::ALL, |v| v as u8, Cause::from_wire);
        check(&RequestCode::ALL, |v| v as u8, RequestCode::from_wire);
        check(&RequestResult::ALL, |v| v as u8, RequestResult::from_wire);
        check(&WireMode::ALL, |v| v as u8, WireMode::from_wire);
    }
}
