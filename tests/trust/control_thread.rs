//! Fault D5 and the figures of the control loop: in a million ticks of a run the thread asks for no memory, waits for nobody and
//! touches no page that is not there. Virtual time; recorder, run file and readers of the status run beside it as in the daemon.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::resource::{UsageWho, getrusage};

use super::allocations;
use super::virtual_loop::{Loop, MS};
use crate::control::Phase;
use crate::control::realtime::ControlHandle;
use crate::control::run::RunOrder;
use crate::recording::recorder::{self, FanOut};
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::{Event, EventKind, Header, Outcome, Recorder, Sample};
use crate::tests::support::bench::mock;

/// Ticks that are measured.
const TICKS: u64 = 1_000_000;
/// Ticks before them: the ring to the recording thread (65 792 places) has gone round once, so that each of its pages was touched.
/// The daemon locks its memory instead, which touches them at once.
const WARM_UP: u64 = 70_000;
/// Ticks between two looks at what the recording thread has left to do.
const CHUNK: u64 = 10_000;
/// 2.5 Hz, corrected from cycle to cycle; longer than the test.
const SINE: &str = "name = \"long-sine\"\ncontrol = \"displacement\"\n[[block]]\n\
    [[block.segment]]\nkind = \"ramp\"\nto_mm = 10.0\nduration_s = 2.0\n\
    [[block.segment]]\nkind = \"sine\"\nmean_mm = 10.0\namplitude_mm = 4.0\nfrequency_hz = 2.5\ncycles = 3000\n\
    taper_cycles = 2\ncorrect = true\n";

/// Counts what came through the ring.
#[derive(Default)]
struct Tally {
    samples: Arc<AtomicU64>,
    corrections: Arc<AtomicU64>,
}

impl Recorder for Tally {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, _: &Sample) {
        self.samples.fetch_add(1, Ordering::Relaxed);
    }
    fn event(&mut self, event: &Event) {
        let correction = event.kind == EventKind::Correction;
        self.corrections
            .fetch_add(u64::from(correction), Ordering::Relaxed);
    }
    fn end(&mut self, _: &Outcome) {}
}

/// What the calling thread has used so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Used {
    /// Without those of the mock rig.
    allocations: u64,
    frees: u64,
    /// Allocations of the mock rig.
    of_mock: u64,
    minor_faults: i64,
    major_faults: i64,
    /// Times that the thread gave the processor away because it waited for something: a lock, a disk, a sleep.
    waits: i64,
}

impl Used {
    fn now(bench: &Loop) -> Used {
        let [mock_allocations, mock_frees] = bench
            .of_mock
            .each_ref()
            .map(|count| count.load(Ordering::Relaxed));
        let usage = getrusage(UsageWho::RUSAGE_THREAD).expect("Linux knows it");
        let own = allocations::of_this_thread();
        Used {
            allocations: own.count - mock_allocations,
            frees: own.freed - mock_frees,
            of_mock: mock_allocations,
            minor_faults: usage.minor_page_faults(),
            major_faults: usage.major_page_faults(),
            waits: usage.voluntary_context_switches(),
        }
    }

    fn add(&mut self, before: Used, now: Used) {
        self.allocations += now.allocations - before.allocations;
        self.frees += now.frees - before.frees;
        self.of_mock += now.of_mock - before.of_mock;
        self.minor_faults += now.minor_faults - before.minor_faults;
        self.major_faults += now.major_faults - before.major_faults;
        self.waits += now.waits - before.waits;
    }
}

/// The order of a run of a profile's text.
fn order(text: &str) -> RunOrder {
    crate::tests::support::bench::order(&mock(), text)
}

/// Somebody who reads the status all the time, so that its lock is held as often as can be.
struct StatusReader {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<u64>,
}

impl StatusReader {
    fn of(handle: ControlHandle) -> StatusReader {
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut reads = 0;
            while !ends.load(Ordering::Relaxed) {
                std::hint::black_box(handle.status());
                reads += 1;
                // Not in a tight loop: the machine has few processors.
                std::thread::sleep(Duration::from_micros(50));
            }
            reads
        });
        StatusReader { stop, thread }
    }

    /// How often it read.
    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("the reader of the status")
    }
}

/// What the ticks of a run need, and the time that they take.
fn measure(bench: &mut Loop, recorded: &AtomicU64) -> (Used, Duration) {
    let (mut used, mut spent) = (Used::default(), Duration::ZERO);
    let mut done = 0;
    while done < WARM_UP + TICKS {
        let (before, begun) = (Used::now(bench), Instant::now());
        (0..CHUNK).for_each(|_| bench.turn());
        if done >= WARM_UP {
            used.add(before, Used::now(bench));
            spent += begun.elapsed();
        }
        done += CHUNK;
        // Virtual time is faster than the disk: without this the ring would overrun, which it does not in 65 s of real time.
        while recorded.load(Ordering::Relaxed) + 20_000 < done {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    (used, spent)
}

#[test]
fn d5_a_million_ticks_of_a_run_need_no_memory_no_lock_and_no_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.leafrun");
    let order = order(SINE);
    let tally = Tally::default();
    let (samples, corrections) = (Arc::clone(&tally.samples), Arc::clone(&tally.corrections));
    let writer = RunFileWriter::create(&path, &order.header).expect("a run file");
    let chain = FanOut(vec![Box::new(writer), Box::new(tally)]);
    let (input, thread) = recorder::spawn(chain).expect("a thread");
    let mut bench = Loop::new();
    bench.start(order, Box::new(input));
    let reader = StatusReader::of(bench.handle.clone());
    let (used, spent) = measure(&mut bench, &samples);
    let reads = reader.end();
    let (status, _) = bench.handle.status();
    assert_eq!(status.phase, Phase::Running, "{status:#?}");
    // The run is left open: its recorder ends with the loop.
    drop(bench);
    drop(thread.join().expect("the recording thread"));

    let corrections = corrections.load(Ordering::Relaxed);
    eprintln!(
        "{TICKS} ticks of a run: {used:?}; {corrections} corrections recorded, status read {reads} times, {:.2} us a tick",
        spent.as_secs_f64() * 1e6 / TICKS as f64
    );
    let recorded = RunFile::open(&path).expect("a run file").survey().samples;
    assert!(recorded >= TICKS, "{recorded} samples: a run was under way");
    assert!(corrections >= 10, "{corrections}: the correction was at work");
    assert!(reads > 100, "{reads}: somebody read the status");
    let of_mock = used.of_mock;
    assert_eq!(
        used,
        Used {
            of_mock,
            ..Used::default()
        }
    );
}

/// The classes of delay in the outcome of a run are those of this run alone.
#[test]
fn o1_the_run_file_tells_how_late_the_control_loop_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.leafrun");
    let text = "name = \"ramp\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 1.0\n\
                duration_s = 0.5\n[[block.segment]]\nkind = \"ramp\"\nto_mm = 0.0\nduration_s = 0.5\n";
    let order = order(text);
    let writer = RunFileWriter::create(&path, &order.header).expect("a run file");
    let mut bench = Loop::new();
    bench.control.note_lateness(80 * MS);
    bench.start(order, Box::new(writer));
    for late_us in [150, 150, 3_000, 70_000] {
        bench.control.note_lateness(late_us * 1000);
    }
    bench.until(Phase::Ready);
    let run = RunFile::open(&path).expect("a run file");
    let punctuality = run.outcome().and_then(|o| o.punctuality).expect("told");
    let classes = Vec::<crate::recording::punctuality::LatenessClass>::from(punctuality.lateness);
    let turns = |up_to_us| {
        classes
            .iter()
            .find(|c| c.up_to_us == up_to_us)
            .map_or(0, |c| c.turns)
    };
    assert_eq!(
        (turns(Some(200)), turns(Some(5000)), turns(None)),
        (2, 1, 1),
        "{punctuality:?}"
    );
    assert_eq!(
        punctuality.worst_lateness_us, 70_000,
        "not the 80 ms before the run"
    );
    assert_eq!(punctuality.late_turns, 2);
    assert_eq!(classes.iter().map(|c| c.turns).sum::<u64>(), punctuality.turns);
}
