//! How full the disk of the run files is, between two runs. A run under way is watched by `disk_watch`.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::run_file::{RunFileError, check_space, free_bytes};

/// A disk with less room than for a run of this length is reported, s. The longest shipped profile takes 2 minutes; half an
/// hour leaves time to make room before a start is refused.
const ROOM_FOR_S: f64 = 1800.0;

/// The newest look at the disk.
#[derive(Debug, Default)]
pub(super) struct DiskSpace(Mutex<DiskLook>);

/// What one look found.
#[derive(Debug, Default)]
struct DiskLook {
    problem: Option<String>,
    free_bytes: Option<u64>,
}

impl DiskSpace {
    /// Looks at the disk of `folder`. May wait for the disk.
    pub(super) fn look(&self, folder: &Path) {
        let checked = check_space(folder, ROOM_FOR_S, f64::from(SAMPLE_RATE_HZ));
        let problem = checked.err().map(|error| match error {
            RunFileError::NoSpace {
                folder,
                free_mb,
                needed_mb,
            } => format!(
                "{} has only {free_mb:.0} MB free, and a run of half an hour needs {needed_mb:.0} MB: delete or move old runs",
                folder.display()
            ),
            other => super::error::chain(&other),
        });
        let free_bytes = free_bytes(folder).ok();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = DiskLook { problem, free_bytes };
    }

    /// What was wrong at the newest look, in one sentence.
    pub(super) fn problem(&self) -> Option<String> {
        let newest = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        newest.problem.clone()
    }

    /// Free space at the newest look; `None` before the first one and where the disk did not answer.
    pub(super) fn free_bytes(&self) -> Option<u64> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).free_bytes
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
        assert_eq!(space.free_bytes(), None);
        space.look(folder.path());
        assert_eq!(space.problem(), None, "{:?}", folder.path());
        assert!(space.free_bytes().is_some_and(|bytes| bytes > 0));
    }
}
