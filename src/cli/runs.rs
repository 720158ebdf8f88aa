//! `leafbench runs`.

use clap::{Args, ValueEnum};
use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};
use jiff::tz::TimeZone;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::{RunSummary, ended_words};
use crate::daemon::store::Store;

/// Characters of a time up to its seconds: `2026-11-23T09:16:21`.
const TO_SECONDS: usize = 19;

/// List the runs of the data folder, newest last; needs no daemon
#[derive(Debug, Args)]
pub(super) struct RunsArgs {
    #[command(flatten)]
    filter: RunFilter,
    /// Only the newest N of these runs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    #[command(flatten)]
    data: DataArg,
}

/// Which runs are listed: those that fit everything that is given.
#[derive(Debug, Default, Args)]
struct RunFilter {
    /// Only runs of specimens with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    specimen: Option<String>,
    /// Only runs of operators with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    operator: Option<String>,
    /// Only runs of profiles with this text in their name; upper and lower case are the same
    #[arg(long, value_name = "TEXT")]
    profile: Option<String>,
    /// Only runs that started on this day or later, or at this time: 2026-11-23, 2026-11-23T14:30 (UTC)
    #[arg(long, value_name = "DATE", value_parser = since)]
    since: Option<Timestamp>,
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

/// A day or a time in UTC.
fn since(text: &str) -> Result<Timestamp, String> {
    let day = || {
        text.parse::<Date>()
            .ok()
            .map(|day| day.to_datetime(Time::midnight()))
    };
    let in_utc = |time: DateTime| time.to_zoned(TimeZone::UTC).ok().map(|zoned| zoned.timestamp());
    // A date alone is also a time to the parser of times.
    let time = || text.parse::<DateTime>().ok();
    let stamp = text.parse::<Timestamp>().ok();
    stamp
        .or_else(|| {
            day()
                .filter(|_| !text.contains(['T', ' ']))
                .or_else(time)
                .and_then(in_utc)
        })
        .ok_or_else(|| "write a day such as 2026-11-23, or a time such as 2026-11-23T14:30 (UTC)".to_owned())
}

impl RunFilter {
    /// Whether a run fits everything that is given.
    fn fits(&self, run: &RunSummary) -> bool {
        let has = |name: &str, text: &Option<String>| {
            text.as_ref()
                .is_none_or(|text| name.to_lowercase().contains(&text.to_lowercase()))
        };
        let result = self.result.and_then(|result| result.to_possible_value());
        has(&run.specimen, &self.specimen)
            && has(&run.operator, &self.operator)
            && has(&run.profile, &self.profile)
            && result.is_none_or(|result| result.get_name() == run.ending)
            && self
                .since
                .is_none_or(|since| run.started_utc.parse::<Timestamp>().is_ok_and(|at| at >= since))
    }
}

impl CliCommand for RunsArgs {
    const NAME: &'static str = "runs";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench runs",
        "leafbench runs --specimen samurai-front --since 2026-11-23 --result completed --limit 10",
        "leafbench runs --data leafbench-data --json",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let folder = &self.data.folder;
        let all: Vec<RunSummary> = match folder.is_dir() {
            true => Store::new(folder)
                .list()?
                .into_iter()
                .map(RunSummary::from)
                .collect(),
            false => Vec::new(),
        };
        let none_yet = all.is_empty();
        let mut runs: Vec<RunSummary> = all.into_iter().filter(|run| self.filter.fits(run)).collect();
        let most = self.limit.map_or(runs.len(), |limit| limit as usize);
        runs.drain(..runs.len().saturating_sub(most));
        output.result(&runs, || text(&runs, none_yet))?;
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

    fn run(specimen: &str, operator: &str, profile: &str, started_utc: &str, ending: &str) -> RunSummary {
        RunSummary {
            run_id: "id".to_owned(),
            started_utc: started_utc.to_owned(),
            profile: profile.to_owned(),
            specimen: specimen.to_owned(),
            operator: operator.to_owned(),
            samples: 0,
            lost: 0,
            late: 0,
            cycles_completed: 0,
            ending: ending.to_owned(),
            cause: String::new(),
            problem: String::new(),
            continues: String::new(),
        }
    }

    /// Which of three runs a command line lists.
    fn fitting(options: &[&str]) -> Vec<usize> {
        let runs = [
            run(
                "Leaf 7",
                "Ann",
                "static-ramp",
                "2026-11-22T23:59:59.900Z",
                "completed",
            ),
            run("Leaf 8", "Bob", "sine-6mm-1hz", "2026-11-23T00:00:00Z", "aborted"),
            run("", "", "", "", "unreadable"),
        ];
        let command = RunFilter::augment_args(clap::Command::new("runs"));
        let words = std::iter::once(&"runs").chain(options);
        let matches = command.try_get_matches_from(words).expect("understood");
        let filter = RunFilter::from_arg_matches(&matches).expect("understood");
        (0..3).filter(|&i| filter.fits(&runs[i])).collect()
    }

    #[test]
    fn each_filter_takes_its_runs_and_all_of_them_together_those_that_fit_all() {
        for (options, wanted) in [
            (&[][..], &[0, 1, 2][..]),
            (&["--specimen", "leaf"], &[0, 1]),
            (&["--specimen", "8"], &[1]),
            (&["--operator", "ANN"], &[0]),
            (&["--profile", "ramp"], &[0]),
            (&["--since", "2026-11-23"], &[1]),
            (&["--since", "2026-11-22T23:59"], &[0, 1]),
            (&["--result", "completed"], &[0]),
            (&["--result", "aborted"], &[1]),
            (&["--result", "unreadable"], &[2]),
            (&["--specimen", "leaf", "--result", "stopped"], &[]),
        ] {
            assert_eq!(fitting(options), wanted, "{options:?}");
        }
    }

    #[test]
    fn a_day_and_a_time_are_in_utc() {
        let shown = |text: &str| since(text).map(|at| at.to_string());
        assert_eq!(shown("2026-11-23").as_deref(), Ok("2026-11-23T00:00:00Z"));
        assert_eq!(shown("2026-11-23T14:30").as_deref(), Ok("2026-11-23T14:30:00Z"));
        assert_eq!(
            shown("2026-11-23T14:30:00+02:00").as_deref(),
            Ok("2026-11-23T12:30:00Z")
        );
        assert!(since("yesterday").is_err() && since("2026-13-01").is_err());
    }
}
