//! `leafbench resume`.

use super::Command;
use super::client::{Client, data_argument};
use super::stop::print_accepted;
use crate::daemon::client_types::Nothing;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "resume",
    what: "Go on with the run after a hold, at the cycle that was cut",
    arguments: |command| command.arg(data_argument()),
    run: |matches, output| print_accepted(Client::of(matches)?.post("/api/resume", &Nothing {})?, output),
};
