//! Log lines for the systemd journal: each begins with its priority (`<4>` for a warning, sd-daemon(3)) and has no time, because
//! the journal adds its own.

use std::io::Write;

use nix::sys::stat::fstat;
use tracing::{Level, Metadata};
use tracing_subscriber::fmt::MakeWriter;

/// Whether `stream`, stderr or stdout, goes to the journal. systemd names the device and the inode of the journal's end in
/// `JOURNAL_STREAM`, so that a redirected one is not taken for it.
pub(crate) fn is_journal(stream: &impl std::os::fd::AsFd) -> bool {
    let named = std::env::var("JOURNAL_STREAM").ok();
    let named = named.as_deref().and_then(|text| text.split_once(':'));
    let (Some((device, inode)), Ok(file)) = (named, fstat(stream)) else {
        return false;
    };
    device.parse() == Ok(file.st_dev) && inode.parse() == Ok(file.st_ino)
}

/// Writes each event to stderr behind its priority.
pub(crate) struct JournalWriter;

/// One event with its priority.
pub(crate) struct JournalLine(u8);

impl MakeWriter<'_> for JournalWriter {
    type Writer = JournalLine;

    fn make_writer(&self) -> JournalLine {
        JournalLine(priority(Level::INFO))
    }

    fn make_writer_for(&self, event: &Metadata<'_>) -> JournalLine {
        JournalLine(priority(*event.level()))
    }
}

impl Write for JournalLine {
    /// The formatter writes an event at once, so that lines of two threads do not mix.
    fn write(&mut self, event: &[u8]) -> std::io::Result<usize> {
        let mut line = format!("<{}>", self.0).into_bytes();
        line.extend_from_slice(event);
        std::io::stderr().write_all(&line)?;
        Ok(event.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

/// The priority of syslog(3) for a level.
fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        _ => 7,
    }
}
