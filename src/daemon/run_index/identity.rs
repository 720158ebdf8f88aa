//! When a run file is still the one that was read: size, times and inode of the file and of its write-ahead log.

use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// Nanoseconds in a second.
const S: i64 = 1_000_000_000;
/// A file that changed less than this before it was read may change again within the same time stamp, ns. File systems have
/// steps of some milliseconds, simple ones of a second.
const FRESH_NS: u64 = S.unsigned_abs();

/// Tells two states of a run file apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FileIdentity {
    file: FileStamp,
    /// The log beside a file that is being written, or that was left open.
    log: Option<FileStamp>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct FileStamp {
    bytes: u64,
    inode: u64,
    /// Time of the last change of the content, ns.
    modified_ns: i64,
    /// Time of the last change of content, name or rights, ns. Programs cannot set it.
    changed_ns: i64,
}

impl FileStamp {
    fn of(path: &Path) -> Option<FileStamp> {
        let metadata = std::fs::metadata(path).ok()?;
        // A time that does not fit is still another one than before.
        let ns = |s: i64, ns: i64| s.wrapping_mul(S).wrapping_add(ns);
        Some(FileStamp {
            bytes: metadata.len(),
            inode: metadata.ino(),
            modified_ns: ns(metadata.mtime(), metadata.mtime_nsec()),
            changed_ns: ns(metadata.ctime(), metadata.ctime_nsec()),
        })
    }
}

impl FileIdentity {
    /// The file at `path` as it is now, with the log at `log`; `None` if it is no longer there.
    pub(super) fn of(path: &Path, log: Option<&Path>) -> Option<FileIdentity> {
        Some(FileIdentity {
            file: FileStamp::of(path)?,
            log: log.and_then(FileStamp::of),
        })
    }

    /// Size of the file.
    pub(super) fn bytes(&self) -> u64 {
        self.file.bytes
    }

    /// There is a log beside the file.
    pub(super) fn has_log(&self) -> bool {
        self.log.is_some()
    }

    /// The file changed so shortly before `now` that a further change could leave all stamps as they are.
    pub(super) fn is_fresh(&self, now: SystemTime) -> bool {
        let now_ns = now.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as i64);
        let mut stamps = [Some(self.file), self.log].into_iter().flatten();
        stamps.any(|stamp| now_ns.abs_diff(stamp.changed_ns) < FRESH_NS)
    }
}
