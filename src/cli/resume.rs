//! `leafbench resume`.

use clap::Args;

use super::shared::client::CommandArgs;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::Nothing;

/// Continue the run after a hold, from the start of the interrupted cycle
#[derive(Debug, Args)]
pub(super) struct ResumeArgs {
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for ResumeArgs {
    const NAME: &'static str = "resume";
    const EXAMPLES: &'static [&'static str] = &["leafbench resume", "leafbench resume --data leafbench-data"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        self.command
            .for_one_order()?
            .order("/api/resume", &Nothing {}, output)
    }
}
