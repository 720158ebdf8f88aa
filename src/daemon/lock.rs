//! Advisory locks: one daemon for each rig, and one for each data folder. The kernel releases them when the process ends,
//! also after a crash.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use super::error::DaemonError;
use crate::link;
use crate::recording::atomic_file;

/// The locks of the data folder and of the link. Dropping it releases both.
#[derive(Debug)]
pub(crate) struct DaemonLock {
    _data_folder: File,
    _link: File,
}

impl DaemonLock {
    /// Locks the data folder, which is created if it does not exist, and the link. Call it before the link is opened: a
    /// second daemon must not send a single frame.
    pub(crate) fn take(data_folder: &Path, link_address: &str) -> Result<DaemonLock, DaemonError> {
        atomic_file::create_private_folder(data_folder).map_err(|source| DaemonError::Folder {
            path: data_folder.to_owned(),
            source,
        })?;
        let _data_folder = lock(
            &data_folder.join("daemon.lock"),
            &data_folder.display().to_string(),
        )?;
        let _link = lock(&link_lock(link_address), link_address)?;
        Ok(DaemonLock { _data_folder, _link })
    }
}

/// The lock file of a link: the same for every user and every data folder of this computer.
fn link_lock(link_address: &str) -> PathBuf {
    let name: String = link_address
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect();
    // Each process has its own mock rig in memory.
    let own = if link::is_in_process(link_address) {
        format!("-{}", std::process::id())
    } else {
        String::new()
    };
    std::env::temp_dir().join(format!("leafbench-link-{name}{own}.lock"))
}

fn lock(path: &Path, what: &str) -> Result<File, DaemonError> {
    let failed = |source| DaemonError::Folder {
        path: path.to_owned(),
        source,
    };
    let mut file = File::options()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .open(path)
        .map_err(failed)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut owner = String::new();
            // The owner is only for the message, so a failed read leaves it empty.
            let _ = file.read_to_string(&mut owner);
            return Err(DaemonError::Locked {
                what: what.to_owned(),
                owner: owner.trim().to_owned(),
            });
        }
        Err(TryLockError::Error(source)) => return Err(failed(source)),
    }
    file.set_len(0).map_err(failed)?;
    file.rewind().map_err(failed)?;
    writeln!(file, "{}", std::process::id()).map_err(failed)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_lock_is_refused_with_the_owner_and_granted_after_the_first_is_released() {
        let folder = tempfile::tempdir().expect("a folder");
        let address = format!("can:test{}", std::process::id());
        let first = DaemonLock::take(folder.path(), &address).expect("free");
        let Err(DaemonError::Locked { owner, .. }) = DaemonLock::take(folder.path(), &address) else {
            panic!("a second lock must be refused");
        };
        assert_eq!(owner, std::process::id().to_string());
        let elsewhere = tempfile::tempdir().expect("a folder");
        assert!(matches!(
            DaemonLock::take(elsewhere.path(), &address),
            Err(DaemonError::Locked { what, .. }) if what == address
        ));
        drop(first);
        DaemonLock::take(folder.path(), &address).expect("free again");
    }
}
