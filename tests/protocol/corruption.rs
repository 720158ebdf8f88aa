//! Up to three flipped bits in a protected frame never pass for another value (CRC-8 0x2F has distance 4 at our length):
//! all single and double flips, and all triple ones, of a frame of every kind.

use crate::protocol::message::*;

use super::fields::Message;

const NODE: u8 = 1;

fn one_of_each_protected_kind() -> [Message; 6] {
    [
        Message::ToRig(ToRig::Command(CommandMessage {
            counter: 5,
            session: 77,
            tick: 0x1234,
            mode: WireMode::Force,
            counts: -12_345,
            last: false,
        })),
        Message::ToRig(ToRig::Lease(LeaseMessage {
            counter: 14,
            session: 77,
            control_tick: 0xFFFF,
        })),
        Message::ToRig(ToRig::Request(RequestMessage {
            counter: 0,
            session: 1,
            code: RequestCode::Arm,
            argument: 0xDEAD_BEEF,
        })),
        Message::FromRig(FromRig::Emergency(EmergencyMessage {
            code: 0xFF10,
            register: 0x81,
            cause: Cause::ForceLimit,
            state: RigState::Unload,
            tick: 9,
        })),
        Message::FromRig(FromRig::Sample(SampleMessage {
            counter: 3,
            tick: 0x00FF,
            force_counts: 20_000,
            displacement_counts: -12_000,
        })),
        Message::FromRig(FromRig::Status(StatusMessage {
            counter: 1,
            state: RigState::Running,
            cause: Cause::None,
            queue_ms: 100,
            session: 77,
            ack_counter: 4,
            ack_result: RequestResult::Done,
            boot: 0x5A,
            tick_high: 0,
        })),
    ]
}

#[test]
fn one_two_and_three_flipped_bits_never_pass() {
    let mut tried = [0_u32; 3];
    for message in one_of_each_protected_kind() {
        let bits = u64::from_le_bytes(message.encode(NODE).data);
        let mut check = |flips: u64| {
            let mut frame = message.encode(NODE);
            frame.data = (bits ^ flips).to_le_bytes();
            assert!(
                message.decode_alike(&frame, NODE).is_err(),
                "{message:?} with {flips:#018x} flipped"
            );
            tried[flips.count_ones() as usize - 1] += 1;
        };
        for a in 0..64 {
            check(1 << a);
            for b in 0..a {
                check(1 << a | 1 << b);
                for c in 0..b {
                    check(1 << a | 1 << b | 1 << c);
                }
            }
        }
    }
    // Of each of the six frames: 64 single flips, 64 * 63 / 2 double, 64 * 63 * 62 / 6 triple.
    assert_eq!(tried, [6 * 64, 6 * 2016, 6 * 41_664]);
}

#[test]
fn flipped_identifier_bits_never_pass() {
    for message in one_of_each_protected_kind() {
        for bit in 0..11 {
            let mut frame = message.encode(NODE);
            frame.id ^= 1 << bit;
            // The node of the new identifier decodes it.
            let node = (frame.id & 0x7F) as u8;
            let as_command = ToRig::decode(&frame, node);
            let as_answer = FromRig::decode(&frame, node);
            let unprotected = matches!(frame.id & 0x780, 0x580 | 0x600 | 0x700);
            assert!(
                unprotected || as_command.is_err() && as_answer.is_err(),
                "{message:?} as {:#05x}",
                frame.id
            );
        }
    }
}
