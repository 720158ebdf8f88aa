//! Whatever arrives, nothing panics, and what is accepted is exactly what would have been sent.

use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, ToRig};
use crate::protocol::serial_framing::Decoder;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    #[test]
    fn any_frame(id in any::<u16>(), len in any::<u8>(), data in any::<[u8; 8]>(), node in any::<u8>()) {
        // Any node may ask; half of the identifiers are made to fit it, or almost none would be looked into.
        for id in [id, id & 0x780 | u16::from(node & 0x7F)] {
            for len in [len, 8] {
                let frame = Frame { id, len, data };
                let _ = frame.bytes();
                if let Ok(message) = ToRig::decode(&frame, node) {
                    prop_assert!(message.encode(node).bytes() == frame.bytes());
                }
                if let Ok(message) = FromRig::decode(&frame, node) {
                    // Bit 7 of a heartbeat is ignored on purpose.
                    let heartbeat = matches!(message, FromRig::Heartbeat { .. });
                    prop_assert!(heartbeat || message.encode(node).bytes() == frame.bytes());
                }
            }
        }
    }

    #[test]
    fn any_stream(bytes in prop::collection::vec(prop_oneof![Just(0), any::<u8>()], 0..1000)) {
        let mut decoder = Decoder::default();
        for byte in bytes {
            decoder.push(byte);
        }
    }
}
