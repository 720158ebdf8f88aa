//! Rows L and T: the link between host and rig.

use std::sync::atomic::Ordering;

use super::{
    Measured, account_is_closed, is_aborted_and_latched, is_as_documented, measure, moving, outcome,
    rig_unloads, run_ended, told, with_faults,
};
use crate::control::{Phase, Refusal};
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::message::{Cause, FromRig, RigState, object};
use crate::recording::{Ending, Flags};
use crate::tests::support::virtual_rig::{NODE, VirtualRig, order, sine};

/// A frame that belongs to no rig.
const FOREIGN_ID: u16 = 0x123;

#[test]
fn l1_lost_samples_are_gaps_and_many_hold() {
    is_as_documented("L1", l1());
}

pub(super) fn l1() -> Measured {
    let mut bench = moving();
    bench.mock.injection.wire.sample_lost = 0.002;
    bench.ticks(500);
    assert_eq!(bench.rig.phase(), Phase::Running, "a few are no reason to hold");
    let held = |b: &VirtualRig| b.mock.state() == RigState::Hold;
    let measured = measure(
        &mut bench,
        |i| i.wire.sample_lost = 0.05,
        |b| told(b, "samples were lost") > 0,
        held,
        500,
    );
    bench.mock.injection.wire.sample_lost = 0.0;
    bench.until(Phase::Held, 50);
    bench.rig.resume().expect("on hold");
    bench.until(Phase::Ready, 60_000);
    assert_eq!(outcome(&bench).ending, Ending::Completed);
    account_is_closed(&bench);
    Measured {
        lost: outcome(&bench).lost,
        ..measured
    }
}

#[test]
fn l2_a_silent_link_ends_the_run_on_both_sides() {
    is_as_documented("L2", l2());
}

pub(super) fn l2() -> Measured {
    let mut bench = moving();
    let measured = measure(&mut bench, |i| i.wire.silent = true, run_ended, rig_unloads, 60);
    assert_eq!(measured.detected_ms, 21, "silence_ms is 20");
    assert_eq!(bench.mock.cause(), Cause::LeaseLapsed);
    is_aborted_and_latched(&mut bench, "no sample for 21 ms");
    account_is_closed(&bench);
    Measured {
        lost: outcome(&bench).lost,
        ..measured
    }
}

#[test]
fn l3_bus_off_aborts() {
    is_as_documented("L3", l3());
}

pub(super) fn l3() -> Measured {
    let mut bench = moving();
    bench.host.health.bus_off.fetch_add(1, Ordering::Relaxed);
    let measured = measure(&mut bench, |_| {}, run_ended, rig_unloads, 5);
    is_aborted_and_latched(&mut bench, "bus-off");
    measured
}

#[test]
fn l4_error_passive_is_told_and_starts_no_run() {
    is_as_documented("L4", l4());
}

pub(super) fn l4() -> Measured {
    let mut bench = moving();
    bench.host.health.error_passive.store(true, Ordering::Relaxed);
    let told = |b: &VirtualRig| b.rig.status().notice.contains("error passive");
    let measured = measure(&mut bench, |_| {}, told, told, 5);
    assert_eq!(bench.rig.phase(), Phase::Running, "the run goes on");
    bench.stop();
    bench.until(Phase::Ready, 30_000);
    assert_eq!(
        bench.rig.start(order(sine(1.0, 1.0, 1))),
        Err(Refusal::ErrorPassive)
    );
    bench.host.health.error_passive.store(false, Ordering::Relaxed);
    bench.tick();
    bench
        .rig
        .start(order(sine(1.0, 1.0, 1)))
        .expect("the controller recovered");
    measured
}

#[test]
fn l5_a_link_that_takes_no_frames_ends_the_run() {
    is_as_documented("L5", l5());
}

pub(super) fn l5() -> Measured {
    let mut bench = moving();
    bench.jammed = true;
    while bench.host.send(Frame::new(FOREIGN_ID, &[])) {}
    let measured = measure(&mut bench, |_| {}, run_ended, rig_unloads, 60);
    assert!(measured.detected_ms <= 23, "{measured:?}");
    bench.jammed = false;
    is_aborted_and_latched(&mut bench, "the link has taken no command");
    measured
}

/// A queue that is full for a few milliseconds costs nothing: commands and leases are sent in the next turns.
#[test]
fn l5_a_short_jam_costs_nothing() {
    let mut bench = moving();
    bench.jammed = true;
    while bench.host.send(Frame::new(FOREIGN_ID, &[])) {}
    bench.ticks(8);
    bench.jammed = false;
    bench.until(Phase::Ready, 60_000);
    assert_eq!(
        outcome(&bench).ending,
        Ending::Completed,
        "{}",
        outcome(&bench).cause
    );
}

#[test]
fn l6_damaged_frames_are_never_used_and_three_abort() {
    is_as_documented("L6", l6());
}

pub(super) fn l6() -> Measured {
    let mut bench = moving();
    let before = bench.memory.samples.len();
    let measured = measure(&mut bench, |i| i.wire.corrupt = 1.0, run_ended, rig_unloads, 10);
    assert_eq!(
        bench.memory.samples.len(),
        before,
        "no damaged sample is in the record"
    );
    is_aborted_and_latched(&mut bench, "damaged frames");
    account_is_closed(&bench);
    Measured {
        lost: outcome(&bench).lost,
        ..measured
    }
}

#[test]
fn l6_damaged_frames_of_the_host_unload() {
    is_as_documented("L6 firmware", l6_firmware());
}

pub(super) fn l6_firmware() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.wire.host_corrupt = 1.0,
        rig_unloads,
        rig_unloads,
        10,
    );
    assert_eq!(bench.mock.cause(), Cause::CorruptFrames);
    is_aborted_and_latched(&mut bench, "corrupt frames");
    measured
}

#[test]
fn l7_repeated_frames_are_dropped_and_counted() {
    is_as_documented("L7", l7());
}

pub(super) fn l7() -> Measured {
    let mut bench = moving();
    let counted = |b: &VirtualRig| b.rig.status().counters.frames_out_of_sequence > 0;
    let measured = measure(&mut bench, |i| i.wire.repeated = 1.0, counted, counted, 5);
    bench.until(Phase::Ready, 60_000);
    assert_eq!(
        outcome(&bench).ending,
        Ending::Completed,
        "{}",
        outcome(&bench).cause
    );
    account_is_closed(&bench);
    assert_eq!(outcome(&bench).lost, 0);
    measured
}

#[test]
fn l8_a_late_frame_is_dropped_and_its_sample_is_a_gap() {
    let mut bench = moving();
    bench.mock.injection.wire.reordered = 0.003;
    bench.ticks(3_000);
    bench.mock.injection.wire.reordered = 0.0;
    bench.until(Phase::Ready, 60_000);
    assert_eq!(
        outcome(&bench).ending,
        Ending::Completed,
        "{}",
        outcome(&bench).cause
    );
    account_is_closed(&bench);
    let dropped = bench.rig.status().counters.frames_out_of_sequence;
    assert!(dropped > 0, "frames were exchanged");
    assert_eq!(
        outcome(&bench).lost,
        dropped,
        "each dropped sample is counted as lost"
    );
}

#[test]
fn l9_samples_that_stay_late_abort() {
    is_as_documented("L9", l9());
}

pub(super) fn l9() -> Measured {
    let mut bench = moving();
    let late = |b: &VirtualRig| {
        b.memory
            .samples
            .last()
            .is_some_and(|s| s.flags.contains(Flags::LATE))
    };
    let measured = measure(&mut bench, |i| i.wire.late_ms = 60.0, late, rig_unloads, 100);
    bench.ticks(100);
    is_aborted_and_latched(&mut bench, "late (limit 20 ms)");
    account_is_closed(&bench);
    assert!(outcome(&bench).late > 0);
    Measured {
        lost: outcome(&bench).lost,
        ..measured
    }
}

#[test]
fn l10_a_second_rig_is_called_a_masquerade() {
    is_as_documented("L10", l10());
}

pub(super) fn l10() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.wire.second_rig = true,
        run_ended,
        rig_unloads,
        10,
    );
    is_aborted_and_latched(&mut bench, "masquerade");
    let newest = bench
        .memory
        .samples
        .iter()
        .filter(|s| s.time_s > 2.8 && s.time_s < 2.92);
    assert!(
        newest.clone().count() > 100 && newest.clone().all(|s| s.force_n > 500.0),
        "no sample of the other rig is in the record"
    );
    measured
}

#[test]
fn l10_a_second_host_unloads() {
    is_as_documented("L10 firmware", l10_firmware());
}

pub(super) fn l10_firmware() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.wire.second_host = true,
        rig_unloads,
        rig_unloads,
        70,
    );
    assert_eq!(bench.mock.cause(), Cause::ForeignSession);
    is_aborted_and_latched(&mut bench, "foreign session");
    measured
}

#[test]
fn l11_an_overflow_of_the_receive_queue_holds() {
    is_as_documented("L11", l11());
}

pub(super) fn l11() -> Measured {
    let mut bench = moving();
    bench.host.health.overflows.fetch_add(7, Ordering::Relaxed);
    let held = |b: &VirtualRig| b.mock.state() == RigState::Hold;
    let measured = measure(&mut bench, |_| {}, |b| told(b, "7 frames were lost") > 0, held, 5);
    bench.until(Phase::Held, 20);
    assert_eq!(bench.rig.status().counters.receive_overflows, 7);
    measured
}

/// A bus that is full of other frames: these are ignored, and the delay that they cause is found by the age of the samples.
#[test]
fn l13_foreign_traffic_is_ignored_and_its_delay_found() {
    is_as_documented("L13", l13());
}

fn l13() -> Measured {
    let mut bench = moving();
    for _ in 0..2_000 {
        for k in 0..5 {
            bench.others_send(Frame::new(FOREIGN_ID + k, &[1, 2, 3, 4, 5, 6, 7, 8]));
        }
        bench.tick();
    }
    assert_eq!(bench.rig.phase(), Phase::Running, "{:#?}", bench.rig.status());
    assert_eq!(bench.rig.status().counters.lost, 0);
    let measured = measure(&mut bench, |i| i.wire.late_ms = 30.0, run_ended, rig_unloads, 100);
    is_aborted_and_latched(&mut bench, "late (limit 20 ms)");
    measured
}

#[test]
fn l14_another_version_rate_calibration_or_limit_is_never_armed() {
    is_as_documented("L14", l14());
}

pub(super) fn l14() -> Measured {
    let cases = [
        (object::PROTOCOL, 0x0002_0000, "protocol 2.0"),
        (object::SAMPLE_RATE, 500, "samples at 500 Hz"),
        (object::CALIBRATION_HASH, 0xBAD, "calibration hash is 0x00000bad"),
        (object::CONFIGURATION_CRC, 0xBAD, "limits in the rig differ"),
    ];
    for (changed, value, words) in cases {
        let mut bench = VirtualRig::new();
        bench.to_host = Box::new(move |frame| match FromRig::decode(&frame, NODE) {
            Ok(FromRig::ConfigValue { index, sub, .. }) if (index, sub) == changed => {
                Some(FromRig::ConfigValue { index, sub, value }.encode(NODE))
            }
            _ => Some(frame),
        });
        bench.ticks(3_000);
        let status = bench.rig.status();
        assert!(status.notice.contains(words), "{words}: {}", status.notice);
        assert_eq!(status.phase, Phase::Connecting, "{words}");
        assert!(matches!(
            bench.rig.start(order(sine(1.0, 1.0, 1))),
            Err(Refusal::NotConnected(_))
        ));
        bench.ticks(500);
        assert!(
            bench.mock.state() == RigState::Off && !bench.mock.pressure_on(),
            "{words}"
        );
    }
    // Not a matter of time: the rig is never armed.
    Measured {
        detected_ms: 0,
        reacted_ms: 0,
        lost: 0,
        allowed_ms: 0,
    }
}

#[test]
fn l15_frames_of_a_wrong_length_are_dropped_and_counted() {
    let mut bench = moving();
    for len in 0..8usize {
        bench.others_send(Frame::new(cob::id(cob::SAMPLE, NODE), &[0xFF; 8][..len]));
        bench.others_send(Frame::new(cob::id(cob::STATUS, NODE), &[0xFF; 8][..len]));
    }
    let before = bench.rig.status().counters.frames_refused;
    bench.tick();
    assert_eq!(bench.rig.status().counters.frames_refused, before + 16);
    bench.until(Phase::Ready, 60_000);
    assert_eq!(outcome(&bench).ending, Ending::Completed);
    assert_eq!(outcome(&bench).lost, 0);
}

#[test]
fn l16_samples_without_status_abort() {
    is_as_documented("L16", l16());
}

pub(super) fn l16() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.wire.status_lost = 1.0,
        run_ended,
        rig_unloads,
        115,
    );
    is_aborted_and_latched(&mut bench, "no status");
    measured
}

#[test]
fn l17_a_lost_abort_is_repeated_and_the_lease_ends() {
    is_as_documented("L17", l17());
}

pub(super) fn l17() -> Measured {
    // The first two aborts are lost.
    let mut bench = moving();
    bench.host.health.bus_off.fetch_add(1, Ordering::Relaxed);
    let measured = measure(
        &mut bench,
        |i| i.wire.abort_lost = 1.0,
        run_ended,
        |b| b.rig.phase() != Phase::Running,
        5,
    );
    bench.ticks(15);
    assert_eq!(bench.mock.state(), RigState::Running);
    bench.mock.injection.wire.abort_lost = 0.0;
    bench.ticks(10);
    assert_eq!(bench.mock.cause(), Cause::HostAbort, "a repeated abort arrived");
    is_aborted_and_latched(&mut bench, "bus-off");
    // None ever arrives, and nothing is heard of the rig.
    let mut bench = moving();
    bench.host.health.bus_off.fetch_add(1, Ordering::Relaxed);
    bench.mock.injection.wire.abort_lost = 1.0;
    bench.mock.injection.wire.status_lost = 1.0;
    bench.mock.injection.wire.emergency_lost = 1.0;
    let by_lease = measure(&mut bench, |_| {}, run_ended, rig_unloads, 62);
    assert_eq!(bench.mock.cause(), Cause::LeaseLapsed);
    bench.ticks(1_100);
    assert!(
        bench.rig.status().notice.contains("press the emergency stop"),
        "{}",
        bench.rig.status().notice
    );
    Measured {
        detected_ms: measured.detected_ms,
        ..by_lease
    }
}

#[test]
fn t2_damaged_packets_abort() {
    is_as_documented("T2", t2());
}

pub(super) fn t2() -> Measured {
    let mut bench = moving();
    let health = std::sync::Arc::clone(&bench.host.health);
    for _ in 0..100 {
        health.good_packets.fetch_add(11, Ordering::Relaxed);
        bench.ticks(10);
    }
    health.bad_packets.fetch_add(4, Ordering::Relaxed);
    bench.ticks(10);
    assert_eq!(bench.rig.phase(), Phase::Running, "four are too few");
    health.bad_packets.fetch_add(13, Ordering::Relaxed);
    let measured = measure(&mut bench, |_| {}, run_ended, rig_unloads, 5);
    is_aborted_and_latched(&mut bench, "serial packets");
    measured
}

/// An adapter that delivers in blocks: the times in the record are those of the rig all the same.
#[test]
fn t6_blocks_of_16_ms_change_no_time_and_longer_ones_are_flagged() {
    for (block_ms, is_late) in [(16, false), (40, true)] {
        let mut bench = moving();
        bench.block_ms = block_ms;
        bench.ticks(2_000);
        bench.block_ms = 1;
        let late = bench
            .memory
            .samples
            .iter()
            .filter(|s| s.flags.contains(Flags::LATE))
            .count();
        assert_eq!(late > 0, is_late, "{late} of blocks of {block_ms} ms");
        if !is_late {
            bench.until(Phase::Ready, 60_000);
            assert_eq!(
                outcome(&bench).ending,
                Ending::Completed,
                "{}",
                outcome(&bench).cause
            );
            account_is_closed(&bench);
            assert!(
                bench
                    .memory
                    .samples
                    .windows(2)
                    .all(|w| (w[1].time_s - w[0].time_s - 0.001).abs() < 1e-9)
            );
        }
    }
}

/// The schedule of the mock rig alone brings a fault in each run: no test code is between.
#[test]
fn a_schedule_in_the_bench_file_plays_its_faults_in_a_run() {
    let mut bench = with_faults(&["status-lost@run+1s..1500ms"]);
    bench.start(sine(6.0, 1.0, 3));
    bench.until(Phase::Unloading, 2_000);
    bench.until(Phase::Interlocked, 30_000);
    let end = outcome(&bench);
    assert!(end.cause.contains("no status"), "{}", end.cause);
    let time_s = bench
        .memory
        .events
        .iter()
        .find(|e| e.text.contains("no status"))
        .expect("an event")
        .time_s;
    // 100 ms after the fault; the motion began with the first command, at time 0.
    assert!((1.09..1.12).contains(&time_s), "{time_s}");
}
