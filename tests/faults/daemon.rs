//! Rows D and O: the daemon and its computer, as far as they are tested in virtual time. The others run real processes.

use super::{
    Measured, account_is_closed, is_as_documented, measure, moving, outcome, rig_unloads, sources, told,
};
use crate::control::{Phase, Refusal};
use crate::protocol::message::{Cause, RigState, ToRig};
use crate::recording::Ending;
use crate::tests::support::virtual_rig::{NODE, order, sine};

#[test]
fn d1_a_dead_daemon_leaves_a_rig_that_unloads() {
    is_as_documented("D1", d1());
}

pub(super) fn d1() -> Measured {
    let mut bench = moving();
    bench.host_alive = false;
    let measured = measure(&mut bench, |_| {}, rig_unloads, rig_unloads, 55);
    assert_eq!(bench.mock.cause(), Cause::LeaseLapsed);
    bench.ticks(10_000);
    assert_eq!(bench.mock.state(), RigState::Tripped);
    assert!(
        bench.mock.displacement_mm() < 1.0,
        "{} mm",
        bench.mock.displacement_mm()
    );
    measured
}

/// A daemon that was frozen for 20 ms goes on; after 60 ms or 5 s it finds a rig that has unloaded, and moves nothing.
#[test]
fn d3_a_frozen_daemon_sends_no_stale_command() {
    for frozen_ms in [20, 60, 5_000] {
        let mut bench = moving();
        bench.host_alive = false;
        bench.ticks(frozen_ms);
        bench.host_alive = true;
        let at_mm = bench.mock.displacement_mm();
        if frozen_ms == 20 {
            bench.until(Phase::Ready, 60_000);
            assert_eq!(
                outcome(&bench).ending,
                Ending::Completed,
                "{}",
                outcome(&bench).cause
            );
            continue;
        }
        for _ in 0..10_000 {
            bench.tick();
            assert_ne!(bench.mock.state(), RigState::Running);
            assert!(
                bench.mock.displacement_mm() < at_mm + 0.3,
                "the rig was loaded again"
            );
        }
        assert_eq!(bench.rig.phase(), Phase::Interlocked);
        assert_eq!(outcome(&bench).ending, Ending::Aborted);
        account_is_closed(&bench);
    }
}

#[test]
fn d4_a_lease_of_a_stuck_loop_is_none() {
    is_as_documented("D4", d4());
}

pub(super) fn d4() -> Measured {
    let mut bench = moving();
    let mut stuck_at = None;
    bench.to_rig = Box::new(move |frame| {
        let Ok(ToRig::Lease(mut lease)) = ToRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        lease.control_tick = *stuck_at.get_or_insert(lease.control_tick);
        Some(ToRig::Lease(lease).encode(NODE))
    });
    let measured = measure(&mut bench, |_| {}, rig_unloads, rig_unloads, 65);
    assert_eq!(bench.mock.cause(), Cause::LeaseLapsed);
    measured
}

/// The daemon is killed and started again while the rig still moves: it waits, starts nothing, and takes a stop.
#[test]
fn d7_a_daemon_that_starts_beside_a_moving_rig_waits() {
    is_as_documented("D7", d7());
}

fn d7() -> Measured {
    let mut bench = moving();
    bench.restart_host();
    let measured = measure(
        &mut bench,
        |_| {},
        |b| b.rig.status().rig_state.is_some(),
        rig_unloads,
        60,
    );
    let mut highest_mm = bench.mock.displacement_mm();
    while bench.mock.pressure_on() {
        bench.tick();
        assert!(
            !matches!(bench.rig.phase(), Phase::Ready | Phase::Running),
            "{:?}",
            bench.rig.phase()
        );
        assert!(bench.rig.start(order(sine(1.0, 1.0, 1))).is_err());
        highest_mm = highest_mm.max(bench.mock.displacement_mm());
    }
    assert!(highest_mm < 14.0, "{highest_mm} mm");
    bench.until(Phase::Interlocked, 3_000);
    assert!(matches!(
        bench.rig.start(order(sine(1.0, 1.0, 1))),
        Err(Refusal::Interlocked(_))
    ));
    bench.rig.reset().expect("interlocked");
    bench.until(Phase::Ready, 3_000);
    measured
}

#[test]
fn o1_a_late_loop_is_told_and_counted_in_the_run() {
    is_as_documented("O1", o1());
}

pub(super) fn o1() -> Measured {
    let mut bench = moving();
    for _ in 0..3 {
        bench.host_alive = false;
        bench.ticks(29);
        bench.host_alive = true;
        bench.ticks(100);
    }
    assert_eq!(
        told(&bench, "control was late by 30 ms"),
        1,
        "once in a run: {:#?}",
        bench.memory.events
    );
    assert!(
        bench.rig.status().notice.contains("control was late"),
        "{}",
        bench.rig.status().notice
    );
    bench.until(Phase::Ready, 60_000);
    assert_eq!(outcome(&bench).ending, Ending::Completed);
    account_is_closed(&bench);
    assert_eq!(
        told(
            &bench,
            "3 turns of control were late in this run, the longest pause was 30 ms"
        ),
        1
    );
    Measured {
        detected_ms: 30,
        reacted_ms: 30,
        lost: outcome(&bench).lost,
        allowed_ms: 30,
    }
}

/// Nothing that controls or records the motion reads the wall clock.
#[test]
fn o2_no_part_of_control_reads_the_wall_clock() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    for folder in ["src/control", "src/protocol", "src/mockrig", "src/profile"] {
        let code = sources(&root.join(folder));
        for clock in [
            "SystemTime",
            "CLOCK_REALTIME",
            "jiff::",
            "Zoned::now",
            "Timestamp::now",
        ] {
            assert!(!code.contains(clock), "{folder} uses {clock}");
        }
    }
}

/// A panic in any thread ends the whole process at once, so that no lease is renewed by a daemon that controls nothing.
#[test]
fn d2_a_panic_in_a_thread_ends_the_process() {
    const CHILD: &str = "LEAFBENCH_TEST_PANIC";
    if std::env::var_os(CHILD).is_some() {
        crate::cli::end_with_the_first_panic();
        let _ = std::thread::spawn(|| panic!("in a thread beside control")).join();
        // Without the hook the process lives on, and ends well.
        std::process::exit(0);
    }
    let started = std::time::Instant::now();
    let end = std::process::Command::new(std::env::current_exe().expect("this test"))
        .args([
            "--exact",
            "tests::faults::daemon::d2_a_panic_in_a_thread_ends_the_process",
            "--nocapture",
        ])
        .env(CHILD, "1")
        .output()
        .expect("the test binary runs");
    use std::os::unix::process::ExitStatusExt;
    assert_eq!(
        end.status.signal(),
        Some(nix::sys::signal::Signal::SIGABRT as i32),
        "{end:?}"
    );
    assert!(started.elapsed().as_secs() < 10);
}
