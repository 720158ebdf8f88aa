//! `leafbench fleet`: what the runs of a whole laboratory say together. Each action is one file.

mod coverage;
mod diagnose;
mod estimate;
mod predict;
mod report;
mod source;
#[cfg(test)]
mod tests;

use clap::{Args, Subcommand};

use super::{CliCommand, CliError, Done, Output};

/// Compare benches, operators, families, batches and specimens over many runs, and predict the next run
#[derive(Debug, Args)]
pub(super) struct FleetArgs {
    #[command(subcommand)]
    action: FleetAction,
}

#[derive(Debug, Subcommand)]
enum FleetAction {
    Diagnose(diagnose::FleetDiagnoseArgs),
    Estimate(estimate::EstimateArgs),
    Report(report::FleetReportArgs),
    Predict(predict::FleetPredictArgs),
    Coverage(coverage::FleetCoverageArgs),
}

impl CliCommand for FleetArgs {
    const NAME: &'static str = "fleet";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench fleet diagnose lab-archive",
        "leafbench fleet report lab-archive --specimens specimens.csv --out fleet-report",
        "leafbench fleet report examples/estimates.csv --out fleet-report --reference-bench B1",
        "leafbench fleet report examples/estimates.csv --drawings examples/drawings.toml --out fleet-report",
        "leafbench fleet estimate leafbench-data/runs --specimens specimens.csv",
        "leafbench fleet predict lab-archive sine-6mm-1hz --specimens specimens.csv --specimen S010 --out predicted",
        "leafbench fleet coverage examples/estimates.csv --out fleet-coverage",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        match self.action {
            FleetAction::Diagnose(args) => args.run(output),
            FleetAction::Estimate(args) => args.run(output),
            FleetAction::Report(args) => args.run(output),
            FleetAction::Predict(args) => args.run(output),
            FleetAction::Coverage(args) => args.run(output),
        }
    }
}
