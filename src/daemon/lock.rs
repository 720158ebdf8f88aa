//! One daemon for each data folder and one for each rig. The kernel releases both claims when the process ends, also after a
//! crash.
//!
//! The data folder is claimed by a lock on its file `daemon.lock`. The file stays behind: a daemon that removed it could
//! leave two others with one lock each. A link has no folder of its own that every user may write to, so it is claimed by a
//! socket with an abstract name: no file, no access rights, the same for all users of this computer. Such names belong to
//! the network namespace, as CAN interfaces do. A serial port has its own exclusive lock besides.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::path::Path;

use nix::fcntl::OFlag;
use nix::sys::socket::{getsockopt, sockopt};
use sha2::{Digest, Sha256};

use super::error::DaemonError;
use crate::link;
use crate::recording::atomic_file;
use crate::regular_file::require_regular;

/// Longest name of a link in the name of its socket, bytes. The kernel takes 107 for the whole name.
const NAME_MAX_BYTES: usize = 80;

/// The claims on data folder and link. Dropping it releases both.
#[derive(Debug)]
pub(crate) struct DaemonLock {
    _data_folder: File,
    /// `None` for a mock rig in memory: each process has its own.
    _link: Option<UnixListener>,
}

impl DaemonLock {
    /// Claims the data folder, which is created if it does not exist, and the link. Call it before the link is opened: a
    /// second daemon must not send a single frame.
    pub(crate) fn take(data_folder: &Path, link_address: &str) -> Result<DaemonLock, DaemonError> {
        atomic_file::create_private_folder(data_folder).map_err(|source| DaemonError::Folder {
            path: data_folder.to_owned(),
            source,
        })?;
        let _data_folder = lock_folder(data_folder)?;
        let _link = match link::is_in_process(link_address) {
            true => None,
            false => Some(claim_link(link_address)?),
        };
        Ok(DaemonLock { _data_folder, _link })
    }
}

fn claim_link(link_address: &str) -> Result<UnixListener, DaemonError> {
    let failed = |source| DaemonError::Claim {
        what: link_address.to_owned(),
        source,
    };
    let address = SocketAddr::from_abstract_name(socket_name(link_address)).map_err(failed)?;
    UnixListener::bind_addr(&address).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => DaemonError::Locked {
            what: link_address.to_owned(),
            owner: owner_of(&address),
        },
        _ => failed(error),
    })
}

/// The name of a link's socket. Two names of one serial port (`/dev/serial/by-id/...`) give the same.
fn socket_name(link_address: &str) -> String {
    let mut name = link_address.to_owned();
    if let Some((scheme, path)) = link_address.split_once(':')
        && path.starts_with('/')
        && let Ok(path) = std::fs::canonicalize(path)
    {
        name = format!("{scheme}:{}", path.display());
    }
    if name.len() > NAME_MAX_BYTES {
        name = Sha256::digest(&name).iter().map(|b| format!("{b:02x}")).collect();
    }
    format!("leafbench-link-{name}")
}

/// Process id of the owner of a socket, for the message; `unknown` if it has just ended.
fn owner_of(address: &SocketAddr) -> String {
    let peer = UnixStream::connect_addr(address)
        .ok()
        .and_then(|stream| getsockopt(&stream, sockopt::PeerCredentials).ok());
    peer.map_or_else(|| "unknown".to_owned(), |peer| peer.pid().to_string())
}

fn lock_folder(folder: &Path) -> Result<File, DaemonError> {
    let path = folder.join("daemon.lock");
    let failed = |source| DaemonError::Folder {
        path: path.clone(),
        source,
    };
    // A link in its place could lead to any file of this user, which the next lines would empty.
    let mut file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .custom_flags((OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK).bits())
        .open(&path)
        .map_err(failed)?;
    require_regular(&file).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut owner = String::new();
            // The owner is only for the message, so a failed read leaves it empty.
            let _ = (&file).take(20).read_to_string(&mut owner);
            return Err(DaemonError::Locked {
                what: folder.display().to_string(),
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
        let own = std::process::id().to_string();
        let first = DaemonLock::take(folder.path(), &address).expect("free");
        let Err(DaemonError::Locked { owner, .. }) = DaemonLock::take(folder.path(), &address) else {
            panic!("a second lock must be refused");
        };
        assert_eq!(owner, own);
        let elsewhere = tempfile::tempdir().expect("a folder");
        assert!(matches!(
            DaemonLock::take(elsewhere.path(), &address),
            Err(DaemonError::Locked { what, owner }) if what == address && owner == own
        ));
        drop(first);
        DaemonLock::take(folder.path(), &address).expect("free again");
    }

    #[test]
    fn a_link_in_place_of_the_lock_file_is_refused_and_its_target_keeps_its_content() {
        let folder = tempfile::tempdir().expect("a folder");
        let target = folder.path().join("target");
        std::fs::write(&target, "precious").expect("written");
        std::os::unix::fs::symlink(&target, folder.path().join("daemon.lock")).expect("made");
        let refused = DaemonLock::take(folder.path(), "mock:");
        assert!(matches!(refused, Err(DaemonError::Folder { .. })), "{refused:?}");
        assert_eq!(std::fs::read_to_string(&target).expect("there"), "precious");
    }

    #[test]
    fn a_lock_leaves_no_file_outside_the_data_folder_and_only_its_user_can_read_it() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let address = format!("can:files{}", std::process::id());
        let _lock = DaemonLock::take(folder.path(), &address).expect("free");
        let strays = std::fs::read_dir(std::env::temp_dir()).expect("listed").flatten();
        let strays: Vec<_> = strays
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .filter(|name| name.contains(&format!("files{}", std::process::id())))
            .collect();
        assert!(strays.is_empty(), "{strays:?}");
        let lock = std::fs::metadata(folder.path().join("daemon.lock")).expect("there");
        assert_eq!(lock.permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn two_names_of_one_port_are_one_link_and_a_long_name_fits() {
        let folder = tempfile::tempdir().expect("a folder");
        let (port, other) = (folder.path().join("port"), folder.path().join("by-id"));
        std::fs::write(&port, "").expect("written");
        std::os::unix::fs::symlink(&port, &other).expect("made");
        let name = |path: &Path| socket_name(&format!("serial:{}", path.display()));
        assert_eq!(name(&port), name(&other));
        assert_ne!(name(&port), name(folder.path()));
        let long = socket_name(&format!("serial:/dev/{}", "x".repeat(200)));
        assert!(
            SocketAddr::from_abstract_name(&long).is_ok() && long.len() < 100,
            "{long}"
        );
    }
}
