//! Between messages and frames, both directions. Bytes in, meaning out: a frame is either exactly what
//! `firmware-protocol.md` says or a [`DecodeError`]. Sequence of counters, states and limits are left to the ends.

use super::frame::Frame;
use super::layout::{Raw, check_crc, config, expect_length, from_signed18, function, id_node, seal};
use super::message::*;
use super::protection::{Kind, crc8, data_id};

/// Function codes of the CANopen predefined connection set; the node is added to all but NMT.
pub(crate) mod cob {
    /// Network management, host to all.
    pub(crate) const NMT: u16 = 0x000;
    /// Emergency, rig to host.
    pub(crate) const EMERGENCY: u16 = 0x080;
    /// TPDO1, rig to host.
    pub(crate) const SAMPLE: u16 = 0x180;
    /// RPDO1, host to rig.
    pub(crate) const COMMAND: u16 = 0x200;
    /// TPDO2, rig to host.
    pub(crate) const STATUS: u16 = 0x280;
    /// RPDO2, host to rig.
    pub(crate) const LEASE: u16 = 0x300;
    /// RPDO3, host to rig.
    pub(crate) const REQUEST: u16 = 0x400;
    /// SDO answer, rig to host.
    pub(crate) const CONFIG_ANSWER: u16 = 0x580;
    /// SDO request, host to rig.
    pub(crate) const CONFIG_REQUEST: u16 = 0x600;
    /// Heartbeat, rig to host.
    pub(crate) const HEARTBEAT: u16 = 0x700;
    /// Bits of an identifier that hold the function; the other seven are the node.
    pub(crate) const FUNCTION_MASK: u16 = 0x780;
}

/// Command bytes of the expedited SDO with 4 bytes (CiA 301).
mod sdo {
    pub(super) const WRITE: u8 = 0x23;
    pub(super) const WRITTEN: u8 = 0x60;
    pub(super) const READ: u8 = 0x40;
    pub(super) const VALUE: u8 = 0x43;
    pub(super) const ABORT: u8 = 0x80;
}

impl ToRig {
    /// The frame for the rig `node`. Counts beyond the 18 bits saturate: a set point never wraps to the other side.
    pub(crate) fn encode(&self, node: u8) -> Frame {
        match *self {
            ToRig::Nmt { command, node } => Frame::new(cob::NMT, &[command as u8, node]),
            ToRig::Command {
                counter,
                session,
                tick,
                mode,
                counts,
                last,
            } => {
                let counts = counts.clamp(-COUNTS_MAX, COUNTS_MAX);
                let bits = (mode as u64) << 12
                    | u64::from(last) << 14
                    | u64::from(session) << 16
                    | from_signed18(counts) << 24
                    | u64::from(tick) << 48;
                seal(cob::COMMAND, Kind::Command, node, counter, bits)
            }
            ToRig::Lease {
                counter,
                session,
                control_tick,
            } => {
                let bits = u64::from(session) << 16 | u64::from(control_tick) << 48;
                seal(cob::LEASE, Kind::Lease, node, counter, bits)
            }
            ToRig::Request {
                counter,
                session,
                code,
                argument,
            } => {
                let bits = u64::from(session) << 16 | (code as u64) << 24 | u64::from(argument) << 32;
                seal(cob::REQUEST, Kind::Request, node, counter, bits)
            }
            ToRig::ConfigRead { index, sub } => config(cob::CONFIG_REQUEST, node, sdo::READ, index, sub, 0),
            ToRig::ConfigWrite { index, sub, value } => {
                config(cob::CONFIG_REQUEST, node, sdo::WRITE, index, sub, value)
            }
        }
    }

    /// What `frame` says to the rig `node`.
    pub(crate) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        if frame.id == cob::NMT {
            return decode_nmt(frame, node);
        }
        let raw = Raw {
            id: frame.id,
            data: frame.data,
        };
        match function(frame, node)? {
            cob::COMMAND => {
                let raw = raw.unsealed(frame, Kind::Command, node)?;
                raw.zero("reserved", 15, 1)?;
                raw.zero("reserved", 42, 6)?;
                let counts = raw.signed18(24);
                if counts == COUNTS_INVALID {
                    return Err(raw.field("counts", raw.bits(24, 18) as u32));
                }
                Ok(ToRig::Command {
                    counter: raw.counter()?,
                    session: raw.session()?,
                    tick: raw.bits(48, 16) as u16,
                    mode: raw.known("mode", 12, 2, WireMode::from_wire)?,
                    counts,
                    last: raw.bits(14, 1) == 1,
                })
            }
            cob::LEASE => {
                let raw = raw.unsealed(frame, Kind::Lease, node)?;
                raw.zero("reserved", 12, 4)?;
                raw.zero("reserved", 24, 24)?;
                Ok(ToRig::Lease {
                    counter: raw.counter()?,
                    session: raw.session()?,
                    control_tick: raw.bits(48, 16) as u16,
                })
            }
            cob::REQUEST => {
                let raw = raw.unsealed(frame, Kind::Request, node)?;
                raw.zero("reserved", 12, 4)?;
                Ok(ToRig::Request {
                    counter: raw.counter()?,
                    session: raw.session()?,
                    code: raw.known("code", 24, 8, RequestCode::from_wire)?,
                    argument: raw.bits(32, 32) as u32,
                })
            }
            cob::CONFIG_REQUEST => {
                expect_length(frame, 8)?;
                let (index, sub) = raw.object();
                match raw.data[0] {
                    sdo::READ => {
                        raw.zero("reserved", 32, 32)?;
                        Ok(ToRig::ConfigRead { index, sub })
                    }
                    sdo::WRITE => Ok(ToRig::ConfigWrite {
                        index,
                        sub,
                        value: raw.bits(32, 32) as u32,
                    }),
                    other => Err(raw.field("command", u32::from(other))),
                }
            }
            _ => Err(DecodeError::ForeignId(frame.id)),
        }
    }
}

impl FromRig {
    /// The frame from the rig `node`. Counts beyond the 18 bits saturate.
    pub(crate) fn encode(&self, node: u8) -> Frame {
        match *self {
            FromRig::Heartbeat { state } => Frame::new(cob::HEARTBEAT + id_node(node), &[state as u8]),
            FromRig::Emergency {
                code,
                register,
                cause,
                state,
                tick,
            } => {
                let (code, tick) = (code.to_le_bytes(), tick.to_le_bytes());
                let mut data = [
                    code[0],
                    code[1],
                    register,
                    cause as u8,
                    state as u8,
                    tick[0],
                    tick[1],
                    0,
                ];
                data[7] = crc8(data_id(Kind::Emergency, node), &data[..7]);
                Frame::new(cob::EMERGENCY + id_node(node), &data)
            }
            FromRig::Sample {
                counter,
                tick,
                force_counts,
                displacement_counts,
            } => {
                let force = force_counts.clamp(COUNTS_INVALID, COUNTS_MAX);
                let displacement = displacement_counts.clamp(COUNTS_INVALID, COUNTS_MAX);
                let bits =
                    from_signed18(force) << 12 | from_signed18(displacement) << 30 | u64::from(tick) << 48;
                seal(cob::SAMPLE, Kind::Sample, node, counter, bits)
            }
            FromRig::Status {
                counter,
                state,
                cause,
                queue_ms,
                session,
                ack_counter,
                ack_result,
                boot,
                tick_high,
            } => {
                let bits = (state as u64) << 12
                    | (cause as u64) << 16
                    | u64::from(queue_ms) << 24
                    | u64::from(session) << 32
                    | u64::from(ack_counter & 0xF) << 40
                    | (ack_result as u64) << 44
                    | u64::from(boot) << 48
                    | u64::from(tick_high) << 56;
                seal(cob::STATUS, Kind::Status, node, counter, bits)
            }
            FromRig::ConfigValue { index, sub, value } => {
                config(cob::CONFIG_ANSWER, node, sdo::VALUE, index, sub, value)
            }
            FromRig::ConfigWritten { index, sub } => {
                config(cob::CONFIG_ANSWER, node, sdo::WRITTEN, index, sub, 0)
            }
            FromRig::ConfigRefused { index, sub, abort } => {
                config(cob::CONFIG_ANSWER, node, sdo::ABORT, index, sub, abort as u32)
            }
        }
    }

    /// What `frame` from the rig `node` says.
    pub(crate) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let raw = Raw {
            id: frame.id,
            data: frame.data,
        };
        match function(frame, node)? {
            cob::SAMPLE => {
                let raw = raw.unsealed(frame, Kind::Sample, node)?;
                Ok(FromRig::Sample {
                    counter: raw.counter()?,
                    tick: raw.bits(48, 16) as u16,
                    force_counts: raw.signed18(12),
                    displacement_counts: raw.signed18(30),
                })
            }
            cob::STATUS => {
                let raw = raw.unsealed(frame, Kind::Status, node)?;
                Ok(FromRig::Status {
                    counter: raw.counter()?,
                    state: raw.known("state", 12, 4, RigState::from_wire)?,
                    cause: raw.known("cause", 16, 8, Cause::from_wire)?,
                    queue_ms: raw.bits(24, 8) as u8,
                    session: raw.bits(32, 8) as u8,
                    ack_counter: raw.bits(40, 4) as u8,
                    ack_result: raw.known("ack_result", 44, 4, RequestResult::from_wire)?,
                    boot: raw.bits(48, 8) as u8,
                    tick_high: raw.bits(56, 8) as u8,
                })
            }
            cob::EMERGENCY => {
                expect_length(frame, 8)?;
                check_crc(
                    frame.id,
                    raw.data[7],
                    crc8(data_id(Kind::Emergency, node), &raw.data[..7]),
                )?;
                Ok(FromRig::Emergency {
                    code: raw.bits(0, 16) as u16,
                    register: raw.bits(16, 8) as u8,
                    cause: raw.known("cause", 24, 8, Cause::from_wire)?,
                    state: raw.known("state", 32, 8, RigState::from_wire)?,
                    tick: raw.bits(40, 16) as u16,
                })
            }
            cob::HEARTBEAT => {
                expect_length(frame, 1)?;
                // Bit 7 is a toggle in old node guarding; some nodes still set it.
                let value = raw.data[0] & 0x7F;
                let state = NmtState::from_wire(value).ok_or(raw.field("state", u32::from(value)))?;
                Ok(FromRig::Heartbeat { state })
            }
            cob::CONFIG_ANSWER => {
                expect_length(frame, 8)?;
                let (index, sub) = raw.object();
                match raw.data[0] {
                    sdo::VALUE => Ok(FromRig::ConfigValue {
                        index,
                        sub,
                        value: raw.bits(32, 32) as u32,
                    }),
                    sdo::WRITTEN => {
                        raw.zero("reserved", 32, 32)?;
                        Ok(FromRig::ConfigWritten { index, sub })
                    }
                    sdo::ABORT => {
                        let value = raw.bits(32, 32) as u32;
                        let abort = ConfigAbort::from_wire(value).ok_or(raw.field("value", value))?;
                        Ok(FromRig::ConfigRefused { index, sub, abort })
                    }
                    other => Err(raw.field("command", u32::from(other))),
                }
            }
            _ => Err(DecodeError::ForeignId(frame.id)),
        }
    }
}

/// NMT has no CRC: it can only stop the rig or change what it reports, and CAN's own CRC-15 stands below it.
fn decode_nmt(frame: &Frame, own: u8) -> Result<ToRig, DecodeError> {
    expect_length(frame, 2)?;
    let [value, node, ..] = frame.data;
    if node != 0 && node != own {
        return Err(DecodeError::ForeignId(frame.id));
    }
    let field = DecodeError::Field {
        id: frame.id,
        field: "command",
        value: u32::from(value),
    };
    let command = NmtCommand::from_wire(value).ok_or(field)?;
    Ok(ToRig::Nmt { command, node })
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: u8 = 5;

    #[test]
    fn extremes_of_a_sample_come_back() {
        for (force, displacement) in [
            (COUNTS_MAX, COUNTS_INVALID),
            (COUNTS_INVALID, COUNTS_MAX),
            (-1, 1),
            (0, -COUNTS_MAX),
        ] {
            let sample = FromRig::Sample {
                counter: 14,
                tick: 0xFFFF,
                force_counts: force,
                displacement_counts: displacement,
            };
            assert_eq!(FromRig::decode(&sample.encode(NODE), NODE), Ok(sample));
        }
    }

    #[test]
    fn a_set_point_beyond_full_scale_saturates() {
        let command = |counts| ToRig::Command {
            counter: 0,
            session: 1,
            tick: 0,
            mode: WireMode::Force,
            counts,
            last: false,
        };
        assert_eq!(command(i32::MAX).encode(NODE), command(COUNTS_MAX).encode(NODE));
        assert_eq!(command(i32::MIN).encode(NODE), command(-COUNTS_MAX).encode(NODE));
    }

    #[test]
    fn shape_comes_before_content() {
        let mut frame = ToRig::Lease {
            counter: 0,
            session: 1,
            control_tick: 0,
        }
        .encode(NODE);
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
        let lease = ToRig::Lease {
            counter: 0,
            session: 1,
            control_tick: 0,
        }
        .encode(NODE);
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
    fn a_frame_renamed_to_another_node_does_not_pass() {
        let mut frame = FromRig::Sample {
            counter: 0,
            tick: 0,
            force_counts: 0,
            displacement_counts: 0,
        }
        .encode(NODE);
        frame.id = 0x186;
        assert!(matches!(
            FromRig::decode(&frame, 6),
            Err(DecodeError::Crc { id: 0x186, .. })
        ));
    }

    #[test]
    fn values_that_mean_nothing_are_refused_with_their_field() {
        let field = |frame: Frame| match ToRig::decode(&frame, NODE) {
            Err(DecodeError::Field { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field(seal(cob::COMMAND, Kind::Command, NODE, 0, 1 << 16)), "mode");
        assert_eq!(
            field(seal(cob::COMMAND, Kind::Command, NODE, 0, 1 << 12)),
            "session"
        );
        assert_eq!(
            field(seal(cob::COMMAND, Kind::Command, NODE, 15, 1 << 12 | 1 << 16)),
            "counter"
        );
        assert_eq!(
            field(seal(cob::COMMAND, Kind::Command, NODE, 0, 1 << 15)),
            "reserved"
        );
        assert_eq!(
            field(seal(cob::COMMAND, Kind::Command, NODE, 0, 0x2_0000 << 24)),
            "counts"
        );
        assert_eq!(field(seal(cob::REQUEST, Kind::Request, NODE, 0, 1 << 16)), "code");
        assert_eq!(
            field(seal(cob::LEASE, Kind::Lease, NODE, 0, 1 << 16 | 1 << 30)),
            "reserved"
        );
        assert_eq!(field(Frame::new(cob::NMT, &[0x82, 0])), "command");
        assert_eq!(
            field(config(cob::CONFIG_REQUEST, NODE, 0x2F, 0x2000, 0, 0)),
            "command"
        );
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
    fn lists_are_in_the_order_of_their_wire_values() {
        fn hold<T: Copy + PartialEq + std::fmt::Debug>(
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
        hold(&NmtCommand::ALL, |v| v as u8, NmtCommand::from_wire);
        hold(&NmtState::ALL, |v| v as u8, NmtState::from_wire);
        hold(&RigState::ALL, |v| v as u8, RigState::from_wire);
        hold(&Cause::ALL, |v| v as u8, Cause::from_wire);
        hold(&RequestCode::ALL, |v| v as u8, RequestCode::from_wire);
        hold(&RequestResult::ALL, |v| v as u8, RequestResult::from_wire);
        hold(&WireMode::ALL, |v| v as u8, WireMode::from_wire);
    }
}
