//! `leafbench jog`.

use clap::Args;

use super::shared::client::CommandArgs;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::JogRequest;

/// Move by a small step at 0.5 mm/s with all limits on; the rig keeps the position for 10 s, then unloads
#[derive(Debug, Args)]
pub(super) struct JogArgs {
    /// Step in mm, -2 to 2; positive loads the spring, 0 ends a jog under way
    #[arg(value_name = "MM", allow_negative_numbers = true)]
    step_mm: f64,
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for JogArgs {
    const NAME: &'static str = "jog";
    const EXAMPLES: &'static [&'static str] = &["leafbench jog 0.5", "leafbench jog -0.1"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let step = JogRequest {
            step_mm: self.step_mm,
            goes_on: false,
        };
        self.command.for_one_order()?.order("/api/jog", &step, output)
    }
}
