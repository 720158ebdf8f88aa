//! Writes a file whole or not at all: temporary name, fsync, rename, fsync of the folder. The caller fills it. Recordings and
//! what is made from them are for their owner only.

use std::fs::{self, DirBuilder, File};
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Makes a new file that only its owner can read and write. A file or link of this name must not exist.
pub(crate) fn create_private(path: &Path) -> io::Result<File> {
    File::options()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)
}

/// Makes a folder, with the folders above it, that only its owner can enter. An existing folder stays as it is.
pub(crate) fn create_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(path)
}

/// Fills `path` through `fill`. A crash at any instant leaves the old file or the new one, never half of one.
pub(crate) fn write<T, E: From<io::Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T, E>,
) -> Result<T, E> {
    let temporary = temporary_path(path)?;
    let written = fill_and_sync(&temporary, fill).and_then(|value| {
        fs::rename(&temporary, path)?;
        sync_folder(path)?;
        Ok(value)
    });
    if written.is_err() {
        // The first error is the one to report, not a failure to remove the temporary file.
        let _ = fs::remove_file(&temporary);
    }
    written
}

fn fill_and_sync<T, E: From<io::Error>>(
    temporary: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T, E>,
) -> Result<T, E> {
    // A killed process with the same id may have left it.
    let _ = fs::remove_file(temporary);
    let mut writer = BufWriter::with_capacity(1 << 18, create_private(temporary)?);
    let value = fill(&mut writer)?;
    writer.flush()?;
    writer.get_ref().sync_all()?;
    Ok(value)
}

/// A hidden name in the same folder, because a rename must not cross file systems. It contains the process id, so that two
/// exports of one run do not write into the same file.
fn temporary_path(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            format!(
                "{} is not a file name: add a file name to the folder",
                path.display()
            ),
        )
    })?;
    let hidden = format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id());
    Ok(path.with_file_name(hidden))
}

/// Syncs the folder of `path`, so that its entry survives a power cut.
pub(crate) fn sync_folder(path: &Path) -> io::Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn k6_a_failed_export_leaves_the_old_file_and_no_litter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.csv");
        write::<_, io::Error>(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write::<(), io::Error>(&path, |w| {
            w.write_all(b"half of the new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_finished_export_replaces_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.csv");
        write::<_, io::Error>(&path, |w| w.write_all(b"old")).unwrap();
        write::<_, io::Error>(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
