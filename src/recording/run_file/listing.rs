//! Lists the run files in a folder. Each one is opened by `reader`.

use std::path::{Path, PathBuf};

use super::{EXTENSION, RunFile, RunFileError};
use crate::recording::Outcome;

/// One run file, readable or not.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct RunListing {
    pub path: PathBuf,
    /// Run id; the name of the file if the header cannot be read.
    pub run_id: String,
    /// Start, UTC, RFC 3339.
    pub started_utc: String,
    pub profile_name: String,
    pub specimen: String,
    /// Name of the operator; may be empty.
    pub operator: String,
    /// Run id of the file that this one continues; empty otherwise.
    pub continues: String,
    /// Number of samples in the file.
    pub samples: u64,
    /// Number of ticks without a sample.
    pub lost: u64,
    /// Samples that the link delivered too late.
    pub late: u64,
    /// Counted cycles that ran to their end.
    pub cycles_completed: u32,
    /// How it ended; `None` while the run is live, or if its daemon could not close it.
    pub outcome: Option<Outcome>,
    /// Samples that are not on the disk, in words; empty if all are.
    pub unsaved: String,
    /// Why the file, or a part of it, cannot be read; empty if all can, as far as the listing has looked.
    pub problem: String,
}

impl RunListing {
    /// The run was closed, so that its file does not change any more.
    pub(crate) fn is_closed(&self) -> bool {
        self.outcome.is_some()
    }
}

/// All run files in `folder`, oldest first. Closed files are not read in full: [`check`] finds damage in them.
pub(crate) fn list(folder: &Path) -> Result<Vec<RunListing>, RunFileError> {
    let io = |source| RunFileError::Io {
        path: folder.to_owned(),
        doing: "listing",
        source,
    };
    let mut runs = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.extension().is_some_and(|extension| extension == EXTENSION) {
            runs.push(listing(path));
        }
    }
    runs.sort_by(|a, b| (&a.started_utc, &a.run_id).cmp(&(&b.started_utc, &b.run_id)));
    Ok(runs)
}

/// What is damaged in a file, as sentences, after it was read in full; empty if it is whole.
pub(crate) fn check(path: &Path) -> String {
    match RunFile::open(path) {
        Ok(run) => run.survey().damage.join("; "),
        Err(error) => error.to_string(),
    }
}

fn listing(path: PathBuf) -> RunListing {
    let run = match RunFile::open(&path) {
        Ok(run) => run,
        Err(error) => return unreadable(path, &error),
    };
    let header = run.header();
    let mut problem = String::new();
    let (samples, lost, late, cycles_completed) = match run.outcome() {
        Some(o) => (o.samples, o.lost, o.late, o.cycles_completed),
        None => {
            let survey = run.survey();
            problem = survey.damage.join("; ");
            (
                survey.samples,
                survey.missing(),
                survey.late,
                survey.cycles_completed(),
            )
        }
    };
    let unsaved = run.outcome().and_then(|outcome| outcome.unsaved.as_ref());
    RunListing {
        run_id: header.run_id.clone(),
        started_utc: header.started_utc.clone(),
        profile_name: header.profile_name.clone(),
        specimen: header.specimen.clone(),
        operator: header.operator.clone(),
        continues: header.continues.clone(),
        samples,
        lost,
        late,
        cycles_completed,
        outcome: run.outcome().cloned(),
        unsaved: unsaved
            .map(|u| u.text(run.zero_tick(), header.sample_rate_hz))
            .unwrap_or_default(),
        problem,
        path,
    }
}

/// A file whose header cannot be read is in the list with its problem.
fn unreadable(path: PathBuf, error: &RunFileError) -> RunListing {
    let run_id = path.file_stem().unwrap_or_default();
    RunListing {
        run_id: run_id.to_string_lossy().into_owned(),
        path,
        started_utc: String::new(),
        profile_name: String::new(),
        specimen: String::new(),
        operator: String::new(),
        continues: String::new(),
        samples: 0,
        lost: 0,
        late: 0,
        cycles_completed: 0,
        outcome: None,
        unsaved: String::new(),
        problem: error.to_string(),
    }
}
#[cfg(test)]
mod tests {
    use super::super::RunFileWriter;
    use super::super::test_support::{header, outcome, sample};
    use super::*;
    use crate::recording::Recorder;

    #[test]
    fn finished_open_and_broken_runs_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        for (name, ends) in [("a", true), ("b", false)] {
            let mut head = header();
            head.run_id = name.into();
            let mut writer =
                RunFileWriter::create(&folder.path().join(name).with_extension(EXTENSION), &head).unwrap();
            for tick in 0..2500 {
                writer.sample(&sample(tick));
            }
            if ends {
                writer.end(&outcome(2500));
            }
        }
        std::fs::write(folder.path().join("c.leafrun"), "not a run").unwrap();
        std::fs::write(folder.path().join("notes.txt"), "not a run").unwrap();
        let runs = list(folder.path()).unwrap();
        let names: Vec<&str> = runs.iter().map(|run| run.run_id.as_str()).collect();
        assert_eq!(names, ["c", "a", "b"], "a file without a start time comes first");
        assert!(runs[0].problem.contains("c.leafrun"));
        assert!(runs[1].outcome.is_some());
        assert!(runs[2].outcome.is_none());
        assert_eq!((runs[2].samples, runs[2].cycles_completed), (2500, 2));
    }
}
