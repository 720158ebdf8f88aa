//! The parsers: what comes over the wire, in files of people and other programs, in run files, over HTTP and WebSocket.

use std::io::{Cursor, Read, Write};
use std::path::Path;

use serde::de::DeserializeOwned;
use tungstenite::protocol::{Role, WebSocket, WebSocketConfig};

use super::engine::{Parser, fuzz, kind, kind_of};
use crate::config::calibration::ReadCalibration;
use crate::config::{Bench, Specimen};
use crate::daemon::client_types;
use crate::link::{LinkHealth, frame_of_the_kernel};
use crate::profile::{Player, Profile};
use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, LeaseMessage, RequestCode, RequestMessage, SampleMessage, ToRig};
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};
use crate::recording::csv;
use crate::recording::import::{ImportOptions, import};

const NODE: u8 = 1;

/// Sound frames of both directions.
fn frames() -> Vec<Frame> {
    let sample = |tick: u16| {
        FromRig::Sample(SampleMessage {
            counter: (tick % 15) as u8,
            tick,
            force_counts: 1234,
            displacement_counts: -77,
        })
        .encode(NODE)
    };
    let lease = LeaseMessage {
        counter: 3,
        session: 7,
        control_tick: 9,
    };
    let request = RequestMessage {
        counter: 1,
        session: 7,
        code: RequestCode::Arm,
        argument: 5,
    };
    vec![
        sample(1),
        sample(2),
        ToRig::Lease(lease).encode(NODE),
        ToRig::Request(request).encode(NODE),
        FromRig::ConfigValue {
            index: 0x2000,
            sub: 0,
            value: 1,
        }
        .encode(NODE),
        ToRig::ConfigWrite {
            index: 0x2010,
            sub: 1,
            value: 1,
        }
        .encode(NODE),
    ]
}

/// Decodes in both directions. What is accepted is what would have been sent.
fn decode(frame: &Frame) -> u64 {
    let to_rig = ToRig::decode(frame, NODE);
    let from_rig = FromRig::decode(frame, NODE);
    if let Ok(message) = &to_rig {
        assert_eq!(message.encode(NODE).bytes(), frame.bytes());
    }
    if let Ok(message) = &from_rig {
        // Bit 7 of a heartbeat is ignored on purpose.
        let heartbeat = matches!(message, FromRig::Heartbeat { .. });
        assert!(heartbeat || message.encode(NODE).bytes() == frame.bytes());
    }
    u64::from(frame.id >> 7) << 2 | u64::from(to_rig.is_ok()) << 1 | u64::from(from_rig.is_ok())
}

#[test]
fn l15_fuzz_can_frame() {
    let health = LinkHealth::default();
    let as_the_kernel_gives_it = |frame: &Frame| {
        let mut bytes = [0; 16];
        bytes[..2].copy_from_slice(&frame.id.to_ne_bytes());
        bytes[4] = frame.len;
        bytes[8..].copy_from_slice(&frame.data);
        bytes.to_vec()
    };
    fuzz(Parser {
        name: "can-frame",
        seeds: frames().iter().map(as_the_kernel_gives_it).collect(),
        words: &[],
        parse: &mut |input| {
            let mut bytes = [0; 16];
            let len = input.len().min(16);
            bytes[..len].copy_from_slice(&input[..len]);
            frame_of_the_kernel(bytes, len == 16, &health).map_or(u64::MAX, |frame| decode(&frame))
        },
    });
}

#[test]
fn t2_fuzz_serial_stream() {
    let mut stream = Vec::new();
    for frame in frames() {
        let mut packet = [0; PACKET_MAX];
        let len = encode(&frame, &mut packet);
        stream.extend_from_slice(&packet[..len]);
    }
    fuzz(Parser {
        name: "serial-stream",
        seeds: vec![stream],
        words: &["\0", "\0\0", "x"],
        parse: &mut |input| {
            let mut decoder = Decoder::default();
            let found = input.iter().filter_map(|byte| decoder.push(*byte));
            let frames = found.fold(0, |frames, frame| {
                decode(&frame);
                frames + 1
            });
            frames << 8_u64 | decoder.errors().min(255)
        },
    });
}

/// The TOML files of a shipped folder.
fn shipped(folder: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("bench-configs")
        .join(folder);
    let entries = std::fs::read_dir(folder).expect("shipped");
    let mut files: Vec<_> = entries.map(|entry| entry.expect("listed").path()).collect();
    files.sort();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "toml"));
    files
        .iter()
        .map(|file| std::fs::read(file).expect("readable"))
        .collect()
}

/// Words of the TOML files.
const TOML_WORDS: &[&str] = &[
    "[",
    "]",
    "[[",
    "{",
    "}",
    "=",
    "\"",
    "'''",
    "#",
    "\n",
    "a.",
    "\u{feff}",
    "\u{0}",
    "true",
    "1979-05-27",
    "0x",
    "[[block]]\n",
    "[[block.segment]]\n",
    "kind = \"ramp\"\n",
    "kind = \"sine\"\n",
    "kind = \"table\"\n",
    "repeat = 4000000000\n",
    "cycles = 4000000000\n",
    "duration_s = 1e300\n",
    "frequency_hz = 1e-300\n",
    "to_mm = 1.0\n",
    "[limits]\n",
    "[model]\n",
    "model = \"leaf-pack\"\n",
    "polynomial = [0, 1, 1e300]\n",
];

/// Files are read as text before they are parsed, so that only text gets here.
fn fuzz_toml(name: &'static str, seeds: Vec<Vec<u8>>, mut parse: impl FnMut(&str) -> u64) {
    fuzz(Parser {
        name,
        seeds,
        words: TOML_WORDS,
        parse: &mut |input| std::str::from_utf8(input).map_or(1, &mut parse),
    });
}

#[test]
fn p7_fuzz_bench() {
    fuzz_toml("bench", shipped("benches"), |text| {
        kind_of(&Bench::parse(text, "fuzz"))
    });
}

#[test]
fn p7_fuzz_specimen() {
    fuzz_toml("specimen", shipped("specimens"), |text| {
        kind_of(&Specimen::parse(text, "fuzz"))
    });
}

#[test]
fn p7_fuzz_calibration() {
    fuzz_toml("calibration", shipped("calibrations"), |text| {
        kind_of(&ReadCalibration::parse(text, "fuzz"))
    });
}

#[test]
fn p7_fuzz_profile() {
    fuzz_toml("profile", shipped("profiles"), |text| {
        let player = Profile::from_toml(text, "fuzz").and_then(|profile| Player::new(&profile, 0.0, 1000.0));
        // Values that are played must be numbers.
        let played = player.map(|mut player| {
            let values = std::iter::from_fn(|| player.next())
                .take(2000)
                .map(|slot| slot.command.value());
            values.for_each(|value| assert!(value.is_finite(), "{value}"));
        });
        kind_of(&played)
    });
}

const TABLES: [&str; 4] = [
    "time_s,displacement_mm,force_n\n0.000,0.0,0.0\n0.001,0.1,7.5\n0.002,0.2,-15\n",
    "time_s,displacement_mm,force_n,command_mm,cycle,flags\r\n0.0,0.0,1.0,0,0,0\r\n0.1,0.1,2.0,,1,3\r\n",
    "\u{feff}Zeit [ms];Weg [mm];Kraft [kN]\n0;0,00;0,001\n10;0,15;0,012\n20;0,30;0,025\n",
    "# logger 7\n# serial 1\ndisp\tload\n\"0.1\"\t\"1\"\n0.2\t3\n0.3\t4\n",
];
const TABLE_WORDS: &[&str] = &[
    ",",
    ";",
    "\t",
    "\n",
    "\r\n",
    "\"",
    "\"\"",
    "time_s",
    "displacement_mm",
    "force_n",
    "flags",
    "cycle",
    "kN",
    "[ms]",
    "NaN",
    "-",
    "'",
    "\u{feff}",
    "\0",
    "1,234.5",
    "1.234,5",
];

/// The values of a recording that was accepted: every number is finite, and time rises.
fn hold_to_the_format(recording: &crate::recording::Recording) {
    assert!(recording.time_s.windows(2).all(|pair| pair[0] < pair[1]));
    let all = [&recording.time_s, &recording.displacement_mm, &recording.force_n];
    assert!(
        all.iter()
            .all(|column| column.iter().all(|value| value.is_finite()))
    );
    assert!(all.iter().all(|column| column.len() == recording.len()));
}

#[test]
fn p8_fuzz_csv() {
    fuzz(Parser {
        name: "csv",
        seeds: TABLES.map(|table| table.as_bytes().to_vec()).to_vec(),
        words: TABLE_WORDS,
        parse: &mut |input| {
            let read = csv::read("fuzz", input);
            if let Ok(recording) = &read {
                hold_to_the_format(recording);
            }
            kind_of(&read)
        },
    });
}

#[test]
fn p8_fuzz_foreign_table() {
    let options = [
        ImportOptions::default(),
        ImportOptions {
            interval_s: Some(0.001),
            flip_force: true,
            ..ImportOptions::default()
        },
    ];
    fuzz(Parser {
        name: "foreign-table",
        seeds: TABLES.map(|table| table.as_bytes().to_vec()).to_vec(),
        words: TABLE_WORDS,
        parse: &mut |input| {
            let kinds = options.each_ref().map(|options| {
                let imported = import("fuzz", input, options);
                if let Ok(imported) = &imported {
                    hold_to_the_format(&imported.recording);
                }
                kind_of(&imported)
            });
            kinds[0].wrapping_add(kinds[1].rotate_left(1))
        },
    });
}

fn body<T: DeserializeOwned>(input: &[u8]) -> u64 {
    kind_of(&serde_json::from_slice::<T>(input))
}

#[test]
fn n8_fuzz_json_body() {
    let seeds = [
        "{\"profile\":\"static-ramp\",\"operator\":\"A\",\"specimen\":\"x\"}",
        "{\"resume_run\":\"20260101-000000-abcd\",\"override_by\":\"B\"}",
        "{\"step_mm\":0.5,\"goes_on\":true}",
        "{\"reason\":\"test\"}",
        "{}",
        "{\"name\":\"a\",\"toml\":\"name = \\\"a\\\"\"}",
    ];
    fuzz(Parser {
        name: "json-body",
        seeds: seeds.map(|text| text.as_bytes().to_vec()).to_vec(),
        words: &[
            "{",
            "}",
            "[",
            "]",
            "\"",
            "\\u0000",
            "\\ud800",
            ":",
            ",",
            "null",
            "1e999",
            "\"step_mm\":",
            "\"profile\":",
            "\"toml\":",
        ],
        parse: &mut |input| {
            let kinds = [
                body::<client_types::StartRun>(input),
                body::<client_types::PlanRequest>(input),
                body::<client_types::StopRequest>(input),
                body::<client_types::JogRequest>(input),
                body::<client_types::Nothing>(input),
                body::<client_types::SaveProfile>(input),
                body::<client_types::OutlineRequest>(input),
            ];
            kinds.iter().fold(0, |all, kind| all.rotate_left(7) ^ kind)
        },
    });
}

/// A connection that gives its bytes and swallows what is written.
struct Line<'a>(Cursor<&'a [u8]>);

impl Read for Line<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Line<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// The library under the live view, with the limit that the live view sets. Clients send nothing that the daemon reads, so frames
/// are all that is parsed.
#[test]
fn n8_fuzz_websocket() {
    let masked = |opcode: u8, payload: &[u8]| {
        let mut frame = vec![0x80 | opcode, 0x80 | payload.len() as u8, 0, 0, 0, 0];
        frame.extend_from_slice(payload);
        frame
    };
    let seeds = vec![
        masked(1, b"hello"),
        masked(2, &[0, 1, 2]),
        masked(9, b"ping"),
        masked(8, &[3, 0xE8]),
        [vec![0x81, 0xFE, 0, 200, 0, 0, 0, 0], vec![b'a'; 200]].concat(),
        [vec![0x82, 0xFF], vec![0x7F; 8]].concat(),
        [masked(1, b"a"), masked(0, b"b")].concat(),
    ];
    fuzz(Parser {
        name: "websocket",
        seeds,
        words: &["\u{81}", "\u{7f}", "\0\0\0\0"],
        parse: &mut |input| {
            let limits = WebSocketConfig::default()
                .max_message_size(Some(1024))
                .max_frame_size(Some(1024));
            let mut socket = WebSocket::from_raw_socket(Line(Cursor::new(input)), Role::Server, Some(limits));
            let mut messages = 0;
            loop {
                match socket.read() {
                    Ok(_) => messages += 1,
                    Err(error) => return kind(&error).wrapping_add(messages),
                }
            }
        },
    });
}
