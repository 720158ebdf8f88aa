//! The file by which commands such as `leafbench run` find the daemon of a data folder.

use std::fs::Permissions;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::client_types::Endpoint;
use super::error::DaemonError;
use crate::recording::atomic_file;

/// Name of the file in the data folder that says where the daemon listens.
pub(crate) const ENDPOINT_FILE: &str = "daemon.json";

/// The file while the daemon serves. Dropping it removes the file; call it only under the lock of the data folder.
pub(super) struct EndpointFile {
    path: PathBuf,
    /// What the file says.
    pub endpoint: Endpoint,
}

impl EndpointFile {
    /// Writes the file of a daemon that answers this computer at `address`. `page`: where other computers find it.
    pub(super) fn publish(
        folder: &Path,
        address: SocketAddr,
        page: Option<String>,
    ) -> Result<EndpointFile, DaemonError> {
        let path = folder.join(ENDPOINT_FILE);
        let endpoint = Endpoint {
            url: format!("http://{address}"),
            pid: std::process::id(),
            page,
        };
        let write = || -> io::Result<()> {
            let text = serde_json::to_string(&endpoint)?;
            atomic_file::write(&path, |file| {
                // Other users of this computer find the daemon too, and show a token of their own.
                file.get_ref().set_permissions(Permissions::from_mode(0o644))?;
                writeln!(file, "{text}")
            })
        };
        write().map_err(|source| DaemonError::Folder {
            path: path.clone(),
            source,
        })?;
        Ok(EndpointFile { path, endpoint })
    }
}

impl Drop for EndpointFile {
    fn drop(&mut self) {
        // A file that stays behind names an address where no daemon answers, which the commands say.
        let _ = std::fs::remove_file(&self.path);
    }
}
