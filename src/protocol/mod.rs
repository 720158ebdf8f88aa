//! The wire: frames, messages, protection, serial framing. Pure: bytes in, meaning out, no socket and no clock.
//! `firmware-protocol.md` is the truth that this module follows; `tests/protocol` holds the two together.

mod codec;
mod dictionary;
pub(crate) mod frame;
mod layout;
pub(crate) mod message;
pub(crate) mod protection;
pub(crate) mod serial_framing;
mod state;

pub(crate) use codec::cob;
