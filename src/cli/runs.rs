//! `leafbench runs`.

use clap::{Args, ValueEnum};
use jiff::Timestamp;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::{RunSummary, ended_words};
use crate::daemon::run_search::{self, RunQuery, WantedEnding};
use crate::daemon::store::Store;

/// Characters of a time up to its seconds: `2026-11-23T09:16:21`.
const TO_SECONDS: usize = 19;

/// List the runs of the data folder, newest last; needs no daemon
#[derive(Debug, Args)]
pub(super) struct RunsArgs {
    #[command(flatten)]
    filter: FilterArgs,
    /// Only the newest N of these runs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    #[command(flatten)]
    data: DataArg,
}

/// Which runs are listed: those that fit everything that is given.
#[derive(Debug, Default, Args)]
struct FilterArgs {
    /// Only runs of specimens with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    specimen: Option<String>,
    /// Only runs of operators with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    operator: Option<String>,
    /// Only runs of profiles with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    profile: Option<String>,
    /// Only runs with all these words somewhere: in id, specimen, operator, profile, or in how and why they ended
    #[arg(long, value_name = "WORDS")]
    text: Option<String>,
    /// Only runs that started on this day or later, or at this time: 2026-11-23, 2026-11-23T14:30 (UTC)
    #[arg(long, value_name = "DATE", value_parser = run_search::since)]
    since: Option<Timestamp>,
    /// Only runs that started on this day or earlier, or at this time: 2026-11-23, 2026-11-23T14:30 (UTC)
    #[arg(long, value_name = "DATE", value_parser = run_search::until)]
    until: Option<Timestamp>,
    /// Only runs that ended like this
    #[arg(long, value_name = "RESULT", value_enum)]
    result: Option<ListedResult>,
}

/// The words of the column `ended`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ListedResult {
    /// All segments ran
    Completed,
    /// An operator stopped it
    Stopped,
    /// A limit, the link or the daemon ended it
    Aborted,
    /// It has no end yet
    Open,
    /// Samples are not on the disk
    Incomplete,
    /// The file is not what was written
    Damaged,
    /// The file cannot be opened
    Unreadable,
}

impl From<ListedResult> for WantedEnding {
    fn from(result: ListedResult) -> WantedEnding {
        match result {
            ListedResult::Completed => WantedEnding::Completed,
            ListedResult::Stopped => WantedEnding::Stopped,
            ListedResult::Aborted => WantedEnding::Aborted,
            ListedResult::Open => WantedEnding::Open,
            ListedResult::Incomplete => WantedEnding::Incomplete,
            ListedResult::Damaged => WantedEnding::Damaged,
            ListedResult::Unreadable => WantedEnding::Unreadable,
        }
    }
}

impl FilterArgs {
    /// The query for the newest runs, `limit` of them at most.
    fn query(self, limit: Option<u32>) -> RunQuery {
        RunQuery {
            specimen: self.specimen,
            operator: self.operator,
            profile: self.profile,
            text: self.text,
            since: self.since,
            until: self.until,
            result: self.result.map(WantedEnding::from),
            limit: limit.map(|limit| limit as usize),
            after: None,
        }
    }
}

impl CliCommand for RunsArgs {
    const NAME: &'static str = "runs";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench runs",
        "leafbench runs --specimen samurai-front --since 2026-11-23 --result completed --limit 10",
        "leafbench runs --since 2026-11-01 --until 2026-11-30 --text limit",
        "leafbench runs --data leafbench-data --json",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let folder = &self.data.folder;
        let query = self.filter.query(self.limit);
        let filtered = RunQuery {
            limit: None,
            ..query.clone()
        } != RunQuery::default();
        let (mut runs, total): (Vec<RunSummary>, usize) = match folder.is_dir() {
            true => {
                let page = Store::new(folder).search(&query, None)?;
                let runs = page.runs.iter().map(|run| run.summary.clone());
                (runs.collect(), page.total)
            }
            false => (Vec::new(), 0),
        };
        runs.reverse();
        if runs.len() < total {
            output.note(&format!("the newest {} of {total} runs", runs.len()));
        }
        output.result(&runs, || text(&runs, !filtered))?;
        Ok(Done::Success)
    }
}

fn text(runs: &[RunSummary], none_yet: bool) -> String {
    match (runs.is_empty(), none_yet) {
        (true, true) => return "no runs yet: `leafbench run PROFILE` makes one".to_owned(),
        (true, false) => return "no run fits: give fewer options, `leafbench runs` lists all".to_owned(),
        (false, _) => {}
    }
    let mut lines = vec![format!(
        "{:<25}{:<22}{:<24}{:>8}{:>10}{:>6}{:>6}  {}",
        "run", "started (UTC)", "profile", "cycles", "samples", "lost", "late", "ended"
    )];
    lines.extend(runs.iter().map(|r| {
        let ended = match (r.problem.as_str(), r.cause.as_str()) {
            ("", cause) => ended_words(&r.ending, cause),
            (problem, "") => format!("{}: {problem}", r.ending),
            (problem, cause) => format!("{}: {problem} ({cause})", r.ending),
        };
        let ended = match r.continues.as_str() {
            "" => ended,
            first => format!("{ended} (continues {first})"),
        };
        let started = r.started_utc.get(..TO_SECONDS).unwrap_or(&r.started_utc);
        format!(
            "{:<25}{started:<22}{:<24}{:>8}{:>10}{:>6}{:>6}  {ended}",
            r.run_id, r.profile, r.cycles_completed, r.samples, r.lost, r.late
        )
    }));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use clap::FromArgMatches;

    use super::*;
    use crate::recording::Recorder;
    use crate::recording::run_file::test_support::{header, outcome};
    use crate::recording::run_file::{EXTENSION, RunFileWriter};
    use crate::recording::{Ending, Outcome};

    /// Runs of a folder: id, specimen, operator, profile, start, ending, cause. The last file cannot be read.
    const RUNS: [[&str; 7]; 3] = [
        [
            "a1",
            "Leaf 7",
            "Ann",
            "static-ramp",
            "2026-11-22T23:59:59.900Z",
            "completed",
            "",
        ],
        [
            "b2",
            "Leaf 8",
            "Bob",
            "sine-6mm-1hz",
            "2026-11-23T00:00:00Z",
            "aborted",
            "force limit",
        ],
        ["c3", "", "", "", "", "unreadable", ""],
    ];

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        for [id, specimen, operator, profile, started, ending, cause] in RUNS {
            let path = folder.path().join(id).with_extension(EXTENSION);
            if ending == "unreadable" {
                std::fs::write(path, "no run").expect("written");
                continue;
            }
            let mut head = header();
            (head.run_id, head.started_utc) = (id.into(), started.into());
            (head.specimen, head.operator, head.profile_name) =
                (specimen.into(), operator.into(), profile.into());
            let ending = if ending == "aborted" {
                Ending::Aborted
            } else {
                Ending::Completed
            };
            let mut writer = RunFileWriter::create(&path, &head).expect("created");
            writer.end(&Outcome {
                ending,
                cause: cause.into(),
                ..outcome(0)
            });
        }
        folder
    }

    /// Ids of the runs that a command line lists, newest first.
    fn fitting(folder: &std::path::Path, options: &[&str]) -> Vec<String> {
        let command = FilterArgs::augment_args(clap::Command::new("runs"));
        let words = std::iter::once(&"runs").chain(options);
        let matches = command.try_get_matches_from(words).expect("understood");
        let filter = FilterArgs::from_arg_matches(&matches).expect("understood");
        let page = Store::new(folder)
            .search(&filter.query(None), None)
            .expect("listed");
        page.runs.iter().map(|run| run.summary.run_id.clone()).collect()
    }

    #[test]
    fn each_filter_takes_its_runs_and_all_of_them_together_those_that_fit_all() {
        let folder = folder();
        for (options, wanted) in [
            (&[][..], &["b2", "a1", "c3"][..]),
            (&["--specimen", "leaf"], &["b2", "a1"]),
            (&["--specimen", "8"], &["b2"]),
            (&["--operator", "ANN"], &["a1"]),
            (&["--profile", "ramp"], &["a1"]),
            (&["--text", "limit BOB"], &["b2"]),
            (&["--text", "bobsine"], &[]),
            (&["--since", "2026-11-23"], &["b2"]),
            (&["--since", "2026-11-22T23:59"], &["b2", "a1"]),
            (&["--until", "2026-11-22"], &["a1"]),
            (&["--until", "2026-11-23"], &["b2", "a1"]),
            (&["--until", "2026-11-22T12:00"], &[]),
            (&["--result", "completed"], &["a1"]),
            (&["--result", "aborted"], &["b2"]),
            (&["--result", "unreadable"], &["c3"]),
            (&["--specimen", "leaf", "--result", "stopped"], &[]),
        ] {
            assert_eq!(fitting(folder.path(), options), wanted, "{options:?}");
        }
    }

    #[test]
    fn a_day_and_a_time_are_in_utc() {
        let since = |text: &str| run_search::since(text).map(|at| at.to_string());
        assert_eq!(since("2026-11-23").as_deref(), Ok("2026-11-23T00:00:00Z"));
        assert_eq!(since("2026-11-23T14:30").as_deref(), Ok("2026-11-23T14:30:00Z"));
        assert_eq!(
            since("2026-11-23T14:30:00+02:00").as_deref(),
            Ok("2026-11-23T12:30:00Z")
        );
        assert!(since("yesterday").is_err() && since("2026-13-01").is_err());
        let until = run_search::until("2026-11-23").map(|at| at.to_string());
        assert_eq!(until.as_deref(), Ok("2026-11-23T23:59:59.999999999Z"));
    }
}
