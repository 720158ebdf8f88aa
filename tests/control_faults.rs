//! Control against a rig, a link and people that misbehave, in virtual time: what the host owes behind the firmware.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::Ordering;

use super::support::virtual_rig::{MS, NODE, VirtualRig, Wire, order, sine, static_ramp};
use crate::control::{Phase, Refusal};
use crate::mockrig::MockRigConfig;
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::message::{FromRig, NmtCommand, RequestCode, RigState, SampleMessage, ToRig};
use crate::recording::{Ending, EventKind, Outcome};

fn is(frame: &Frame, function: u16) -> bool {
    frame.id == cob::id(function, NODE)
}

fn nmt(frame: &Frame) -> Option<NmtCommand> {
    match ToRig::decode(frame, NODE) {
        Ok(ToRig::Nmt { command, .. }) => Some(command),
        _ => None,
    }
}

fn request(frame: &Frame) -> Option<RequestCode> {
    match ToRig::decode(frame, NODE) {
        Ok(ToRig::Request(request)) => Some(request.code),
        _ => None,
    }
}

/// All frames but those of a function.
fn without(function: u16) -> Wire {
    Box::new(move |frame| (!is(&frame, function)).then_some(frame))
}

/// A bench 20 s into the static ramp.
fn running() -> VirtualRig {
    let mut bench = VirtualRig::new();
    bench.start(static_ramp());
    bench.ticks(20_000);
    bench
}

/// How long the run goes on, ms.
fn ends_within(bench: &mut VirtualRig, limit_ms: u64) -> u64 {
    bench.until(Phase::Unloading, limit_ms)
}

fn outcome(bench: &VirtualRig) -> &Outcome {
    bench.memory.outcome.as_ref().expect("the run ended")
}

/// The run is aborted for a cause that contains `words`, and the bench is latched until a reset.
fn is_aborted_and_latched(bench: &mut VirtualRig, words: &str) {
    bench.until(Phase::Interlocked, 30_000);
    let end = outcome(bench);
    assert_eq!(end.ending, Ending::Aborted, "{}", end.cause);
    assert!(end.cause.contains(words), "{}", end.cause);
    let status = bench.rig.status();
    assert!(
        status.fault.contains(words) || status.rig_state == Some(RigState::Tripped),
        "{status:#?}"
    );
    let refusal = bench.rig.start(order(static_ramp()));
    assert!(matches!(refusal, Err(Refusal::Interlocked(_))), "{refusal:?}");
}

/// After a reset the same bench plays a run to its end.
fn runs_again_after_a_reset(bench: &mut VirtualRig) {
    bench.rig.reset().expect("is interlocked");
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    bench.rig.start(order(sine(3.0, 2.0, 2))).expect("ready");
    bench.until(Phase::Running, 1_000);
    bench.until(Phase::Ready, 60_000);
    assert_eq!(
        outcome(bench).ending,
        Ending::Completed,
        "{}",
        outcome(bench).cause
    );
    let peak = |m: f64, s: &crate::recording::Sample| m.max(s.displacement_mm);
    let peak_mm = bench.memory.samples.iter().fold(0.0, peak);
    assert!(peak_mm > 20.0, "the second run moved: {peak_mm} mm");
}

#[test]
fn a_tare_moves_the_limits_of_the_rig() {
    // The load cell reads 150 N too low, the LVDT 0.5 mm.
    let mut config = MockRigConfig::default();
    (config.load_cell.zero_counts, config.lvdt.zero_counts) = (-1500.0, -1000.0);
    let mut bench = VirtualRig::with(&config);
    let written = Rc::new(Cell::new((0, 0)));
    let seen = Rc::clone(&written);
    bench.to_rig = Box::new(move |frame| {
        if let Ok(ToRig::ConfigWrite {
            index: 0x2100,
            sub,
            value,
        }) = ToRig::decode(&frame, NODE)
        {
            let (max, unloaded) = seen.get();
            match sub {
                1 => seen.set((value as i32, unloaded)),
                12 => seen.set((max, value as i32)),
                _ => {}
            }
        }
        Some(frame)
    });
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    assert_eq!(written.get(), (40_000, 200), "4000 N and 20 N");
    let report = bench.rig.tare().expect("the rig is still");
    assert!((report.force_new_n + 150.0).abs() < 1.0, "{report:?}");
    bench.ticks(100);
    let (max, unloaded) = written.get();
    assert!(
        (max - 38_500).abs() < 10 && (unloaded + 1_300).abs() < 10,
        "{max}, {unloaded}"
    );
    bench.start(static_ramp());
    bench.ticks(30_000);
    bench.stop();
    bench.until(Phase::Ready, 20_000);
    let status = bench.rig.status();
    let force_n = status.force_n.expect("samples flow");
    assert!(force_n.abs() < 25.0, "unloaded to {force_n} N: {status:#?}");
}

#[test]
fn an_abort_is_repeated_until_the_rig_confirms_it() {
    let mut bench = running();
    let stops = Rc::new(Cell::new(0));
    let leases = Rc::new(Cell::new(0));
    let (stop, lease) = (Rc::clone(&stops), Rc::clone(&leases));
    bench.to_rig = Box::new(move |frame| {
        if is(&frame, cob::LEASE) && stop.get() > 0 {
            lease.set(lease.get() + 1);
        }
        if nmt(&frame) == Some(NmtCommand::Stop) {
            stop.set(stop.get() + 1);
            return (stop.get() > 2).then_some(frame);
        }
        Some(frame)
    });
    bench.to_host = without(cob::STATUS);
    let ms = ends_within(&mut bench, 1_000);
    assert!(ms <= 105, "{ms} ms without a status");
    bench.to_host = Box::new(Some);
    bench.ticks(25);
    assert_eq!(bench.mock.state(), RigState::Unload, "the third stop arrived");
    let sent = stops.get();
    assert!((3..=4).contains(&sent), "{sent}");
    bench.ticks(500);
    assert!(stops.get() <= sent + 1, "confirmed, but {} stops", stops.get());
    assert_eq!(leases.get(), 0, "the lease stops with the abort");
    is_aborted_and_latched(&mut bench, "no status");
    runs_again_after_a_reset(&mut bench);
}

#[test]
fn an_abort_that_never_arrives_is_told_and_the_lease_lapses() {
    let mut bench = running();
    bench.to_rig = Box::new(|frame| (nmt(&frame) != Some(NmtCommand::Stop)).then_some(frame));
    bench.to_host =
        Box::new(|frame| (!is(&frame, cob::STATUS) && !is(&frame, cob::EMERGENCY)).then_some(frame));
    ends_within(&mut bench, 1_000);
    bench.ticks(60);
    assert_eq!(bench.mock.state(), RigState::Unload, "by the lease");
    bench.ticks(1_500);
    let notice = bench.rig.status().notice;
    assert!(notice.contains("press the emergency stop"), "{notice}");
}

#[test]
fn a_rig_that_takes_no_commands_completes_no_run() {
    let mut bench = VirtualRig::new();
    bench.to_rig = without(cob::COMMAND);
    bench.start(sine(6.0, 1.0, 3));
    let ms = ends_within(&mut bench, 30_000);
    assert!(ms < 350, "{ms} ms");
    is_aborted_and_latched(&mut bench, "does not follow the commands");
    bench.to_rig = Box::new(Some);
    runs_again_after_a_reset(&mut bench);
}

#[test]
fn a_queue_that_the_rig_calls_empty_ends_the_run() {
    let mut bench = running();
    bench.to_host = Box::new(|frame| {
        let Ok(FromRig::Status(mut status)) = FromRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        status.queue_ms = 0;
        Some(FromRig::Status(status).encode(NODE))
    });
    let ms = ends_within(&mut bench, 1_000);
    assert!(ms <= 125, "{ms} ms");
    is_aborted_and_latched(&mut bench, "queue");
}

#[test]
fn an_emergency_alone_ends_the_run() {
    let mut bench = running();
    bench.to_host = without(cob::STATUS);
    bench.mock.injection.emergency_stop = true;
    let ms = ends_within(&mut bench, 1_000);
    assert!(ms <= 3, "{ms} ms");
    bench.mock.injection.emergency_stop = false;
    bench.to_host = Box::new(Some);
    is_aborted_and_latched(&mut bench, "emergency stop");
}

#[test]
fn damaged_frames_abort_the_run_two_do_not() {
    let mut bench = running();
    let damage = |count: u32| -> Wire {
        let mut left = count;
        Box::new(move |mut frame| {
            if left > 0 && is(&frame, cob::SAMPLE) {
                left -= 1;
                frame.data[4] ^= 0x10;
            }
            Some(frame)
        })
    };
    bench.to_host = damage(2);
    bench.ticks(500);
    assert_eq!(bench.rig.phase(), Phase::Running);
    bench.to_host = damage(3);
    let ms = ends_within(&mut bench, 1_000);
    assert!(ms <= 4, "{ms} ms");
    is_aborted_and_latched(&mut bench, "damaged frames");
}

#[test]
fn samples_that_arrive_late_abort_the_run() {
    let mut bench = running();
    // The link begins to hold frames back, and lets one through now and then, so that it is not silent.
    for delay_ms in 1..=60 {
        bench.delay_ms = delay_ms;
        bench.ticks(3);
    }
    bench.delay_ms = 0;
    is_aborted_and_latched(&mut bench, "late (limit 20 ms)");
}

/// What becomes of a sample on its way.
type ChangeSample = fn(&mut SampleMessage);

/// Samples of the rig as the host sees them, changed by `change`.
fn samples_read(change: ChangeSample) -> Wire {
    Box::new(move |frame| {
        let Ok(FromRig::Sample(mut sample)) = FromRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        change(&mut sample);
        Some(FromRig::Sample(sample).encode(NODE))
    })
}

#[test]
fn readings_beyond_the_limits_abort_where_the_rig_does_not() {
    let cases: [(ChangeSample, &str); 4] = [
        (|s| s.force_counts = 55_260, "force 5526.00 N"),
        (|s| s.force_counts = -16_340, "force -1634.00 N"),
        (|s| s.force_counts = -131_072, "load cell"),
        (|s| s.displacement_counts = -131_072, "LVDT"),
    ];
    for (change, words) in cases {
        let mut bench = running();
        bench.to_host = samples_read(change);
        let ms = ends_within(&mut bench, 1_000);
        assert!(ms <= 6, "{words}: {ms} ms");
        bench.to_host = Box::new(Some);
        is_aborted_and_latched(&mut bench, words);
    }
}

#[test]
fn a_link_that_reports_bus_off_or_an_overflow_is_answered() {
    let mut bench = running();
    bench.host.health.overflows.fetch_add(7, Ordering::Relaxed);
    bench.until(Phase::Held, 100);
    assert!(bench.rig.status().notice.contains("7 frames were lost"));
    assert_eq!(bench.rig.status().counters.receive_overflows, 7);
    bench.rig.resume().expect("is held");
    bench.until(Phase::Running, 500);
    bench.ticks(1_000);
    bench.host.health.bus_off.fetch_add(1, Ordering::Relaxed);
    let ms = ends_within(&mut bench, 100);
    assert!(ms <= 1, "{ms} ms");
    is_aborted_and_latched(&mut bench, "bus-off");
}

#[test]
fn damaged_packets_of_a_serial_line_abort_the_run() {
    let mut bench = running();
    let health = std::sync::Arc::clone(&bench.host.health);
    for _ in 0..100 {
        health.good_packets.fetch_add(11, Ordering::Relaxed);
        bench.ticks(10);
    }
    assert_eq!(bench.rig.phase(), Phase::Running);
    health.bad_packets.fetch_add(13, Ordering::Relaxed);
    ends_within(&mut bench, 10);
    is_aborted_and_latched(&mut bench, "serial packets");
}

#[test]
fn an_error_passive_controller_is_told_and_starts_no_run() {
    let mut bench = running();
    bench.host.health.error_passive.store(true, Ordering::Relaxed);
    bench.ticks(100);
    let status = bench.rig.status();
    assert!(
        status.phase == Phase::Running && status.notice.contains("error passive"),
        "{status:#?}"
    );
    bench.stop();
    bench.until(Phase::Ready, 30_000);
    assert_eq!(bench.rig.start(order(static_ramp())), Err(Refusal::ErrorPassive));
    bench.host.health.error_passive.store(false, Ordering::Relaxed);
    bench.tick();
    bench
        .rig
        .start(order(static_ramp()))
        .expect("the controller recovered");
}

#[test]
fn a_stop_while_arming_leaves_no_run() {
    // Stopped before Arm is sent, after it is sent, and while its answer is lost.
    for (ticks, lose_answers) in [(0, false), (1, false), (1, true), (5, true)] {
        let mut bench = VirtualRig::new();
        bench.until(Phase::Ready, 2_000);
        bench.ticks(600);
        if lose_answers {
            bench.to_rig = Box::new(|frame| (request(&frame) != Some(RequestCode::Arm)).then_some(frame));
        }
        bench.rig.start(order(static_ramp())).expect("ready");
        bench.ticks(ticks);
        bench.stop();
        assert_eq!(bench.rig.phase(), Phase::Unloading);
        bench.to_rig = Box::new(Some);
        bench.until(Phase::Ready, 2_000);
        bench.ticks(3_000);
        assert_eq!(bench.mock.state(), RigState::Off, "after {ticks} ms");
        assert!(bench.memory.samples.is_empty(), "no run began");
    }
}

#[test]
fn a_stop_is_taken_in_every_phase() {
    let mut bench = VirtualRig::new();
    bench.stop();
    bench.until(Phase::Ready, 3_000);
    bench.stop();
    assert_eq!(bench.rig.phase(), Phase::Ready);
    bench.start(sine(6.0, 1.0, 3));
    bench.ticks(6_000);
    bench.rig.hold().expect("running");
    bench.until(Phase::Held, 100);
    bench.stop();
    bench.stop();
    bench.until(Phase::Ready, 20_000);
    assert_eq!(outcome(&bench).ending, Ending::Stopped);
    bench.mock.injection.emergency_stop = true;
    bench.until(Phase::Interlocked, 100);
    bench.stop();
    assert_eq!(bench.rig.phase(), Phase::Interlocked);
}

#[test]
fn unloading_ends_when_the_link_comes_back() {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    bench.to_rig = Box::new(|_| None);
    bench.rig.start(order(static_ramp())).expect("ready");
    bench.ticks(10);
    bench.stop();
    bench.ticks(300);
    bench.to_rig = Box::new(Some);
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    bench.rig.tare().expect("nothing is under way");
}

#[test]
fn a_rig_that_ignores_the_unload_is_aborted() {
    let mut bench = running();
    bench.to_rig = Box::new(|frame| (request(&frame) != Some(RequestCode::Unload)).then_some(frame));
    bench.stop();
    bench.ticks(1_200);
    assert_eq!(bench.mock.state(), RigState::Unload, "by NMT stop");
}

#[test]
fn a_restart_of_the_rig_is_named_latched_and_on_the_time_axis() {
    let mut bench = running();
    bench.power_cycle();
    bench.until(Phase::Interlocked, 3_000);
    let end = outcome(&bench);
    assert_eq!(end.ending, Ending::Aborted);
    assert!(end.cause.contains("firmware restarted"), "{}", end.cause);
    let last = bench.memory.events.last().expect("events");
    assert!(last.kind == EventKind::End && last.time_s > 19.0, "{last:?}");
    assert!(
        bench.memory.events.iter().all(|e| e.time_s >= -0.2),
        "{:#?}",
        bench.memory.events
    );
    bench
        .rig
        .reset()
        .expect("a fault of the host is cleared by a reset");
    bench.until(Phase::Ready, 1_000);
}

#[test]
fn a_rig_that_comes_back_after_a_silence_is_latched() {
    let mut bench = running();
    bench.to_host = Box::new(|_| None);
    bench.ticks(1_000);
    assert!(
        outcome(&bench).cause.contains("no sample for 21 ms"),
        "{}",
        outcome(&bench).cause
    );
    let last = bench.memory.events.last().expect("events");
    assert!(last.kind == EventKind::End && last.time_s > 19.0, "{last:?}");
    bench.power_cycle();
    bench.to_host = Box::new(Some);
    bench.until(Phase::Interlocked, 3_000);
    assert!(
        bench.rig.status().fault.contains("no sample"),
        "{:#?}",
        bench.rig.status()
    );
}

#[test]
fn a_direct_trip_is_shown_within_a_second() {
    let mut bench = running();
    bench.mock.injection.emergency_stop = true;
    let ms = bench.until(Phase::Interlocked, 30_000);
    assert!(ms < 1_000, "{ms} ms");
    let end = outcome(&bench);
    assert!(
        end.ending == Ending::Aborted && end.cause.contains("emergency stop"),
        "{end:?}"
    );
}

#[test]
fn a_host_that_was_held_up_says_so() {
    let mut bench = running();
    bench.host_alive = false;
    bench.ticks(60);
    bench.host_alive = true;
    bench.until(Phase::Interlocked, 30_000);
    let end = outcome(&bench);
    assert!(end.cause.contains("control was delayed by 6"), "{}", end.cause);
    assert_eq!(end.lost, 0, "the frames waited");
    assert!(bench.now_ns > MS);
}

#[test]
fn a_silence_behind_a_pause_of_the_host_closes_the_run() {
    let mut bench = running();
    bench.host_alive = false;
    bench.to_host = Box::new(|_| None);
    bench.ticks(2_000);
    bench.host_alive = true;
    bench.tick();
    let end = outcome(&bench);
    // What waited before the cable was pulled is in the run.
    assert!(
        end.ending == Ending::Aborted && end.cause.contains("no sample"),
        "{end:?}"
    );
}

#[test]
fn an_emergency_does_not_confirm_an_abort() {
    let mut bench = running();
    let stops = Rc::new(Cell::new(0));
    let stop = Rc::clone(&stops);
    bench.to_rig = Box::new(move |frame| {
        stop.set(stop.get() + u32::from(nmt(&frame) == Some(NmtCommand::Stop)));
        Some(frame)
    });
    bench.to_host = without(cob::STATUS);
    ends_within(&mut bench, 1_000);
    bench.ticks(400);
    assert_eq!(bench.rig.status().counters.emergencies, 1);
    assert!(
        stops.get() >= 40,
        "{} stops in 400 ms without a status",
        stops.get()
    );
}

#[test]
fn a_run_begins_where_the_rig_stands_not_where_it_was() {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    // Somebody moved the piston by 3 mm just before the start.
    bench.to_host = samples_read(|s| s.displacement_counts += 6_000);
    bench.ticks(100);
    let first = Rc::new(Cell::new(None));
    let seen = Rc::clone(&first);
    bench.to_rig = Box::new(move |frame| {
        if let (Ok(ToRig::Command(command)), None) = (ToRig::decode(&frame, NODE), seen.get()) {
            seen.set(Some(command.counts));
        }
        Some(frame)
    });
    bench.rig.start(order(sine(6.0, 1.0, 3))).expect("ready");
    bench.until(Phase::Running, 1_000);
    bench.ticks(20);
    let counts = first.get().expect("a command was sent");
    assert!(
        (counts - 6_000).abs() < 20,
        "{counts} counts, the rig stands at 6000"
    );
}

#[test]
fn a_rig_that_is_loaded_without_a_run_is_unloaded() {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    let asked = Rc::new(Cell::new(false));
    let unload = Rc::clone(&asked);
    bench.to_rig = Box::new(move |frame| {
        unload.set(unload.get() || request(&frame) == Some(RequestCode::Unload));
        Some(frame)
    });
    bench.to_host = Box::new(|frame| {
        let Ok(FromRig::Status(mut status)) = FromRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        status.state = RigState::Hold;
        Some(FromRig::Status(status).encode(NODE))
    });
    bench.ticks(50);
    assert!(asked.get(), "{:#?}", bench.rig.status());
}

#[test]
fn a_tick_that_goes_back_aborts_the_run() {
    let mut bench = running();
    bench.to_host = samples_read(|s| s.tick = s.tick.wrapping_sub(5_000));
    let ms = ends_within(&mut bench, 1_000);
    assert!(ms <= 4, "{ms} ms");
    bench.to_host = Box::new(Some);
    is_aborted_and_latched(&mut bench, "damaged frames");
}

/// Number of NMT starts that the host sends in `ms`.
fn starts_in(bench: &mut VirtualRig, ms: u64) -> u32 {
    let starts = Rc::new(Cell::new(0));
    let start = Rc::clone(&starts);
    bench.to_rig = Box::new(move |frame| {
        start.set(start.get() + u32::from(nmt(&frame) == Some(NmtCommand::Start)));
        Some(frame)
    });
    bench.ticks(ms);
    starts.get()
}

#[test]
fn nmt_start_is_repeated_each_half_second_and_no_faster() {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.to_host = without(cob::SAMPLE);
    bench.ticks(1_000);
    let starts = starts_in(&mut bench, 2_000);
    assert_eq!(starts, 4, "in 2 s");
}
