//! The wire: frames, messages, protection, serial framing. Pure functions on bytes: sockets and clocks are left to `link`,
//! decisions to `control` and to the firmware.
//!
//! `firmware-protocol.md` is the specification that this module follows; `tests/protocol` compares the two.

mod bits;
pub(crate) mod cob;
mod dictionary;
pub(crate) mod frame;
pub(crate) mod message;
pub(crate) mod protection;
pub(crate) mod serial_framing;
mod state;
pub(crate) mod tick;
pub(crate) mod wire_enum;
