//! `leafbench hold`.

use clap::Args;

use super::shared::client::CommandArgs;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::Nothing;

/// Pause the run: the rig keeps its position until `leafbench resume`
#[derive(Debug, Args)]
pub(super) struct HoldArgs {
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for HoldArgs {
    const NAME: &'static str = "hold";
    const EXAMPLES: &'static [&'static str] = &["leafbench hold", "leafbench hold --data leafbench-data"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        self.command
            .for_one_order()?
            .order("/api/hold", &Nothing {}, output)
    }
}
