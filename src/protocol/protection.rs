//! Protection of the content of frames: CRC-8 with data id, the alternating counter, the CRC-32 of the limits. What to
//! do about a bad frame is left to firmware and control.

use super::cob;
use super::dictionary::Limits;

/// CRC-8 0x2F (AUTOSAR CRC8H2F): Hamming distance 4 up to 119 protected bits; here 72 bits with the data id.
static CRC8: crc::Crc<u8> = crc::Crc::<u8>::new(&crc::CRC_8_AUTOSAR);
/// CRC-32 as in Ethernet and zip.
static CRC32: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Kind of a protected message: the high byte of its data id. Each message has its own, so that a frame that is looped
/// back or sent under a wrong identifier fails the CRC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum FrameKind {
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

impl FrameKind {
    /// Function of the message's identifier.
    pub(super) fn function(self) -> u16 {
        match self {
            FrameKind::Sample => cob::SAMPLE,
            FrameKind::Status => cob::STATUS,
            FrameKind::Emergency => cob::EMERGENCY,
            FrameKind::Command => cob::COMMAND,
            FrameKind::Lease => cob::LEASE,
            FrameKind::Request => cob::REQUEST,
        }
    }
}

/// Data id of a message: kind in the high byte, node in the low byte.
pub(crate) fn data_id(kind: FrameKind, node: u8) -> u16 {
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

/// Size of the alternating counter: it counts 0 to 14 and wraps; 15 is never sent.
pub(crate) const COUNTER_MODULO: u8 = 15;

/// The counter after `counter`.
pub(crate) fn next_counter(counter: u8) -> u8 {
    (counter + 1) % COUNTER_MODULO
}

/// Most frames in a row that may be missing without a wrong sequence.
pub(crate) const MAX_LOST: u8 = 3;

/// What a counter says about its frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sequence {
    /// Use the frame. At most [`MAX_LOST`] frames before it are missing; or it is the first one; or it follows a single frame
    /// out of sequence by one, which means that the sender restarted or more frames are missing. Only the tick can tell
    /// how many samples are missing.
    Usable,
    /// The same counter again: drop the frame and count it.
    Repeated,
    /// Late, replayed or foreign: drop the frame and count it.
    Wrong,
}

/// Follows the counter of one stream of frames. Only for frames with a good CRC.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct CounterCheck {
    /// Counter of the last frame used.
    last: Option<u8>,
    /// Counter of the newest frame out of sequence since then.
    stray: Option<u8>,
}

impl CounterCheck {
    /// Checks the next frame's `counter` (0 to 14).
    pub(crate) fn check(&mut self, counter: u8) -> Sequence {
        let Some(last) = self.last else {
            self.last = Some(counter);
            return Sequence::Usable;
        };
        match distance(last, counter) {
            0 => return Sequence::Repeated,
            d if d <= MAX_LOST + 1 => {}
            _ if self.stray.is_some_and(|stray| distance(stray, counter) == 1) => {}
            _ => {
                // `last` stays: a single late frame must not make the good frames after it look wrong.
                self.stray = Some(counter);
                return Sequence::Wrong;
            }
        }
        self.last = Some(counter);
        self.stray = None;
        Sequence::Usable
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

    #[test]
    fn check_values_of_the_catalogue() {
        // "123456789": the first two bytes stand in for the data id.
        assert_eq!(crc8(u16::from_le_bytes(*b"12"), b"3456789"), 0xDF);
        assert_eq!(CRC32.checksum(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn another_node_or_kind_changes_the_crc() {
        let bytes = [1, 2, 3, 4, 5, 6, 7];
        let own = crc8(data_id(FrameKind::Sample, 5), &bytes);
        for node in (0..=127).filter(|&node| node != 5) {
            assert_ne!(crc8(data_id(FrameKind::Sample, node), &bytes), own, "node {node}");
        }
        for kind in [
            FrameKind::Status,
            FrameKind::Emergency,
            FrameKind::Command,
            FrameKind::Lease,
            FrameKind::Request,
        ] {
            assert_ne!(crc8(data_id(kind, 5), &bytes), own, "{kind:?}");
        }
    }

    #[test]
    fn counter_in_order_lost_repeated() {
        let mut check = CounterCheck::default();
        for (counter, expected) in [
            (13, Sequence::Usable),
            (14, Sequence::Usable),
            (0, Sequence::Usable),
            (0, Sequence::Repeated),
            // One frame lost, then three, then four.
            (2, Sequence::Usable),
            (6, Sequence::Usable),
            (11, Sequence::Wrong),
            (7, Sequence::Usable),
        ] {
            assert_eq!(check.check(counter), expected, "counter {counter}");
        }
    }

    /// Only ticks can tell long gaps: n lost frames look like (n + 1) mod 15 steps.
    #[test]
    fn a_loss_of_fifteen_frames_looks_like_none() {
        for (lost, expected) in [
            (13, Sequence::Wrong),
            (14, Sequence::Repeated),
            (15, Sequence::Usable),
            (18, Sequence::Usable),
            (19, Sequence::Wrong),
            (30, Sequence::Usable),
        ] {
            let mut check = CounterCheck::default();
            check.check(4);
            assert_eq!(
                check.check((4 + lost + 1) % COUNTER_MODULO),
                expected,
                "{lost} lost"
            );
        }
    }

    #[test]
    fn a_late_frame_does_not_disturb_the_stream() {
        let mut check = CounterCheck::default();
        check.check(4);
        assert_eq!(check.check(6), Sequence::Usable);
        assert_eq!(check.check(5), Sequence::Wrong);
        assert_eq!(check.check(7), Sequence::Usable);
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
                // After a jump of 14 the next one repeats the last good counter: one more frame is needed.
                if jump == COUNTER_MODULO - 1 {
                    assert_eq!(after, Sequence::Repeated);
                } else {
                    assert_eq!(after, Sequence::Usable, "{start} + {jump}");
                }
            }
        }
    }
}
