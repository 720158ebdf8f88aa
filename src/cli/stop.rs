//! `leafbench stop`.

use clap::Arg;

use super::client::{Client, data_argument};
use super::{CliError, Command, Done, Output};
use crate::daemon::client_types::{Accepted, StopRequest};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "stop",
    what: "End the run under way: the rig unloads, the data are kept",
    arguments: |command| {
        let reason = Arg::new("reason")
            .long("reason")
            .value_name("TEXT")
            .help("Goes into the run's cause");
        command.arg(reason).arg(data_argument())
    },
    run: |matches, output| {
        let reason = matches.get_one::<String>("reason").cloned();
        print_accepted(
            Client::of(matches)?.post("/api/stop", &StopRequest { reason })?,
            output,
        )
    },
};

/// Says what the daemon does now.
pub(super) fn print_accepted(accepted: Accepted, output: &Output) -> Result<Done, CliError> {
    output.result(&accepted, || accepted.message.clone())?;
    Ok(Done::Well)
}
