//! Fields of a frame: where their bits stand, how they are packed, checked and read. Which message has which fields is
//! defined in `message`.

use super::cob;
use super::frame::Frame;
use super::protection::{COUNTER_MODULO, FrameKind, crc8, data_id};

/// Why a frame is not a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DecodeError {
    /// The identifier is not of this protocol, or for another node. This is no fault.
    #[error("identifier {0:#05x} is not one of this protocol, or not for this node")]
    ForeignId(u16),
    /// Right identifier, wrong length.
    #[error("frame {id:#05x} has {len} bytes instead of {expected}")]
    Length {
        /// Identifier of the frame.
        id: u16,
        /// Bytes in the frame.
        len: u8,
        /// Bytes that the protocol specifies.
        expected: u8,
    },
    /// The CRC-8 is wrong.
    #[error("CRC-8 of frame {id:#05x} is {found:#04x}, expected {expected:#04x}")]
    Crc {
        /// Identifier of the frame.
        id: u16,
        /// CRC-8 in the frame.
        found: u8,
        /// CRC-8 that was computed.
        expected: u8,
    },
    /// A field holds a value that the protocol does not name.
    #[error("field {field} of frame {id:#05x} holds {value}")]
    Field {
        /// Identifier of the frame.
        id: u16,
        /// Name of the field in `firmware-protocol.md`.
        field: &'static str,
        /// Value of the field.
        value: u32,
    },
    /// A request whose code this version does not know. It is answered, not counted as corrupt.
    #[error("request {counter} has the unknown code {code}")]
    RequestCode {
        /// Counter of the request, for the answer.
        counter: u8,
        /// The code in the frame.
        code: u8,
    },
    /// A configuration request that is neither a read nor a write of 4 bytes. It is refused, not counted as corrupt.
    #[error("configuration request of object {index:#06x}:{sub} is malformed (command {command:#04x})")]
    Config {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
        /// Command byte in the frame.
        command: u8,
    },
}

/// A field of a frame in Intel bit numbering: bit 0 is the lowest bit of byte 0.
pub(super) struct Field {
    /// Name in `firmware-protocol.md`.
    name: &'static str,
    start: u32,
    width: u32,
}

/// Alternating counter of a protected frame.
const COUNTER: Field = Field::new("counter", 8, 4);
/// Session of a protected frame from the host.
pub(super) const SESSION: Field = Field::new("session", 16, 8);
/// Low 16 bits of a tick, in the frames with counter that carry one.
pub(super) const TICK: Field = Field::new("tick", 48, 16);

impl Field {
    /// The field `name` of `width` bits (1 to 32) from bit `start` on.
    pub(super) const fn new(name: &'static str, start: u32, width: u32) -> Self {
        Field { name, start, width }
    }

    /// Bits that must be zero.
    pub(super) const fn reserved(start: u32, width: u32) -> Self {
        Field::new("reserved", start, width)
    }

    fn mask(&self) -> u64 {
        (1 << self.width) - 1
    }

    /// `value` at the field's place in the 64 bits; bits beyond the width are cut off.
    pub(super) fn put(&self, value: impl Into<u64>) -> u64 {
        (value.into() & self.mask()) << self.start
    }

    /// `value` in two's complement at the field's place.
    pub(super) fn put_signed(&self, value: i32) -> u64 {
        (value as u64 & self.mask()) << self.start
    }
}

/// The 64 bits of a frame of 8 bytes.
pub(super) struct Bits {
    id: u16,
    bits: u64,
}

impl Bits {
    /// The bits of `frame`, which must have 8 bytes.
    pub(super) fn of(frame: &Frame) -> Result<Self, DecodeError> {
        expect_length(frame, 8)?;
        Ok(Bits {
            id: frame.id,
            bits: u64::from_le_bytes(frame.data),
        })
    }

    /// The bits of a frame whose byte 0 is the CRC-8 of the rest. Length first, then CRC.
    pub(super) fn unseal(frame: &Frame, kind: FrameKind, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::of(frame)?;
        let [found, rest @ ..] = &frame.data;
        check_crc(frame.id, *found, crc8(data_id(kind, node), rest))?;
        Ok(bits)
    }

    fn get(&self, field: &Field) -> u64 {
        self.bits >> field.start & field.mask()
    }

    /// A field of one bit.
    pub(super) fn flag(&self, field: &Field) -> bool {
        self.get(field) != 0
    }

    /// A field of at most 8 bits.
    pub(super) fn u8(&self, field: &Field) -> u8 {
        self.get(field) as u8
    }

    /// A field of at most 16 bits.
    pub(super) fn u16(&self, field: &Field) -> u16 {
        self.get(field) as u16
    }

    /// A field of at most 32 bits.
    pub(super) fn u32(&self, field: &Field) -> u32 {
        self.get(field) as u32
    }

    /// A field in two's complement.
    pub(super) fn signed(&self, field: &Field) -> i32 {
        let unused = 32 - field.width;
        (self.get(field) as i32) << unused >> unused
    }

    /// The value of an enumeration, or the error that names the field.
    pub(super) fn known<T>(&self, field: &Field, from_wire: fn(u8) -> Option<T>) -> Result<T, DecodeError> {
        from_wire(self.u8(field)).ok_or_else(|| self.refused(field))
    }

    /// The error that `field` holds a value that its table does not name.
    pub(super) fn refused(&self, field: &Field) -> DecodeError {
        DecodeError::Field {
            id: self.id,
            field: field.name,
            value: self.u32(field),
        }
    }

    /// Refuses the frame if one of these bits is set.
    pub(super) fn expect_zero(&self, reserved: &[Field]) -> Result<(), DecodeError> {
        match reserved.iter().find(|field| self.get(field) != 0) {
            Some(field) => Err(self.refused(field)),
            None => Ok(()),
        }
    }

    /// The counter of a protected frame; 15 is refused.
    pub(super) fn counter(&self) -> Result<u8, DecodeError> {
        match self.u8(&COUNTER) {
            counter if counter < COUNTER_MODULO => Ok(counter),
            _ => Err(self.refused(&COUNTER)),
        }
    }

    /// The session of a frame from the host; 0 is refused.
    pub(super) fn session(&self) -> Result<u8, DecodeError> {
        match self.u8(&SESSION) {
            0 => Err(self.refused(&SESSION)),
            session => Ok(session),
        }
    }
}

/// Refuses a frame of another length.
pub(super) fn expect_length(frame: &Frame, expected: u8) -> Result<(), DecodeError> {
    if frame.len != expected {
        return Err(DecodeError::Length {
            id: frame.id,
            len: frame.len,
            expected,
        });
    }
    Ok(())
}

/// Refuses a frame whose CRC-8 differs from the computed one.
pub(super) fn check_crc(id: u16, found: u8, expected: u8) -> Result<(), DecodeError> {
    if found != expected {
        return Err(DecodeError::Crc { id, found, expected });
    }
    Ok(())
}

/// A protected frame: `bits` with the counter at bit 8 and the CRC-8 in byte 0.
pub(super) fn seal(kind: FrameKind, node: u8, counter: u8, bits: u64) -> Frame {
    let mut data = (bits | COUNTER.put(counter)).to_le_bytes();
    data[0] = crc8(data_id(kind, node), &data[1..]);
    frame_of(kind.function(), node, u64::from_le_bytes(data))
}

/// A frame of 8 bytes.
pub(super) fn frame_of(function: u16, node: u8, bits: u64) -> Frame {
    Frame {
        id: cob::id(function, node),
        len: 8,
        data: bits.to_le_bytes(),
    }
}
