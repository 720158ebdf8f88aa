//! `leafbench result`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::shared::client::DataArg;
use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::acceptance::{LimitVerdict, RunResult, ValueSummary, digits};
use crate::recording::Ending;
use crate::recording::run_file::{EXTENSION, RunFile};

/// Show what a run measured and whether it kept the limits of its profile; needs no daemon
#[derive(Debug, Args)]
#[command(
    after_help = "Exit code 1 if the run did not complete, or a limit is broken or could not be judged."
)]
pub(super) struct ResultArgs {
    /// Run id, whole or short, `latest`, or a .leafrun file
    #[arg(value_name = "RUN")]
    run: String,
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for ResultArgs {
    const NAME: &'static str = "result";
    const EXAMPLES: &'static [&'static str] = &["leafbench result latest", "leafbench result latest --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let run = RunFile::open(&run_path(&self.run, &self.data)?)?;
        let result = RunResult::of(&run);
        output.result(&result, || {
            let ending = result.ending.map_or("has no end yet", |ending| match ending {
                Ending::Completed => "completed",
                Ending::Stopped => "stopped",
                Ending::Aborted => "aborted",
            });
            let mut head = format!("run {} {ending}", result.run_id);
            for (name, told) in [("cause", &result.cause), ("NOT WHOLE", &result.problem)] {
                if !told.is_empty() {
                    head += &format!("\n{name}: {told}");
                }
            }
            format!("{head}\n{}", text(&result))
        })?;
        let completed = result.ending == Some(Ending::Completed) && result.problem.is_empty();
        Ok(Done::success_if(completed && result.is_accepted()))
    }
}

/// The run file that a word of the command line stands for: a run id, whole or short, `latest`, or the file itself.
pub(super) fn run_path(word: &str, data: &DataArg) -> Result<PathBuf, CliError> {
    let path = Path::new(word);
    match path.extension().is_some_and(|e| e == EXTENSION) {
        true => Ok(path.to_owned()),
        false => Ok(local::find_run(&data.folder, word)?.path),
    }
}

/// Values and limits as the terminal shows them.
pub(super) fn text(result: &RunResult) -> String {
    let mut lines = Vec::new();
    if !result.values.is_empty() {
        lines.extend(values(result));
        lines.push(String::new());
    }
    for l in &result.limits {
        let why = match l.verdict {
            LimitVerdict::NotJudged => format!("  ({})", l.why),
            _ => String::new(),
        };
        let (verdict, measured) = (l.verdict.words(), l.measured_words());
        lines.push(format!("{verdict:<12}{:<66}{measured}{why}", l.words()));
    }
    lines.push(format!("{}: {}", result.verdict.words(), result.why));
    lines.join("\n")
}

fn values(result: &RunResult) -> Vec<String> {
    let trend = |v: &ValueSummary| {
        v.trend
            .map_or(String::new(), |t| format!("{} {}", digits(t), v.trend_unit))
    };
    let (mut lines, counted) = (Vec::new(), result.cycles_planned > 0);
    lines.push(match counted {
        true => format!(
            "{:<24}{:<6}{:>10}{:>10}{:>10}{:>10}{:>10}  {}",
            format!("{} complete cycles", result.loops().len()),
            "",
            "first",
            "last",
            "smallest",
            "largest",
            "mean",
            "trend"
        ),
        false => "whole motion".to_owned(),
    });
    lines.extend(result.values.iter().map(|v| match counted {
        true => {
            let [first, last, min, max, mean] = [v.first, v.last, v.min, v.max, v.mean].map(digits);
            let row = format!(
                "{:<24}{:<6}{first:>10}{last:>10}{min:>10}{max:>10}{mean:>10}",
                v.what, v.unit
            );
            format!("{row}  {}", trend(v)).trim_end().to_owned()
        }
        false => format!("{:<24}{:<6}{:>10}", v.what, v.unit, digits(v.mean)),
    }));
    lines
}
