//! Any message at all, for property tests.

use crate::protocol::message::*;
use proptest::prelude::*;
use proptest::sample::select;

use super::fields::Message;

fn counter() -> impl Strategy<Value = u8> {
    0..COUNTER_MODULO
}

fn counts(from: i32) -> impl Strategy<Value = i32> {
    prop_oneof![Just(from), Just(COUNTS_MAX), Just(0), Just(-1), from..=COUNTS_MAX]
}

fn to_rig(node: u8) -> impl Strategy<Value = ToRig> {
    prop_oneof![
        (select(&NmtCommand::ALL[..]), select(vec![0, node]))
            .prop_map(|(command, node)| ToRig::Nmt { command, node }),
        (
            counter(),
            1..=u8::MAX,
            any::<u16>(),
            select(&WireMode::ALL[..]),
            counts(-COUNTS_MAX),
            any::<bool>()
        )
            .prop_map(|(counter, session, tick, mode, counts, last)| {
                ToRig::Command(CommandMessage {
                    counter,
                    session,
                    tick,
                    mode,
                    counts,
                    last,
                })
            }),
        (counter(), 1..=u8::MAX, any::<u16>()).prop_map(|(counter, session, control_tick)| ToRig::Lease(
            LeaseMessage {
                counter,
                session,
                control_tick
            }
        )),
        (
            counter(),
            1..=u8::MAX,
            select(&RequestCode::ALL[..]),
            any::<u32>()
        )
            .prop_map(
                |(counter, session, code, argument)| ToRig::Request(RequestMessage {
                    counter,
                    session,
                    code,
                    argument
                })
            ),
        (any::<u16>(), any::<u8>()).prop_map(|(index, sub)| ToRig::ConfigRead { index, sub }),
        (any::<u16>(), any::<u8>(), any::<u32>()).prop_map(|(index, sub, value)| ToRig::ConfigWrite {
            index,
            sub,
            value
        }),
    ]
}

fn from_rig() -> impl Strategy<Value = FromRig> {
    let state = || select(&RigState::ALL[..]);
    let cause = || select(&Cause::ALL[..]);
    let result = select(&RequestResult::ALL[..]);
    prop_oneof![
        select(&NmtState::ALL[..]).prop_map(|state| FromRig::Heartbeat { state }),
        (any::<u16>(), any::<u8>(), cause(), state(), any::<u16>()).prop_map(
            |(code, register, cause, state, tick)| FromRig::Emergency(EmergencyMessage {
                code,
                register,
                cause,
                state,
                tick
            })
        ),
        (
            counter(),
            any::<u16>(),
            counts(COUNTS_INVALID),
            counts(COUNTS_INVALID)
        )
            .prop_map(|(counter, tick, force_counts, displacement_counts)| {
                FromRig::Sample(SampleMessage {
                    counter,
                    tick,
                    force_counts,
                    displacement_counts,
                })
            }),
        (
            (counter(), state(), cause(), any::<u8>(), any::<u8>()),
            (0..16u8, result, any::<u8>(), any::<u8>())
        )
            .prop_map(|(first, second)| {
                let (counter, state, cause, queue_ms, session) = first;
                let (ack_counter, ack_result, boot, tick_high) = second;
                FromRig::Status(StatusMessage {
                    counter,
                    state,
                    cause,
                    queue_ms,
                    session,
                    ack_counter,
                    ack_result,
                    boot,
                    tick_high,
                })
            }),
        (any::<u16>(), any::<u8>(), any::<u32>()).prop_map(|(index, sub, value)| FromRig::ConfigValue {
            index,
            sub,
            value
        }),
        (any::<u16>(), any::<u8>()).prop_map(|(index, sub)| FromRig::ConfigWritten { index, sub }),
        (any::<u16>(), any::<u8>(), select(&ConfigAbort::ALL[..]))
            .prop_map(|(index, sub, abort)| FromRig::ConfigRefused { index, sub, abort }),
    ]
}

/// Any message that `node` may send or be sent.
pub fn message(node: u8) -> impl Strategy<Value = Message> {
    prop_oneof![
        to_rig(node).prop_map(Message::ToRig),
        from_rig().prop_map(Message::FromRig)
    ]
}

/// Any message and its node.
pub fn message_and_node() -> impl Strategy<Value = (Message, u8)> {
    (1..=126u8).prop_flat_map(|node| (message(node), Just(node)))
}
