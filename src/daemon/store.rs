//! The data folder: run files, found by run id and never by path. Runs that an earlier daemon left open are closed as
//! aborted.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::run_index::{CheckLimits, IndexedRun, IndexedRuns, RunIndex};
use super::run_search::{self, RunPage, RunQuery};
use crate::nearest;
use crate::recording::run_file::{EXTENSION, RunFile, RunFileError, RunListing};

/// The cause of a run that was closed by the next daemon.
const LEFT_OPEN: &str = "the file was left open: the daemon was killed or crashed, the power failed, or the disk could not \
                         be written; a rig that was running unloaded by itself when its lease expired";

/// The id that means the newest run.
pub(crate) const LATEST: &str = "latest";
/// Fewest characters of a short run id.
const SHORTEST_ID: usize = 3;
/// Messages show at most this many characters of an id.
const SHOWN_CHARS: usize = 40;

/// Why an id stands for no run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FindRunError {
    #[error(transparent)]
    Disk(#[from] RunFileError),
    #[error(
        "there is no run \"{id}\" in {}{}: list the runs with `leafbench runs`, or name another folder with --data",
        folder.display(),
        nearest::question(meant.as_deref())
    )]
    Unknown {
        id: String,
        folder: PathBuf,
        /// The run id that is probably meant.
        meant: Option<String>,
    },
    /// A short id that several run ids begin or end with.
    #[error("\"{id}\" stands for {} runs: write more of the id: {}", runs.len(), runs.join(", "))]
    Several { id: String, runs: Vec<String> },
}

/// The folder of run files. Clones share one index.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    index: Arc<RunIndex>,
}

impl Store {
    /// The store of the run files in `folder`.
    pub(crate) fn new(folder: &Path) -> Self {
        Store {
            index: Arc::new(RunIndex::new(folder)),
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        self.index.folder()
    }

    /// Path of the run file for an id that [`new_run_id`] has just made. Ids from requests go through [`Store::find`].
    pub(crate) fn path_for_new(&self, run_id: &str) -> PathBuf {
        self.folder().join(format!("{run_id}.{EXTENSION}"))
    }

    /// Closes the runs that an earlier daemon left open. Returns one sentence for each run, for the log.
    pub(crate) fn close_left_open(&self) -> Result<Vec<String>, RunFileError> {
        let runs = self.runs()?;
        let listings = runs.iter().map(|run| &run.listing);
        let open = listings
            .clone()
            .filter(|run| !run.is_closed() && run.problem.is_empty());
        let close = |run: &RunListing| {
            let next = listings.clone().find(|r| r.continues == run.run_id);
            let cause = next.map_or_else(|| LEFT_OPEN.to_owned(), |next| continued_in(&next.run_id));
            close_as_aborted(&run.path, &run.run_id, &cause)
        };
        Ok(open.map(close).collect())
    }

    /// Every run, oldest first. Closed files are not read in full.
    pub(crate) fn runs(&self) -> Result<IndexedRuns, RunFileError> {
        self.index.look()
    }

    /// The runs that are wanted, newest first, with what is damaged in their files. Files are read in full for at most the
    /// time `within`.
    pub(crate) fn search(&self, query: &RunQuery, within: Option<Duration>) -> Result<RunPage, RunFileError> {
        run_search::search(&self.index, query, within)
    }

    /// Reads files in full that were not, newest first, for at most the time `within`. Returns how many are left.
    pub(crate) fn check_some(&self, within: Duration) -> Result<usize, RunFileError> {
        let newest_first: Vec<_> = self.runs()?.iter().rev().map(Arc::clone).collect();
        let limits = CheckLimits {
            until: Some(Instant::now() + within),
            file_bytes: None,
        };
        Ok(self.index.check(&newest_first, limits))
    }

    /// The run with this id, or the only one whose id begins or ends with it. The id `latest` means the newest run. A closed file
    /// is not read in full.
    pub(crate) fn find(&self, run_id: &str) -> Result<RunListing, FindRunError> {
        let runs = self.runs()?;
        let place = match run_id {
            LATEST => runs.len().checked_sub(1),
            id => place_of(id, &runs)?,
        };
        match place {
            Some(place) => Ok(runs[place].listing.clone()),
            None => Err(self.unknown(run_id, &runs)),
        }
    }

    /// As [`Store::find`], but `latest` means the newest run that is over.
    pub(crate) fn find_finished(&self, run_id: &str) -> Result<RunListing, FindRunError> {
        if run_id != LATEST {
            return self.find(run_id);
        }
        let runs = self.runs()?;
        let newest = runs.iter().rev().find(|run| run.listing.is_closed());
        newest.map_or_else(|| Err(self.unknown(run_id, &[])), |run| Ok(run.listing.clone()))
    }

    fn unknown(&self, run_id: &str, runs: &[Arc<IndexedRun>]) -> FindRunError {
        let ids: Vec<&str> = runs.iter().map(|run| run.listing.run_id.as_str()).collect();
        FindRunError::Unknown {
            id: run_id.chars().take(SHOWN_CHARS).collect(),
            folder: self.folder().to_owned(),
            meant: nearest::typed_wrong(run_id, &ids).map(str::to_owned),
        }
    }
}

/// Index of the run with this id, or of the only one whose id begins or ends with it.
fn place_of(id: &str, runs: &[Arc<IndexedRun>]) -> Result<Option<usize>, FindRunError> {
    let run_id = |run: &Arc<IndexedRun>| run.listing.run_id.clone();
    if let Some(exact) = runs.iter().position(|run| run.listing.run_id == id) {
        return Ok(Some(exact));
    }
    if id.chars().count() < SHORTEST_ID {
        return Ok(None);
    }
    let matches = |run: &RunListing| run.run_id.starts_with(id) || run.run_id.ends_with(id);
    let places: Vec<usize> = (0..runs.len()).filter(|&i| matches(&runs[i].listing)).collect();
    match places.as_slice() {
        [] => Ok(None),
        [only] => Ok(Some(*only)),
        several => Err(FindRunError::Several {
            id: id.to_owned(),
            runs: several.iter().map(|&i| run_id(&runs[i])).collect(),
        }),
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
    use crate::recording::Recorder;
    use crate::recording::run_file::{self, test_support};

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
    fn n6_ids_from_requests_are_looked_up_and_never_become_paths() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("secret.leafrun"), "x").expect("written");
        std::fs::create_dir(folder.path().join("runs")).expect("made");
        let store = Store::new(&folder.path().join("runs"));
        for id in ["../secret", "..%2fsecret", "/etc/passwd", "", ".", "latest"] {
            assert!(
                matches!(store.find(id), Err(FindRunError::Unknown { .. })),
                "{id}"
            );
        }
    }

    /// A folder with an empty run of each id, started at the given times; a closed run if `closed`.
    fn store_of(runs: &[(&str, &str, bool)]) -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().expect("a folder");
        for (id, started_utc, closed) in runs {
            let mut header = test_support::header();
            (header.run_id, header.started_utc) = ((*id).to_owned(), (*started_utc).to_owned());
            let path = folder.path().join(format!("{id}.{EXTENSION}"));
            let mut writer = run_file::RunFileWriter::create(&path, &header).expect("created");
            if *closed {
                writer.end(&test_support::outcome(0));
            }
        }
        let store = Store::new(folder.path());
        (folder, store)
    }

    const RUNS: [(&str, &str, bool); 3] = [
        ("20261123t091621-wxyz", "2026-11-23T09:16:21.100Z", true),
        ("20261123t091621-abcd", "2026-11-23T09:16:21.900Z", true),
        ("20261124t080000-efgh", "2026-11-24T08:00:00.000Z", false),
    ];

    #[test]
    fn a_short_id_stands_for_the_only_run_that_begins_or_ends_with_it() {
        let (_folder, store) = store_of(&RUNS);
        let found = |id: &str| store.find(id).map(|run| run.run_id).map_err(|e| e.to_string());
        for (id, run) in [
            ("abcd", RUNS[1].0),
            ("20261124", RUNS[2].0),
            (RUNS[0].0, RUNS[0].0),
        ] {
            assert_eq!(found(id).as_deref(), Ok(run), "{id}");
        }
        let several = found("20261123t").expect_err("two");
        assert!(
            several.ends_with(
                "stands for 2 runs: write more of the id: 20261123t091621-wxyz, 20261123t091621-abcd"
            ),
            "{several}"
        );
        for id in ["zz", "cd", "t0916"] {
            assert!(found(id).expect_err(id).contains("there is no run"), "{id}");
        }
        let typed = found("20261123t091621-abce").expect_err("mistyped");
        assert!(typed.contains("did you mean 20261123t091621-abcd?"), "{typed}");
    }

    #[test]
    fn runs_of_one_second_are_in_order_and_the_latest_finished_one_is_closed() {
        let (_folder, store) = store_of(&RUNS);
        let runs = store.runs().expect("listed");
        let ids: Vec<String> = runs.iter().map(|r| r.listing.run_id.clone()).collect();
        assert_eq!(ids, RUNS.map(|(id, ..)| id.to_owned()));
        assert_eq!(store.find(LATEST).expect("found").run_id, RUNS[2].0);
        assert_eq!(store.find_finished(LATEST).expect("found").run_id, RUNS[1].0);
    }
}
