//! Writes the samples of one run: a block at least every 10 ms, so that a kill costs at most the last 20 ms. `part` is the
//! file, `waiting` keeps what is not yet known to be on the disk.
//!
//! On a full disk the run goes on: samples wait in memory and the commit is tried again each second. After any other error
//! the file is left as it is, and a second file beside it takes everything that is not known to be on the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::part::{Disk, FileSystem, Part, WriteError};
use super::status::RunFileStatus;
use super::waiting::{ROOM_SAMPLES, Waiting};
use super::{EXTENSION, RunFileError};
use crate::recording::{Event, EventKind, Header, Outcome, Recorder, Sample};

/// Number of samples in the largest block: a run in virtual time commits this many at once.
const BLOCK_SAMPLES: usize = 2048;
/// A block is committed at the latest this long after the one before it.
const COMMIT_PERIOD: Duration = Duration::from_millis(10);
/// Number of samples between two looks at the clock, because reading it costs more than packing a sample.
const SAMPLES_PER_CLOCK_LOOK: usize = 8;
/// Time between two attempts to write to a disk that reported an error.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Time that an ended run waits for its disk. The operator has been warned since the first error.
const WAIT_AT_END: Duration = Duration::from_secs(30);
/// Attempts to close the file when there is no more time to wait: an error needs a new file, which may fail too.
const ATTEMPTS_TO_CLOSE: u32 = 3;
/// Step of that wait.
const WAIT_STEP: Duration = Duration::from_millis(50);

/// The time for the writer; a test has its own.
pub(super) trait Clock: Send {
    /// Time since any fixed moment.
    fn now(&self) -> Duration;
    /// Waits; only used after the end of the run.
    fn sleep(&mut self, time: Duration);
}

/// The clock of this computer.
struct HostClock(Instant);

impl Clock for HostClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }

    fn sleep(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// A [`Recorder`] that writes one run.
pub(crate) struct RunFileWriter {
    disk: Box<dyn Disk>,
    clock: Box<dyn Clock>,
    /// Path of the first file.
    path: PathBuf,
    header: Header,
    /// The file in use; `None` between a failed file and the next one, and after the end.
    part: Option<Box<dyn Part>>,
    /// Number of files that were made.
    parts: u32,
    waiting: Waiting,
    trouble: Trouble,
    first_tick: Option<u64>,
    last_tick: Option<u64>,
    last_event_tick: u64,
    last_commit: Duration,
    /// Samples in the file in use, and the tick of the first of them.
    in_part: u64,
    part_first_tick: Option<u64>,
    status: Arc<RunFileStatus>,
}

/// What is wrong with the disk.
#[derive(Debug, Default)]
struct Trouble {
    /// The error under way; empty if the last commit succeeded.
    cause: String,
    /// The last error, also after it was overcome.
    last_cause: String,
    /// No attempt before this time.
    retry_at: Option<Duration>,
    /// Files that failed, as a sentence that stays; empty if there is one file.
    split: String,
}

impl RunFileWriter {
    /// Makes the file with its header and syncs it, so that a disk that cannot be written is found before the run.
    pub(crate) fn create(path: &Path, header: &Header) -> Result<RunFileWriter, RunFileError> {
        let clock = Box::new(HostClock(Instant::now()));
        Self::create_on(Box::new(FileSystem), clock, path, header, ROOM_SAMPLES)
    }

    /// The same on a disk and with a clock of a test.
    pub(super) fn create_on(
        mut disk: Box<dyn Disk>,
        clock: Box<dyn Clock>,
        path: &Path,
        header: &Header,
        room: usize,
    ) -> Result<RunFileWriter, RunFileError> {
        let part = disk.make(path, header, None)?;
        let status = RunFileStatus::default();
        status.add_path(path);
        Ok(RunFileWriter {
            path: path.to_owned(),
            header: header.clone(),
            part: Some(part),
            parts: 1,
            waiting: Waiting::with_room(room),
            trouble: Trouble::default(),
            first_tick: None,
            last_tick: None,
            last_event_tick: 0,
            last_commit: clock.now(),
            in_part: 0,
            part_first_tick: None,
            status: Arc::new(status),
            disk,
            clock,
        })
    }

    /// The state of the file, for other threads.
    pub(crate) fn status(&self) -> Arc<RunFileStatus> {
        self.status.clone()
    }

    /// Writes what waits, as far as the disk takes it.
    fn commit(&mut self) {
        self.last_commit = self.clock.now();
        if self.trouble.retry_at.is_some_and(|at| self.last_commit < at) {
            return;
        }
        self.trouble.retry_at = None;
        let mut result = self.note_synced();
        while result.is_ok() && !self.waiting.is_committed() {
            result = self.commit_block();
        }
        // In virtual time a run is faster than the sync thread. In real time this waits only for a disk that stalls.
        if result.is_ok() && self.waiting.committed() > ROOM_SAMPLES / 2 {
            result = self.sync();
        }
        match result {
            Ok(()) => self.note_recovery(),
            Err(error) => self.note_error(error),
        }
    }

    fn commit_block(&mut self) -> Result<(), WriteError> {
        let part = match &mut self.part {
            Some(part) => part,
            None => {
                let part = self.next_part()?;
                self.part.insert(part)
            }
        };
        let (samples, events) = self.waiting.next_commit(BLOCK_SAMPLES);
        part.commit(samples, events)?;
        self.in_part += samples.len() as u64;
        self.part_first_tick = self.part_first_tick.or(samples.first().map(|s| s.tick));
        self.waiting.commit_done(BLOCK_SAMPLES);
        Ok(())
    }

    /// Makes the file that continues a failed one.
    fn next_part(&mut self) -> Result<Box<dyn Part>, WriteError> {
        let number = self.parts + 1;
        let mut header = self.header.clone();
        header.run_id = format!("{}-{number}", self.header.run_id);
        header.continues.clone_from(&self.part_id(self.parts));
        let path = self.part_path(number);
        let part = self.disk.make(&path, &header, self.first_tick).map_err(|error| {
            let text = super::chain(&error);
            WriteError::Failed(text)
        })?;
        self.parts = number;
        self.in_part = 0;
        self.part_first_tick = None;
        self.status.add_path(&path);
        Ok(part)
    }

    /// Run id of one of the files, from 1.
    fn part_id(&self, number: u32) -> String {
        match number {
            1 => self.header.run_id.clone(),
            _ => format!("{}-{number}", self.header.run_id),
        }
    }

    fn part_path(&self, number: u32) -> PathBuf {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        match number {
            1 => self.path.clone(),
            _ => self.path.with_file_name(format!("{stem}-{number}.{EXTENSION}")),
        }
    }

    /// Takes note of the commits that the sync thread has brought to the disk.
    fn note_synced(&mut self) -> Result<(), WriteError> {
        let Some(part) = &mut self.part else {
            return Ok(());
        };
        let commits = part.synced()?;
        self.status.settle(self.waiting.synced_up_to(commits));
        Ok(())
    }

    /// Waits until everything in the file is on the disk.
    fn sync(&mut self) -> Result<(), WriteError> {
        if let Some(part) = &mut self.part {
            part.sync()?;
        }
        self.settle_all();
        Ok(())
    }

    /// Everything in the file is on the disk.
    fn settle_all(&mut self) {
        let committed = self.waiting.committed() as u64;
        self.waiting.all_synced();
        self.status.settle(committed);
    }

    fn note_error(&mut self, error: WriteError) {
        let first = self.trouble.cause.is_empty();
        let path = self.part_path(self.parts);
        let (path, mut next) = (path.display(), None);
        self.trouble.cause = match error {
            WriteError::Full(_) => format!("the disk of {path} is full"),
            WriteError::Busy(_) => format!("another program has locked {path}"),
            WriteError::Failed(cause) if self.part.is_some() => {
                next = Some(self.part_path(self.parts + 1));
                format!("writing {path} failed ({cause})")
            }
            WriteError::Failed(cause) => {
                format!("no file can be made after an error of {path} ({cause})")
            }
        };
        self.trouble.last_cause.clone_from(&self.trouble.cause);
        let cause = &self.trouble.cause;
        // A disk that stays full is tried each second; the status tells it all the time, the log once.
        if first || next.is_some() {
            tracing::error!("{cause}");
        }
        self.trouble.retry_at = Some(self.clock.now() + RETRY_PERIOD);
        if let Some(next) = next {
            // The new file is tried at once: each error is final for its file, so this ends.
            self.trouble.retry_at = None;
            self.trouble.split = format!(
                "{cause}: the recording continues in {}, keep all of its files",
                next.display()
            );
            let text = self.trouble.split.clone();
            self.part = None;
            self.waiting.take_back();
            self.note_event(text);
        } else if first {
            let text = format!("{cause}: samples wait in memory");
            self.note_event(text);
        }
        self.tell();
    }

    /// The last commit succeeded: ends the alarm of an error before it.
    fn note_recovery(&mut self) {
        if self.trouble.cause.is_empty() {
            return;
        }
        let cause = std::mem::take(&mut self.trouble.cause);
        tracing::info!("the disk can be written again");
        let missing = match self.waiting.dropped() {
            0 => "no sample is missing".to_owned(),
            dropped => format!("{dropped} samples found no room in memory and are not saved"),
        };
        self.note_event(format!(
            "the disk can be written again after \"{cause}\": {missing}"
        ));
        self.tell();
    }

    /// Brings the problem in words up to date.
    fn tell(&self) {
        let cause = &self.trouble.cause;
        let waits = match cause.is_empty() {
            true => String::new(),
            false => format!(
                "{cause}: samples wait in memory, which has room for {:.0} s, and the disk is tried again every second: free \
                 space on it or stop the run",
                self.waiting.room() as f64 / self.header.sample_rate_hz
            ),
        };
        let sentences = [self.trouble.split.clone(), waits];
        let sentences: Vec<String> = sentences.into_iter().filter(|s| !s.is_empty()).collect();
        self.status.set_problem(sentences.join("; "));
    }

    /// Adds an event of the writer itself to the recording.
    fn note_event(&mut self, text: String) {
        let tick = self.last_tick.unwrap_or(self.last_event_tick);
        let event = Event {
            tick,
            time_s: self.time_s(tick),
            kind: EventKind::Host,
            text,
        };
        self.take_event(event);
    }

    /// Events stay in order: after a restart of the rig its ticks begin again at 0.
    fn take_event(&mut self, mut event: Event) {
        if event.tick < self.last_event_tick {
            event.tick = self.last_event_tick.max(self.last_tick.unwrap_or(0));
            event.time_s = self.time_s(event.tick);
        }
        self.last_event_tick = event.tick;
        self.waiting.push_event(event);
    }

    fn time_s(&self, tick: u64) -> f64 {
        let zero_tick = self.first_tick.unwrap_or(tick);
        (tick as f64 - zero_tick as f64) / self.header.sample_rate_hz
    }

    /// The outcome with the counts of the file in use: samples + lost + unsaved = ticks from its first to its last sample.
    fn with_own_counts(&self, outcome: &Outcome) -> Outcome {
        let unsaved = self.waiting.unsaved(&self.trouble.last_cause);
        let first = [self.part_first_tick, unsaved.as_ref().map(|u| u.from_tick)];
        let span = match (first.into_iter().flatten().min(), self.last_tick) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        };
        let not_lost = self.in_part + unsaved.as_ref().map_or(0, |u| u.samples);
        Outcome {
            samples: self.in_part,
            lost: span.saturating_sub(not_lost),
            unsaved,
            ..outcome.clone()
        }
    }

    /// Writes the outcome into the file in use and syncs it.
    fn close(&mut self, outcome: &Outcome) -> Result<(), WriteError> {
        let mut part = match self.part.take() {
            Some(part) => part,
            None => self.next_part()?,
        };
        let counted = self.with_own_counts(outcome);
        let closed = part.close(&counted);
        if closed.is_err() {
            self.part = Some(part);
        } else {
            self.settle_all();
        }
        closed
    }

    /// Brings the rest to the disk and closes the file. Waits for a disk that cannot be written, unless it is asked not to.
    fn finish(&mut self, outcome: &Outcome) {
        let deadline = self.clock.now() + WAIT_AT_END;
        self.trouble.retry_at = None;
        let mut last_attempts = 0;
        while last_attempts < ATTEMPTS_TO_CLOSE {
            let waits = self.clock.now() < deadline && !self.status.is_given_up();
            if !waits {
                last_attempts += 1;
                self.trouble.retry_at = None;
            }
            self.commit();
            let due = self.trouble.retry_at.is_none() && self.waiting.is_committed();
            if due || !waits {
                match self.close(outcome) {
                    Ok(()) => break,
                    Err(error) => self.note_error(error),
                }
            }
            if waits {
                self.clock.sleep(WAIT_STEP);
            }
        }
        self.part = None;
        self.tell_end();
    }

    /// Ends the watch over the disk, and puts into words what is missing for good.
    fn tell_end(&self) {
        let unsaved = self.waiting.unsaved(&self.trouble.last_cause);
        self.status
            .set_not_saved(unsaved.as_ref().map_or(0, |u| u.samples));
        let missing = unsaved.map(|u| u.text(self.first_tick.unwrap_or(0), self.header.sample_rate_hz));
        let missing = missing.map(|text| format!("{text}: free space on the disk and repeat the test"));
        let sentences = [Some(self.trouble.split.clone()), missing];
        let sentences: Vec<String> = sentences
            .into_iter()
            .flatten()
            .filter(|s| !s.is_empty())
            .collect();
        self.status.set_problem(sentences.join("; "));
        self.status.set_over();
    }
}

impl Recorder for RunFileWriter {
    /// Writes the header again: a tare since `create` has changed it.
    fn begin(&mut self, header: &Header) {
        self.header = header.clone();
        if let Some(part) = &mut self.part
            && let Err(error) = part.rewrite_header(header)
        {
            // A full disk here would leave the header before the tare, so the next file has the right one.
            let (WriteError::Failed(cause) | WriteError::Full(cause) | WriteError::Busy(cause)) = error;
            self.note_error(WriteError::Failed(cause));
        }
    }

    fn sample(&mut self, sample: &Sample) {
        if self.last_tick.is_some_and(|last| sample.tick <= last) {
            return self.status.settle(1);
        }
        self.first_tick.get_or_insert(sample.tick);
        self.last_tick = Some(sample.tick);
        self.waiting.push(sample);
        let waiting = self.waiting.uncommitted();
        let look = waiting.is_multiple_of(SAMPLES_PER_CLOCK_LOOK);
        if (waiting >= BLOCK_SAMPLES && self.trouble.retry_at.is_none())
            || (look && self.clock.now().saturating_sub(self.last_commit) >= COMMIT_PERIOD)
        {
            self.commit();
        }
    }

    fn event(&mut self, event: &Event) {
        self.take_event(event.clone());
    }

    fn end(&mut self, outcome: &Outcome) {
        self.finish(outcome);
    }

    fn flush(&mut self) {
        self.commit();
    }
}

impl Drop for RunFileWriter {
    /// A writer that is dropped without an end leaves an open run with all samples so far.
    fn drop(&mut self) {
        if self.part.is_some() {
            self.commit();
        }
        self.status.set_over();
    }
}
