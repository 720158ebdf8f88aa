//! Every message comes back as it went, over CAN frames and serial packets.

use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};
use proptest::prelude::*;

use super::any;
use super::fields::Message;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn message_to_frame_and_back((message, node) in any::message_and_node()) {
        let frame = message.encode(node);
        prop_assert_eq!(message.decode_alike(&frame, node), Ok(message));
        // Nothing but what it means: encoding what was decoded gives the same bytes.
        prop_assert_eq!(Message::build(message.name(), &message.fields()).encode(node), frame);
    }

    #[test]
    fn frame_to_packet_and_back((message, node) in any::message_and_node()) {
        let frame = message.encode(node);
        let mut packet = [0; PACKET_MAX];
        let len = encode(&frame, &mut packet);
        let mut decoder = Decoder::default();
        let frames: Vec<_> = packet[..len].iter().filter_map(|&byte| decoder.push(byte)).collect();
        prop_assert_eq!(frames, [frame]);
    }

    #[test]
    fn another_nodes_frame_means_nothing((message, node) in any::message_and_node(), other in 1..=126u8) {
        prop_assume!(other != node);
        let mut frame = message.encode(node);
        let own = message.fields().get("node") == Some(&0);
        prop_assert!(own || message.decode_alike(&frame, other).is_err());
        // Sent under the other's identifier, the protected ones still do not pass: their data id has the node in it.
        if message.is_protected() {
            frame.id = frame.id & 0x780 | u16::from(other);
            prop_assert!(message.decode_alike(&frame, other).is_err());
        }
    }
}
