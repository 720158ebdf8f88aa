//! `leafbench diagnose --run-next`: the bench runs the test that tells the candidates apart, adds the recording and diagnoses
//! again.
//!
//! Each round leaves the files of its diagnosis in `DIR/round-N/` and its recording beside them, so that Ctrl-C at any time loses
//! nothing that was measured. A [`Tester`] runs a test: the daemon's rig, or the bench's mock rig in virtual time.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::{DiagnoseJob, NextTestRig, files, inputs, text};
use crate::cli::shared::client::{Client, DataArg};
use crate::cli::shared::ctrl_c::ctrl_c_count;
use crate::cli::shared::local;
use crate::cli::virtual_bench::record_run;
use crate::cli::{CliError, Done, Output, run};
use crate::config::Bench;
use crate::control::Phase;
use crate::daemon::client_types::{StartRun, Status, ended_words};
use crate::daemon::plan;
use crate::diagnose::Verdict;
use crate::diagnose::diagnosis::{Diagnosis, NextTest};
use crate::profile::Profile;
use crate::recording::export::Selection;
use crate::recording::run_file::RunFile;
use crate::recording::{Recording, csv};
use crate::report::diagnosis::InputFile;

/// Pause between two looks at an unloading rig.
const POLL_PERIOD: Duration = Duration::from_millis(200);
/// Looks before the start is tried anyway, 2 min: the rig is at rest well within this.
const POLLS: u32 = 600;

/// Why the rounds end after Ctrl-C.
const STOPPED: &str = "stopped by Ctrl-C";

/// How a test ended.
pub(super) enum Tested {
    /// The run completed; its run file.
    Ran(Box<RunFile>),
    /// The bench refuses this profile, with the reason.
    NotAdmissible(String),
    /// The run ended before it was complete, with the reason.
    CutShort(String),
}

/// Runs tests, one after the other.
pub(super) trait Tester {
    /// Ctrl-C count since the start.
    fn interrupts(&self) -> u32;
    /// Runs one profile to its end.
    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError>;
}

/// The tester of `--run-next`; from now on Ctrl-C ends a test instead of the process.
pub(super) fn tester<'a>(
    rig: NextTestRig,
    data: &DataArg,
    job: &DiagnoseJob<'a>,
) -> Result<Box<dyn Tester + 'a>, CliError> {
    let interrupts = ctrl_c_count();
    Ok(match rig {
        NextTestRig::Virtual => Box::new(VirtualRig::new(job, interrupts)),
        NextTestRig::Live => Box::new(LiveRig {
            client: data.client()?.calling(true, false),
            data: data.folder.clone(),
            interrupts,
        }),
    })
}

/// The daemon's rig.
struct LiveRig {
    client: Client,
    data: PathBuf,
    interrupts: Arc<AtomicU32>,
}

impl Tester for LiveRig {
    fn interrupts(&self) -> u32 {
        self.interrupts.load(Ordering::Relaxed)
    }

    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError> {
        self.until_ready()?;
        let order = StartRun {
            profile: Some(profile_toml.to_owned()),
            ..StartRun::default()
        };
        // The daemon checks the plan against its own limits before anything moves.
        let started = match run::start(&self.client, order, &self.interrupts, output) {
            Ok(started) => started,
            Err(CliError::Refused(_)) if self.interrupts() > 0 => {
                return Ok(Tested::CutShort(STOPPED.to_owned()));
            }
            Err(CliError::Refused(why)) => return Ok(Tested::NotAdmissible(why)),
            Err(other) => return Err(other),
        };
        if !output.json {
            eprintln!(
                "run {} ({}) started; page: {}",
                started.run_id,
                profile.name,
                self.client.page()
            );
        }
        let ended = run::wait(&self.client, &started.run_id, &self.interrupts, output)?;
        if !ended.is_whole() {
            let ended_as = ended.ending.as_deref().unwrap_or("did not start");
            let mut why = ended_words(ended_as, &ended.cause);
            if !ended.disk_problem.is_empty() {
                why = format!("{why}; {}", ended.disk_problem);
            }
            return Ok(Tested::CutShort(format!(
                "run {0} {why}; what it recorded is kept: leafbench export {0}",
                started.run_id
            )));
        }
        let listing = local::find_run(&self.data, &started.run_id)?;
        Ok(Tested::Ran(Box::new(RunFile::open(&listing.path)?)))
    }
}

impl LiveRig {
    /// Waits until the rig has unloaded after the previous test.
    fn until_ready(&self) -> Result<(), CliError> {
        for _ in 0..POLLS {
            let status: Status = self.client.get("/api/status")?;
            if matches!(status.rig.phase, Phase::Ready | Phase::Interlocked) {
                break;
            }
            std::thread::sleep(POLL_PERIOD);
        }
        Ok(())
    }
}

/// The bench's mock rig in virtual time.
pub(super) struct VirtualRig<'a> {
    bench: &'a Bench,
    folder: PathBuf,
    interrupts: Arc<AtomicU32>,
}

impl<'a> VirtualRig<'a> {
    /// The mock rig of a job's bench. Its runs end where `interrupts` counts a Ctrl-C.
    pub(super) fn new(job: &DiagnoseJob<'a>, interrupts: Arc<AtomicU32>) -> VirtualRig<'a> {
        VirtualRig {
            bench: job.bench,
            folder: job.folder.to_owned(),
            interrupts,
        }
    }
}

impl Tester for VirtualRig<'_> {
    fn interrupts(&self) -> u32 {
        self.interrupts.load(Ordering::Relaxed)
    }

    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError> {
        let refused = match plan::check(self.bench, profile) {
            Err(error) => Some(error.to_string()),
            Ok(plan) if plan.trips.is_empty() => None,
            Ok(plan) => Some(plan.trips.join("; ")),
        };
        if let Some(why) = refused {
            return Ok(Tested::NotAdmissible(why));
        }
        let run = record_run(
            self.bench,
            profile,
            profile_toml.to_owned(),
            &self.folder,
            output.json,
        )?;
        if self.interrupts() > 0 {
            return Ok(Tested::CutShort(STOPPED.to_owned()));
        }
        Ok(Tested::Ran(Box::new(run.file)))
    }
}

/// One round, for scripts.
#[derive(serde::Serialize)]
struct Round {
    folder: PathBuf,
    verdict: Verdict,
    effects: Vec<String>,
    alternatives: Vec<String>,
    /// Recording of the test that was run after this diagnosis.
    recording: Option<PathBuf>,
}

/// How the rounds ended, for scripts.
#[derive(serde::Serialize)]
pub(crate) struct Ended {
    /// False if a question was left open.
    pub settled: bool,
    /// Why no further test was run.
    pub why: String,
    rounds: Vec<Round>,
    /// The diagnosis of all recordings.
    pub diagnosis: Diagnosis,
    /// The diagnoses before it, each with the test that was run after it.
    #[serde(skip)]
    pub earlier: Vec<Diagnosis>,
}

/// Why no further test is run.
struct RoundsEnd {
    settled: bool,
    why: String,
}

impl RoundsEnd {
    fn not_settled(why: impl Into<String>) -> RoundsEnd {
        RoundsEnd {
            settled: false,
            why: why.into(),
        }
    }
}

/// [`until_settled`], with the last diagnosis as the result of the command.
pub(super) fn run(
    mut tester: Box<dyn Tester + '_>,
    most: u32,
    job: &DiagnoseJob<'_>,
    recordings: Vec<Recording>,
    read: Vec<InputFile>,
) -> Result<Done, CliError> {
    let ended = until_settled(tester.as_mut(), most, job, recordings, read)?;
    job.output.result(&ended, || {
        let word = if ended.settled { "SETTLED" } else { "NOT SETTLED" };
        let tests = ended.earlier.len();
        let said = text(&ended.diagnosis, job.folder);
        format!("{word} after {tests} tests: {}\n{said}", ended.why)
    })?;
    Ok(Done::Success)
}

/// Diagnoses and tests until the diagnosis is settled or no further test can be run; at most `most` tests. Writes `rounds.json`.
pub(super) fn until_settled(
    tester: &mut dyn Tester,
    most: u32,
    job: &DiagnoseJob<'_>,
    recordings: Vec<Recording>,
    read: Vec<InputFile>,
) -> Result<Ended, CliError> {
    let mut rounds = Rounds {
        job,
        recordings,
        read,
        rounds: Vec::new(),
    };
    let mut earlier = Vec::new();
    let (diagnosis, end) = loop {
        let diagnosis = rounds.diagnose()?;
        let next = match rounds.next_test(&diagnosis, most, tester.interrupts()) {
            Ok(next) => next,
            Err(end) => break (diagnosis, end),
        };
        if let Some(end) = rounds.test(tester, next)? {
            break (diagnosis, end);
        }
        earlier.push(diagnosis);
    };
    let path = job.folder.join(files::ROUNDS);
    std::fs::write(&path, files::json(&rounds.rounds)?).map_err(CliError::file(&path, "writing"))?;
    Ok(Ended {
        settled: end.settled,
        why: end.why,
        rounds: rounds.rounds,
        diagnosis,
        earlier,
    })
}

/// The rounds so far.
struct Rounds<'a> {
    job: &'a DiagnoseJob<'a>,
    /// The recordings given, and those of the tests.
    recordings: Vec<Recording>,
    /// The files that they come from.
    read: Vec<InputFile>,
    rounds: Vec<Round>,
}

impl Rounds<'_> {
    /// Diagnoses all recordings into the next round's folder; `--out` itself has the newest diagnosis.
    fn diagnose(&mut self) -> Result<Diagnosis, CliError> {
        let number = self.rounds.len();
        let folder = self.job.folder.join(format!("round-{number}"));
        let diagnosis = self
            .job
            .diagnose(&self.recordings, &self.read, &[], Some(&folder))?;
        let codes: Vec<String> = diagnosis.alternatives.iter().map(|a| a.code.clone()).collect();
        if !self.job.output.json {
            let or = match codes.is_empty() {
                true => String::new(),
                false => format!(" Or: {}.", codes.join(", ")),
            };
            eprintln!("after {number} tests: {}{or}", diagnosis.summary);
        }
        self.rounds.push(Round {
            folder,
            verdict: diagnosis.verdict,
            effects: diagnosis.effects.iter().map(|e| e.code.clone()).collect(),
            alternatives: codes,
            recording: None,
        });
        Ok(diagnosis)
    }

    /// The test to run next, or why there is none.
    fn next_test<'d>(
        &self,
        diagnosis: &'d Diagnosis,
        most: u32,
        interrupts: u32,
    ) -> Result<&'d NextTest, RoundsEnd> {
        if let Some(why) = diagnosis.settled() {
            return Err(RoundsEnd {
                settled: true,
                why: why.to_owned(),
            });
        }
        if interrupts > 0 {
            return Err(RoundsEnd::not_settled(STOPPED));
        }
        let next = diagnosis.next().map_err(RoundsEnd::not_settled)?;
        let tests_run = self.rounds.len() - 1;
        if tests_run as u32 >= most {
            let why = format!("{most} tests were run, as many as --rounds allows");
            return Err(RoundsEnd::not_settled(why));
        }
        Ok(next)
    }

    /// Runs the next test and adds its recording; or why that was not possible.
    fn test(&mut self, tester: &mut dyn Tester, next: &NextTest) -> Result<Option<RoundsEnd>, CliError> {
        let number = self.rounds.len();
        let profile = Profile::from_toml(&next.profile_toml, files::NEXT_TEST)?;
        if !self.job.output.json {
            eprintln!(
                "round {number}: {} ({:.0} s). {}",
                profile.name, next.duration_s, next.why
            );
        }
        let file = match tester.test(&profile, &next.profile_toml, self.job.output)? {
            Tested::Ran(file) => file,
            Tested::NotAdmissible(why) => {
                let why = format!("the bench refuses the next test: {why}");
                return Ok(Some(RoundsEnd::not_settled(why)));
            }
            Tested::CutShort(why) => return Ok(Some(RoundsEnd::not_settled(why))),
        };
        let path = self.job.folder.join(format!("round-{number}-recording.csv"));
        let written = crate::recording::export::export(&file, Selection::Whole, &path)?.csv;
        self.recordings.push(csv::read_file(&written)?);
        self.read.push(inputs::input_csv(&written)?);
        if let Some(last) = self.rounds.last_mut() {
            last.recording = Some(written);
        }
        Ok(None)
    }
}
