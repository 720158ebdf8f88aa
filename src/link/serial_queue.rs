//! Packets that wait for a serial port: urgent ones first, but never inside a packet that is half written. The port and its
//! bytes are left to `serial`.

use crate::protocol::frame::Frame;
use crate::protocol::serial_framing::{self, PACKET_MAX};
use crate::units::NS_PER_MS;

/// Bytes that ordinary packets may fill: some 1100 packets. A poll sends 300 at most, after a pause of 100 ms.
const ORDINARY_BYTES: usize = 16 * 1024;
/// Bytes that urgent packets may fill in addition: some 70 packets.
const URGENT_BYTES: usize = 1024;
/// A peer that does not accept a packet within this time has stopped reading.
const DEADLINE_NS: u64 = 20 * NS_PER_MS;

/// The bytes of the waiting packets. Never allocates after `new`.
pub(super) struct PacketQueue {
    bytes: Vec<u8>,
    /// Packets in `bytes`, a half-written one included.
    packets: u64,
    /// Length of the front part: the rest of a half-written packet and the urgent packets.
    front: usize,
    /// Newest byte that the port accepted. It is 0 between two packets: a packet holds no other zero.
    accepted: u8,
    /// Time since which the first packet waits, ns.
    waits_since_ns: Option<u64>,
}

impl PacketQueue {
    /// A queue for a port that was just opened. A leading zero ends what the other end has received so far: noise, or a packet
    /// that was cut off.
    pub(super) fn new() -> Self {
        let mut bytes = Vec::with_capacity(ORDINARY_BYTES + URGENT_BYTES);
        bytes.push(0);
        PacketQueue {
            bytes,
            packets: 0,
            front: 1,
            accepted: 0,
            waits_since_ns: None,
        }
    }

    /// Puts `frame` at the end, an urgent one behind the earlier urgent ones. False if there is no room.
    pub(super) fn push(&mut self, frame: &Frame, urgent: bool) -> bool {
        let mut packet = [0; PACKET_MAX];
        let len = serial_framing::encode(frame, &mut packet);
        let room = ORDINARY_BYTES + if urgent { URGENT_BYTES } else { 0 };
        let Some(packet) = packet.get(..len).filter(|_| self.bytes.len() + len <= room) else {
            return false;
        };
        self.bytes.extend_from_slice(packet);
        self.packets += 1;
        if urgent {
            if let Some(after_front) = self.bytes.get_mut(self.front..) {
                after_front.rotate_right(len);
            }
            self.front += len;
        }
        true
    }

    /// All waiting bytes in the order in which they must be written.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// True if a packet waits. The leading zero alone waits for the first packet.
    pub(super) fn has_packets(&self) -> bool {
        self.packets > 0
    }

    /// The port accepted the first `count` bytes at `now_ns`.
    pub(super) fn accept(&mut self, count: usize, now_ns: u64) {
        let packets_before = self.packets;
        for byte in self.bytes.drain(..count.min(self.bytes.len())) {
            // Several zeros in a row end one packet.
            if byte == 0 && self.accepted != 0 {
                self.packets = self.packets.saturating_sub(1);
            }
            self.accepted = byte;
        }
        self.front = self.front.saturating_sub(count).max(self.half_written());
        if self.packets == 0 {
            self.waits_since_ns = None;
        } else if self.packets < packets_before || self.waits_since_ns.is_none() {
            self.waits_since_ns = Some(now_ns);
        }
    }

    /// True if the first packet has waited for more than 20 ms.
    pub(super) fn is_overdue(&self, now_ns: u64) -> bool {
        self.waits_since_ns
            .is_some_and(|since_ns| now_ns.saturating_sub(since_ns) > DEADLINE_NS)
    }

    /// Drops all packets except the urgent ones and returns how many. A late frame is worse than a lost one; a late abort is not.
    pub(super) fn drop_ordinary(&mut self) -> u64 {
        let before = self.packets;
        self.bytes.truncate(self.front);
        let cut = self.half_written();
        self.bytes.drain(..cut);
        // Ends the packet that was cut off, or completes it if only its closing zero was missing.
        let completed = u64::from(cut == 1);
        if self.bytes.first() != Some(&0) {
            self.bytes.insert(0, 0);
        }
        self.front = self.bytes.len();
        self.packets = packets_in(&self.bytes);
        self.accepted = 0;
        self.waits_since_ns = None;
        before - self.packets - completed
    }

    /// Bytes of the first packet that still wait, if the port accepted a part of it; else 0.
    fn half_written(&self) -> usize {
        if self.accepted == 0 {
            return 0;
        }
        let end = self.bytes.iter().position(|&byte| byte == 0);
        end.map_or(0, |end| end + 1)
    }
}

/// Whole packets in `bytes`: zeros that follow another byte.
fn packets_in(bytes: &[u8]) -> u64 {
    let ends = bytes
        .windows(2)
        .filter(|pair| matches!(pair, [byte, 0] if *byte != 0));
    ends.count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::serial_framing::Decoder;

    const MS: u64 = NS_PER_MS;

    fn frame(number: u8) -> Frame {
        Frame::new(0x200 + u16::from(number), &[number, 0, number])
    }

    /// Numbers of the frames in `bytes`, and the packets that could not be read.
    fn numbers(bytes: &[u8]) -> (Vec<u8>, u64) {
        let mut decoder = Decoder::default();
        // The first packet of a decoder may be the tail of one that began before it; here nothing did.
        decoder.push(1);
        decoder.push(0);
        let frames = bytes.iter().filter_map(|&byte| decoder.push(byte));
        (frames.map(|frame| frame.bytes()[0]).collect(), decoder.errors())
    }

    /// Accepts `count` bytes as a port does, and keeps them.
    fn take(queue: &mut PacketQueue, count: usize, now_ns: u64, into: &mut Vec<u8>) {
        into.extend_from_slice(&queue.bytes()[..count]);
        queue.accept(count, now_ns);
    }

    #[test]
    fn an_urgent_frame_passes_the_others_and_never_cuts_one() {
        // However many bytes of the ordinary packets are written before.
        for written in 0..20 {
            let mut queue = PacketQueue::new();
            let mut line = Vec::new();
            (1..=3).for_each(|n| assert!(queue.push(&frame(n), false)));
            take(&mut queue, written, 0, &mut line);
            assert!(queue.push(&frame(10), true) && queue.push(&frame(11), true));
            take(&mut queue, 2, 0, &mut line);
            assert!(queue.push(&frame(12), true));
            while queue.has_packets() {
                take(&mut queue, 1, 0, &mut line);
            }
            let (found, errors) = numbers(&line);
            let begun = (written + 7) / 9;
            let mut expected: Vec<u8> = (1..=3).collect();
            let at = begun.min(3);
            expected.splice(at..at, [10, 11, 12]);
            assert_eq!((found, errors), (expected, 0), "{written} bytes before");
        }
    }

    #[test]
    fn a_packet_that_waits_for_more_than_20_ms_is_overdue() {
        let mut queue = PacketQueue::new();
        assert!(!queue.is_overdue(100 * MS), "nothing waits");
        queue.push(&frame(1), false);
        queue.push(&frame(2), false);
        queue.accept(0, 100 * MS);
        assert!(!queue.is_overdue(120 * MS));
        assert!(queue.is_overdue(121 * MS));
        // The first packet is through: the second one has its own 20 ms.
        queue.accept(12, 121 * MS);
        assert!(!queue.is_overdue(141 * MS));
        assert!(queue.is_overdue(142 * MS));
    }

    #[test]
    fn after_the_deadline_the_urgent_frames_remain_and_one_packet_is_cut() {
        for written in 0..20 {
            let mut queue = PacketQueue::new();
            let mut line = Vec::new();
            (1..=4).for_each(|n| assert!(queue.push(&frame(n), false)));
            take(&mut queue, written, 0, &mut line);
            queue.push(&frame(9), true);
            let dropped = queue.drop_ordinary();
            queue.push(&frame(5), false);
            let rest = queue.bytes().len();
            take(&mut queue, rest, 0, &mut line);
            let (found, errors) = numbers(&line);
            let through = 4 - dropped as usize;
            let expected: Vec<u8> = (1..=through as u8).chain([9, 5]).collect();
            assert_eq!(found, expected, "{written} bytes before");
            assert!(
                through <= written / 9,
                "{written} bytes before: {through} are through"
            );
            assert!(errors <= 1, "{written} bytes before: {errors} errors");
            assert!(!queue.has_packets());
        }
    }

    #[test]
    fn a_full_queue_still_takes_urgent_frames() {
        let mut queue = PacketQueue::new();
        let capacity = queue.bytes.capacity();
        while queue.push(&frame(1), false) {}
        assert!(queue.push(&frame(2), true));
        while queue.push(&frame(2), true) {}
        assert_eq!(queue.bytes.capacity(), capacity, "nothing was allocated");
    }
}
