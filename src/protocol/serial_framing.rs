//! Frames over a byte stream: COBS packets with a CRC-16, each ended by a zero. After any error the decoder goes on at the
//! next zero. Ports and time-outs are left to `link::serial`.

use super::cob;
use super::frame::Frame;

/// CRC-16/IBM-3740 (poly 0x1021, init 0xFFFF, often "CCITT-FALSE"): Hamming distance 4 over 112 bits.
static CRC16: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_IBM_3740);

/// Bytes of identifier and CRC around the payload.
const OVERHEAD_BYTES: usize = 4;
/// Longest packet before COBS in bytes: identifier, payload of 8 bytes, CRC.
const RAW_MAX: usize = OVERHEAD_BYTES + 8;
/// Longest packet on the line in bytes: COBS adds one byte, the closing zero another.
pub(crate) const PACKET_MAX: usize = RAW_MAX + 2;
/// Bytes that the decoder holds at most. More bytes without a zero are noise.
const BUFFER_BYTES: usize = 256;

/// The CRC-16 of a packet's identifier and payload.
fn crc16(bytes: &[u8]) -> u16 {
    CRC16.checksum(bytes)
}

/// Writes `frame` as a packet, the closing zero included, and returns the packet's length.
pub(crate) fn encode(frame: &Frame, packet: &mut [u8; PACKET_MAX]) -> usize {
    let mut raw = [0; RAW_MAX];
    let payload = frame.bytes();
    let end = 2 + payload.len();
    raw[..2].copy_from_slice(&frame.id.to_le_bytes());
    raw[2..end].copy_from_slice(payload);
    let crc = crc16(&raw[..end]);
    raw[end..end + 2].copy_from_slice(&crc.to_le_bytes());
    // PACKET_MAX has room for the longest raw packet.
    let len = cobs::encode(&raw[..end + 2], packet);
    packet[len] = 0;
    len + 1
}

/// Turns bytes into frames, one byte at a time. Holds [`BUFFER_BYTES`] and never allocates.
#[derive(Debug)]
pub(crate) struct Decoder {
    buffer: [u8; BUFFER_BYTES],
    len: usize,
    overlong: bool,
    /// No zero has come yet: the bytes may be the tail of a packet that began before the decoder did.
    fresh: bool,
    errors: u64,
}

impl Default for Decoder {
    fn default() -> Self {
        Decoder {
            buffer: [0; BUFFER_BYTES],
            len: 0,
            overlong: false,
            fresh: true,
            errors: 0,
        }
    }
}

impl Decoder {
    /// Takes the next byte. Returns the frame if the byte ended a good packet.
    pub(crate) fn push(&mut self, byte: u8) -> Option<Frame> {
        if byte != 0 {
            match self.buffer.get_mut(self.len) {
                Some(slot) => {
                    *slot = byte;
                    self.len += 1;
                }
                None => self.overlong = true,
            }
            return None;
        }
        // Several zeros in a row are an idle line, not packets.
        if self.len == 0 {
            return None;
        }
        let packet = self.buffer.get_mut(..self.len).filter(|_| !self.overlong);
        let frame = packet.and_then(decode);
        if frame.is_none() && !self.fresh {
            self.errors += 1;
        }
        self.len = 0;
        self.overlong = false;
        self.fresh = false;
        frame
    }

    /// Packets dropped because COBS, length, CRC-16 or identifier was wrong. The first packet after the start is not
    /// counted, because a receiver may start in the middle of a packet.
    pub(crate) fn errors(&self) -> u64 {
        self.errors
    }
}

/// The frame of one packet without its closing zero.
fn decode(packet: &mut [u8]) -> Option<Frame> {
    let len = cobs::decode_in_place(packet).ok()?;
    let raw = packet.get(..len)?;
    let (body, crc) = raw.split_last_chunk::<2>()?;
    let (id, payload) = body.split_first_chunk::<2>()?;
    let id = u16::from_le_bytes(*id);
    let good = payload.len() <= 8 && id <= cob::ID_MAX && crc16(body) == u16::from_le_bytes(*crc);
    good.then(|| Frame::new(id, payload))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(frame: &Frame) -> Vec<u8> {
        let mut packet = [0; PACKET_MAX];
        let len = encode(frame, &mut packet);
        packet[..len].to_vec()
    }

    fn feed(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Frame> {
        bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
    }

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc16(b"123456789"), 0x29B1);
    }

    #[test]
    fn frames_of_every_length_come_back() {
        let mut decoder = Decoder::default();
        for len in 0..=8 {
            let frame = Frame::new(0x100 * len as u16 % 0x7FF, &[0, 1, 0, 0xFF, 0, 0, 7, 0][..len]);
            let bytes = packet(&frame);
            assert_eq!(
                bytes.iter().filter(|&&byte| byte == 0).count(),
                1,
                "one zero, at the end"
            );
            assert_eq!(feed(&mut decoder, &bytes), [frame]);
        }
        assert_eq!(decoder.errors(), 0);
    }

    #[test]
    fn starting_in_the_middle_of_a_packet_is_no_error() {
        let mut decoder = Decoder::default();
        let frame = Frame::new(0x185, &[1, 2, 3]);
        let bytes = packet(&frame);
        assert_eq!(feed(&mut decoder, &bytes[3..]), []);
        assert_eq!(feed(&mut decoder, &bytes), [frame]);
        assert_eq!(decoder.errors(), 0);
        assert_eq!(feed(&mut decoder, &bytes[3..]), []);
        assert_eq!(decoder.errors(), 1);
    }

    #[test]
    fn too_long_is_one_error_and_the_next_packet_is_good() {
        let mut decoder = Decoder::default();
        let frame = Frame::new(0x185, &[1, 2, 3]);
        feed(&mut decoder, &packet(&frame));
        assert_eq!(feed(&mut decoder, &[0x55; 10 * BUFFER_BYTES]), []);
        assert_eq!(feed(&mut decoder, &[0]), []);
        assert_eq!(feed(&mut decoder, &packet(&frame)), [frame]);
        assert_eq!(decoder.errors(), 1);
    }

    #[test]
    fn an_identifier_beyond_11_bits_is_refused() {
        let mut decoder = Decoder::default();
        let frame = Frame {
            id: 0x985,
            len: 0,
            data: [0; 8],
        };
        assert_eq!(feed(&mut decoder, &packet(&frame)), []);
    }
}
