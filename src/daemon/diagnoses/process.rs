//! A diagnosis as a process of its own: `leafbench diagnose --job`. What it does to processor and memory stays away from
//! control; it takes a low priority itself, and it ends when this program ends.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use serde::Deserialize;

use super::job::{BENCH, DiagnosisJob};

/// This program, also if its file was replaced since it was started.
const PROGRAM: &str = "/proc/self/exe";
/// What is kept of the messages of a process, bytes.
const MESSAGES_MAX_BYTES: u64 = 1 << 16;

/// A line of progress on the stdout of a job.
#[derive(Debug, Deserialize)]
pub(super) struct ProgressLine {
    /// Share that is done, 0 to 1.
    pub share: f64,
    /// What is being done, in words.
    pub step: String,
}

/// A diagnosis under way.
pub(super) struct DiagnosisProcess {
    child: Child,
    /// Its other end closes when this program ends, in whatever way. The process looks for that.
    _alive: Option<ChildStdin>,
}

impl DiagnosisProcess {
    /// Starts `job`, whose folder is below `jobs`, on the runs in the folder `data`.
    pub(super) fn start(data: &Path, jobs: &Path, job: &DiagnosisJob) -> Result<Self, String> {
        let folder = job.folder(jobs);
        let mut command = Command::new(PROGRAM);
        command.arg0("leafbench");
        command.args(["diagnose", "--job", "--json", "--bench"]);
        command.arg(folder.join(BENCH)).arg("--data").arg(data);
        command.arg("--out").arg(&folder);
        command.args(job.mixed_specimens.then_some("--mixed-specimens"));
        command.args(&job.runs);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command
            .spawn()
            .map_err(|error| format!("the process of the diagnosis cannot be started: {error}"))?;
        let _alive = child.stdin.take();
        Ok(DiagnosisProcess { child, _alive })
    }

    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Passes each line of progress to `tell`. Returns at the end of the process, what it said on stderr.
    pub(super) fn follow(&mut self, mut tell: impl FnMut(ProgressLine)) -> String {
        let messages = self.child.stderr.take().map(|stderr| {
            std::thread::spawn(move || {
                let mut text = String::new();
                let mut stderr = BufReader::new(stderr);
                // What cannot be read is not shown; the rest is read so that the process does not wait for it.
                let _ = stderr.by_ref().take(MESSAGES_MAX_BYTES).read_to_string(&mut text);
                let _ = std::io::copy(&mut stderr, &mut std::io::sink());
                text
            })
        });
        let lines = self.child.stdout.take().map(BufReader::new);
        for line in lines.into_iter().flat_map(BufRead::lines).map_while(Result::ok) {
            // The last line is the diagnosis, which is also in its folder.
            if let Ok(progress) = serde_json::from_str(&line) {
                tell(progress);
            }
        }
        let text = messages.and_then(|thread| thread.join().ok());
        text.unwrap_or_default()
    }

    /// Waits for the end. `messages` is what the process said on stderr; the error is in words.
    pub(super) fn end(mut self, messages: &str) -> Result<(), String> {
        let status = self.child.wait().map_err(|error| error.to_string())?;
        if status.success() {
            return Ok(());
        }
        let last = messages.lines().last().unwrap_or_default();
        let told: serde_json::Value = serde_json::from_str(last).unwrap_or_default();
        Err(match (told["error"].as_str(), status.code()) {
            (Some(error), _) => error.to_owned(),
            (None, None) => {
                "the diagnosis was ended by the system, probably for lack of memory: choose fewer or shorter runs".to_owned()
            }
            (None, Some(code)) => format!("the diagnosis ended with code {code}: {last}"),
        })
    }
}
