//! `leafbench runs`.

use super::client::{data_argument, data_folder};
use super::{Command, Done};
use crate::daemon::client_types::RunSummary;
use crate::daemon::store::Store;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "runs",
    what: "List the runs of the data folder, newest last; needs no daemon",
    arguments: |command| command.arg(data_argument()),
    run: |matches, output| {
        let folder = data_folder(matches);
        let runs: Vec<RunSummary> = match folder.is_dir() {
            true => Store::new(&folder)
                .list()?
                .into_iter()
                .map(RunSummary::from)
                .collect(),
            false => Vec::new(),
        };
        output.result(&runs, || text(&runs))?;
        Ok(Done::Well)
    },
};

fn text(runs: &[RunSummary]) -> String {
    if runs.is_empty() {
        return "no runs yet: `leafbench run PROFILE` makes one".to_owned();
    }
    let mut lines = vec![format!(
        "{:<22}{:<22}{:<24}{:>8}{:>10}{:>6}  {}",
        "run", "started (UTC)", "profile", "cycles", "samples", "lost", "ended"
    )];
    lines.extend(runs.iter().map(|r| {
        let ended = match (r.problem.as_str(), r.cause.as_str()) {
            ("", "") => r.ending.clone(),
            ("", cause) => format!("{}: {cause}", r.ending),
            (problem, _) => format!("unreadable: {problem}"),
        };
        format!(
            "{:<22}{:<22}{:<24}{:>8}{:>10}{:>6}  {ended}",
            r.run_id, r.started_utc, r.profile, r.cycles_completed, r.samples, r.lost
        )
    }));
    lines.join("\n")
}
