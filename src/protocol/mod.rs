//! The wire: frames, messages, protection, serial framing. Pure: bytes in, meaning out, no socket and no clock.
//! `firmware-protocol.md` is the truth that this module follows; `tests/protocol` holds the two together.

mod codec;
mod dictionary;
pub mod frame;
mod layout;
pub mod message;
pub mod protection;
pub mod serial_framing;
mod state;

pub use codec::cob;
