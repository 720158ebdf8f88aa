//! Faults K1, K2 and K3: a disk that is full, that reports errors, or that stalls, in virtual time.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::part::{Disk, FileSystem, Part, PartFile, WriteError};
use super::test_support::{header, outcome, sample};
use super::waiting::{ROOM_SAMPLES, Waiting};
use super::writer::Clock;
use super::{Gap, GapCause, RunFile, RunFileError, RunFileStatus, RunFileWriter};
use crate::recording::{Event, EventKind, Flags, Header, Outcome, Recorder, Sample};

/// The time of a test, in milliseconds.
#[derive(Clone, Default)]
struct TestClock(Arc<Mutex<u64>>);

impl TestClock {
    fn advance_ms(&self, ms: u64) {
        *self.0.lock().unwrap() += ms;
    }
}

impl Clock for TestClock {
    fn now(&self) -> Duration {
        Duration::from_millis(*self.0.lock().unwrap())
    }

    fn sleep(&mut self, time: Duration) {
        self.advance_ms(time.as_millis() as u64);
    }
}

/// What a call of the disk does, from its number, from 1, and the time in ms.
type Fault = fn(u64, u64, FaultTime) -> Option<WriteError>;

/// Which calls fail.
#[derive(Debug, Clone, Copy, Default)]
struct FaultTime {
    first: u64,
    last: u64,
}

/// A disk whose calls fail by plan; those that do not fail are done on the real one.
#[derive(Clone)]
struct FaultyDisk {
    fault: Fault,
    plan: FaultTime,
    clock: TestClock,
    calls: Arc<Mutex<u64>>,
}

impl FaultyDisk {
    fn call(&self) -> Result<(), WriteError> {
        let mut calls = self.calls.lock().unwrap();
        *calls += 1;
        let now_ms = *self.clock.0.lock().unwrap();
        (self.fault)(*calls, now_ms, self.plan).map_or(Ok(()), Err)
    }
}

impl Disk for FaultyDisk {
    fn make(
        &mut self,
        path: &Path,
        header: &Header,
        zero: Option<u64>,
    ) -> Result<Box<dyn Part>, RunFileError> {
        self.call().map_err(|_| RunFileError::Io {
            path: path.to_owned(),
            doing: "making",
            source: std::io::Error::other("injected"),
        })?;
        let part = FileSystem.make(path, header, zero)?;
        Ok(Box::new(FaultyPart {
            part,
            disk: self.clone(),
            commits: 0,
        }))
    }
}

struct FaultyPart {
    part: Box<dyn Part>,
    disk: FaultyDisk,
    commits: u64,
}

impl Part for FaultyPart {
    fn rewrite_header(&mut self, header: &Header) -> Result<(), WriteError> {
        self.disk.call()?;
        self.part.rewrite_header(header)
    }

    fn commit(&mut self, samples: &[Sample], events: &[Event]) -> Result<(), WriteError> {
        self.disk.call()?;
        self.commits += 1;
        self.part.commit(samples, events)
    }

    fn synced(&mut self) -> Result<u64, WriteError> {
        self.disk.call()?;
        // In virtual time each look finds everything synced.
        Ok(self.commits)
    }

    fn sync(&mut self) -> Result<(), WriteError> {
        self.disk.call()?;
        self.part.sync()
    }

    fn close(&mut self, outcome: &Outcome) -> Result<(), WriteError> {
        self.disk.call()?;
        self.part.close(outcome)
    }
}

/// A run on a disk with faults.
struct FaultyRun {
    folder: tempfile::TempDir,
    clock: TestClock,
    calls: Arc<Mutex<u64>>,
    writer: Option<RunFileWriter>,
    status: Arc<RunFileStatus>,
    tick: u64,
}

impl FaultyRun {
    fn new(fault: Fault, plan: FaultTime, room: usize) -> FaultyRun {
        let folder = tempfile::tempdir().unwrap();
        let (clock, calls) = (TestClock::default(), Arc::default());
        let disk = FaultyDisk {
            fault,
            plan,
            clock: clock.clone(),
            calls: Arc::clone(&calls),
        };
        let path = folder.path().join("a.leafrun");
        let writer =
            RunFileWriter::create_on(Box::new(disk), Box::new(clock.clone()), &path, &header(), room)
                .unwrap();
        FaultyRun {
            status: writer.status(),
            writer: Some(writer),
            folder,
            clock,
            calls,
            tick: 0,
        }
    }

    fn writer(&mut self) -> &mut RunFileWriter {
        self.writer.as_mut().unwrap()
    }

    /// Samples at 1 kHz with a flush every 10 ms.
    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            let tick = self.tick;
            self.tick += 1;
            self.clock.advance_ms(1);
            self.writer().sample(&sample(tick));
            if tick % 10 == 9 {
                self.writer().flush();
            }
        }
    }

    /// Ends the run; its files, read back.
    fn end(&mut self) -> Vec<RunFile> {
        let samples = self.tick;
        self.writer().end(&outcome(samples));
        self.writer = None;
        self.status
            .paths()
            .iter()
            .map(|path| RunFile::open(path).unwrap())
            .collect()
    }

    /// All ticks that are in any of the files, in order.
    fn ticks(files: &[RunFile]) -> Vec<u64> {
        let mut ticks = Vec::new();
        for s in files.iter().flat_map(RunFile::samples) {
            let plain = Sample {
                flags: s.flags.difference(Flags::AFTER_GAP),
                ..s
            };
            assert_eq!(plain, sample(s.tick), "the time of every file is that of the run");
            ticks.push(s.tick);
        }
        ticks.sort_unstable();
        ticks.dedup();
        ticks
    }

    fn names(&self) -> Vec<String> {
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        self.status.paths().iter().map(name).collect()
    }
}

fn full() -> WriteError {
    WriteError::Full("database or disk is full".into())
}

fn broken() -> WriteError {
    WriteError::Failed("disk I/O error".into())
}

/// K1. Times are in ms. `first` to `last` is the time without space.
fn full_for_a_time(_: u64, now_ms: u64, plan: FaultTime) -> Option<WriteError> {
    (plan.first..plan.last).contains(&now_ms).then(full)
}

#[test]
fn k1_a_full_disk_alarms_at_once_and_loses_nothing_if_space_is_freed() {
    let plan = FaultTime {
        first: 2000,
        last: 42_000,
    };
    let mut bench = FaultyRun::new(full_for_a_time, plan, ROOM_SAMPLES);
    bench.run_ms(1990);
    assert_eq!(bench.status.problem(), None);
    bench.run_ms(30);
    let problem = bench.status.problem().unwrap();
    assert!(problem.contains("is full: samples wait in memory"), "{problem}");
    bench.run_ms(39_000);
    assert!(bench.status.problem().is_some());
    assert!(
        bench.status.settled() <= 2010,
        "what waits in memory is not called saved"
    );
    bench.run_ms(3000);
    assert_eq!(bench.status.problem(), None, "tried again within a second");
    let files = bench.end();
    assert_eq!(FaultyRun::ticks(&files), (0..bench.tick).collect::<Vec<_>>());
    let [file] = files.as_slice() else {
        panic!("one file")
    };
    let survey = file.survey();
    assert_eq!((survey.missing(), survey.damage.as_slice()), (0, [].as_slice()));
    let texts: Vec<String> = file.events().into_iter().map(|e| e.text).collect();
    assert!(
        texts[0].contains("is full") && texts[1].contains("no sample is missing"),
        "{texts:?}"
    );
}

#[test]
fn a_disk_that_stays_full_is_waited_for_and_the_rest_is_told() {
    let plan = FaultTime {
        first: 2000,
        last: 40_000,
    };
    let mut bench = FaultyRun::new(full_for_a_time, plan, ROOM_SAMPLES);
    bench.run_ms(12_000);
    // The run ends at 12 s, the wait at 42 s, and space is free at 40 s.
    let files = bench.end();
    assert_eq!(FaultyRun::ticks(&files).len(), 12_000);
    assert_eq!((bench.status.problem(), bench.status.not_saved()), (None, 0));
}

/// The samples are refused for good, but the outcome finds the space that was kept for it.
fn full_except_for_the_end(_: u64, now_ms: u64, plan: FaultTime) -> Option<WriteError> {
    (now_ms >= plan.first && now_ms < plan.last).then(full)
}

#[test]
fn what_is_not_on_the_disk_at_the_end_is_in_the_outcome() {
    let plan = FaultTime {
        first: 5625,
        last: u64::MAX,
    };
    // The disk of this test refuses everything, so the file stays open and only the status tells.
    let mut bench = FaultyRun::new(full_except_for_the_end, plan, ROOM_SAMPLES);
    bench.run_ms(12_000);
    bench.status.give_up();
    let files = bench.end();
    assert!(files[0].outcome().is_none());
    let saved = files[0].samples().count() as u64;
    assert_eq!(bench.status.not_saved(), 12_000 - saved);
    let problem = bench.status.problem().unwrap();
    assert!(
        problem.contains(&format!(
            "{} samples from 5.620 s to 11.999 s are not on the disk",
            12_000 - saved
        )),
        "{problem}"
    );
}

#[test]
fn k1_samples_beyond_the_room_are_a_told_gap() {
    let plan = FaultTime {
        first: 2000,
        last: 10_000,
    };
    let mut bench = FaultyRun::new(full_for_a_time, plan, 5000);
    bench.run_ms(12_000);
    let files = bench.end();
    let survey = files[0].survey();
    let outcome = files[0].outcome().unwrap();
    let unsaved = outcome.unsaved.as_ref().unwrap();
    assert!(unsaved.samples > 2000 && unsaved.samples < 4000, "{unsaved:?}");
    assert_eq!(
        (survey.unsaved, survey.lost, survey.damage.as_slice()),
        (unsaved.samples, 0, [].as_slice())
    );
    assert_eq!(outcome.samples + unsaved.samples, 12_000);
    let [
        Gap {
            cause: GapCause::Unsaved,
            from_tick,
            ..
        },
    ] = survey.gaps.as_slice()
    else {
        panic!("{:?}", survey.gaps)
    };
    assert_eq!(*from_tick, unsaved.from_tick);
    assert!(bench.status.problem().unwrap().contains("are not on the disk"));
}

/// K2. Call `first` to `last` fails with an I/O error.
fn broken_calls(call: u64, _: u64, plan: FaultTime) -> Option<WriteError> {
    (plan.first..=plan.last).contains(&call).then(broken)
}

/// Number of calls of a run of 300 ms without faults.
fn calls_of_a_short_run() -> u64 {
    let mut bench = FaultyRun::new(broken_calls, FaultTime::default(), ROOM_SAMPLES);
    bench.run_ms(300);
    bench.end();
    let calls = bench.calls.lock().unwrap();
    *calls
}

#[test]
fn k2_an_error_at_any_call_moves_the_run_to_a_second_file_and_loses_nothing() {
    let calls = calls_of_a_short_run();
    assert!(calls > 60, "{calls}");
    for call in 2..=calls {
        let plan = FaultTime {
            first: call,
            last: call,
        };
        let mut bench = FaultyRun::new(broken_calls, plan, ROOM_SAMPLES);
        bench.run_ms(300);
        let files = bench.end();
        assert_eq!(
            FaultyRun::ticks(&files),
            (0..300).collect::<Vec<_>>(),
            "call {call}"
        );
        assert_eq!(bench.names(), ["a.leafrun", "a-2.leafrun"], "call {call}");
        let second = &files[1];
        assert_eq!(second.header().continues, files[0].header().run_id);
        assert_ne!(second.header().run_id, files[0].header().run_id);
        assert!(
            files[0].outcome().is_none(),
            "call {call}: nothing more is written into the first file"
        );
        assert!(second.outcome().is_some(), "call {call}");
        assert_eq!(second.survey().damage, [""; 0], "call {call}");
        let problem = bench.status.problem().unwrap();
        assert!(
            problem.contains("a.leafrun failed") && problem.contains("a-2.leafrun"),
            "{problem}"
        );
        assert_eq!(bench.status.not_saved(), 0);
    }
}

/// The same for what is not a sample: each event is in one of the files, with its time.
#[test]
fn k2_an_error_at_any_call_loses_no_event() {
    let event = |tick: u64| Event {
        tick,
        time_s: tick as f64 / 1000.0,
        kind: EventKind::Operator,
        text: format!("event at {tick}"),
    };
    for call in (2..=calls_of_a_short_run()).step_by(3) {
        let plan = FaultTime {
            first: call,
            last: call,
        };
        let mut bench = FaultyRun::new(broken_calls, plan, ROOM_SAMPLES);
        for tick in 0..300 {
            if tick % 25 == 0 {
                bench.writer().event(&event(tick));
            }
            bench.run_ms(1);
        }
        let files = bench.end();
        let mut read: Vec<Event> = files.iter().flat_map(RunFile::events).collect();
        read.retain(|event| event.kind == EventKind::Operator);
        read.sort_by_key(|event| event.tick);
        read.dedup();
        let written: Vec<Event> = (0..300).step_by(25).map(event).collect();
        assert_eq!(read, written, "call {call}");
    }
}

#[test]
fn k2_while_no_file_can_be_made_the_samples_wait_and_are_never_called_saved() {
    for call in [3, 20, 41] {
        let plan = FaultTime {
            first: call,
            last: call + 5,
        };
        let mut bench = FaultyRun::new(broken_calls, plan, ROOM_SAMPLES);
        bench.run_ms(10_000);
        let files = bench.end();
        assert_eq!(
            FaultyRun::ticks(&files),
            (0..10_000).collect::<Vec<_>>(),
            "from call {call}"
        );
    }
    let plan = FaultTime {
        first: 41,
        last: u64::MAX,
    };
    let mut bench = FaultyRun::new(broken_calls, plan, ROOM_SAMPLES);
    bench.run_ms(10_000);
    let settled = bench.status.settled();
    assert!(settled < 400, "{settled} of 10000 samples are called saved");
    let files = bench.end();
    assert_eq!(bench.status.not_saved(), 10_000 - settled);
    assert_eq!(files.len(), 1);
}

#[test]
fn a_commit_is_not_called_saved_before_it_is_synced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.leafrun");
    let mut part = PartFile::create(&path, &header(), None).unwrap();
    let mut waiting = Waiting::with_room(100);
    waiting.push(&sample(0));
    let (samples, events) = waiting.next_commit(10);
    part.commit(samples, events).unwrap();
    waiting.commit_done(10);
    assert_eq!((waiting.synced_up_to(0), waiting.in_memory()), (0, 1));
    // The sync thread needs real time.
    let deadline = std::time::Instant::now() + Duration::from_secs(60);
    while part.synced().unwrap() == 0 {
        assert!(
            std::time::Instant::now() < deadline,
            "the sync thread works every 100 ms"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!((waiting.synced_up_to(1), waiting.in_memory()), (1, 0));
}

/// A file that SQLite itself finds full: the next commit after it has room again has everything.
#[test]
fn a_file_without_room_is_as_before_and_takes_the_same_commit_later() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.leafrun");
    let mut part = PartFile::create(&path, &header(), None).unwrap();
    let samples: Vec<Sample> = (0..2000).map(sample).collect();
    part.commit(&samples[..1000], &[]).unwrap();
    part.limit_pages(12);
    assert!(matches!(
        part.commit(&samples[1000..], &[]),
        Err(WriteError::Full(_))
    ));
    part.limit_pages(1 << 20);
    part.commit(&samples[1000..], &[]).unwrap();
    part.close(&outcome(2000)).unwrap();
    drop(part);
    let run = RunFile::open(&path).unwrap();
    assert_eq!(run.samples().collect::<Vec<_>>(), samples);
    assert_eq!(run.survey().damage, [""; 0]);
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no log and no reserve beside it"
    );
}

/// Defect 17: after a restart the ticks of the rig begin again.
#[test]
fn events_stay_in_order_when_the_rig_restarts() {
    let mut bench = FaultyRun::new(broken_calls, FaultTime::default(), ROOM_SAMPLES);
    bench.run_ms(2000);
    let after_restart = Event {
        tick: 3,
        time_s: -1.996,
        kind: EventKind::End,
        text: "the rig restarted".into(),
    };
    let mut early = after_restart.clone();
    early.tick = 1900;
    bench.writer().event(&early);
    bench.writer().event(&after_restart);
    let files = bench.end();
    let times: Vec<(u64, f64)> = files[0].events().iter().map(|e| (e.tick, e.time_s)).collect();
    assert_eq!(times, [(1900, -1.996), (1999, 1.999)]);
    assert!(bench.folder.path().exists());
}
