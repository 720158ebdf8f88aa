//! `leafbench fleet`: what the runs of a whole laboratory say together. Each action is one file.

mod estimate;

use clap::{Args, Subcommand};

use super::{CliCommand, CliError, Done, Output};

/// Estimate the parameters and effects of all runs of a laboratory, for pooling
#[derive(Debug, Args)]
pub(super) struct FleetArgs {
    #[command(subcommand)]
    action: FleetAction,
}

#[derive(Debug, Subcommand)]
enum FleetAction {
    Estimate(estimate::EstimateArgs),
}

impl CliCommand for FleetArgs {
    const NAME: &'static str = "fleet";
    const EXAMPLES: &'static [&'static str] =
        &["leafbench fleet estimate leafbench-data/runs --specimens specimens.csv"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        match self.action {
            FleetAction::Estimate(args) => args.run(output),
        }
    }
}
