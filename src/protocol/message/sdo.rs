//! CONFIG_REQUEST (0x600 + N) and CONFIG_ANSWER (0x580 + N): expedited SDO with 4 bytes (CiA 301).

use super::{ConfigAbort, DecodeError, FromRig, ToRig};
use crate::protocol::bits::{Bits, Field, frame_of};
use crate::protocol::cob;
use crate::protocol::frame::Frame;

/// Command byte of a request to write an object.
const WRITE: u8 = 0x23;
/// Command byte of the answer to a write.
const WRITTEN: u8 = 0x60;
/// Command byte of a request to read an object.
const READ: u8 = 0x40;
/// Command byte of the answer to a read.
const VALUE: u8 = 0x43;
/// Command byte of a refusal.
const ABORT: u8 = 0x80;

const COMMAND: Field = Field::new("command", 0, 8);
const INDEX: Field = Field::new("index", 8, 16);
const SUB: Field = Field::new("sub", 24, 8);
const DATA: Field = Field::new("value", 32, 32);
/// The data of a read and of a confirmed write are zero.
const NO_DATA: [Field; 1] = [Field::reserved(32, 32)];

fn encode(function: u16, node: u8, command: u8, index: u16, sub: u8, value: u32) -> Frame {
    let bits = COMMAND.put(command) | INDEX.put(index) | SUB.put(sub) | DATA.put(value);
    frame_of(function, node, bits)
}

pub(super) fn encode_read(node: u8, index: u16, sub: u8) -> Frame {
    encode(cob::CONFIG_REQUEST, node, READ, index, sub, 0)
}

pub(super) fn encode_write(node: u8, index: u16, sub: u8, value: u32) -> Frame {
    encode(cob::CONFIG_REQUEST, node, WRITE, index, sub, value)
}

pub(super) fn decode_request(frame: &Frame) -> Result<ToRig, DecodeError> {
    let bits = Bits::of(frame)?;
    let (index, sub, command) = (bits.u16(&INDEX), bits.u8(&SUB), bits.u8(&COMMAND));
    match command {
        READ if bits.expect_zero(&NO_DATA).is_ok() => Ok(ToRig::ConfigRead { index, sub }),
        WRITE => Ok(ToRig::ConfigWrite {
            index,
            sub,
            value: bits.u32(&DATA),
        }),
        // The host gives up a transfer; one of 4 bytes has nothing to give up.
        ABORT => Err(DecodeError::ForeignId(frame.id)),
        _ => Err(DecodeError::Config { index, sub, command }),
    }
}

pub(super) fn encode_value(node: u8, index: u16, sub: u8, value: u32) -> Frame {
    encode(cob::CONFIG_ANSWER, node, VALUE, index, sub, value)
}

pub(super) fn encode_written(node: u8, index: u16, sub: u8) -> Frame {
    encode(cob::CONFIG_ANSWER, node, WRITTEN, index, sub, 0)
}

pub(super) fn encode_refused(node: u8, index: u16, sub: u8, abort: ConfigAbort) -> Frame {
    encode(cob::CONFIG_ANSWER, node, ABORT, index, sub, abort as u32)
}

pub(super) fn decode_answer(frame: &Frame) -> Result<FromRig, DecodeError> {
    let bits = Bits::of(frame)?;
    let (index, sub, value) = (bits.u16(&INDEX), bits.u8(&SUB), bits.u32(&DATA));
    match bits.u8(&COMMAND) {
        VALUE => Ok(FromRig::ConfigValue { index, sub, value }),
        WRITTEN => {
            bits.expect_zero(&NO_DATA)?;
            Ok(FromRig::ConfigWritten { index, sub })
        }
        ABORT => {
            let abort = ConfigAbort::from_wire(value).ok_or_else(|| bits.refused(&DATA))?;
            Ok(FromRig::ConfigRefused { index, sub, abort })
        }
        _ => Err(bits.refused(&COMMAND)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_command_byte_is_refused() {
        let block_write = encode(cob::CONFIG_REQUEST, 5, 0x2F, 0x2000, 0, 0);
        let refused = DecodeError::Config {
            index: 0x2000,
            sub: 0,
            command: 0x2F,
        };
        assert_eq!(decode_request(&block_write), Err(refused));
    }
}
