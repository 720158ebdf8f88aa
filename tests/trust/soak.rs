//! Faults D5 and the figures of long use: run after run without a leak. `docs/trust-figures.md` has the commands for a whole soak.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::virtual_loop::Loop;
use crate::control::Phase;
use crate::recording::recorder::{self, FanOut};
use crate::recording::{Ending, Event, Header, Outcome, Recorder, Sample};
use crate::tests::support::bench::{mock, order, sine, twin};
use crate::tests::support::{Daemon, json};

/// Virtual hours where `LEAFBENCH_SOAK_HOURS` says nothing.
const HOURS: f64 = 0.25;
/// Runs before the memory is measured.
const WARM_UP_RUNS: u32 = 8;
/// The same for the daemon: buffers, caches and the allocator's arenas reach their final size after about 5 minutes.
const WARM_UP_RUNS_OF_THE_DAEMON: u32 = 24;
/// Most that the memory may grow, bytes.
const MOST_GROWTH: i64 = 1 << 20;

/// Resident memory of a process in bytes: the second word of `statm` is in pages of 4 KiB.
fn resident_bytes(process: &str) -> i64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/statm")).expect("Linux");
    let pages = text
        .split_whitespace()
        .nth(1)
        .and_then(|word| word.parse::<i64>().ok());
    4096 * pages.expect("a number of pages")
}

fn setting(name: &str) -> Option<f64> {
    Some(std::env::var(name).ok()?.parse().expect("a number"))
}

/// Holds each sample to the order of ticks, and the end to what was recorded.
struct Checked {
    samples: u64,
    last_tick: Option<u64>,
    total: Arc<AtomicU64>,
}

impl Recorder for Checked {
    fn begin(&mut self, _: &Header) {}
    fn sample(&mut self, sample: &Sample) {
        assert!(
            self.last_tick.is_none_or(|last| sample.tick == last + 1),
            "none is missing"
        );
        assert!(sample.force_n.is_finite() && sample.displacement_mm.is_finite());
        self.last_tick = Some(sample.tick);
        self.samples += 1;
        self.total.fetch_add(1, Ordering::Relaxed);
    }
    fn event(&mut self, _: &Event) {}
    fn end(&mut self, outcome: &Outcome) {
        assert_eq!(
            (outcome.ending, outcome.lost, outcome.late),
            (Ending::Completed, 0, 0),
            "{outcome:?}"
        );
        assert_eq!(outcome.samples, self.samples);
    }
}

/// One run with twin and recording thread, from start to rest.
fn one_run(bench: &mut Loop, total: &Arc<AtomicU64>) {
    let config = mock();
    let chain = FanOut(vec![Box::new(Checked {
        samples: 0,
        last_tick: None,
        total: Arc::clone(total),
    })]);
    // The recording thread has 65 s of room, so runs are shorter than that.
    let (input, thread) = recorder::spawn(twin(&config, Box::new(chain))).expect("a thread");
    let order = order(&config, &sine("soak", 6.0, 2.5, 110));
    bench.start(order, Box::new(input));
    bench.until(Phase::Ready);
    // The recorder of a run is dropped between two runs, which ends its thread.
    (0..40).for_each(|_| bench.turn());
    drop(thread.join().expect("the recording thread holds its rules"));
}

/// In a process of its own, because the memory of this one is that of all tests.
#[test]
fn d5_run_after_run_in_virtual_time_loses_no_sample_and_no_memory() {
    let binary = std::env::current_exe().expect("a test binary knows its path");
    let output = Command::new(binary)
        .args([
            "--exact",
            "tests::trust::soak::run_after_run",
            "--ignored",
            "--nocapture",
        ])
        // With arenas for threads the allocator grows by one of them at some run, which is no leak.
        .env("MALLOC_ARENA_MAX", "1")
        .output()
        .expect("this binary starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    eprintln!("{said}");
    assert!(output.status.success() && said.contains("soak: "), "{said}");
}

#[test]
#[ignore = "d5_run_after_run_in_virtual_time_loses_no_sample_and_no_memory starts it"]
fn run_after_run() {
    let hours = setting("LEAFBENCH_SOAK_HOURS").unwrap_or(HOURS);
    let total = Arc::new(AtomicU64::new(0));
    let mut bench = Loop::new();
    // The allocator keeps what it was given: it has its size after some runs.
    (0..WARM_UP_RUNS).for_each(|_| one_run(&mut bench, &total));
    let (begun_ns, begun) = (bench.now_ns, Instant::now());
    let (first, mut runs) = (resident_bytes("self"), 0);
    let virtual_hours = |now_ns: u64| (now_ns - begun_ns) as f64 / 3.6e12;
    while virtual_hours(bench.now_ns) < hours {
        one_run(&mut bench, &total);
        runs += 1;
    }
    let grown = resident_bytes("self") - first;
    eprintln!(
        "soak: {runs} runs, {:.2} virtual hours in {:.0} s, {} samples, 0 lost; memory {:+} KiB",
        virtual_hours(bench.now_ns),
        begun.elapsed().as_secs_f64(),
        total.load(Ordering::Relaxed),
        grown / 1024,
    );
    let (status, health) = bench.handle.status();
    assert_eq!(
        (status.counters.lost, status.counters.late, health.skipped_ms),
        (0, 0, 0)
    );
    assert!(grown < MOST_GROWTH, "{grown} bytes");
}

#[test]
#[ignore = "lasts as long as LEAFBENCH_SOAK_SECONDS says"]
fn d5_the_daemon_in_real_time_does_not_grow() {
    let seconds = setting("LEAFBENCH_SOAK_SECONDS").unwrap_or(600.0);
    let folder = tempfile::tempdir().expect("a folder");
    let daemon = Daemon::ready(folder.path(), &[]);
    let process = daemon.process.0.id().to_string();
    let profile = folder.path().join("soak.toml");
    std::fs::write(&profile, sine("soak", 6.0, 2.5, 20)).expect("written");
    let run = |path: &Path| {
        let (answer, code) = json(folder.path(), &["run", path.to_str().expect("UTF-8")]);
        assert_eq!(code, 0, "{answer}");
        resident_bytes(&process)
    };
    let warm = (0..WARM_UP_RUNS_OF_THE_DAEMON)
        .map(|_| run(&profile))
        .max()
        .unwrap_or(0);
    let (begun, mut runs, mut newest) = (Instant::now(), 0, warm);
    while begun.elapsed() < Duration::from_secs_f64(seconds) {
        newest = run(&profile);
        runs += 1;
        eprintln!(
            "{:6.0} s  {runs} runs  {} KiB",
            begun.elapsed().as_secs_f64(),
            newest / 1024
        );
    }
    let status = daemon.status();
    let counters = &status["rig"]["counters"];
    eprintln!(
        "soak: {runs} runs, memory {:+} KiB, {counters}",
        (newest - warm) / 1024
    );
    assert_eq!(counters["lost"], 0, "{status}");
    assert!(newest - warm < MOST_GROWTH, "{} bytes more", newest - warm);
}
