//! A diagnosis that was asked for over HTTP: what it reads, how far it is, what it found. Its folder has all of it, so it
//! outlives page and daemon.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::recording::atomic_file;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// The record of a job in its folder.
const RECORD: &str = "job.json";
/// The bench on which a job diagnoses, in its folder.
pub(super) const BENCH: &str = "bench.toml";
/// The bench with the improved model, in the folder of a job that is done.
pub(crate) const IMPROVED: &str = "improved.toml";
/// The profile of the next test, in the folder of a job that is done.
const NEXT_TEST: &str = "next-test.toml";
/// The diagnosis for programs, in the folder of a job that is done.
const DIAGNOSIS: &str = "diagnosis.json";
/// Files that can be asked for, with their types.
const FILES: [(&str, &str); 4] = [
    ("report.html", "text/html; charset=utf-8"),
    (DIAGNOSIS, "application/json"),
    (IMPROVED, "application/toml"),
    (NEXT_TEST, "application/toml"),
];
/// A larger `diagnosis.json` is not read, bytes.
const DIAGNOSIS_MAX_BYTES: u64 = 1 << 26;

/// How far a job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum JobState {
    /// It waits for the jobs before it.
    Queued,
    /// It is being computed.
    Running,
    /// Its results are there.
    Done,
    /// It ended without a result; `error` says why.
    Failed,
    /// A person ended it.
    Cancelled,
}

impl JobState {
    /// The job waits or is computed.
    pub(crate) fn is_pending(self) -> bool {
        matches!(self, JobState::Queued | JobState::Running)
    }
}

/// A diagnosis of runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct DiagnosisJob {
    /// Id of the diagnosis; its folder is `diagnoses/ID` in the data folder.
    pub id: String,
    /// When it was asked for, UTC, RFC 3339.
    pub asked_utc: String,
    /// Ids of the runs that it reads.
    pub runs: Vec<String>,
    /// Specimen of the runs.
    pub specimen: String,
    /// Name of the bench from whose model it starts.
    pub bench: String,
    /// The runs are of several specimens, and it was asked for all the same.
    #[serde(default)]
    pub mixed_specimens: bool,
    pub state: JobState,
    /// Share that is done, 0 to 1.
    #[serde(default)]
    pub share: f64,
    /// What is being done, in words.
    #[serde(default)]
    pub step: String,
    /// Why it failed, and what to do; empty otherwise.
    #[serde(default)]
    pub error: String,
    /// What it found; null until it is done.
    #[serde(default)]
    pub found: Option<JobFinding>,
}

/// What a diagnosis found, in short. `diagnosis.json` has all of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct JobFinding {
    /// `adequate`, `missing_physics` or `unexplained`.
    pub verdict: String,
    /// The result in a sentence.
    pub summary: String,
    /// Codes of the physics that the model lacks.
    pub effects: Vec<String>,
    /// There is an improved model, which the twin can take.
    pub improved: bool,
    /// Why a next test is proposed; empty if none is.
    pub next_test: String,
}

impl DiagnosisJob {
    /// The folder of this job.
    pub(super) fn folder(&self, jobs: &Path) -> PathBuf {
        jobs.join(&self.id)
    }

    /// Writes the record into the folder of the job, which is made if it is missing.
    pub(super) fn write(&self, jobs: &Path) -> io::Result<()> {
        let folder = self.folder(jobs);
        atomic_file::create_private_folder(&folder)?;
        let text = serde_json::to_string_pretty(self)?;
        atomic_file::write(&folder.join(RECORD), |file| writeln!(file, "{text}"))
    }
}

/// The jobs in a folder, oldest first. Those that an earlier daemon did not finish have failed.
pub(super) fn read_all(jobs: &Path) -> Vec<DiagnosisJob> {
    let Ok(folders) = std::fs::read_dir(jobs) else {
        return Vec::new();
    };
    let mut all: Vec<DiagnosisJob> = folders
        .flatten()
        .filter_map(|folder| read(&folder.path()))
        .collect();
    all.sort_by(|a, b| a.id.cmp(&b.id));
    for job in all.iter_mut().filter(|job| job.state.is_pending()) {
        job.state = JobState::Failed;
        job.error = "the daemon ended before this diagnosis did: start it again".to_owned();
        if let Err(error) = job.write(jobs) {
            tracing::warn!("diagnosis {}: its record cannot be written: {error}", job.id);
        }
    }
    all
}

/// The job in a folder, if it has the name of the folder.
fn read(folder: &Path) -> Option<DiagnosisJob> {
    let text = regular_file::read_text(&folder.join(RECORD), WRITTEN_MAX_BYTES).ok()?;
    let job: DiagnosisJob = serde_json::from_str(&text).ok()?;
    (folder.file_name()? == job.id.as_str()).then_some(job)
}

/// What the files that a diagnosis has written in its folder say.
pub(super) fn found_in(folder: &Path) -> Result<JobFinding, String> {
    let path = folder.join(DIAGNOSIS);
    let text =
        regular_file::read(&path, DIAGNOSIS_MAX_BYTES).map_err(|e| format!("{}: {e}", path.display()))?;
    let value: serde_json::Value =
        serde_json::from_slice(&text).map_err(|e| format!("{}: {e}", path.display()))?;
    let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
    let effects = value["effects"].as_array().map(Vec::as_slice).unwrap_or_default();
    let there = |name: &str| folder.join(name).is_file();
    Ok(JobFinding {
        verdict: text(&value["verdict"]),
        summary: text(&value["summary"]),
        effects: effects.iter().map(|effect| text(&effect["code"])).collect(),
        improved: there(IMPROVED),
        next_test: match there(NEXT_TEST) {
            true => text(&value["next_test"]["why"]),
            false => String::new(),
        },
    })
}

/// Type of a file that a job leaves and that can be asked for; `None` for every other name.
pub(super) fn type_of(file: &str) -> Option<&'static str> {
    FILES
        .iter()
        .find_map(|(name, kind)| (*name == file).then_some(*kind))
}
