//! Any bytes may arrive: nothing panics, and what is accepted is exactly what would have been sent.

use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, ToRig};
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use super::any;

const CASES: u32 = 20_000;

/// A decoded message encodes to the bytes that it was decoded from. Counts the messages of either direction.
fn decode(frame: &Frame, node: u8, accepted: &mut [u32; 2]) -> Result<(), TestCaseError> {
    if let Ok(message) = ToRig::decode(frame, node) {
        prop_assert!(message.encode(node).bytes() == frame.bytes());
        accepted[0] += 1;
    }
    if let Ok(message) = FromRig::decode(frame, node) {
        // Bit 7 of a heartbeat is ignored on purpose.
        let heartbeat = matches!(message, FromRig::Heartbeat { .. });
        prop_assert!(heartbeat || message.encode(node).bytes() == frame.bytes());
        accepted[1] += 1;
    }
    Ok(())
}

#[test]
fn any_frame_is_refused_or_decoded_to_its_own_bytes() {
    let accepted = std::cell::Cell::new([0; 2]);
    let random = (any::<u16>(), any::<u8>(), any::<[u8; 8]>());
    // Random bytes are almost never a message, so the other half of the frames is a message with one byte replaced.
    let frames = (any::message_and_node(), random, 0..8_usize, any::<u8>());
    TestRunner::new(ProptestConfig::with_cases(CASES))
        .run(&frames, |((message, node), (id, len, data), at, byte)| {
            let mut counts = accepted.get();
            let mut replaced = message.encode(node);
            replaced.data[at] = byte;
            for frame in [Frame { id, len, data }, replaced] {
                decode(&frame, node, &mut counts)?;
            }
            accepted.set(counts);
            Ok(())
        })
        .unwrap_or_else(|error| panic!("{error}"));
    let accepted = accepted.get();
    assert!(accepted.iter().all(|&n| n > 100), "{accepted:?} messages decoded");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(CASES))]

    #[test]
    fn after_any_stream_and_a_zero_the_next_packet_is_decoded(
        bytes in prop::collection::vec(prop_oneof![Just(0), any::<u8>()], 0..1000),
        (message, node) in any::message_and_node(),
    ) {
        let mut decoder = Decoder::default();
        for byte in bytes {
            decoder.push(byte);
        }
        decoder.push(0);
        let frame = message.encode(node);
        let mut packet = [0; PACKET_MAX];
        let len = encode(&frame, &mut packet);
        let frames: Vec<Frame> = packet[..len].iter().filter_map(|&byte| decoder.push(byte)).collect();
        prop_assert_eq!(frames, [frame]);
    }
}
