//! `leafbench stop`.

use clap::Args;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::StopRequest;

/// End the run under way: the rig unloads, the data are kept
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
        let request = StopRequest { reason: self.reason };
        self.data.client()?.order("/api/stop", &request, output)
    }
}
