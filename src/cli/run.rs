//! `leafbench run`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use clap::Args;

use super::shared::client::{Client, CommandArgs};
use super::shared::ctrl_c::ctrl_c_count;
use super::shared::local::{self, WrittenKind, profile_help};
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output, result};
use crate::acceptance::{LimitResult, LimitVerdict, RunResult};
use crate::daemon::client_types::{RunProgress, RunState, StartRun, Started, Status, ended_words};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::atomic_file;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};
use crate::report::junit::{self, CaseEnding, TestCase};

/// Pause between two questions to the daemon.
const POLL_PERIOD: Duration = Duration::from_millis(150);
/// Cause of a run's end by Ctrl-C.
const STOP_REASON: &str = "stopped by Ctrl-C in leafbench run";

/// Run a profile on the rig and wait for its end; Ctrl-C stops the run and unloads the rig
#[derive(Debug, Args)]
pub(super) struct RunArgs {
    #[arg(value_name = "PROFILE", required_unless_present = "resume", help = profile_help())]
    profile: Option<String>,
    /// Continue this interrupted run at the cycle after its last complete one; RUN is a run id
    #[arg(long, value_name = "RUN")]
    resume: Option<String>,
    /// Name of the specimen: that of the bench file, or one that begins with it [default: from the bench file]
    #[arg(long, value_name = "TEXT")]
    specimen: Option<String>,
    /// Name of the person who runs the test
    #[arg(long, value_name = "TEXT")]
    operator: Option<String>,
    /// Start despite an overdue calibration or another specimen; NAME answers for it and is recorded
    #[arg(long = "override", value_name = "NAME")]
    override_by: Option<String>,
    /// Write the outcome as JUnit XML for a CI server: a test case for the run, also if it cannot start, and one for each limit
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    #[command(flatten)]
    command: CommandArgs,
}

impl CliCommand for RunArgs {
    const NAME: &'static str = "run";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench run static-ramp-12s --operator Technician",
        "leafbench run sine-6mm-2.5hz-10 --specimen samurai-front-7",
        "leafbench run static-ramp-12s --junit static-ramp-12s.xml",
    ];

    fn run(mut self, output: &Output) -> Result<Done, CliError> {
        let asked = self.profile.clone().or_else(|| self.resume.clone());
        let junit = self.junit.take();
        let ended = self.follow(output);
        // A report that cannot be written must not hide why the run failed.
        let reported = junit.map_or(Ok(()), |path| write_junit(&path, asked, &ended));
        let ended = ended?;
        output.result(&ended, || ended.text())?;
        reported?;
        Ok(ended.done())
    }
}

impl RunArgs {
    /// Starts the run and follows it to its end.
    fn follow(self, output: &Output) -> Result<EndedRun, CliError> {
        let client = self.command.to_the_end()?;
        let order = self.order()?;
        let interrupts = ctrl_c_count();
        let started = start(&client, order, &interrupts, output)?;
        if !output.json {
            eprintln!("run {} started; page: {}", started.run_id, client.page());
        }
        let progress = wait(&client, &started.run_id, &interrupts, output)?;
        EndedRun::of(&client, progress)
    }

    fn order(self) -> Result<StartRun, CliError> {
        let profile = match self.profile {
            // The daemon may run in another folder, so it gets the text of the file.
            Some(path) if path.ends_with(".toml") => {
                let path = Path::new(&path);
                local::require_file(path, WrittenKind::Profile)?;
                let text = regular_file::read_text(path, WRITTEN_MAX_BYTES);
                Some(text.map_err(CliError::file(path, "reading"))?)
            }
            name => name,
        };
        Ok(StartRun {
            profile,
            specimen: self.specimen,
            operator: self.operator,
            resume_run: self.resume,
            override_by: self.override_by,
        })
    }
}

/// A run that is over, with its result.
#[derive(Debug, serde::Serialize)]
pub(super) struct EndedRun {
    #[serde(flatten)]
    progress: RunProgress,
    /// What it measured, and the verdict on each limit; `null` if nothing was recorded.
    result: Option<RunResult>,
}

impl EndedRun {
    /// Asks the daemon for the result of a run that is over.
    pub(super) fn of(client: &Client, progress: RunProgress) -> Result<EndedRun, CliError> {
        let result = match progress.state {
            RunState::NeverStarted => None,
            _ => Some(client.get(&format!("/api/runs/{}/result", progress.run_id))?),
        };
        Ok(EndedRun { progress, result })
    }

    /// Success if the run completed, all its samples are on the disk, and it kept its limits.
    pub(super) fn done(&self) -> Done {
        let accepted = self.result.as_ref().is_none_or(RunResult::is_accepted);
        Done::success_if(self.progress.is_whole() && accepted)
    }

    /// The end of the run as the terminal shows it.
    pub(super) fn text(&self) -> String {
        let result = self
            .result
            .as_ref()
            .map_or(String::new(), |r| format!("\n\n{}", result::text(r)));
        text(&self.progress) + &result
    }
}

/// Asks for a run and waits until it begins. Ctrl-C in the meantime stops it.
pub(super) fn start(
    client: &Client,
    order: StartRun,
    interrupts: &AtomicU32,
    output: &Output,
) -> Result<Started, CliError> {
    let (answered, answer) = mpsc::channel();
    let asking = client.clone();
    std::thread::Builder::new()
        .name("start".to_owned())
        .spawn(move || {
            // Nobody receives it after a second Ctrl-C.
            let _ = answered.send(asking.start(&order));
        })
        .map_err(|e| CliError::Internal(e.to_string()))?;
    let mut told = false;
    loop {
        match answer.recv_timeout(POLL_PERIOD) {
            Ok(answer) => return answer,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(CliError::Internal("the start was not answered".to_owned()));
            }
        }
        match interrupts.load(Ordering::Relaxed) {
            0 => {}
            1 => {
                if !std::mem::replace(&mut told, true) && !output.json {
                    eprintln!(
                        "\nCtrl-C: stopping the run before it begins (press Ctrl-C again to leave without waiting)"
                    );
                }
                // Sent again until the start is answered: the first one may be there before the start.
                let _ = client.stop(Some(STOP_REASON.to_owned()));
            }
            _ => {
                return Err(CliError::Refused(
                    "leafbench no longer waits, and without it the run does not begin: see `leafbench status`".to_owned(),
                ));
            }
        }
    }
}

/// Follows a run to its end; Ctrl-C stops it.
pub(super) fn wait(
    client: &Client,
    run_id: &str,
    interrupts: &AtomicU32,
    output: &Output,
) -> Result<RunProgress, CliError> {
    let mut progress: Option<Progress> = None;
    let mut stop_asked = false;
    let mut told = String::new();
    loop {
        std::thread::sleep(POLL_PERIOD);
        let pressed = interrupts.load(Ordering::Relaxed);
        if pressed > 0 && !stop_asked {
            stop_asked = true;
            if !output.json {
                eprintln!(
                    "\nCtrl-C: stopping the run, the rig unloads (press Ctrl-C again to leave without waiting)"
                );
            }
            // A daemon that no longer answers is seen at the next status.
            let _ = client.stop(Some(STOP_REASON.to_owned()));
        } else if pressed > 1 {
            return Err(CliError::Refused(format!(
                "leafbench no longer waits for run {run_id}, which the daemon is stopping: see `leafbench status`"
            )));
        }
        let status: Status = client.get("/api/status").map_err(|e| match e {
            CliError::NoDaemon { .. } => CliError::DaemonGone,
            other => other,
        })?;
        let Some(run) = status.run.filter(|run| run.run_id == run_id) else {
            return Err(CliError::Refused(format!(
                "the daemon has another run than {run_id} now: see `leafbench runs`"
            )));
        };
        if run.disk_problem != told && !run.is_over() {
            told.clone_from(&run.disk_problem);
            if !output.json {
                eprintln!("{}", disk_alarm(&told));
            }
        }
        if run.is_over() {
            if let Some(progress) = progress {
                progress.finish();
            }
            return Ok(run);
        }
        if status.rig.run_id.as_deref() == Some(run_id) {
            let bar = progress.get_or_insert_with(|| Progress::new(&run.profile, output.json));
            bar.show_run(&status.rig);
        }
    }
}

/// The line for a disk that fails, and for one that can be written again.
fn disk_alarm(problem: &str) -> String {
    match problem.is_empty() {
        true => "disk: it can be written again".to_owned(),
        false => format!("disk: {problem}"),
    }
}

/// Writes the report for CI. `asked` is the profile of the command line, or the run to resume.
fn write_junit(
    path: &Path,
    asked: Option<String>,
    ended: &Result<EndedRun, CliError>,
) -> Result<(), CliError> {
    let cases = match ended {
        Ok(run) => {
            let limits = run.result.iter().flat_map(|result| &result.limits);
            let of_limit = |limit| limit_case(&run.progress.profile, limit);
            std::iter::once(case_of(&run.progress))
                .chain(limits.map(of_limit))
                .collect()
        }
        Err(error) => vec![TestCase {
            name: asked.unwrap_or_default(),
            time_s: 0.0,
            properties: Vec::new(),
            ending: CaseEnding::Error {
                reason: crate::daemon::chain(error),
            },
        }],
    };
    let written = atomic_file::write(path, |file| file.write_all(junit::xml(&cases).as_bytes()));
    written.map_err(CliError::file(path, "writing"))
}

/// The run as a test case. It fails unless it completed and all its samples are on the disk.
fn case_of(run: &RunProgress) -> TestCase {
    let count = |number: u64| number.to_string();
    let ending = match (run.is_whole(), run.ending.as_deref()) {
        (true, _) => CaseEnding::Passed,
        (false, Some("completed")) => failed("incomplete", &run.disk_problem, run),
        (false, ending) => failed(ending.unwrap_or("never_started"), &run.cause, run),
    };
    TestCase {
        name: run.profile.clone(),
        time_s: (run.samples + run.lost) as f64 / f64::from(SAMPLE_RATE_HZ),
        properties: vec![
            ("run_id", run.run_id.clone()),
            ("samples", count(run.samples)),
            ("lost", count(run.lost)),
            ("late", count(run.late)),
            ("cycles_completed", count(run.cycles_completed.into())),
            ("model_mismatch", run.model_mismatch.clone()),
        ],
        ending,
    }
}

/// One limit of the profile as a test case.
fn limit_case(profile: &str, limit: &LimitResult) -> TestCase {
    let ending = match limit.verdict {
        LimitVerdict::Pass => CaseEnding::Passed,
        LimitVerdict::NotJudged => CaseEnding::Skipped {
            reason: limit.why.clone(),
        },
        LimitVerdict::Fail => {
            let reason = format!("{}: measured {}", limit.words(), limit.measured_words());
            CaseEnding::Failed {
                kind: "limit".to_owned(),
                text: reason.clone(),
                reason,
            }
        }
    };
    let measured = limit.measured.map_or(String::new(), |m| m.to_string());
    TestCase {
        name: format!("{profile}: {}", limit.words()),
        time_s: 0.0,
        properties: vec![
            ("key", limit.key.clone()),
            ("limit", limit.limit.to_string()),
            ("measured", measured),
            ("unit", limit.unit.clone()),
        ],
        ending,
    }
}

fn failed(kind: &str, reason: &str, run: &RunProgress) -> CaseEnding {
    CaseEnding::Failed {
        kind: kind.to_owned(),
        reason: reason.to_owned(),
        text: text(run),
    }
}

/// The end of a run as the terminal shows it.
fn text(run: &RunProgress) -> String {
    if run.state == RunState::NeverStarted {
        return format!("run {} did not start: {}", run.run_id, run.cause);
    }
    let ended = ended_words(run.ending.as_deref().unwrap_or("ended"), &run.cause);
    let mut lines = vec![format!("run {} {ended}", run.run_id)];
    lines.push(format!(
        "samples  {}, {} lost, {} late; {} counted cycles",
        run.samples, run.lost, run.late, run.cycles_completed
    ));
    if !run.disk_problem.is_empty() {
        lines.push(format!("disk     {}", run.disk_problem));
    }
    lines.push(format!("CSV      leafbench export {}", run.run_id));
    lines.push(format!("sheet    leafbench certificate {}", run.run_id));
    lines.join("\n")
}
