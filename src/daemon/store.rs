//! The data folder: run files, found by run id and never by path. Runs that an earlier daemon left open are closed as
//! aborted.

use std::collections::HashMap;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use crate::recording::run_file::{self, EXTENSION, RunFile, RunFileError, RunListing};

/// The cause of a run that was closed by the next daemon.
const LEFT_OPEN: &str = "the file was left open: the daemon was killed or crashed, the power failed, or the disk could not \
                         be written; a rig that was running unloaded by itself when its lease expired";

/// The folder of run files. Clones share what they know of the files.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    folder: PathBuf,
    checked: Arc<Mutex<HashMap<PathBuf, Checked>>>,
}

/// The result of reading a closed file in full.
#[derive(Debug, Clone)]
struct Checked {
    bytes: u64,
    changed: SystemTime,
    problem: String,
}

impl Store {
    /// The store of the run files in `folder`.
    pub(crate) fn new(folder: &Path) -> Self {
        Store {
            folder: folder.to_owned(),
            checked: Arc::default(),
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Path of the run file for an id that [`new_run_id`] has just made. Ids from requests go through [`Store::find`].
    pub(crate) fn path_for_new(&self, run_id: &str) -> PathBuf {
        self.folder.join(format!("{run_id}.{EXTENSION}"))
    }

    /// Closes the runs that an earlier daemon left open. Returns one sentence for each run, for the log.
    pub(crate) fn close_left_open(&self) -> Result<Vec<String>, RunFileError> {
        let runs = run_file::list(&self.folder)?;
        let open = runs
            .iter()
            .filter(|run| !run.is_closed() && run.problem.is_empty());
        let close = |run: &RunListing| {
            let next = runs.iter().find(|r| r.continues == run.run_id);
            let cause = next.map_or_else(|| LEFT_OPEN.to_owned(), |next| continued_in(&next.run_id));
            close_as_aborted(&run.path, &run.run_id, &cause)
        };
        Ok(open.map(close).collect())
    }

    /// Every run, oldest first, with what is damaged in its file. A closed file is read in full once, and again if its size
    /// or its time of change differs.
    pub(crate) fn list(&self) -> Result<Vec<RunListing>, RunFileError> {
        let mut runs = run_file::list(&self.folder)?;
        for run in runs
            .iter_mut()
            .filter(|run| run.is_closed() && run.problem.is_empty())
        {
            run.problem = self.check(&run.path);
        }
        Ok(runs)
    }

    fn check(&self, path: &Path) -> String {
        let metadata = std::fs::metadata(path);
        let state = metadata.and_then(|m| Ok((m.len(), m.modified()?))).ok();
        let known = |state: &(u64, SystemTime)| {
            let checked = self.checked.lock().unwrap_or_else(PoisonError::into_inner);
            let known = checked.get(path).filter(|c| (c.bytes, c.changed) == *state);
            known.map(|c| c.problem.clone())
        };
        if let Some(problem) = state.as_ref().and_then(known) {
            return problem;
        }
        let problem = run_file::check(path);
        if let Some((bytes, changed)) = state {
            let checked = Checked {
                bytes,
                changed,
                problem: problem.clone(),
            };
            let mut all = self.checked.lock().unwrap_or_else(PoisonError::into_inner);
            all.insert(path.to_owned(), checked);
        }
        problem
    }

    /// The run with this id. The id `latest` means the newest run. A closed file is not read in full.
    pub(crate) fn find(&self, run_id: &str) -> Result<Option<RunListing>, RunFileError> {
        let mut runs = run_file::list(&self.folder)?;
        if run_id == "latest" {
            return Ok(runs.pop());
        }
        Ok(runs.into_iter().find(|run| run.run_id == run_id))
    }
}

/// The cause of a file that was left open because of an error of the disk.
pub(super) fn continued_in(next: &str) -> String {
    format!("writing this file failed, and the recording continues in run {next}")
}

/// Closes one run file as aborted. Returns a sentence about the result, for the log.
pub(crate) fn close_as_aborted(path: &Path, run_id: &str, cause: &str) -> String {
    match RunFile::open(path).and_then(|run| run.close_as_aborted(cause)) {
        Ok(outcome) => format!(
            "run {run_id} was left open: closed as aborted with {} samples",
            outcome.samples
        ),
        Err(error) => format!("run {run_id} was left open and cannot be closed: {error}"),
    }
}

/// A new run id: UTC time in s and four random characters, so that ids sort by time and differ.
pub(crate) fn new_run_id(now: jiff::Timestamp) -> String {
    const LETTERS: &[u8; 32] = b"abcdefghijkmnpqrstuvwxyz23456789";
    // The standard library gives every RandomState a random key.
    let random = RandomState::new().build_hasher().finish();
    let tail: String = (0..4)
        .map(|i| char::from(LETTERS[(random >> (5 * i)) as usize % LETTERS.len()]))
        .collect();
    let time = now.strftime("%Y%m%dt%H%M%S");
    format!("{time}-{tail}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_sort_by_time_differ_and_have_only_letters_digits_and_a_dash() {
        let at = |s| jiff::Timestamp::from_second(s).expect("a time");
        let (a, b, later) = (new_run_id(at(0)), new_run_id(at(0)), new_run_id(at(86_400)));
        assert_ne!(a, b);
        assert!(a < later && b < later);
        assert!(a.starts_with("19700101t000000-") && a.len() == 20, "{a}");
        assert!(
            a.chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-')
        );
    }

    #[test]
    fn ids_from_requests_are_looked_up_and_never_become_paths() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("secret.leafrun"), "x").expect("written");
        std::fs::create_dir(folder.path().join("runs")).expect("made");
        let store = Store::new(&folder.path().join("runs"));
        for id in ["../secret", "..%2fsecret", "/etc/passwd", "", ".", "latest"] {
            assert!(store.find(id).expect("listed").is_none(), "{id}");
        }
    }
}
