//! Files that only one user can read: written with mode 0600, and believed only if they still are so.

use std::fs::{self, File, Metadata};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, chown};
use std::path::Path;

use crate::recording::atomic_file;

/// Largest file that is read, bytes: thousands of tokens.
const MAX_BYTES: u64 = 1 << 20;
/// Rights of group and others.
const NOT_PRIVATE: u32 = 0o077;

/// The user of this process.
fn own_uid() -> io::Result<u32> {
    Ok(fs::metadata("/proc/self")?.uid())
}

/// Why a file cannot be believed; `None` if nobody but its user can have written or read it.
fn objection(metadata: &Metadata) -> io::Result<Option<&'static str>> {
    let is_own = metadata.uid() == own_uid()? || metadata.uid() == 0;
    Ok(match metadata {
        m if !m.is_file() => Some("it is no regular file"),
        _ if !is_own => Some("it belongs to another user"),
        m if m.mode() & NOT_PRIVATE != 0 => Some("other users may read or write it"),
        _ => None,
    })
}

/// The text of a file that only this user, or root, can have written. `Ok(None)` if it is not there. A file that others could
/// read or write is an error: its secrets may be theirs.
pub(super) fn read(path: &Path) -> io::Result<Option<String>> {
    let refuse = |why: &str| Err(io::Error::new(io::ErrorKind::PermissionDenied, why.to_owned()));
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
        Ok(metadata) => {
            if let Some(why) = objection(&metadata)? {
                return refuse(why);
            }
        }
    }
    let file = File::open(path)?;
    // The file that is open, which may be another one by now.
    if let Some(why) = objection(&file.metadata()?)? {
        return refuse(why);
    }
    let mut text = String::new();
    file.take(MAX_BYTES).read_to_string(&mut text)?;
    Ok(Some(text))
}

/// Writes a file for the owner of its folder, whole or not at all. So root can do it for the user of the daemon.
pub(super) fn write(path: &Path, text: &str) -> io::Result<()> {
    atomic_file::write(path, |file| file.write_all(text.as_bytes()))?;
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let owner = fs::metadata(folder)?.uid();
    if owner != own_uid()? {
        chown(path, Some(owner), None)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_file_that_others_can_read_or_a_link_is_not_believed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("token");
        assert_eq!(read(&path).expect("not there"), None);
        write(&path, "secret").expect("written");
        assert_eq!(read(&path).expect("private").as_deref(), Some("secret"));
        for mode in [0o640, 0o604, 0o620, 0o602] {
            fs::set_permissions(&path, PermissionsExt::from_mode(mode)).expect("set");
            assert!(read(&path).is_err(), "{mode:o}");
        }
        write(&path, "again").expect("written");
        assert_eq!(
            fs::metadata(&path).expect("there").permissions().mode() & 0o777,
            0o600
        );
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&path, &link).expect("made");
        assert!(read(&link).is_err());
    }
}
