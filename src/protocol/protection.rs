//! What guards a frame's meaning: CRC-8 with data id, the alternating counter, the CRC-32 of the configuration.
//! Which frames carry what stands in `codec`; what to do about a bad one is up to firmware and control.

use super::message::{COUNTER_MODULO, Limits};

/// CRC-8 0x2F (AUTOSAR CRC8H2F): distance 4 up to 119 protected bits, ours are 72 with the data id.
static CRC8: crc::Crc<u8> = crc::Crc::<u8>::new(&crc::CRC_8_AUTOSAR);
/// CRC-32 as in Ethernet and zip.
static CRC32: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Kind of a protected message: the high byte of its data id. Another one in each direction, so that a frame that is
/// looped back or sent under a wrong identifier does not pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Kind {
    /// Rig to host, 0x180 + N.
    Sample = 0x51,
    /// Rig to host, 0x280 + N.
    Status = 0x52,
    /// Rig to host, 0x080 + N.
    Emergency = 0x53,
    /// Host to rig, 0x200 + N.
    Command = 0xA1,
    /// Host to rig, 0x300 + N.
    Lease = 0xA2,
    /// Host to rig, 0x400 + N.
    Request = 0xA3,
}

/// Data id of a message: kind in the high byte, node in the low byte.
pub(crate) fn data_id(kind: Kind, node: u8) -> u16 {
    u16::from_le_bytes([node, kind as u8])
}

/// CRC-8 over the data id (low byte first) and then `bytes`, which are all bytes of the frame but the CRC itself.
pub(crate) fn crc8(data_id: u16, bytes: &[u8]) -> u8 {
    let mut digest = CRC8.digest();
    digest.update(&data_id.to_le_bytes());
    digest.update(bytes);
    digest.finalize()
}

impl Limits {
    /// CRC-32 (ISO-HDLC) over sub-indices 1 to 13 as little-endian i32: object 0x2004, and the argument of Arm.
    pub(crate) fn crc32(&self) -> u32 {
        let mut digest = CRC32.digest();
        for value in self.to_array() {
            digest.update(&value.to_le_bytes());
        }
        digest.finalize()
    }
}

/// Most frames in a row that may be missing before a counter says "wrong sequence" instead of "some lost".
pub(crate) const MAX_LOST: u8 = 3;

/// What a counter says about its frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sequence {
    /// First frame seen, or first after [`CounterCheck::reset`]. Use it.
    First,
    /// The next one. Use it.
    Next,
    /// Use it, but this many (1 to [`MAX_LOST`]) before it are missing.
    Lost(u8),
    /// The second of two frames in a row that fit each other, but not what came before: more than `MAX_LOST` are
    /// missing or the sender restarted. Use it; only the tick can tell how many are missing.
    Resynced,
    /// The same counter again: drop it, count it.
    Repeated,
    /// Late, replayed or foreign: drop it, count it.
    Wrong,
}

impl Sequence {
    /// True where the frame is to be used.
    pub(crate) fn is_usable(self) -> bool {
        !matches!(self, Sequence::Repeated | Sequence::Wrong)
    }
}

/// Follows the counter of one stream of frames. Frames with a bad CRC must not reach it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct CounterCheck {
    last: Option<u8>,
    stray: Option<u8>,
}

impl CounterCheck {
    /// Judges the next frame's `counter` (0 to 14, as every decoded frame has it).
    pub(crate) fn check(&mut self, counter: u8) -> Sequence {
        let Some(last) = self.last else {
            self.last = Some(counter);
            return Sequence::First;
        };
        let verdict = match distance(last, counter) {
            0 => return Sequence::Repeated,
            1 => Sequence::Next,
            d if d <= MAX_LOST + 1 => Sequence::Lost(d - 1),
            _ if self.stray.is_some_and(|stray| distance(stray, counter) == 1) => Sequence::Resynced,
            _ => {
                // The stream keeps its place: a single late frame must not make the good ones after it look wrong.
                self.stray = Some(counter);
                return Sequence::Wrong;
            }
        };
        self.last = Some(counter);
        self.stray = None;
        verdict
    }

    /// Forgets the past: a new session, or a rig that booted.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }
}

/// Steps from `from` to `to` on the counter's circle.
fn distance(from: u8, to: u8) -> u8 {
    (to % COUNTER_MODULO + COUNTER_MODULO - from % COUNTER_MODULO) % COUNTER_MODULO
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::message::next_counter;

    #[test]
    fn check_values_of_the_catalogue() {
        // "123456789": the first two bytes stand in for the data id.
        assert_eq!(crc8(u16::from_le_bytes(*b"12"), b"3456789"), 0xDF);
        assert_eq!(CRC32.checksum(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn another_node_or_kind_changes_the_crc() {
        let bytes = [1, 2, 3, 4, 5, 6, 7];
        let own = crc8(data_id(Kind::Sample, 5), &bytes);
        for node in (0..=127).filter(|&node| node != 5) {
            assert_ne!(crc8(data_id(Kind::Sample, node), &bytes), own, "node {node}");
        }
        for kind in [
            Kind::Status,
            Kind::Emergency,
            Kind::Command,
            Kind::Lease,
            Kind::Request,
        ] {
            assert_ne!(crc8(data_id(kind, 5), &bytes), own, "{kind:?}");
        }
    }

    #[test]
    fn counter_in_order_lost_repeated() {
        let mut check = CounterCheck::default();
        assert_eq!(check.check(13), Sequence::First);
        assert_eq!(check.check(14), Sequence::Next);
        assert_eq!(check.check(0), Sequence::Next);
        assert_eq!(check.check(0), Sequence::Repeated);
        assert_eq!(check.check(2), Sequence::Lost(1));
        assert_eq!(check.check(6), Sequence::Lost(3));
        assert_eq!(check.check(11), Sequence::Wrong);
        assert_eq!(check.check(7), Sequence::Next);
    }

    #[test]
    fn a_late_frame_does_not_disturb_the_stream() {
        let mut check = CounterCheck::default();
        check.check(4);
        assert_eq!(check.check(6), Sequence::Lost(1));
        assert_eq!(check.check(5), Sequence::Wrong);
        assert_eq!(check.check(7), Sequence::Next);
    }

    #[test]
    fn two_in_a_row_resynchronise_after_a_long_gap() {
        for start in 0..COUNTER_MODULO {
            for jump in MAX_LOST + 2..COUNTER_MODULO {
                let mut check = CounterCheck::default();
                check.check(start);
                let strange = (start + jump) % COUNTER_MODULO;
                assert_eq!(check.check(strange), Sequence::Wrong, "{start} + {jump}");
                let after = check.check(next_counter(strange));
                // 14 steps on, the next one repeats the last good counter: one more frame is needed.
                if jump == COUNTER_MODULO - 1 {
                    assert_eq!(after, Sequence::Repeated);
                } else {
                    assert_eq!(after, Sequence::Resynced, "{start} + {jump}");
                }
            }
        }
    }
}
