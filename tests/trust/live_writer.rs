//! A process that records a run as the daemon does, to be killed, and what must be left of its file. It is a test of this binary that
//! only others start: with `LEAFBENCH_LIVE_RUN` it records into that file until somebody ends it.

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use crate::link::now_ns;
use crate::link::priority::raise_this_thread;
use crate::recording::run_file::test_support::{header, sample};
use crate::recording::run_file::{RunFile, RunFileWriter};
use crate::recording::{Event, EventKind, Flags, Recorder, Sample, recorder};

/// Names the file to record into.
pub const FILE: &str = "LEAFBENCH_LIVE_RUN";
/// Name of the test that records.
pub const WRITER: &str = "tests::trust::live_writer::writer";
/// An event each so many ticks.
const EVENT_TICKS: u64 = 50;
const TICK_NS: u64 = 1_000_000;

fn event(tick: u64) -> Event {
    Event {
        tick,
        time_s: tick as f64 / 1000.0,
        kind: EventKind::Operator,
        text: format!("event at tick {tick}"),
    }
}

/// Records a sample each millisecond. Prints for each: samples passed on, samples that are known to be on the disk.
#[test]
#[ignore = "runs until it is killed; other tests start it"]
fn writer() {
    let Ok(path) = std::env::var(FILE) else { return };
    let path = Path::new(&path);
    let writer = RunFileWriter::create(path, &header()).expect("a run file");
    let status = writer.status();
    let (mut input, _thread) = recorder::spawn(writer).expect("a thread");
    let _ = raise_this_thread();
    let mut out = std::io::stdout();
    input.begin(&header());
    let mut next_ns = now_ns();
    for tick in 0.. {
        input.sample(&sample(tick));
        if tick % EVENT_TICKS == 0 {
            input.event(&event(tick));
        }
        // One write: a kill leaves no half line of it in a pipe.
        let line = format!("live {} {}\n", tick + 1, status.settled());
        if out.write_all(line.as_bytes()).and_then(|()| out.flush()).is_err() {
            return;
        }
        next_ns += TICK_NS;
        std::thread::sleep(Duration::from_nanos(next_ns.saturating_sub(now_ns())));
    }
}

/// The newest whole line of a writer: samples passed on, samples on the disk.
pub fn newest_report(output: &str) -> Option<(u64, u64)> {
    let whole = output.rfind('\n').map_or("", |end| &output[..end]);
    whole.lines().rev().find_map(|line| {
        let mut words = line.split("live ").last()?.split_whitespace();
        Some((words.next()?.parse().ok()?, words.next()?.parse().ok()?))
    })
}

/// Holds what is left of a run to what was written: from the first sample on, none missing, none changed, with the events between
/// them. Returns the number of samples.
pub fn hold_to_what_was_written(path: &Path) -> u64 {
    let run = RunFile::open(path).expect("the file opens");
    assert_eq!(run.header(), &header());
    let survey = run.survey();
    assert_eq!(
        (survey.lost, survey.damaged, survey.unsaved),
        (0, 0, 0),
        "{survey:?}"
    );
    assert!(survey.damage.is_empty(), "{:?}", survey.damage);
    let samples: Vec<Sample> = run.samples().collect();
    for (tick, read) in (0..).zip(&samples) {
        assert_eq!(*read, sample(tick));
        assert_eq!(read.flags, Flags::empty());
    }
    let count = samples.len() as u64;
    let events = run.events();
    for (number, read) in (0..).zip(&events) {
        assert_eq!(*read, event(number * EVENT_TICKS));
    }
    // An event is committed with the samples before it, or with the next ones.
    let expected = count.div_ceil(EVENT_TICKS);
    let found = events.len() as u64;
    assert!(
        found == expected || found + 1 == expected,
        "{found} events of {expected}"
    );
    count
}

/// Reads the file after a cut of the power, and prints the number of its samples.
#[test]
#[ignore = "reads what the writer left; .ci/power-cut starts it"]
fn reader() {
    let Ok(path) = std::env::var(FILE) else { return };
    let path = Path::new(&path);
    if !path.exists() {
        println!("\nleft none");
        return;
    }
    let count = hold_to_what_was_written(path);
    println!("\nleft {count}");
    // The next start of the daemon closes it.
    let closed = RunFile::open(path).and_then(|run| run.close_as_aborted("power cut"));
    assert_eq!(closed.expect("it closes").samples, count);
    assert_eq!(hold_to_what_was_written(path), count);
}
