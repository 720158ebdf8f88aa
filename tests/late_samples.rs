//! Lateness of samples: what waited in this computer is not late, what waited in the link is. Control against the mock rig
//! in virtual time, with pauses of either side.

use super::support::virtual_rig::{VirtualRig, static_ramp};
use crate::recording::Flags;

/// A bench with a run of one second behind it.
fn running() -> VirtualRig {
    let mut bench = VirtualRig::new();
    bench.start(static_ramp());
    bench.ticks(1_000);
    bench
}

/// The host's program stands still while the rig and the link go on.
fn pause(bench: &mut VirtualRig, ms: u64) {
    bench.host_alive = false;
    bench.ticks(ms);
    bench.host_alive = true;
}

fn assert_all_in_time(bench: &VirtualRig, what: &str) {
    let flagged = |flag| {
        let samples = bench.memory.samples.iter();
        samples.filter(|s| s.flags.contains(flag)).count()
    };
    assert_eq!(flagged(Flags::LATE), 0, "{what}: late");
    assert_eq!(flagged(Flags::AFTER_GAP), 0, "{what}: gaps");
}

#[test]
fn a_pause_of_the_host_makes_no_sample_late_and_loses_none() {
    for pause_ms in [5, 20, 50, 100, 200, 500] {
        let mut bench = running();
        pause(&mut bench, pause_ms);
        bench.ticks(2_000);
        assert_all_in_time(&bench, &format!("{pause_ms} ms"));
    }
}

/// The control thread takes the time, is preempted, and then reads what arrived meanwhile.
#[test]
fn a_pause_between_the_clock_and_the_read_makes_no_sample_late() {
    for pause_ms in [5, 30, 80] {
        let mut bench = running();
        let before_ns = bench.now_ns;
        pause(&mut bench, pause_ms);
        bench.rig.poll(before_ns, &mut bench.host, &mut bench.memory);
        bench.ticks(2_000);
        assert_all_in_time(&bench, &format!("{pause_ms} ms"));
    }
}

/// A busy computer stops the process of the mock rig: its clock stands still and is behind from then on.
#[test]
fn a_rig_clock_that_stood_still_makes_samples_late_for_seconds_only() {
    let mut bench = running();
    for _ in 0..3 {
        bench.rig_alive = false;
        bench.ticks(15);
        bench.rig_alive = true;
        bench.ticks(20);
    }
    bench.ticks(2_500);
    let late = bench.rig.status().counters.late;
    assert!(late > 0, "three times 15 ms are more than the 20 ms allowed");
    bench.ticks(2_500);
    assert_eq!(bench.rig.status().counters.late, late, "late of the last 2500");
}

#[test]
fn a_delay_in_the_link_is_flagged_from_its_first_sample() {
    let mut bench = running();
    let before = bench.memory.samples.len();
    bench.delay_ms = 25;
    bench.ticks(100);
    let delayed = &bench.memory.samples[before..];
    // The silence before the first one ends the run, which is soon unloaded.
    assert!(delayed.len() > 20, "{} samples", delayed.len());
    assert!(delayed.iter().all(|s| s.flags.contains(Flags::LATE)));
    let late = bench.rig.status().counters.late;
    assert!(late >= delayed.len() as u64, "{late} counted");
}
