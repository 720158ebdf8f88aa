//! Where bits stand in a frame: the 64 bits in Intel numbering, the seal of protected frames, the checks of fields.
//! Which message has which fields is in `codec`.

use super::codec::cob;
use super::frame::Frame;
use super::message::{COUNTER_MODULO, DecodeError};
use super::protection::{Kind, crc8, data_id};

/// Node part of an identifier.
pub(super) fn id_node(node: u8) -> u16 {
    u16::from(node & 0x7F)
}

/// Function of a frame that carries our node.
pub(super) fn function(frame: &Frame, node: u8) -> Result<u16, DecodeError> {
    if frame.id > 0x7FF || frame.id & !cob::FUNCTION_MASK != u16::from(node) {
        return Err(DecodeError::ForeignId(frame.id));
    }
    Ok(frame.id & cob::FUNCTION_MASK)
}

/// Shape comes first.
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

/// The frame's CRC-8 against the computed one.
pub(super) fn check_crc(id: u16, found: u8, expected: u8) -> Result<(), DecodeError> {
    if found != expected {
        return Err(DecodeError::Crc { id, found, expected });
    }
    Ok(())
}

/// A protected frame: `bits` with the counter at bit 8 and the CRC-8 in byte 0.
pub(super) fn seal(function: u16, kind: Kind, node: u8, counter: u8, bits: u64) -> Frame {
    let mut data = (bits | u64::from(counter & 0xF) << 8).to_le_bytes();
    data[0] = crc8(data_id(kind, node), &data[1..]);
    Frame {
        id: function + id_node(node),
        len: 8,
        data,
    }
}

/// An expedited SDO frame.
pub(super) fn config(function: u16, node: u8, command: u8, index: u16, sub: u8, value: u32) -> Frame {
    let (index, value) = (index.to_le_bytes(), value.to_le_bytes());
    let data = [
        command, index[0], index[1], sub, value[0], value[1], value[2], value[3],
    ];
    Frame {
        id: function + id_node(node),
        len: 8,
        data,
    }
}

/// Two's complement of `counts` in 18 bits.
pub(super) fn from_signed18(counts: i32) -> u64 {
    u64::from(counts as u32 & 0x3_FFFF)
}

/// The 64 bits of a frame of full length, bit 0 the lowest of byte 0 (Intel numbering, as in the DBC).
#[derive(Clone, Copy)]
pub(super) struct Raw {
    pub(super) id: u16,
    pub(super) data: [u8; 8],
}

impl Raw {
    /// Itself, once length and CRC-8 are right.
    pub(super) fn unsealed(self, frame: &Frame, kind: Kind, node: u8) -> Result<Self, DecodeError> {
        expect_length(frame, 8)?;
        check_crc(self.id, self.data[0], crc8(data_id(kind, node), &self.data[1..]))?;
        Ok(self)
    }

    /// `width` bits from `start` on.
    pub(super) fn bits(&self, start: u32, width: u32) -> u64 {
        u64::from_le_bytes(self.data) >> start & ((1 << width) - 1)
    }

    /// 18 bits from `start` on, signed.
    pub(super) fn signed18(&self, start: u32) -> i32 {
        ((self.bits(start, 18) as i32) << 14) >> 14
    }

    /// Index and sub-index of an SDO frame.
    pub(super) fn object(&self) -> (u16, u8) {
        (self.bits(8, 16) as u16, self.bits(24, 8) as u8)
    }

    /// The error that `field` holds `value`.
    pub(super) fn field(&self, field: &'static str, value: u32) -> DecodeError {
        DecodeError::Field {
            id: self.id,
            field,
            value,
        }
    }

    /// Refuses reserved bits that are set.
    pub(super) fn zero(&self, field: &'static str, start: u32, width: u32) -> Result<(), DecodeError> {
        match self.bits(start, width) {
            0 => Ok(()),
            value => Err(self.field(field, value as u32)),
        }
    }

    /// The value of an enumeration, or the error that names it.
    pub(super) fn known<T>(
        &self,
        field: &'static str,
        start: u32,
        width: u32,
        from_wire: fn(u8) -> Option<T>,
    ) -> Result<T, DecodeError> {
        let value = self.bits(start, width);
        from_wire(value as u8).ok_or_else(|| self.field(field, value as u32))
    }

    /// The counter of a protected frame; 15 is none.
    pub(super) fn counter(&self) -> Result<u8, DecodeError> {
        let counter = self.bits(8, 4) as u8;
        if counter >= COUNTER_MODULO {
            return Err(self.field("counter", u32::from(counter)));
        }
        Ok(counter)
    }

    /// The session of a frame from the host; 0 is none.
    pub(super) fn session(&self) -> Result<u8, DecodeError> {
        match self.bits(16, 8) as u8 {
            0 => Err(self.field("session", 0)),
            session => Ok(session),
        }
    }
}
