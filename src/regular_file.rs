//! Opens and reads files that a person or another program named. A pipe, a device or a socket in their place is refused at
//! once: the open does not wait for a writer, and the read ends at a limit.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use nix::fcntl::OFlag;

/// Largest size of a file that a person writes (bench, specimen, profile, table), in bytes.
pub(crate) const WRITTEN_MAX_BYTES: u64 = 1 << 20;

/// Largest size of a table of tests or of the points of one loop, in bytes: some 100 000 rows.
pub(crate) const TABLE_MAX_BYTES: u64 = 1 << 24;

/// Why a file is not read. The caller's error names the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FileRefusal {
    /// The path leads to something that has no end or that waits for another program.
    #[error("it is {0}: give a regular file")]
    NotRegular(&'static str),
    /// The file has more bytes than a file of its kind can need.
    #[error("it has more than {most_bytes} bytes, the most that is allowed: check that it is the right file")]
    TooLarge {
        /// Largest size allowed, in bytes.
        most_bytes: u64,
    },
}

impl From<FileRefusal> for io::Error {
    fn from(refusal: FileRefusal) -> io::Error {
        io::Error::new(io::ErrorKind::InvalidInput, refusal)
    }
}

/// Opens a regular file for reading. Never waits: a named pipe without a writer is refused like every other special file.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(OFlag::O_NONBLOCK.bits())
        .open(path)?;
    require_regular(&file)?;
    Ok(file)
}

/// Refuses an open file that is not a regular one.
pub(crate) fn require_regular(file: &File) -> io::Result<()> {
    match kind(file.metadata()?.file_type()) {
        None => Ok(()),
        Some(kind) => Err(FileRefusal::NotRegular(kind).into()),
    }
}

/// The kind of a special file in words; `None` for a regular file.
fn kind(of: FileType) -> Option<&'static str> {
    match of {
        of if of.is_file() => None,
        of if of.is_dir() => Some("a folder"),
        of if of.is_fifo() => Some("a pipe"),
        of if of.is_socket() => Some("a socket"),
        _ => Some("a device"),
    }
}

/// The bytes of a regular file of at most `most_bytes` bytes. At most one byte more is read, also if the file grows.
pub(crate) fn read(path: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let too_large = FileRefusal::TooLarge { most_bytes };
    if file.metadata()?.len() > most_bytes {
        return Err(too_large.into());
    }
    let mut bytes = Vec::new();
    file.take(most_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most_bytes {
        return Err(too_large.into());
    }
    Ok(bytes)
}

/// The text (UTF-8) of a regular file of at most `most_bytes` bytes.
pub(crate) fn read_text(path: &Path, most_bytes: u64) -> io::Result<String> {
    let bytes = read(path, most_bytes)?;
    String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(path: &Path) -> String {
        read_text(path, 10).expect_err("refused").to_string()
    }

    #[test]
    fn a_pipe_a_device_and_a_folder_are_refused_without_waiting() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe.toml");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).expect("made");
        assert_eq!(refusal(&pipe), "it is a pipe: give a regular file");
        assert_eq!(
            refusal(Path::new("/dev/zero")),
            "it is a device: give a regular file"
        );
        assert_eq!(refusal(folder.path()), "it is a folder: give a regular file");
    }

    #[test]
    fn a_file_at_the_limit_is_read_and_one_byte_more_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.toml");
        std::fs::write(&path, "0123456789").expect("written");
        assert_eq!(read_text(&path, 10).expect("read"), "0123456789");
        std::fs::write(&path, "0123456789a").expect("written");
        assert!(refusal(&path).contains("more than 10 bytes"));
        // A file of the kernel says that it has 0 bytes.
        assert!(refusal(Path::new("/proc/self/status")).contains("more than 10 bytes"));
    }

    #[test]
    fn a_link_to_a_regular_file_is_followed_and_bytes_that_are_no_text_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let (file, link) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::write(&file, b"\xff\xfe").expect("written");
        std::os::unix::fs::symlink(&file, &link).expect("made");
        assert!(refusal(&link).contains("utf-8"), "{}", refusal(&link));
    }
}
