//! One daemon a rig and one daemon a data folder: advisory locks that the kernel drops with the process, however it ends.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

use super::DaemonError;
use crate::link;

/// Both locks; they are held as long as this lives.
#[derive(Debug)]
pub(crate) struct Claim {
    _data_folder: File,
    _link: File,
}

impl Claim {
    /// Claims the data folder (made where it is missing) and the link. Take it before the link is opened: a second
    /// daemon must not put one frame on the bus.
    pub(crate) fn take(data_folder: &Path, link_address: &str) -> Result<Claim, DaemonError> {
        std::fs::create_dir_all(data_folder).map_err(|source| DaemonError::Folder {
            path: data_folder.to_owned(),
            source,
        })?;
        let _data_folder = lock(
            &data_folder.join("daemon.lock"),
            &data_folder.display().to_string(),
        )?;
        let _link = lock(&link_lock(link_address), link_address)?;
        Ok(Claim { _data_folder, _link })
    }
}

/// The same for every user and data folder of this machine, so that it is the rig that is claimed.
fn link_lock(link_address: &str) -> PathBuf {
    let name: String = link_address
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect();
    // A rig in memory belongs to its process: nobody else can reach it.
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
        .open(path)
        .map_err(failed)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut owner = String::new();
            // Only for the message: an unreadable owner is no reason to fail otherwise.
            let _ = file.read_to_string(&mut owner);
            return Err(DaemonError::Claimed {
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
    fn a_second_claim_is_refused_with_the_owner_and_granted_after_the_first_has_gone() {
        let folder = tempfile::tempdir().expect("a folder");
        let address = format!("can:test{}", std::process::id());
        let first = Claim::take(folder.path(), &address).expect("free");
        let Err(DaemonError::Claimed { owner, .. }) = Claim::take(folder.path(), &address) else {
            panic!("a second claim must be refused");
        };
        assert_eq!(owner, std::process::id().to_string());
        let elsewhere = tempfile::tempdir().expect("a folder");
        assert!(matches!(
            Claim::take(elsewhere.path(), &address),
            Err(DaemonError::Claimed { what, .. }) if what == address
        ));
        drop(first);
        Claim::take(folder.path(), &address).expect("free again");
    }
}
