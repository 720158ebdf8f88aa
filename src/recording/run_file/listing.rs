//! What a list says about one run file. The file is opened by `reader`; `daemon::run_index` lists folders of them.

use std::path::{Path, PathBuf};

use super::{RunFile, RunFileError};
use crate::recording::Outcome;

/// One run file, readable or not.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
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
    /// Run id of the interrupted run that this one resumes; empty otherwise.
    pub resumes_run: String,
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

/// What is damaged in a file, as sentences, after it was read in full; empty if it is whole.
pub(crate) fn check(path: &Path) -> String {
    match RunFile::open(path) {
        Ok(run) => run.survey().damage.join("; "),
        Err(error) => error.to_string(),
    }
}

/// True for a file that can be opened and has no end yet: it may still be written to.
pub(crate) fn is_open(path: &Path) -> bool {
    RunFile::open(path).is_ok_and(|run| run.outcome().is_none())
}

/// What is in the file at `path`. A closed file is not read in full: [`check`] finds damage in it.
pub(crate) fn listing(path: PathBuf) -> RunListing {
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
        resumes_run: header.resumes_run.clone(),
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
        resumes_run: String::new(),
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
    use super::super::test_support::{header, outcome, sample};
    use super::super::{EXTENSION, RunFileWriter};
    use super::*;
    use crate::recording::Recorder;

    #[test]
    fn finished_open_and_broken_runs_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).with_extension(EXTENSION);
        for (name, ends) in [("a", true), ("b", false)] {
            let mut head = header();
            head.run_id = name.into();
            let mut writer = RunFileWriter::create(&path(name), &head).unwrap();
            for tick in 0..2500 {
                writer.sample(&sample(tick));
            }
            if ends {
                writer.end(&outcome(2500));
            }
        }
        std::fs::write(path("c"), "not a run").unwrap();
        let [a, b, c] = ["a", "b", "c"].map(|name| listing(path(name)));
        assert!(a.is_closed() && a.problem.is_empty() && !is_open(&a.path));
        assert!(!b.is_closed() && is_open(&b.path));
        assert_eq!((b.samples, b.cycles_completed), (2500, 2));
        assert_eq!((c.run_id.as_str(), c.started_utc.as_str()), ("c", ""));
        assert!(c.problem.contains("c.leafrun") && !is_open(&c.path));
    }
}
