//! The example frames of `firmware-protocol.md`, both ways, and its tables of codes.

use std::collections::{BTreeMap, BTreeSet};

use crate::config::Bench;
use crate::protocol::frame::Frame;
use crate::protocol::message::*;
use crate::protocol::serial_framing::{PACKET_MAX, encode};

use super::fields::{Fields, Message};

const NODE: u8 = 1;

fn document() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/firmware-protocol.md");
    std::fs::read_to_string(path).expect("firmware-protocol.md")
}

/// Cells of the rows of every table whose header starts with `header`, without backticks.
fn table(header: &[&str]) -> Vec<Vec<String>> {
    let text = document();
    let mut rows = vec![];
    let mut inside = false;
    for line in text.lines() {
        let Some(row) = line.strip_prefix('|') else {
            inside = false;
            continue;
        };
        let cells: Vec<String> = row
            .trim_end_matches('|')
            .split('|')
            .map(|cell| cell.trim().replace('`', ""))
            .collect();
        if cells.iter().zip(header).all(|(cell, name)| cell == name) && cells.len() >= header.len() {
            inside = true;
        } else if inside && !cells[0].starts_with("---") {
            rows.push(cells);
        }
    }
    assert!(!rows.is_empty(), "no table {header:?} in firmware-protocol.md");
    rows
}

fn number(text: &str) -> i64 {
    let parsed = match text.strip_prefix("0x") {
        Some(hex) => i64::from_str_radix(&hex.replace('_', ""), 16),
        None => text.parse(),
    };
    parsed.unwrap_or_else(|_| panic!("{text:?} is no number"))
}

fn bytes(text: &str) -> Vec<u8> {
    text.split(' ')
        .map(|byte| u8::from_str_radix(byte, 16).unwrap_or_else(|_| panic!("{text:?}")))
        .collect()
}

fn fields(text: &str) -> Fields {
    text.split(' ')
        .map(|pair| {
            pair.split_once('=')
                .unwrap_or_else(|| panic!("{pair:?} in {text:?}"))
        })
        .map(|(name, value)| (name.to_owned(), number(value)))
        .collect()
}

#[test]
fn example_frames_of_the_document_both_ways() {
    let mut shown = BTreeSet::new();
    for row in table(&["Message", "Identifier", "Fields", "Bytes", "Serial packet"]) {
        let message = Message::build(&row[0], &fields(&row[2]));
        let frame = Frame::new(number(&row[1]) as u16, &bytes(&row[3]));
        assert_eq!(message.encode(NODE), frame, "{row:?}");
        assert_eq!(message.decode_alike(&frame, NODE), Ok(message), "{row:?}");
        let mut packet = [0; PACKET_MAX];
        let len = encode(&frame, &mut packet);
        assert_eq!(packet[..len], bytes(&row[4]), "{row:?}");
        shown.insert((message.name(), message.fields().get("command").copied()));
    }
    // Each message at least once, each SDO and NMT command too.
    assert_eq!(shown.len(), 7 + NmtCommand::ALL.len() + 5, "{shown:?}");
}

#[test]
fn emergency_codes_of_the_document() {
    let rows = table(&["Cause", "Name", "Code", "Register"]);
    let shown: BTreeMap<i64, (i64, i64)> = rows
        .iter()
        .map(|row| (number(&row[0]), (number(&row[2]), number(&row[3]))))
        .collect();
    for cause in Cause::ALL {
        let (code, register) = cause.emergency();
        assert_eq!(
            shown.get(&(cause as i64)),
            Some(&(code.into(), register.into())),
            "{cause:?}"
        );
    }
    assert_eq!(shown.len(), Cause::ALL.len());
}

#[test]
fn abort_codes_of_the_document() {
    let shown: BTreeSet<i64> = table(&["Abort code", "Meaning"])
        .iter()
        .map(|row| number(&row[0]))
        .collect();
    assert_eq!(
        shown,
        ConfigAbort::ALL.iter().map(|&abort| abort as i64).collect()
    );
}

#[test]
fn objects_of_the_document() {
    let shown: BTreeSet<(i64, i64)> = table(&["Index", "Sub", "Object"])
        .iter()
        .flat_map(|row| {
            // The limits share one row: "1-13".
            let (first, last) = row[1].split_once('-').unwrap_or((&row[1], &row[1]));
            (number(first)..=number(last)).map(move |sub| (number(&row[0]), sub))
        })
        .collect();
    let single = [
        object::DEVICE_TYPE,
        object::VENDOR,
        object::PRODUCT,
        object::REVISION,
        object::SERIAL,
        object::PROTOCOL,
        object::BOOT_ID,
        object::SAMPLE_RATE,
        object::CALIBRATION_HASH,
        object::CONFIGURATION_CRC,
        object::FRAMES_REFUSED,
        object::COMMANDS_DROPPED,
        object::FRAMES_FOREIGN,
    ];
    let limits = (0..=LIMIT_COUNT as u8).map(|sub| (object::LIMITS, sub));
    let known = single
        .into_iter()
        .chain(limits)
        .map(|(index, sub)| (index.into(), sub.into()))
        .collect();
    assert_eq!(shown, known);
}

/// Names, ranges and defaults of the limits.
#[test]
fn limits_of_the_document() {
    let rows = table(&["Sub", "Limit", "Unit", "Lowest", "Highest", "Default"]);
    assert_eq!(rows.len(), LIMIT_COUNT);
    for (i, (row, entry)) in rows.iter().zip(LIMITS).enumerate() {
        let shown = (
            number(&row[0]),
            row[1].as_str(),
            number(&row[3]),
            number(&row[4]),
            number(&row[5]),
        );
        let known = (
            i as i64 + 1,
            entry.name,
            entry.lowest.into(),
            entry.highest.into(),
            entry.default.into(),
        );
        assert_eq!(shown, known);
    }
}

/// The calibration record of the shipped mock bench, its hash, and the frame that stores it.
#[test]
fn worked_calibration_hash_of_the_document() {
    let hash = Bench::shipped().expect("shipped").calibration_hash();
    assert_eq!(
        i64::from(hash),
        number(&table(&["Calibration record", "Hash"])[0][1])
    );
    let (index, sub) = object::CALIBRATION_HASH;
    let frame = ToRig::ConfigWrite {
        index,
        sub,
        value: hash,
    }
    .encode(NODE);
    let typed: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
    let line = format!("cansend can0 {:03X}#{typed}", frame.id);
    assert!(document().contains(&line), "{line}");
}

/// The worked CRC-32 in the document: these limits in sub-index order. They are the defaults.
#[test]
fn worked_crc_32_of_the_document() {
    let row = &table(&["Limits, sub-index 1 to 13", "CRC-32"])[0];
    let values: Vec<i32> = row[0].split(", ").map(|value| number(value) as i32).collect();
    let limits = Limits::from_array(values.try_into().expect("13 limits"));
    assert_eq!(i64::from(limits.crc32()), number(&row[1]));
    assert_eq!(limits, Limits::defaults());
}
