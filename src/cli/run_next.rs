//! `leafbench diagnose --run-next`: the bench runs the test that tells, adds the recording and judges again.
//!
//! Each round leaves its diagnosis in `DIR/round-N/` and its recording beside it, so that Ctrl-C at any time loses nothing
//! that was measured. `Tester` is who runs a test: the daemon's rig, or the bench's mock rig in virtual time.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use clap::ArgMatches;

use super::client::{Client, data_folder};
use super::diagnose::DiagnoseJob;
use super::{CliError, Done, Output, demo, diagnose, export, run};
use crate::config::Bench;
use crate::control::Phase;
use crate::daemon::client_types::{StartRun, Started, Status};
use crate::daemon::plan;
use crate::diagnose::Verdict;
use crate::diagnose::diagnosis::Diagnosis;
use crate::profile::Profile;
use crate::recording::export::Selection;
use crate::recording::run_file::RunFile;
use crate::recording::{Recording, csv};

/// An unloading rig is looked at this often.
const LOOK_PERIOD: Duration = Duration::from_millis(200);
/// It is at rest well within this.
const LOOKS: u32 = 600;

/// What came of a test.
enum Tested {
    /// It ran to its end; the run file.
    Ran(Box<RunFile>),
    /// The bench will not run this profile.
    NotAdmissible(String),
    /// It was stopped or came to another end.
    CutShort(String),
}

/// Who runs a test.
trait Tester {
    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError>;
}

/// The daemon's rig.
struct LiveRig {
    client: Client,
    data: PathBuf,
    interrupts: Arc<AtomicU32>,
}

impl Tester for LiveRig {
    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError> {
        self.until_ready()?;
        let order = StartRun {
            profile: Some(profile_toml.to_owned()),
            ..StartRun::default()
        };
        // The daemon checks the plan against its own limits before anything moves.
        let started: Started = match self.client.post("/api/run", &order) {
            Ok(started) => started,
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
        if ended.ending.as_deref() != Some("completed") {
            let ending = ended.ending.as_deref().unwrap_or("did not start");
            return Ok(Tested::CutShort(format!(
                "run {0} {ending}: {1}; what it recorded is kept: leafbench export {0}",
                started.run_id, ended.cause
            )));
        }
        Ok(Tested::Ran(Box::new(RunFile::open(&export::find_run(
            &self.data,
            &started.run_id,
        )?)?)))
    }
}

impl LiveRig {
    /// Waits for the rig to unload after the test before.
    fn until_ready(&self) -> Result<(), CliError> {
        for _ in 0..LOOKS {
            let status: Status = self.client.get("/api/status")?;
            if matches!(status.rig.phase, Phase::Ready | Phase::Interlocked) {
                break;
            }
            std::thread::sleep(LOOK_PERIOD);
        }
        Ok(())
    }
}

/// The bench's mock rig, as fast as it can.
struct VirtualRig<'a> {
    bench: &'a Bench,
    folder: PathBuf,
    interrupts: Arc<AtomicU32>,
}

impl Tester for VirtualRig<'_> {
    fn test(&mut self, profile: &Profile, profile_toml: &str, output: &Output) -> Result<Tested, CliError> {
        let refused = match plan::check(self.bench, profile) {
            Err(error) => Some(error.to_string()),
            Ok(plan) if plan.trips.is_empty() => None,
            Ok(plan) => Some(plan.trips.join("; ")),
        };
        if let Some(why) = refused {
            return Ok(Tested::NotAdmissible(why));
        }
        let file = demo::play(
            self.bench,
            profile,
            profile_toml.to_owned(),
            &self.folder,
            &mut 0.0,
            output,
        )?;
        if self.interrupts.load(Ordering::Relaxed) > 0 {
            return Ok(Tested::CutShort("stopped by Ctrl-C".to_owned()));
        }
        Ok(Tested::Ran(Box::new(file)))
    }
}

/// One round, for scripts.
#[derive(serde::Serialize)]
struct Round {
    folder: PathBuf,
    verdict: Verdict,
    effects: Vec<String>,
    alternatives: Vec<String>,
    /// The test that was run after it, and its recording.
    recording: Option<PathBuf>,
}

/// How the rounds ended.
#[derive(serde::Serialize)]
struct Ended<'a> {
    settled: bool,
    why: String,
    rounds: Vec<Round>,
    diagnosis: &'a Diagnosis,
}

/// Rounds of diagnosis and test.
pub(super) fn run(
    matches: &ArgMatches,
    case: &DiagnoseJob<'_>,
    mut recordings: Vec<Recording>,
    folder: &Path,
) -> Result<Done, CliError> {
    let most = matches.get_one::<u32>("rounds").copied().unwrap_or(4);
    let interrupts = run::interrupts();
    let mut tester: Box<dyn Tester> = match matches.get_one::<String>("run-next").map(String::as_str) {
        Some("virtual") => Box::new(VirtualRig {
            bench: case.bench,
            folder: folder.to_owned(),
            interrupts: Arc::clone(&interrupts),
        }),
        _ => Box::new(LiveRig {
            client: Client::of(matches)?,
            data: data_folder(matches),
            interrupts: Arc::clone(&interrupts),
        }),
    };
    let mut rounds: Vec<Round> = Vec::new();
    let (diagnosis, settled, why) = loop {
        let number = rounds.len();
        let at = folder.join(format!("round-{number}"));
        // The folder itself always has the newest.
        let diagnosis = case.diagnose(&recordings, folder)?;
        keep(folder, &at)?;
        tell(number, &diagnosis, case.output);
        rounds.push(round(&at, &diagnosis));
        if let Some(why) = diagnosis.settled() {
            break (diagnosis, true, why.to_owned());
        }
        if interrupts.load(Ordering::Relaxed) > 0 {
            break (diagnosis, false, "stopped by Ctrl-C".to_owned());
        }
        let next = match diagnosis.next().cloned() {
            Err(why) => break (diagnosis, false, why.to_owned()),
            Ok(_) if number as u32 >= most => {
                let why = format!("{most} tests were run, as many as --rounds allows");
                break (diagnosis, false, why);
            }
            Ok(next) => next,
        };
        let profile = Profile::from_toml(&next.profile_toml, "next-test.toml")?;
        if !case.output.json {
            eprintln!(
                "round {}: {} ({:.0} s). {}",
                number + 1,
                profile.name,
                next.duration_s,
                next.why
            );
        }
        let file = match tester.test(&profile, &next.profile_toml, case.output)? {
            Tested::Ran(file) => file,
            Tested::NotAdmissible(why) => {
                break (
                    diagnosis,
                    false,
                    format!("the bench will not run the next test: {why}"),
                );
            }
            Tested::CutShort(why) => break (diagnosis, false, why),
        };
        let path = folder.join(format!("round-{}-recording.csv", number + 1));
        let written = crate::recording::export::export(&file, Selection::Whole, &path)?.csv;
        recordings.push(csv::read_file(&written)?);
        if let Some(last) = rounds.last_mut() {
            last.recording = Some(written);
        }
    };
    let ended = Ended {
        settled,
        why,
        rounds,
        diagnosis: &diagnosis,
    };
    let json = serde_json::to_string_pretty(&ended.rounds).map_err(|e| CliError::Internal(e.to_string()))?;
    let path = folder.join("rounds.json");
    std::fs::write(&path, json).map_err(CliError::file(&path, "writing"))?;
    case.output.result(&ended, || {
        let word = if settled { "SETTLED" } else { "NOT SETTLED" };
        let tests = ended.rounds.len() - 1;
        format!(
            "{word} after {tests} tests: {}\n{}",
            ended.why,
            diagnose::text(&diagnosis, folder)
        )
    })?;
    Ok(Done::Well)
}

fn round(folder: &Path, d: &Diagnosis) -> Round {
    Round {
        folder: folder.to_owned(),
        verdict: d.verdict,
        effects: d.effects.iter().map(|e| e.code.clone()).collect(),
        alternatives: d.alternatives.iter().map(|a| a.code.clone()).collect(),
        recording: None,
    }
}

fn tell(number: usize, d: &Diagnosis, output: &Output) {
    if !output.json {
        let others: Vec<&str> = d.alternatives.iter().map(|a| a.code.as_str()).collect();
        let or = if others.is_empty() {
            String::new()
        } else {
            format!(" Or: {}.", others.join(", "))
        };
        eprintln!("after {number} tests: {}{or}", d.summary);
    }
}

/// Copies the diagnosis of a round to its own folder.
fn keep(from: &Path, to: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(to).map_err(CliError::file(to, "making the folder"))?;
    for name in ["diagnosis.json", "report.html", "improved.toml"] {
        std::fs::copy(from.join(name), to.join(name)).map_err(CliError::file(to, "copying the diagnosis"))?;
    }
    Ok(())
}
