//! Serial: one damaged byte, wherever it is, costs at most two frames, and noise costs no memory.

use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, SampleMessage};
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};
use rand::{RngExt, SeedableRng};

const NODE: u8 = 1;
const FRAMES: u16 = 40;

fn frames() -> Vec<Frame> {
    let sample = |tick: u16| {
        FromRig::Sample(SampleMessage {
            counter: (tick % 15) as u8,
            tick,
            force_counts: i32::from(tick) * 257 - 3000,
            displacement_counts: -i32::from(tick),
        })
    };
    (0..FRAMES).map(|tick| sample(tick).encode(NODE)).collect()
}

fn line(frames: &[Frame]) -> Vec<u8> {
    let mut bytes = vec![];
    for frame in frames {
        let mut packet = [0; PACKET_MAX];
        let len = encode(frame, &mut packet);
        bytes.extend_from_slice(&packet[..len]);
    }
    bytes
}

/// Frames that were sent and did not come out; none may come out that was not sent.
fn lost(sent: &[Frame], bytes: &[u8]) -> usize {
    let mut decoder = Decoder::default();
    let received: Vec<Frame> = bytes.iter().filter_map(|&byte| decoder.push(byte)).collect();
    let mut rest = sent.iter();
    for frame in &received {
        assert!(
            rest.any(|sent| sent == frame),
            "{frame:?} was never sent, or came out of order"
        );
    }
    sent.len() - received.len()
}

#[test]
fn t1_a_dropped_byte_loses_at_most_two_frames() {
    let frames = frames();
    let good = line(&frames);
    assert_eq!(lost(&frames, &good), 0);
    for at in 0..good.len() {
        let mut bytes = good.clone();
        bytes.remove(at);
        assert!(lost(&frames, &bytes) <= 2, "byte {at} dropped");
    }
}

#[test]
fn a_changed_byte_loses_at_most_two_frames() {
    let frames = frames();
    let good = line(&frames);
    for at in 0..good.len() {
        for flip in 1..=255 {
            let mut bytes = good.clone();
            bytes[at] ^= flip;
            assert!(lost(&frames, &bytes) <= 2, "byte {at} ^ {flip:#04x}");
        }
    }
}

#[test]
fn an_inserted_byte_loses_at_most_two_frames() {
    let frames = frames();
    let good = line(&frames);
    for at in 0..=good.len() {
        for extra in [0, 1, 2, 3, 13, 0x7F, 0x80, 0xFF] {
            let mut bytes = good.clone();
            bytes.insert(at, extra);
            assert!(lost(&frames, &bytes) <= 2, "{extra:#04x} inserted at {at}");
        }
    }
}

/// The decoder is a plain value without a heap behind it, so its size is all the memory there is.
#[test]
fn t3_ten_megabytes_of_noise_are_survived() {
    assert!(size_of::<Decoder>() <= 512);
    let mut decoder = Decoder::default();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut passed = 0;
    for _ in 0..10_000_000 {
        passed += u32::from(decoder.push(random.random()).is_some());
    }
    // Random packets are mostly too long or no COBS; of the rest one in 65 536 has the right CRC-16.
    assert!(passed <= 5, "{passed} frames out of noise");
    assert!(decoder.errors() > 1000);
    // No delimiter at all: still the same.
    let errors = decoder.errors();
    for _ in 0..10_000_000 {
        assert_eq!(decoder.push(0x55), None);
    }
    assert_eq!(decoder.push(0), None);
    assert_eq!(decoder.errors(), errors + 1);
    let frames = frames();
    let received: Vec<Frame> = line(&frames)
        .into_iter()
        .filter_map(|byte| decoder.push(byte))
        .collect();
    assert_eq!(received, frames);
}
