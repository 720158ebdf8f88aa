//! Rows F: the firmware.

use std::cell::Cell;
use std::rc::Rc;

use super::{
    Inject, Measured, is_aborted_and_latched, is_as_documented, measure, moving, outcome, rig_unloads,
    run_ended, told,
};
use crate::control::Phase;
use crate::mockrig::Injection;
use crate::protocol::message::{Cause, FromRig, RequestResult, RigState, ToRig};
use crate::recording::EventKind;
use crate::tests::support::virtual_rig::{MS, NODE, VirtualRig, sine};

#[test]
fn f1_firmware_that_stands_still_loses_its_pressure() {
    is_as_documented("F1", f1());
}

pub(super) fn f1() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.firmware_hangs = true,
        run_ended,
        |b| !b.mock.pressure_on(),
        10,
    );
    // It runs again before the daemon notices.
    bench.ticks(3);
    bench.mock.injection = Injection::default();
    bench.tick();
    assert_eq!(
        (bench.mock.state(), bench.mock.cause()),
        (RigState::Tripped, Cause::Watchdog)
    );
    is_aborted_and_latched(&mut bench, "watchdog");
    // It never runs again: the daemon ends the run.
    let mut bench = moving();
    bench.mock.injection.firmware_hangs = true;
    assert_eq!(bench.until(Phase::Unloading, 30), 21);
    is_aborted_and_latched(&mut bench, "no sample for 21 ms");
    measured
}

#[test]
fn f2_a_restart_of_the_firmware_closes_the_run_and_latches() {
    is_as_documented("F2", f2());
}

pub(super) fn f2() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.firmware_reboots = true,
        |b| b.memory.outcome.is_some(),
        |b| b.memory.outcome.is_some() && !b.mock.pressure_on(),
        20,
    );
    is_aborted_and_latched(&mut bench, "firmware restarted");
    let last = bench.memory.events.last().expect("events");
    assert!(last.kind == EventKind::End && last.time_s > 2.5, "{last:?}");
    // Between runs nothing is latched, because nothing moved, but it is told.
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    assert_eq!(
        bench.rig.status().notice,
        "",
        "a rig that is switched on is no restart"
    );
    bench.ticks(600);
    bench.mock.injection.firmware_reboots = true;
    bench.ticks(2_000);
    assert!(
        bench.rig.status().notice.contains("firmware restarted"),
        "{}",
        bench.rig.status().notice
    );
    assert_eq!(bench.rig.phase(), Phase::Ready);
    measured
}

#[test]
fn f3_an_emergency_frame_alone_ends_the_run() {
    is_as_documented("F3", f3());
}

pub(super) fn f3() -> Measured {
    let mut bench = moving();
    bench.mock.injection.wire.status_lost = 1.0;
    let measured = measure(&mut bench, |i| i.emergency_stop = true, run_ended, run_ended, 3);
    is_aborted_and_latched(&mut bench, "emergency stop");
    // Between runs it is shown.
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.mock.injection.wire.status_lost = 1.0;
    bench.mock.injection.emergency_stop = true;
    bench.ticks(3);
    assert_eq!(bench.rig.phase(), Phase::Interlocked);
    assert!(
        bench.rig.status().notice.contains("reports emergency stop"),
        "{}",
        bench.rig.status().notice
    );
    measured
}

#[test]
fn f4_a_clock_that_drifts_is_told() {
    is_as_documented("F4", f4());
}

pub(super) fn f4() -> Measured {
    for (ppm, is_told) in [(500, false), (2_000, true)] {
        let mut bench = VirtualRig::new();
        bench.until(Phase::Ready, 2_000);
        bench.ms_ns = MS + MS / 1_000_000 * ppm;
        let told = |b: &VirtualRig| b.rig.status().notice.contains("ppm against this computer");
        let ms = (1..=25_000).find(|_| {
            bench.tick();
            told(&bench)
        });
        assert_eq!(ms.is_some(), is_told, "{ppm} ppm: {ms:?}");
        if let Some(ms) = ms {
            // The clock wraps after 65.5 s: no sample is lost or late.
            bench.ticks(70_000);
            let counters = bench.rig.status().counters;
            assert_eq!((counters.lost, counters.late), (0, 0));
            return Measured {
                detected_ms: ms,
                reacted_ms: ms,
                lost: 0,
                allowed_ms: 22_000,
            };
        }
    }
    unreachable!("2000 ppm is told")
}

#[test]
fn f5_a_request_that_is_not_followed_is_repeated_then_aborted() {
    is_as_documented("F5", f5());
}

pub(super) fn f5() -> Measured {
    let mut bench = moving();
    let until = |b: &VirtualRig| told(b, "did not answer") > 0 || told(b, "did not begin to unload") > 0;
    bench.mock.injection.wire.request_lost = 1.0;
    // A status that claims an acknowledgement is not needed: the state alone shows that the rig does not unload.
    bench.stop();
    let measured = measure(&mut bench, |_| {}, until, rig_unloads, 1_010);
    assert_eq!(bench.mock.cause(), Cause::HostAbort);
    // An answer that is lost once is asked for again, and nothing is done twice.
    let mut bench = moving();
    bench.mock.injection.wire.request_lost = 1.0;
    bench.rig.hold().expect("running");
    bench.ticks(10);
    bench.mock.injection.wire.request_lost = 0.0;
    bench.until(Phase::Held, 40);
    // A rig that takes the unload for done and does nothing is aborted after a second.
    let mut bench = moving();
    is_deaf_and_says_done(&mut bench);
    bench.stop();
    bench.ticks(950);
    assert_eq!(
        bench.mock.state(),
        RigState::Hold,
        "its queue is empty, {}",
        bench.mock.cause()
    );
    bench.ticks(60);
    assert_eq!(bench.mock.state(), RigState::Unload, "by NMT stop");
    assert_eq!(told(&bench, "did not begin to unload within 1 s"), 1);
    measured
}

/// The rig acknowledges each request as done and does nothing.
fn is_deaf_and_says_done(bench: &mut VirtualRig) {
    let asked = Rc::new(Cell::new(None));
    let answered = Rc::clone(&asked);
    bench.to_rig = Box::new(move |frame| match ToRig::decode(&frame, NODE) {
        Ok(ToRig::Request(request)) => {
            asked.set(Some(request.counter));
            None
        }
        _ => Some(frame),
    });
    bench.to_host = Box::new(move |frame| {
        let (Ok(FromRig::Status(mut status)), Some(counter)) =
            (FromRig::decode(&frame, NODE), answered.get())
        else {
            return Some(frame);
        };
        (status.ack_counter, status.ack_result) = (counter, RequestResult::Done);
        Some(FromRig::Status(status).encode(NODE))
    });
}

#[test]
fn f6_a_queue_that_runs_dry_holds_then_unloads() {
    is_as_documented("F6", f6());
}

pub(super) fn f6() -> Measured {
    let mut bench = moving();
    let held = |b: &VirtualRig| b.mock.state() == RigState::Hold;
    let measured = measure(&mut bench, |i| i.wire.command_lost = 1.0, held, held, 80);
    assert_eq!(bench.mock.cause(), Cause::QueueDry);
    bench.until(Phase::Held, 5);
    bench.mock.injection = Injection::default();
    let ms = bench.until(Phase::Unloading, 31_000);
    assert!((29_900..30_100).contains(&ms), "{ms} ms");
    is_aborted_and_latched(&mut bench, "queue dry");
    measured
}

#[test]
fn f7_a_rig_that_ignores_the_commands_ends_the_run() {
    is_as_documented("F7", f7());
}

pub(super) fn f7() -> Measured {
    let mut bench = VirtualRig::new();
    bench.mock.injection.wire.command_lost = 1.0;
    bench.start(sine(6.0, 1.0, 3));
    let measured = measure(&mut bench, |_| {}, run_ended, rig_unloads, 230);
    is_aborted_and_latched(&mut bench, "does not follow the commands");
    assert!(outcome(&bench).cycles_completed == 0);
    measured
}

#[test]
fn f8_a_rig_that_enforces_no_limit_is_aborted_by_the_daemon() {
    is_as_documented("F8", f8());
}

pub(super) fn f8() -> Measured {
    let mut longest = Measured {
        detected_ms: 0,
        reacted_ms: 0,
        lost: 0,
        allowed_ms: 12,
    };
    let cases: [(Inject, &str); 4] = [
        (|i| i.force_open = true, "the load cell has had no valid reading"),
        (
            |i| i.displacement_open = true,
            "the LVDT has had no valid reading",
        ),
        (|i| i.force_offset_n = 4_000.0, "force"),
        (|i| i.force_offset_n = -3_000.0, "force -"),
    ];
    for (inject, words) in cases {
        let mut bench = moving();
        bench.mock.injection.limits_ignored = true;
        let measured = measure(&mut bench, inject, run_ended, rig_unloads, 12);
        bench.ticks(3);
        bench.mock.injection = Injection::default();
        is_aborted_and_latched(&mut bench, words);
        if measured.reacted_ms > longest.reacted_ms {
            longest = measured;
        }
    }
    longest
}
