//! The audit log: who did what, and when. A thread of its own writes it, so that no disk is between a request and its answer;
//! `chain` has the lines.

pub(crate) mod chain;

use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use jiff::Timestamp;

use super::error::DaemonError;
use crate::recording::atomic_file;
use chain::{AuditEntry, ChainEnd, Deed};

/// File of the audit log in the data folder: one JSON object a line.
pub(crate) const AUDIT_FILE: &str = "audit.jsonl";
/// File that says how many lines the log has, and the hash of the last one.
pub(crate) const AUDIT_END_FILE: &str = "audit-end.json";
/// Deeds that may wait for the disk. Beyond that they are counted, and the count is written.
const MOST_WAITING: usize = 4096;
/// The same deed of the same person within this time is one line with a count: a button that is held jogs ten times a second.
const SAME_DEED: Duration = Duration::from_secs(1);
/// Only these deeds are counted together.
const REPEATED: &str = "POST /api/jog";
/// The end of the log is looked for in so many bytes.
const TAIL_BYTES: u64 = 1 << 16;
/// Looks at the log and its end until both fit, with [`READ_PAUSE`] between.
const READ_TRIES: u32 = 25;
/// Pause between two looks: the daemon may be writing.
const READ_PAUSE: Duration = Duration::from_millis(20);
/// Longest text of a deed, characters.
const TEXT_MAX_CHARS: usize = 400;

/// One deed with its time.
struct NotedDeed {
    at: Timestamp,
    deed: Deed,
}

/// Takes deeds for the log.
#[derive(Debug)]
pub(super) struct Audit {
    /// `None` once the log is closed.
    to_thread: Mutex<Option<SyncSender<NotedDeed>>>,
    missed: Arc<AtomicU64>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Audit {
    /// Opens the log of a data folder and starts its thread.
    pub(super) fn open(folder: &Path) -> Result<Audit, DaemonError> {
        let path = folder.join(AUDIT_FILE);
        let writer = AuditWriter::open(folder).map_err(|source| DaemonError::Folder { path, source })?;
        let (to_thread, deeds) = sync_channel(MOST_WAITING);
        let missed = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&missed);
        let thread = std::thread::Builder::new()
            .name("audit".to_owned())
            .spawn(move || write_deeds(writer, &deeds, &counted))?;
        Ok(Audit {
            to_thread: Mutex::new(Some(to_thread)),
            missed,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// Notes a deed. Never waits.
    pub(super) fn note(&self, mut deed: Deed) {
        for text in [&mut deed.client, &mut deed.detail, &mut deed.what] {
            if let Some((at, _)) = text.char_indices().nth(TEXT_MAX_CHARS) {
                text.truncate(at);
            }
        }
        let noted = NotedDeed {
            at: Timestamp::now(),
            deed,
        };
        let sender = self.to_thread.lock().unwrap_or_else(PoisonError::into_inner);
        let is_sent = sender
            .as_ref()
            .is_some_and(|sender| sender.try_send(noted).is_ok());
        if !is_sent {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Notes what the daemon did by itself.
    pub(super) fn note_daemon(&self, what: &str, detail: &str) {
        self.note(Deed {
            who: "daemon".to_owned(),
            what: what.to_owned(),
            detail: detail.to_owned(),
            ..Deed::default()
        });
    }

    /// Closes the log after all deeds are written, or after `longest`: a disk that does not answer does not keep the daemon.
    pub(super) fn close(&self, longest: Duration) {
        self.to_thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let deadline = std::time::Instant::now() + longest;
        while let Some(thread) = &thread
            && !thread.is_finished()
            && std::time::Instant::now() < deadline
        {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Writes deeds until the log is closed.
fn write_deeds(mut writer: AuditWriter, deeds: &Receiver<NotedDeed>, missed: &AtomicU64) {
    let mut waiting: Option<(NotedDeed, u64)> = None;
    loop {
        let next = next_deed(&mut writer, deeds, waiting.is_some());
        if let (Some((first, times)), Ok(noted)) = (&mut waiting, &next)
            && first.deed == noted.deed
        {
            *times += 1;
            continue;
        }
        if let Some((noted, times)) = waiting.take() {
            writer.write(noted, times);
        }
        match next {
            Ok(noted) if noted.deed.what == REPEATED => waiting = Some((noted, 1)),
            Ok(noted) => writer.write(noted, 1),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                writer.settle();
                return;
            }
        }
        let lost = missed.swap(0, Ordering::Relaxed);
        if lost > 0 {
            writer.write_own(&format!("{lost} entries are missing here: the disk was too slow"));
        }
    }
}

/// Waits for the next deed; a second at most while one is held back. Before it waits, all that is written is on the disk.
fn next_deed(
    writer: &mut AuditWriter,
    deeds: &Receiver<NotedDeed>,
    is_held: bool,
) -> Result<NotedDeed, RecvTimeoutError> {
    match deeds.try_recv() {
        Ok(noted) => return Ok(noted),
        Err(TryRecvError::Disconnected) => return Err(RecvTimeoutError::Disconnected),
        Err(TryRecvError::Empty) => writer.settle(),
    }
    match is_held {
        true => deeds.recv_timeout(SAME_DEED),
        false => deeds.recv().map_err(|_| RecvTimeoutError::Disconnected),
    }
}

/// What was written down about the end of the log.
fn read_end(folder: &Path) -> io::Result<ChainEnd> {
    let text = std::fs::read_to_string(folder.join(AUDIT_END_FILE))?;
    Ok(serde_json::from_str(&text)?)
}

/// The log lacks what was written down about its end. A crash between both leaves one line more in the log, and none less.
fn is_behind(log: &ChainEnd, told: &ChainEnd) -> bool {
    told.n > log.n || (told.n == log.n && told.hash != log.hash)
}

/// The text of the log of a data folder, and what was written down about its end. Waits a little for a daemon that is writing.
pub(crate) fn read(folder: &Path) -> io::Result<(String, ChainEnd)> {
    let mut tries = 0;
    loop {
        let text = std::fs::read_to_string(folder.join(AUDIT_FILE))?;
        let end = read_end(folder)?;
        let fits = end == ChainEnd::default() || chain::has_hash(&text, &end.hash);
        tries += 1;
        if fits || tries >= READ_TRIES {
            return Ok((text, end));
        }
        std::thread::sleep(READ_PAUSE);
    }
}

/// Appends lines to the log.
struct AuditWriter {
    file: File,
    end_path: PathBuf,
    end: ChainEnd,
    /// Lines were written and may not be on the disk yet.
    is_unsettled: bool,
    /// A failure was logged; the next one is not.
    has_failed: bool,
}

impl AuditWriter {
    /// Continues the chain after the last line of the file.
    fn open(folder: &Path) -> io::Result<AuditWriter> {
        let mut options = File::options();
        let file = options
            .read(true)
            .append(true)
            .create(true)
            .mode(0o600)
            .open(folder.join(AUDIT_FILE))?;
        let size = file.metadata()?.size();
        let mut tail = vec![0; size.min(TAIL_BYTES) as usize];
        file.read_exact_at(&mut tail, size.saturating_sub(TAIL_BYTES))?;
        let tail = String::from_utf8_lossy(&tail);
        let last = tail.lines().rev().find_map(chain::read_line);
        let end = last.map_or_else(ChainEnd::default, |(entry, hash)| ChainEnd { n: entry.n, hash });
        let told = read_end(folder).ok();
        let mut writer = AuditWriter {
            file,
            end_path: folder.join(AUDIT_END_FILE),
            end,
            is_unsettled: false,
            has_failed: false,
        };
        // A line that was cut off stays as it is; the next one begins after it.
        if !tail.is_empty() && !tail.ends_with('\n') {
            writer.file.write_all(b"\n")?;
        }
        if let Some(told) = told.filter(|told| is_behind(&writer.end, told)) {
            let (n, end) = (writer.end.n, told.n);
            writer.write_own(&format!(
                "the log ended with entry {n}, but entry {end} had been written: lines were changed or removed"
            ));
        }
        Ok(writer)
    }

    fn write_own(&mut self, what: &str) {
        let deed = Deed {
            who: "daemon".to_owned(),
            what: what.to_owned(),
            ..Deed::default()
        };
        let at = Timestamp::now();
        self.write(NotedDeed { at, deed }, 1);
    }

    fn write(&mut self, noted: NotedDeed, times: u64) {
        let written = self.append(noted, times);
        self.tell(written);
    }

    /// Brings all lines to the disk, and writes down where the log ends.
    fn settle(&mut self) {
        if std::mem::take(&mut self.is_unsettled) {
            let settled = self.write_end();
            self.tell(settled);
        }
    }

    /// Logs the first failure of several.
    fn tell(&mut self, result: io::Result<()>) {
        if let Err(error) = &result
            && !self.has_failed
        {
            tracing::error!(
                "the audit log cannot be written, so this and what follows is missing in it: {error}"
            );
        }
        self.has_failed = result.is_err();
    }

    fn append(&mut self, noted: NotedDeed, times: u64) -> io::Result<()> {
        let entry = AuditEntry {
            n: self.end.n + 1,
            time_utc: noted.at.strftime("%Y-%m-%dT%H:%M:%S%.3fZ").to_string(),
            deed: noted.deed,
            times,
            previous: self.end.hash.clone(),
        };
        let (line, hash) = chain::line(&entry)?;
        // In one piece: a crash leaves all of a line, or a part that shows.
        self.file.write_all(format!("{line}\n").as_bytes())?;
        self.end = ChainEnd { n: entry.n, hash };
        self.is_unsettled = true;
        Ok(())
    }

    fn write_end(&mut self) -> io::Result<()> {
        self.file.sync_data()?;
        let text = serde_json::to_string(&self.end)?;
        atomic_file::write(&self.end_path, |file| writeln!(file, "{text}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deed(what: &str) -> Deed {
        Deed {
            who: "owner".to_owned(),
            what: what.to_owned(),
            ..Deed::default()
        }
    }

    fn checked(folder: &Path) -> chain::AuditCheck {
        let text = std::fs::read_to_string(folder.join(AUDIT_FILE)).expect("written");
        let end = std::fs::read_to_string(folder.join(AUDIT_END_FILE)).expect("written");
        chain::check(&text, &serde_json::from_str(&end).expect("JSON"))
    }

    /// Longest wait on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(60);

    #[test]
    fn the_chain_goes_on_after_a_restart_and_a_cut_line_shows() {
        let folder = tempfile::tempdir().expect("a folder");
        for _ in 0..3 {
            let audit = Audit::open(folder.path()).expect("opened");
            audit.note(deed("POST /api/tare"));
            audit.note_daemon("end", "");
            audit.close(PATIENCE);
        }
        let whole = checked(folder.path());
        assert_eq!((whole.lines, whole.problems.len()), (6, 0), "{whole:?}");
        // A log that is shorter than it was is told by the next daemon too.
        let path = folder.path().join(AUDIT_FILE);
        let text = std::fs::read_to_string(&path).expect("there");
        let shorter = text
            .lines()
            .take(5)
            .map(|line| format!("{line}\n"))
            .collect::<String>();
        std::fs::write(&path, shorter).expect("written");
        Audit::open(folder.path()).expect("opened").close(PATIENCE);
        let told = std::fs::read_to_string(&path).expect("there");
        assert!(
            told.contains("ended with entry 5, but entry 6 had been written"),
            "{told}"
        );
        let mut text = std::fs::read_to_string(&path).expect("there");
        text.push_str("{\"n\":7,\"time_u");
        std::fs::write(&path, text).expect("written");
        let audit = Audit::open(folder.path()).expect("opened");
        audit.note(deed("POST /api/reset"));
        audit.close(PATIENCE);
        let cut = checked(folder.path());
        assert_eq!(cut.lines, 8);
        assert_eq!(cut.problems.len(), 1, "{cut:?}");
        assert!(cut.problems[0].starts_with("line 7 "), "{cut:?}");
    }

    #[test]
    fn jogs_of_a_held_button_are_one_line_with_a_count_and_other_orders_are_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let audit = Audit::open(folder.path()).expect("opened");
        for _ in 0..5 {
            audit.note(deed(REPEATED));
        }
        audit.note(deed("POST /api/tare"));
        audit.note(deed("POST /api/tare"));
        audit.close(PATIENCE);
        let text = std::fs::read_to_string(folder.path().join(AUDIT_FILE)).expect("written");
        let times: Vec<u64> = text
            .lines()
            .filter_map(|line| Some(chain::read_line(line)?.0.times))
            .collect();
        assert_eq!(times, [5, 1, 1]);
    }
}
