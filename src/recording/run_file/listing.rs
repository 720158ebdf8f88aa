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
    /// Number of samples in the file.
    pub samples: u64,
    /// Number of ticks without a sample.
    pub lost: u64,
    /// Samples that the link delivered too late.
    pub late: u64,
    /// Counted cycles that ran to their end.
    pub cycles_completed: u32,
    /// How it ended; `None` while the run is live, or if its daemon was killed.
    pub outcome: Option<Outcome>,
    /// Why the file cannot be read; empty if it can.
    pub problem: String,
}

/// All run files in `folder`, oldest first. A file that cannot be read is in the list with its problem.
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

fn listing(path: PathBuf) -> RunListing {
    let run = match RunFile::open(&path) {
        Ok(run) => run,
        Err(error) => {
            return RunListing {
                run_id: path
                    .file_stem()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned(),
                path,
                started_utc: String::new(),
                profile_name: String::new(),
                specimen: String::new(),
                samples: 0,
                lost: 0,
                late: 0,
                cycles_completed: 0,
                outcome: None,
                problem: error.to_string(),
            };
        }
    };
    let header = run.header();
    let (samples, lost, late, cycles_completed) = match run.outcome() {
        Some(outcome) => (
            outcome.samples,
            outcome.lost,
            outcome.late,
            outcome.cycles_completed,
        ),
        None => {
            let survey = run.survey();
            (
                survey.samples,
                survey.lost + survey.damaged,
                survey.late,
                survey.cycles_completed(),
            )
        }
    };
    RunListing {
        run_id: header.run_id.clone(),
        started_utc: header.started_utc.clone(),
        profile_name: header.profile_name.clone(),
        specimen: header.specimen.clone(),
        samples,
        lost,
        late,
        cycles_completed,
        outcome: run.outcome().cloned(),
        problem: String::new(),
        path,
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
