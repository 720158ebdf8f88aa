//! `leafbench fleet coverage`: how often predictions of the quantities were right.

use std::path::{Path, PathBuf};

use clap::Args;

use super::source::EstimateSource;
use crate::cli::shared::local;
use crate::cli::{CliError, Done, Output};
use crate::fleet::predict::coverage::{FleetCoverage, QuantityCoverage, coverage};
use crate::report::coverage as page;

/// Predict every run from the runs before it, and count how many lie inside the predicted intervals
#[derive(Debug, Args)]
#[command(
    after_help = "FOLDER gets coverage.html with a plot, coverage.csv with one row for each quantity of each run, and coverage.json."
)]
pub(super) struct FleetCoverageArgs {
    #[command(flatten)]
    source: EstimateSource,
    /// Folder to write coverage.html, coverage.csv and coverage.json to
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Replace the files if they are there already
    #[arg(long)]
    force: bool,
}

impl FleetCoverageArgs {
    pub(super) fn run(self, output: &Output) -> Result<Done, CliError> {
        let estimates = self.source.load()?;
        let found = coverage(&estimates.rows);
        let written = write(&found, &self.source.shown(), &self.out, self.force)?;
        output.result(&found, || {
            let left_out = estimates
                .left_out
                .iter()
                .map(|reason| format!("\nLEFT OUT: {reason}"));
            format!(
                "{}\nwritten: {}{}",
                text(&found),
                written.display(),
                left_out.collect::<String>()
            )
        })?;
        Ok(Done::Success)
    }
}

fn text(found: &FleetCoverage) -> String {
    let line = |of: &QuantityCoverage| {
        let shares = of.shares.iter().map(|share| format!("  {:<34}", share.words()));
        format!("{:<26}{}\n", of.name(), shares.collect::<String>())
    };
    let head = format!("{:<26}  {:<34}  {:<34}\n", "", "inside 50 %", "inside 95 %");
    let all = std::iter::once(&found.all).chain(&found.quantities);
    let lines: String = std::iter::once(head).chain(all.map(line)).collect();
    format!(
        "{lines}\nInside 95 %, specimen with earlier runs: {}; without: {}.\n{} estimates had too few runs before them.\n",
        found.all.seen95.words(),
        found.all.unseen95.words(),
        found.not_predicted
    )
}

/// Writes page, table and JSON; returns the page.
fn write(found: &FleetCoverage, source: &str, folder: &Path, force: bool) -> Result<PathBuf, CliError> {
    let json = serde_json::to_string_pretty(found).map_err(|e| CliError::Internal(e.to_string()))?;
    let files = [
        ("coverage.html", page::page(found, source)),
        ("coverage.csv", page::table(found)),
        ("coverage.json", json),
    ];
    local::write_files(folder, &files, force)?;
    Ok(folder.join(files[0].0))
}
