//! `leafbench runs`.

use clap::Args;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::RunSummary;
use crate::daemon::store::Store;

/// List the runs of the data folder, newest last; needs no daemon
#[derive(Debug, Args)]
pub(super) struct RunsArgs {
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for RunsArgs {
    const NAME: &'static str = "runs";
    const EXAMPLES: &'static [&'static str] =
        &["leafbench runs", "leafbench runs --data leafbench-data --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let folder = &self.data.folder;
        let runs: Vec<RunSummary> = match folder.is_dir() {
            true => Store::new(folder)
                .list()?
                .into_iter()
                .map(RunSummary::from)
                .collect(),
            false => Vec::new(),
        };
        output.result(&runs, || text(&runs))?;
        Ok(Done::Success)
    }
}

fn text(runs: &[RunSummary]) -> String {
    if runs.is_empty() {
        return "no runs yet: `leafbench run PROFILE` makes one".to_owned();
    }
    let mut lines = vec![format!(
        "{:<25}{:<22}{:<24}{:>8}{:>10}{:>6}{:>6}  {}",
        "run", "started (UTC)", "profile", "cycles", "samples", "lost", "late", "ended"
    )];
    lines.extend(runs.iter().map(|r| {
        let ended = match (r.problem.as_str(), r.cause.as_str()) {
            ("", "") => r.ending.clone(),
            ("", cause) => format!("{}: {cause}", r.ending),
            (problem, "") => format!("{}: {problem}", r.ending),
            (problem, cause) => format!("{}: {problem} ({cause})", r.ending),
        };
        let ended = match r.continues.as_str() {
            "" => ended,
            first => format!("{ended} (continues {first})"),
        };
        format!(
            "{:<25}{:<22}{:<24}{:>8}{:>10}{:>6}{:>6}  {ended}",
            r.run_id, r.started_utc, r.profile, r.cycles_completed, r.samples, r.lost, r.late
        )
    }));
    lines.join("\n")
}
