//! A message as its name and raw fields in the document's words, and back: what document, DBC and codec compare by.

use std::collections::BTreeMap;

use crate::protocol::frame::Frame;
use crate::protocol::message::*;

/// Raw values by field, without CRC.
pub type Fields = BTreeMap<String, i64>;

/// A message of either direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Message {
    ToRig(ToRig),
    FromRig(FromRig),
}

use FromRig::*;
use ToRig::*;

impl Message {
    pub fn encode(&self, node: u8) -> Frame {
        match self {
            Message::ToRig(message) => message.encode(node),
            Message::FromRig(message) => message.encode(node),
        }
    }

    /// Decodes in the direction that `self` has.
    pub fn decode_alike(&self, frame: &Frame, node: u8) -> Result<Message, DecodeError> {
        match self {
            Message::ToRig(_) => ToRig::decode(frame, node).map(Message::ToRig),
            Message::FromRig(_) => FromRig::decode(frame, node).map(Message::FromRig),
        }
    }

    /// Name in document and DBC.
    pub fn name(&self) -> &'static str {
        match self {
            Message::ToRig(Nmt { .. }) => "NMT",
            Message::ToRig(Command(_)) => "COMMAND",
            Message::ToRig(Lease(_)) => "LEASE",
            Message::ToRig(Request(_)) => "REQUEST",
            Message::ToRig(ConfigRead { .. } | ConfigWrite { .. }) => "CONFIG_REQUEST",
            Message::FromRig(Heartbeat { .. }) => "HEARTBEAT",
            Message::FromRig(Emergency(_)) => "EMERGENCY",
            Message::FromRig(Sample(_)) => "SAMPLE",
            Message::FromRig(Status(_)) => "STATUS",
            Message::FromRig(ConfigValue { .. } | ConfigWritten { .. } | ConfigRefused { .. }) => {
                "CONFIG_ANSWER"
            }
        }
    }

    /// Raw values in document and DBC.
    pub fn fields(&self) -> Fields {
        let list: Vec<(&str, i64)> = match *self {
            Message::ToRig(Nmt { command, node }) => vec![("command", command as i64), ("node", node.into())],
            Message::ToRig(Command(CommandMessage {
                counter,
                session,
                tick,
                mode,
                counts,
                last,
            })) => vec![
                ("counter", counter.into()),
                ("mode", mode as i64),
                ("last", last.into()),
                ("session", session.into()),
                ("counts", counts.into()),
                ("tick", tick.into()),
            ],
            Message::ToRig(Lease(LeaseMessage {
                counter,
                session,
                control_tick,
            })) => vec![
                ("counter", counter.into()),
                ("session", session.into()),
                ("control_tick", control_tick.into()),
            ],
            Message::ToRig(Request(RequestMessage {
                counter,
                session,
                code,
                argument,
            })) => vec![
                ("counter", counter.into()),
                ("session", session.into()),
                ("code", code as i64),
                ("argument", argument.into()),
            ],
            Message::ToRig(ConfigRead { index, sub }) => config(0x40, index, sub, 0),
            Message::ToRig(ConfigWrite { index, sub, value }) => config(0x23, index, sub, value),
            Message::FromRig(Heartbeat { state }) => vec![("state", state as i64)],
            Message::FromRig(Emergency(EmergencyMessage {
                code,
                register,
                cause,
                state,
                tick,
            })) => vec![
                ("error_code", code.into()),
                ("error_register", register.into()),
                ("cause", cause as i64),
                ("state", state as i64),
                ("tick", tick.into()),
            ],
            Message::FromRig(Sample(SampleMessage {
                counter,
                tick,
                force_counts,
                displacement_counts,
            })) => vec![
                ("counter", counter.into()),
                ("force", force_counts.into()),
                ("displacement", displacement_counts.into()),
                ("tick", tick.into()),
            ],
            Message::FromRig(Status(StatusMessage {
                counter,
                state,
                cause,
                queue_ms,
                session,
                ack_counter,
                ack_result,
                boot,
                tick_high,
            })) => vec![
                ("counter", counter.into()),
                ("state", state as i64),
                ("cause", cause as i64),
                ("queue", queue_ms.into()),
                ("session", session.into()),
                ("ack_counter", ack_counter.into()),
                ("ack_result", ack_result as i64),
                ("boot", boot.into()),
                ("tick_high", tick_high.into()),
            ],
            Message::FromRig(ConfigValue { index, sub, value }) => config(0x43, index, sub, value),
            Message::FromRig(ConfigWritten { index, sub }) => config(0x60, index, sub, 0),
            Message::FromRig(ConfigRefused { index, sub, abort }) => config(0x80, index, sub, abort as u32),
        };
        list.into_iter()
            .map(|(name, value)| (name.to_owned(), value))
            .collect()
    }

    /// From name and raw values; the fields must be exactly those of the message.
    pub fn build(name: &str, fields: &Fields) -> Message {
        let raw = |field: &str| {
            *fields
                .get(field)
                .unwrap_or_else(|| panic!("{name} without {field}"))
        };
        let u8 = |field: &str| u8::try_from(raw(field)).expect(field);
        let u16 = |field: &str| u16::try_from(raw(field)).expect(field);
        let u32 = |field: &str| u32::try_from(raw(field)).expect(field);
        let i32 = |field: &str| i32::try_from(raw(field)).expect(field);
        let (index, sub, value) = (|| u16("index"), || u8("sub"), || u32("value"));
        let message = match name {
            "NMT" => Message::ToRig(Nmt {
                command: NmtCommand::from_wire(u8("command")).expect("command"),
                node: u8("node"),
            }),
            "COMMAND" => Message::ToRig(Command(CommandMessage {
                counter: u8("counter"),
                session: u8("session"),
                tick: u16("tick"),
                mode: WireMode::from_wire(u8("mode")).expect("mode"),
                counts: i32("counts"),
                last: raw("last") == 1,
            })),
            "LEASE" => Message::ToRig(Lease(LeaseMessage {
                counter: u8("counter"),
                session: u8("session"),
                control_tick: u16("control_tick"),
            })),
            "REQUEST" => Message::ToRig(Request(RequestMessage {
                counter: u8("counter"),
                session: u8("session"),
                code: RequestCode::from_wire(u8("code")).expect("code"),
                argument: u32("argument"),
            })),
            "CONFIG_REQUEST" if raw("command") == 0x40 => Message::ToRig(ConfigRead {
                index: index(),
                sub: sub(),
            }),
            "CONFIG_REQUEST" => Message::ToRig(ConfigWrite {
                index: index(),
                sub: sub(),
                value: value(),
            }),
            "HEARTBEAT" => Message::FromRig(Heartbeat {
                state: NmtState::from_wire(u8("state")).expect("state"),
            }),
            "EMERGENCY" => Message::FromRig(Emergency(EmergencyMessage {
                code: u16("error_code"),
                register: u8("error_register"),
                cause: Cause::from_wire(u8("cause")).expect("cause"),
                state: RigState::from_wire(u8("state")).expect("state"),
                tick: u16("tick"),
            })),
            "SAMPLE" => Message::FromRig(Sample(SampleMessage {
                counter: u8("counter"),
                tick: u16("tick"),
                force_counts: i32("force"),
                displacement_counts: i32("displacement"),
            })),
            "STATUS" => Message::FromRig(Status(StatusMessage {
                counter: u8("counter"),
                state: RigState::from_wire(u8("state")).expect("state"),
                cause: Cause::from_wire(u8("cause")).expect("cause"),
                queue_ms: u8("queue"),
                session: u8("session"),
                ack_counter: u8("ack_counter"),
                ack_result: RequestResult::from_wire(u8("ack_result")).expect("ack_result"),
                boot: u8("boot"),
                tick_high: u8("tick_high"),
            })),
            "CONFIG_ANSWER" => Message::FromRig(match raw("command") {
                0x43 => ConfigValue {
                    index: index(),
                    sub: sub(),
                    value: value(),
                },
                0x60 => ConfigWritten {
                    index: index(),
                    sub: sub(),
                },
                _ => {
                    let abort = ConfigAbort::from_wire(value()).expect("an abort code");
                    ConfigRefused {
                        index: index(),
                        sub: sub(),
                        abort,
                    }
                }
            }),
            other => panic!("no message {other}"),
        };
        assert_eq!(&message.fields(), fields, "fields of {name}");
        message
    }
}

fn config(command: i64, index: u16, sub: u8, value: u32) -> Vec<(&'static str, i64)> {
    vec![
        ("command", command),
        ("index", index.into()),
        ("sub", sub.into()),
        ("value", value.into()),
    ]
}

impl Message {
    /// True for the messages that carry a CRC-8.
    pub fn is_protected(&self) -> bool {
        matches!(
            self.name(),
            "COMMAND" | "LEASE" | "REQUEST" | "EMERGENCY" | "SAMPLE" | "STATUS"
        )
    }
}
