//! `rig-check`: the mock rig passes every row in memory, over a pseudo-terminal and over vcan; a firmware that deviates in one
//! thing fails exactly the row about it.

use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::support::leafbench;
use super::support::wire::Wire;
use super::two_processes::{ONE_BENCH, vcan0_is_there};
use crate::conformance::{Probe, ProbeClock, Reach, RowReport, RowVerdict, WalkPart, walk};
use crate::link::{self, Side, loopback};
use crate::mockrig::{MockRig, MockRigConfig};
use crate::model::equivalent::Equivalent;

mod deviation;

use deviation::{DEVIATIONS, DeviantRig, Deviation, NODE};

const SESSION: u8 = 77;

fn mock_rig() -> MockRig {
    let plant = Equivalent::new(&[0.0, 80.0, 0.1, 0.5], 0.0).expect("four values");
    MockRig::new(&MockRigConfig::default(), Box::new(plant)).expect("defaults are possible")
}

/// All rows, with motion.
fn all(probe: &mut Probe) -> Vec<RowReport> {
    assert_eq!(probe.reach(), Reach::Free);
    let mut rows = walk(probe, WalkPart::Still, |_| {});
    rows.extend(walk(probe, WalkPart::Moving, |_| {}));
    rows.extend(walk(probe, WalkPart::Whole, |_| {}));
    rows
}

/// The failed rows, each with what is wrong.
fn failed(rows: &[RowReport]) -> Vec<String> {
    rows.iter()
        .filter(|row| row.verdict != RowVerdict::Pass)
        .map(|row| format!("{}: {}", row.id, row.seen))
        .collect()
}

#[test]
fn the_mock_rig_passes_every_row_in_memory() {
    let (host, mut rig_end) = loopback::pair();
    let mut rig = mock_rig();
    let step = Box::new(move || rig.tick(&mut rig_end));
    let rows = all(&mut Probe::new(host, ProbeClock::Virtual(step), NODE, SESSION));
    assert_eq!(failed(&rows), [""; 0]);
    let mut ids: Vec<&str> = rows.iter().map(|row| row.id).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), rows.len(), "each id once");
}

#[test]
fn each_deviation_fails_exactly_its_row() {
    let mut wrong = Vec::new();
    for (deviation, row) in DEVIATIONS {
        let found = failed(&deviant(deviation));
        if found.len() != 1 || !found[0].starts_with(&format!("{row}: ")) {
            wrong.push(format!("{deviation:?}: {row} expected, found {found:#?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn deviant(deviation: Deviation) -> Vec<RowReport> {
    let (mut rig, host) = DeviantRig::new(deviation, mock_rig());
    let step = Box::new(move || rig.step());
    all(&mut Probe::new(host, ProbeClock::Virtual(step), NODE, SESSION))
}

/// All rows over two addresses of one wire, in real time.
fn passes_over(rig_address: &str, host_address: &str) {
    let _alone = ONE_BENCH.lock().unwrap_or_else(PoisonError::into_inner);
    let rig_link = link::open(rig_address, Side::Rig { node: NODE }).expect("the rig's end opens");
    let host_link = link::open(host_address, Side::Host { rig_node: NODE }).expect("the host's end opens");
    let stop = AtomicBool::new(false);
    let began = Instant::now();
    let wait = Box::new(move || {
        std::thread::sleep(Duration::from_micros(500));
        began.elapsed().as_millis() as u64
    });
    let rows = std::thread::scope(|scope| {
        let rig = mock_rig();
        let running = scope.spawn(|| {
            let _ = link::priority::raise_this_thread();
            rig.run_realtime(rig_link, &stop)
        });
        // In a thread of its own, whose priority ends with it.
        let host = scope.spawn(move || {
            let _ = link::priority::raise_this_thread();
            all(&mut Probe::new(host_link, ProbeClock::Real(wait), NODE, SESSION))
        });
        let rows = host.join().expect("no panic");
        stop.store(true, Ordering::Relaxed);
        running.join().expect("no panic").expect("the clock works");
        rows
    });
    assert_eq!(failed(&rows), [""; 0]);
}

#[test]
fn the_mock_rig_passes_every_row_over_a_pseudo_terminal() {
    let wire = Wire::new();
    let [rig, host] = wire.ports.clone().map(|port| format!("serial:{port}"));
    passes_over(&rig, &host);
}

#[test]
fn the_mock_rig_passes_every_row_over_vcan() {
    if vcan0_is_there() {
        passes_over("can:vcan0", "can:vcan0");
    }
}

#[test]
fn the_command_prints_the_table_and_its_summary() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&["rig-check", "--link", "mock:"])
        .current_dir(folder.path())
        .output()
        .expect("leafbench starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("pass    limit-ranges"), "{text}");
    assert!(text.contains("skipped lease-lapse"), "{text}");
    assert!(text.contains(" passed, 0 FAILED, "), "{text}");
}

#[test]
fn motion_needs_a_person_at_a_terminal() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = leafbench(&["rig-check", "--link", "mock:", "--motion"])
        .current_dir(folder.path())
        .stdin(std::process::Stdio::null())
        .output()
        .expect("leafbench starts");
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(!text.contains("lease-lapse"), "no row with motion: {text}");
}
