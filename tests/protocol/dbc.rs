//! `firmware-protocol.dbc` says what the codec does: every bit of every message is packed from the DBC alone, by other
//! code, and compared.

use std::collections::{BTreeMap, BTreeSet};

use crate::protocol::cob;
use crate::protocol::message::*;
use crate::protocol::protection::crc8;
use can_dbc::{
    AttributeValue, ByteOrder, Dbc, MessageId, MultiplexIndicator, NumericValue, Signal, ValueDescription,
    ValueType,
};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

use super::any;

/// The DBC is written for this node.
const NODE: u8 = 1;

fn dbc() -> Dbc {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/firmware-protocol.dbc");
    let text = std::fs::read_to_string(path).expect("firmware-protocol.dbc");
    Dbc::try_from(text.as_str()).expect("a DBC")
}

/// The 64 bits of a frame, one signal at a time, one bit at a time.
fn pack(signals: &[Signal], values: &BTreeMap<String, i64>) -> [u8; 8] {
    let mut data = [0_u8; 8];
    for signal in signals {
        let value = values
            .get(&signal.name)
            .unwrap_or_else(|| panic!("no value for {}", signal.name));
        for bit in 0..signal.size {
            let at = signal.start_bit + bit;
            data[at as usize / 8] |= ((value >> bit & 1) as u8) << (at % 8);
        }
    }
    data
}

#[test]
fn every_signal_of_every_message_stands_where_the_codec_puts_it() {
    let dbc = dbc();
    let mut runner = TestRunner::deterministic();
    let mut seen = BTreeMap::new();
    for _ in 0..20_000 {
        let message = any::message(NODE)
            .new_tree(&mut runner)
            .expect("a message")
            .current();
        let frame = message.encode(NODE);
        let described = dbc
            .messages
            .iter()
            .find(|described| described.name == message.name());
        let described = described.unwrap_or_else(|| panic!("the DBC has no {}", message.name()));
        assert_eq!(described.id, MessageId::Standard(frame.id), "{}", message.name());
        assert_eq!(described.size, u64::from(frame.len), "{}", message.name());
        let mut values = message.fields();
        if let Some(crc) = described.signals.iter().find(|signal| signal.name == "crc") {
            values.insert("crc".to_owned(), frame.data[crc.start_bit as usize / 8].into());
        }
        assert_eq!(values.len(), described.signals.len(), "{}", message.name());
        assert_eq!(pack(&described.signals, &values), frame.data, "{message:?}");
        *seen.entry(message.name()).or_insert(0) += 1;
    }
    assert_eq!(
        seen.len(),
        dbc.messages.len(),
        "messages of the DBC that were never made"
    );
    assert!(seen.values().all(|&count| count > 500), "{seen:?}");
}

#[test]
fn signals_are_little_endian_plain_and_within_their_range() {
    for message in dbc().messages {
        let mut taken = 0_u64;
        for signal in &message.signals {
            let what = format!("{}.{}", message.name, signal.name);
            assert_eq!(signal.byte_order, ByteOrder::LittleEndian, "{what}");
            assert_eq!(signal.multiplexer_indicator, MultiplexIndicator::Plain, "{what}");
            let mask = ((1_u128 << signal.size) - 1) as u64;
            assert_eq!(taken & mask << signal.start_bit, 0, "{what} overlaps");
            taken |= mask << signal.start_bit;
            assert!(signal.start_bit + signal.size <= 8 * message.size, "{what}");
            let signed = ["force", "displacement", "counts"].contains(&signal.name.as_str());
            assert_eq!(signal.value_type == ValueType::Signed, signed, "{what}");
        }
    }
}

fn number(value: NumericValue) -> f64 {
    match value {
        NumericValue::Uint(value) => value as f64,
        NumericValue::Int(value) => value as f64,
        NumericValue::Double(value) => value,
    }
}

#[test]
fn scales_and_ranges_are_those_of_the_code() {
    let dbc = dbc();
    let signal = |name| {
        dbc.signal_by_name(MessageId::Standard(cob::SAMPLE + 1), name)
            .expect("a signal")
    };
    for (name, scale, unit) in [
        ("force", FORCE_N_PER_COUNT, "N"),
        ("displacement", DISPLACEMENT_MM_PER_COUNT, "mm"),
    ] {
        let signal = signal(name);
        assert_eq!(
            (signal.factor, signal.offset, signal.unit.as_str()),
            (scale, 0.0, unit)
        );
        // The DBC has four decimals.
        assert!((number(signal.min) - f64::from(COUNTS_INVALID) * scale).abs() < 1e-9);
        assert!((number(signal.max) - f64::from(COUNTS_MAX) * scale).abs() < 1e-9);
    }
}

/// The attribute "DataId" of each message with a CRC-8 gives that CRC.
#[test]
fn data_ids_of_the_dbc_are_those_of_the_codec() {
    let dbc = dbc();
    let mut runner = TestRunner::deterministic();
    let mut seen = BTreeSet::new();
    for _ in 0..2_000 {
        let message = any::message(NODE)
            .new_tree(&mut runner)
            .expect("a message")
            .current();
        let frame = message.encode(NODE);
        let attribute = dbc.attribute_values_message.iter().find(|attribute| {
            attribute.name == "DataId" && attribute.message_id == MessageId::Standard(frame.id)
        });
        assert_eq!(attribute.is_some(), message.is_protected(), "{}", message.name());
        let Some(attribute) = attribute else { continue };
        let data_id = match attribute.value {
            AttributeValue::Uint(value) => value as u16,
            AttributeValue::Int(value) => value as u16,
            ref other => panic!("{}: {other:?}", message.name()),
        };
        let (found, rest) = match message.name() {
            "EMERGENCY" => (frame.data[7], &frame.data[..7]),
            _ => (frame.data[0], &frame.data[1..]),
        };
        assert_eq!(crc8(data_id, rest), found, "{}", message.name());
        seen.insert(message.name());
    }
    assert_eq!(seen.len(), 6, "{seen:?}");
}

/// Enumerations of the DBC by signal: value and name.
fn enumeration(dbc: &Dbc, message: u16, signal: &str) -> Vec<(i64, String)> {
    let mut found: Vec<(i64, String)> = dbc
        .value_descriptions
        .iter()
        .filter_map(|description| match description {
            ValueDescription::Signal {
                message_id,
                name,
                value_descriptions,
            } if *message_id == MessageId::Standard(message) && name == signal => Some(value_descriptions),
            _ => None,
        })
        .flatten()
        .map(|value| (value.id, value.description.clone()))
        .collect();
    found.sort();
    found
}

/// As serde names it: the name that the daemon shows.
fn snake(name: String) -> String {
    let mut out = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(letter.to_lowercase());
    }
    out
}

#[test]
fn enumerations_are_those_of_the_code() {
    fn names<T: Copy + std::fmt::Debug>(all: &[T], wire: fn(T) -> i64) -> Vec<(i64, String)> {
        let mut names: Vec<_> = all
            .iter()
            .map(|&one| (wire(one), snake(format!("{one:?}"))))
            .collect();
        names.sort();
        names
    }
    let dbc = dbc();
    let states = names(&RigState::ALL, |state| state as i64);
    let causes = names(&Cause::ALL, |cause| cause as i64);
    assert_eq!(enumeration(&dbc, cob::STATUS + 1, "state"), states);
    assert_eq!(enumeration(&dbc, cob::EMERGENCY + 1, "state"), states);
    assert_eq!(enumeration(&dbc, cob::STATUS + 1, "cause"), causes);
    assert_eq!(enumeration(&dbc, cob::EMERGENCY + 1, "cause"), causes);
    assert_eq!(
        enumeration(&dbc, cob::STATUS + 1, "ack_result"),
        names(&RequestResult::ALL, |one| one as i64)
    );
    assert_eq!(
        enumeration(&dbc, cob::REQUEST + 1, "code"),
        names(&RequestCode::ALL, |one| one as i64)
    );
    assert_eq!(
        enumeration(&dbc, cob::COMMAND + 1, "mode"),
        names(&WireMode::ALL, |one| one as i64)
    );
    assert_eq!(
        enumeration(&dbc, cob::HEARTBEAT + 1, "state"),
        names(&NmtState::ALL, |one| one as i64)
    );
    assert_eq!(
        enumeration(&dbc, cob::NMT, "command"),
        names(&NmtCommand::ALL, |one| one as i64)
    );
}
