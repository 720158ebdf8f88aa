//! What several commands use. No file here is a command.

pub(super) mod client;
pub(super) mod ctrl_c;
pub(super) mod error;
pub(super) mod journal;
pub(crate) mod local;
pub(super) mod progress;
pub(crate) mod virtual_bench;
