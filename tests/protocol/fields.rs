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
        let list = match *self {
            Message::ToRig(message) => fields_to_rig(message),
            Message::FromRig(message) => fields_from_rig(message),
        };
        list.into_iter()
            .map(|(name, value)| (name.to_owned(), value))
            .collect()
    }

    /// From name and raw values; the fields must be exactly those of the message.
    pub fn build(name: &str, fields: &Fields) -> Message {
        let raw = Raw { name, fields };
        let message = match name {
            "NMT" | "COMMAND" | "LEASE" | "REQUEST" | "CONFIG_REQUEST" => Message::ToRig(raw.host_message()),
            _ => Message::FromRig(raw.rig_message()),
        };
        assert_eq!(&message.fields(), fields, "fields of {name}");
        message
    }
}

fn fields_to_rig(message: ToRig) -> Vec<(&'static str, i64)> {
    match message {
        Nmt { command, node } => vec![("command", command as i64), ("node", node.into())],
        Command(CommandMessage {
            counter,
            session,
            tick,
            mode,
            counts,
            last,
        }) => vec![
            ("counter", counter.into()),
            ("mode", mode as i64),
            ("last", last.into()),
            ("session", session.into()),
            ("counts", counts.into()),
            ("tick", tick.into()),
        ],
        Lease(LeaseMessage {
            counter,
            session,
            control_tick,
        }) => vec![
            ("counter", counter.into()),
            ("session", session.into()),
            ("control_tick", control_tick.into()),
        ],
        Request(RequestMessage {
            counter,
            session,
            code,
            argument,
        }) => vec![
            ("counter", counter.into()),
            ("session", session.into()),
            ("code", code as i64),
            ("argument", argument.into()),
        ],
        ConfigRead { index, sub } => config(0x40, index, sub, 0),
        ConfigWrite { index, sub, value } => config(0x23, index, sub, value),
    }
}

fn fields_from_rig(message: FromRig) -> Vec<(&'static str, i64)> {
    match message {
        Heartbeat { state } => vec![("state", state as i64)],
        Emergency(EmergencyMessage {
            code,
            register,
            cause,
            state,
            tick,
        }) => vec![
            ("error_code", code.into()),
            ("error_register", register.into()),
            ("cause", cause as i64),
            ("state", state as i64),
            ("tick", tick.into()),
        ],
        Sample(SampleMessage {
            counter,
            tick,
            force_counts,
            displacement_counts,
        }) => vec![
            ("counter", counter.into()),
            ("force", force_counts.into()),
            ("displacement", displacement_counts.into()),
            ("tick", tick.into()),
        ],
        Status(StatusMessage {
            counter,
            state,
            cause,
            queue_ms,
            session,
            ack_counter,
            ack_result,
            boot,
            tick_high,
        }) => vec![
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
        ConfigValue { index, sub, value } => config(0x43, index, sub, value),
        ConfigWritten { index, sub } => config(0x60, index, sub, 0),
        ConfigRefused { index, sub, abort } => config(0x80, index, sub, abort as u32),
    }
}

/// Name and raw values of a message to build.
struct Raw<'a> {
    name: &'a str,
    fields: &'a Fields,
}

impl Raw<'_> {
    /// The value of a field as the integer type of the message.
    fn get<T: TryFrom<i64>>(&self, field: &str) -> T {
        let value = self.fields.get(field);
        let value = *value.unwrap_or_else(|| panic!("{} without {field}", self.name));
        T::try_from(value).unwrap_or_else(|_| panic!("{}: {field} = {value} does not fit", self.name))
    }

    /// The value of a field as one of an enumeration.
    fn one_of<W: TryFrom<i64>, T>(&self, field: &str, from_wire: fn(W) -> Option<T>) -> T {
        from_wire(self.get(field)).unwrap_or_else(|| panic!("{}: {field} has no such value", self.name))
    }

    fn host_message(&self) -> ToRig {
        match self.name {
            "NMT" => Nmt {
                command: self.one_of("command", NmtCommand::from_wire),
                node: self.get("node"),
            },
            "COMMAND" => Command(CommandMessage {
                counter: self.get("counter"),
                session: self.get("session"),
                tick: self.get("tick"),
                mode: self.one_of("mode", WireMode::from_wire),
                counts: self.get("counts"),
                last: self.get::<i64>("last") == 1,
            }),
            "LEASE" => Lease(LeaseMessage {
                counter: self.get("counter"),
                session: self.get("session"),
                control_tick: self.get("control_tick"),
            }),
            "REQUEST" => Request(RequestMessage {
                counter: self.get("counter"),
                session: self.get("session"),
                code: self.one_of("code", RequestCode::from_wire),
                argument: self.get("argument"),
            }),
            "CONFIG_REQUEST" if self.get::<i64>("command") == 0x40 => ConfigRead {
                index: self.get("index"),
                sub: self.get("sub"),
            },
            "CONFIG_REQUEST" => ConfigWrite {
                index: self.get("index"),
                sub: self.get("sub"),
                value: self.get("value"),
            },
            other => panic!("no message {other}"),
        }
    }

    fn rig_message(&self) -> FromRig {
        match self.name {
            "HEARTBEAT" => Heartbeat {
                state: self.one_of("state", NmtState::from_wire),
            },
            "EMERGENCY" => Emergency(EmergencyMessage {
                code: self.get("error_code"),
                register: self.get("error_register"),
                cause: self.one_of("cause", Cause::from_wire),
                state: self.one_of("state", RigState::from_wire),
                tick: self.get("tick"),
            }),
            "SAMPLE" => Sample(SampleMessage {
                counter: self.get("counter"),
                tick: self.get("tick"),
                force_counts: self.get("force"),
                displacement_counts: self.get("displacement"),
            }),
            "STATUS" => Status(StatusMessage {
                counter: self.get("counter"),
                state: self.one_of("state", RigState::from_wire),
                cause: self.one_of("cause", Cause::from_wire),
                queue_ms: self.get("queue"),
                session: self.get("session"),
                ack_counter: self.get("ack_counter"),
                ack_result: self.one_of("ack_result", RequestResult::from_wire),
                boot: self.get("boot"),
                tick_high: self.get("tick_high"),
            }),
            "CONFIG_ANSWER" => match self.get::<i64>("command") {
                0x43 => ConfigValue {
                    index: self.get("index"),
                    sub: self.get("sub"),
                    value: self.get("value"),
                },
                0x60 => ConfigWritten {
                    index: self.get("index"),
                    sub: self.get("sub"),
                },
                _ => {
                    let abort = self.one_of("value", ConfigAbort::from_wire);
                    ConfigRefused {
                        index: self.get("index"),
                        sub: self.get("sub"),
                        abort,
                    }
                }
            },
            other => panic!("no message {other}"),
        }
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
