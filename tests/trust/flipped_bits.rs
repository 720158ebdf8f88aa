//! Ten million frames with one, two or three flipped bits, of messages with random content: none passes for another message
//! (CRC-8 0x2F and CRC-16 have distance 4 at these lengths). `tests/protocol/corruption.rs` has every flip of one frame of each kind.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::protocol::frame::Frame;
use crate::protocol::message::*;
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};

const NODE: u8 = 1;
/// Corrupted frames over CAN.
const FRAMES: u32 = 10_000_000;
/// Corrupted packets over a serial line.
const PACKETS: u32 = 1_000_000;

/// A frame of a protected kind with random content.
fn any_frame(rng: &mut ChaCha8Rng) -> Frame {
    let counts = |rng: &mut ChaCha8Rng| rng.random_range(-COUNTS_MAX..=COUNTS_MAX);
    let counter = rng.random_range(0..COUNTER_MODULO);
    match rng.random_range(0..5) {
        0 => ToRig::Command(CommandMessage {
            counter,
            session: rng.random_range(1..=255),
            tick: rng.random(),
            mode: WireMode::Force,
            counts: counts(rng),
            last: rng.random(),
        })
        .encode(NODE),
        1 => ToRig::Lease(LeaseMessage {
            counter,
            session: rng.random_range(1..=255),
            control_tick: rng.random(),
        })
        .encode(NODE),
        2 => ToRig::Request(RequestMessage {
            counter,
            session: rng.random_range(1..=255),
            code: RequestCode::Arm,
            argument: rng.random(),
        })
        .encode(NODE),
        3 => FromRig::Sample(SampleMessage {
            counter,
            tick: rng.random(),
            force_counts: counts(rng),
            displacement_counts: counts(rng),
        })
        .encode(NODE),
        _ => FromRig::Status(StatusMessage {
            counter,
            state: RigState::Running,
            cause: Cause::None,
            queue_ms: rng.random(),
            session: rng.random(),
            ack_counter: rng.random_range(0..16),
            ack_result: RequestResult::Done,
            boot: rng.random(),
            tick_high: rng.random(),
        })
        .encode(NODE),
    }
}

/// One to three different bits of `bits`.
fn flips(rng: &mut ChaCha8Rng, bits: u32) -> u128 {
    let wanted = rng.random_range(1..=3);
    let mut flips = 0_u128;
    while flips.count_ones() < wanted {
        flips |= 1 << rng.random_range(0..bits);
    }
    flips
}

fn is_accepted(frame: &Frame) -> bool {
    ToRig::decode(frame, NODE).is_ok() || FromRig::decode(frame, NODE).is_ok()
}

#[test]
fn l6_ten_million_corrupted_frames_are_all_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let (mut accepted, mut tried) = (0, 0);
    while tried < FRAMES {
        let frame = any_frame(&mut rng);
        assert!(is_accepted(&frame), "a sound frame: {frame:?}");
        // Many corruptions of one frame, because making the frame costs more.
        for _ in 0..100 {
            let mut wrong = frame;
            let bits = u64::from_le_bytes(frame.data) ^ flips(&mut rng, 64) as u64;
            wrong.data = bits.to_le_bytes();
            accepted += u32::from(is_accepted(&wrong));
            tried += 1;
        }
    }
    eprintln!("{tried} frames with 1 to 3 flipped bits: {accepted} accepted");
    assert_eq!(accepted, 0);
}

/// On the line a flipped bit can also change where a packet ends. What then comes out must still be the frame that was sent.
#[test]
fn l6_a_million_corrupted_packets_give_no_other_frame() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut wrong, mut whole) = (0, 0);
    for _ in 0..PACKETS {
        let frame = any_frame(&mut rng);
        let mut packet = [0; PACKET_MAX];
        let len = encode(&frame, &mut packet);
        let flips = flips(&mut rng, 8 * len as u32);
        for (at, byte) in packet[..len].iter_mut().enumerate() {
            *byte ^= (flips >> (8 * at)) as u8;
        }
        let mut decoder = Decoder::default();
        let stream = packet[..len].iter().chain(&[0]);
        for found in stream.filter_map(|byte| decoder.push(*byte)) {
            match found == frame {
                true => whole += 1,
                // What the CRC-16 lets through the CRC-8 of the frame itself still refuses.
                false => wrong += u32::from(is_accepted(&found)),
            }
        }
    }
    eprintln!("{PACKETS} packets with 1 to 3 flipped bits: {wrong} wrong frames, {whole} whole ones");
    assert_eq!(wrong, 0);
}
