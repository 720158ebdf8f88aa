//! `leafbench reset`.

use clap::Args;

use super::shared::client::CommandArgs;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::Nothing;

/// Clear the interlock after its cause was removed; nothing moves
#[derive(Debug, Args)]
pub(super) struct ResetArgs {
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for ResetArgs {
    const NAME: &'static str = "reset";
    const EXAMPLES: &'static [&'static str] = &["leafbench reset", "leafbench reset --data leafbench-data"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        self.command
            .for_one_order()?
            .order("/api/reset", &Nothing {}, output)
    }
}
