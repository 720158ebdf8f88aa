//! Frames for and from cantools, an independent reader of the DBC. `tests/protocol/cantools_check.py` starts this with
//! `LEAFBENCH_EXCHANGE` naming a folder: `theirs.jsonl` in it is checked, `ours.jsonl` written for cantools to check.

use std::fmt::Write;
use std::path::PathBuf;

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use serde::{Deserialize, Serialize};

use super::any;
use super::fields::{Fields, Message};

const NODE: u8 = 1;

/// One line of either file.
#[derive(Serialize, Deserialize)]
struct Line {
    name: String,
    id: u16,
    hex: String,
    fields: Fields,
}

impl Line {
    fn of(message: &Message) -> Self {
        let frame = message.encode(NODE);
        let mut hex = String::new();
        for byte in frame.bytes() {
            write!(hex, "{byte:02x}").expect("a string takes all");
        }
        Line {
            name: message.name().to_owned(),
            id: frame.id,
            hex,
            fields: message.fields(),
        }
    }
}

#[test]
#[ignore = "cantools_check.py runs it"]
fn frames_of_both() {
    let folder =
        PathBuf::from(std::env::var("LEAFBENCH_EXCHANGE").expect("LEAFBENCH_EXCHANGE names a folder"));
    let theirs = std::fs::read_to_string(folder.join("theirs.jsonl")).expect("theirs.jsonl");
    let mut checked = 0;
    for text in theirs.lines() {
        let line: Line = serde_json::from_str(text).expect(text);
        let ours = Line::of(&Message::build(&line.name, &line.fields));
        assert_eq!((ours.id, ours.hex), (line.id, line.hex), "{text}");
        checked += 1;
    }
    assert!(checked > 0, "theirs.jsonl is empty");
    let mut runner = TestRunner::deterministic();
    let mut ours = String::new();
    for _ in 0..5000 {
        let message = any::message(NODE)
            .new_tree(&mut runner)
            .expect("a message")
            .current();
        writeln!(
            ours,
            "{}",
            serde_json::to_string(&Line::of(&message)).expect("plain data")
        )
        .expect("a string");
    }
    std::fs::write(folder.join("ours.jsonl"), ours).expect("ours.jsonl written");
}
