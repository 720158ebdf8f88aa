//! One writer at a time: an object that only one command can create. A command that was killed leaves it; the next one on the same
//! computer sees that its process is gone.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::{ArchiveError, ArchiveStore};

/// The object that a writer holds.
const LOCK: &str = "_archive/writer.json";

/// Pause between two looks at the lock of another command.
const PAUSE: Duration = Duration::from_millis(200);

/// The process that writes to the archive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct LockHolder {
    host: String,
    pid: u32,
    /// When this process began: a later process may have the same number.
    process: String,
    since_utc: String,
    /// Tells two holders of the same process apart.
    nonce: u64,
}

/// The right to write to an archive. It is given back when this value is dropped.
#[derive(Debug)]
pub(super) struct WriterLock<'a> {
    store: &'a ArchiveStore,
    holder: LockHolder,
}

impl<'a> WriterLock<'a> {
    /// Takes the lock. `take_over` takes it from another holder, whoever that is.
    pub(super) fn take(store: &'a ArchiveStore, take_over: bool) -> Result<WriterLock<'a>, ArchiveError> {
        let holder = LockHolder {
            host: host(),
            pid: std::process::id(),
            process: process_began(std::process::id()).unwrap_or_default(),
            since_utc: jiff::Timestamp::now().to_string(),
            nonce: rand::random(),
        };
        let lock = WriterLock { store, holder };
        let text = serde_json::to_vec(&lock.holder).unwrap_or_default();
        for _ in 0..2 {
            if store.create(LOCK, text.clone())? {
                return Ok(lock);
            }
            match read(store)? {
                // The answer to the first try was lost.
                Some(other) if other == lock.holder => return Ok(lock),
                Some(other) if !take_over && other.may_live() => {
                    return Err(ArchiveError::Locked {
                        place: store.name().to_owned(),
                        host: other.host,
                        pid: other.pid,
                        since: other.since_utc,
                    });
                }
                // Gone, or damaged: only a writer makes it, and makes it whole.
                _ => store.delete(LOCK)?,
            }
        }
        Err(ArchiveError::TakenOver {
            place: store.name().to_owned(),
        })
    }

    /// Takes the lock, and waits so long for another command that has it.
    pub(super) fn take_within(
        store: &'a ArchiveStore,
        patience: Duration,
    ) -> Result<WriterLock<'a>, ArchiveError> {
        let until = Instant::now() + patience;
        loop {
            match WriterLock::take(store, false) {
                Err(ArchiveError::Locked { .. } | ArchiveError::TakenOver { .. })
                    if Instant::now() < until =>
                {
                    std::thread::sleep(PAUSE);
                }
                taken => return taken,
            }
        }
    }

    /// An error if another command has taken the archive over. Called before each commit.
    pub(super) fn check(&self) -> Result<(), ArchiveError> {
        match read(self.store)? {
            Some(holder) if holder == self.holder => Ok(()),
            _ => Err(ArchiveError::TakenOver {
                place: self.store.name().to_owned(),
            }),
        }
    }
}

impl Drop for WriterLock<'_> {
    fn drop(&mut self) {
        // If it stays, the next writer sees that this process is gone.
        if self.check().is_ok() {
            let _ = self.store.delete(LOCK);
        }
    }
}

impl LockHolder {
    /// False if it is known that the process is gone.
    fn may_live(&self) -> bool {
        self.host != host() || process_began(self.pid).is_some_and(|began| began == self.process)
    }
}

fn read(store: &ArchiveStore) -> Result<Option<LockHolder>, ArchiveError> {
    let text = store.get(LOCK)?;
    Ok(text.and_then(|text| serde_json::from_slice(&text).ok()))
}

/// Name of this computer.
fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname");
    name.unwrap_or_default().trim().to_owned()
}

/// What tells a process from any other with its number on this computer: the start of the kernel, and the ticks from there to the
/// start of the process. `None` if there is no such process.
fn process_began(pid: u32) -> Option<String> {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // Field 22, counted from behind the name, which is in parentheses and may have spaces.
    let ticks = stat.rsplit_once(')')?.1.split_whitespace().nth(19)?;
    Some(format!("{} {ticks}", boot.trim()))
}
