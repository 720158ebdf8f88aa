//! How full the disk of the run files is, between two runs. A run under way is watched by `disk_watch`.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::{RunFileError, check_space};

/// A disk with less room than for a run of this length is reported, s. The longest shipped profile takes 2 minutes; half an
/// hour leaves time to make room before a start is refused.
const ROOM_FOR_S: f64 = 1800.0;

/// The newest look at the disk.
#[derive(Debug, Default)]
pub(super) struct DiskSpace(Mutex<Option<String>>);

impl DiskSpace {
    /// Looks at the disk of `folder`. May wait for the disk.
    pub(super) fn look(&self, folder: &Path) {
        let checked = check_space(folder, ROOM_FOR_S, f64::from(SAMPLE_RATE_HZ));
        self.note(checked.err().map(|error| match error {
            RunFileError::NoSpace {
                folder,
                free_mb,
                needed_mb,
            } => format!(
                "{} has only {free_mb:.0} MB free, and a run of half an hour needs {needed_mb:.0} MB: delete or move old runs",
                folder.display()
            ),
            other => super::error::chain(&other),
        }));
    }

    fn note(&self, problem: Option<String>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = problem;
    }

    /// What was wrong at the newest look, in one sentence.
    pub(super) fn problem(&self) -> Option<String> {
        let newest = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        newest.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_read_is_a_sentence_and_one_with_room_is_none() {
        let space = DiskSpace::default();
        let folder = tempfile::tempdir().expect("a folder");
        space.look(&folder.path().join("gone"));
        let said = space.problem().expect("a problem");
        assert!(said.contains("gone"), "{said}");
        space.look(folder.path());
        assert_eq!(space.problem(), None, "{:?}", folder.path());
    }
}
