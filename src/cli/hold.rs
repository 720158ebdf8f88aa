//! `leafbench hold`.

use super::Command;
use super::client::{Client, data_argument};
use super::stop::print_accepted;
use crate::daemon::client_types::Nothing;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "hold",
    what: "Keep the rig's position; the run may resume",
    arguments: |command| command.arg(data_argument()),
    run: |matches, output| print_accepted(Client::of(matches)?.post("/api/hold", &Nothing {})?, output),
};
