//! `leafbench stop`.

use clap::Args;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};

/// End the run under way or the start of one: the rig unloads, the data are kept; allowed at any time
#[derive(Debug, Args)]
pub(super) struct StopArgs {
    /// Reason, which is recorded as the cause of the run's end
    #[arg(long, value_name = "TEXT")]
    reason: Option<String>,
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for StopArgs {
    const NAME: &'static str = "stop";
    const EXAMPLES: &'static [&'static str] = &["leafbench stop", "leafbench stop --reason oil-leak"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let accepted = self.data.client()?.stop(self.reason)?;
        output.result(&accepted, || accepted.message.clone())?;
        Ok(Done::Success)
    }
}
