//! Return to zero and jog against the mock rig in virtual time.

use super::support::virtual_rig::{VirtualRig, order, sine, static_ramp};
use crate::control::{Phase, Refusal, SlowMotion, ZeroRemedy};
use crate::protocol::message::RigState;

/// A bench that is ready and has been still for half a second.
fn ready() -> VirtualRig {
    let mut bench = VirtualRig::new();
    bench.until(Phase::Ready, 2_000);
    bench.ticks(600);
    bench
}

/// A bench that stands where a stopped run was unloaded.
fn after_a_stop() -> VirtualRig {
    let mut bench = ready();
    bench.start(sine(10.0, 1.0, 50));
    bench.ticks(9_300);
    bench.stop();
    bench.until(Phase::Ready, 10_000);
    bench.ticks(600);
    bench
}

fn displacement_mm(bench: &VirtualRig) -> f64 {
    bench.rig.status().displacement_mm.expect("a reading")
}

/// Largest speed over 50 ms until the bench is in `phase`, mm/s.
fn fastest_until(bench: &mut VirtualRig, phase: Phase) -> f64 {
    let mut seen = vec![displacement_mm(bench)];
    while bench.rig.phase() != phase {
        bench.tick();
        seen.push(displacement_mm(bench));
        assert!(seen.len() < 60_000, "{:#?}", bench.rig.status());
    }
    seen.windows(51)
        .map(|w| (w[50] - w[0]).abs() / 0.050)
        .fold(0.0, f64::max)
}

#[test]
fn after_a_stop_the_bench_says_where_it_stands_and_zero_brings_it_back() {
    let mut bench = after_a_stop();
    let away = bench.rig.status();
    let at_mm = away.displacement_mm.expect("a reading");
    assert!(
        at_mm > 0.15,
        "an unload of this spring ends above zero: {at_mm} mm"
    );
    assert!(away.off_zero.contains("return to zero"), "{}", away.off_zero);
    assert_eq!(away.zero_remedy, Some(ZeroRemedy::ReturnToZero));
    let samples = bench.memory.samples.len();
    bench.rig.zero().expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    assert_eq!(bench.rig.status().motion, Some(SlowMotion::Zero));
    assert_eq!(bench.rig.status().run_id, None);
    let fastest = fastest_until(&mut bench, Phase::Ready);
    // 2 mm/s of the return, 5 mm/s of the unload at its end, which lasts some milliseconds.
    assert!(fastest < 3.0, "{fastest} mm/s");
    let back = bench.rig.status();
    assert_eq!((back.off_zero.as_str(), back.zero_remedy), ("", None));
    assert!(displacement_mm(&bench).abs() < 0.15, "{back:?}");
    assert_eq!(bench.memory.samples.len(), samples, "nothing is recorded");
    assert_eq!(back.motion, None);
    bench.rig.start(order(static_ramp())).expect("a run may start");
    bench.until(Phase::Running, 1_000);
}

#[test]
fn after_a_trip_zero_is_refused_until_the_reset_and_then_possible() {
    let mut bench = ready();
    bench.start(static_ramp());
    bench.ticks(20_000);
    bench.host_alive = false;
    bench.ticks(10_000);
    bench.host_alive = true;
    bench.until(Phase::Interlocked, 3_000);
    bench.ticks(600);
    assert!(
        bench.rig.status().off_zero.contains("reset, then return to zero"),
        "{:?}",
        bench.rig.status().off_zero
    );
    assert!(matches!(bench.rig.zero(), Err(Refusal::Interlocked(_))));
    assert!(matches!(bench.rig.jog(0.1), Err(Refusal::Interlocked(_))));
    bench.rig.reset().expect("the cause is gone");
    bench.until(Phase::Ready, 1_000);
    bench.rig.zero().expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    bench.until(Phase::Ready, 20_000);
    assert_eq!(bench.rig.status().off_zero, "");
}

#[test]
fn zero_and_jog_are_refused_with_the_reason_before_the_hello_and_during_a_run() {
    let mut bench = VirtualRig::new();
    assert!(matches!(bench.rig.zero(), Err(Refusal::NotConnected(_))));
    assert!(matches!(bench.rig.jog(0.1), Err(Refusal::NotConnected(_))));
    bench.start(static_ramp());
    for refused in [bench.rig.zero(), bench.rig.jog(0.1)] {
        let why = refused.expect_err("a run is under way").to_string();
        assert!(why.contains("run test is under way"), "{why}");
    }
    bench.ticks(1_000);
    bench.stop();
    bench.tick();
    assert!(matches!(bench.rig.zero(), Err(Refusal::Busy(_))));
}

#[test]
fn a_force_limit_ends_a_return_to_zero_as_it_ends_a_run() {
    let mut bench = after_a_stop();
    bench.rig.jog(2.0).expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    bench.ticks(200);
    // The load cell reads a hundred times as much: the limit is passed within the step.
    bench.mock.injection.force_gain_error = 99.0;
    bench.until(Phase::Interlocked, 20_000);
    assert!(matches!(bench.rig.zero(), Err(Refusal::Interlocked(_))));
}

#[test]
fn a_jog_moves_its_step_slowly_keeps_it_for_ten_seconds_and_unloads() {
    let mut bench = ready();
    let from_mm = displacement_mm(&bench);
    bench.rig.jog(1.0).expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    let mut seen = Vec::new();
    for _ in 0..3_000 {
        bench.tick();
        seen.push(displacement_mm(&bench));
    }
    let fastest = seen
        .windows(101)
        .map(|w| (w[100] - w[0]).abs() / 0.1)
        .fold(0.0, f64::max);
    assert!(fastest < 0.6, "{fastest} mm/s");
    let moved_mm = displacement_mm(&bench) - from_mm;
    assert!((moved_mm - 1.0).abs() < 0.05, "{moved_mm} mm");
    let left_s = bench.rig.status().hold_left_s.expect("it keeps its position");
    assert!((8.5..10.0).contains(&left_s), "{left_s} s");
    bench.ticks(5_000);
    assert!((displacement_mm(&bench) - from_mm - 1.0).abs() < 0.05);
    bench.until(Phase::Ready, 10_000);
    assert_eq!(bench.mock.state(), RigState::Off);
    assert!(bench.memory.samples.is_empty(), "nothing is recorded");
}

#[test]
fn steps_in_a_row_are_one_motion_that_ends_where_they_end() {
    let mut bench = ready();
    let from_mm = displacement_mm(&bench);
    // As the page sends them while a button is held: 0.1 mm every 100 ms.
    bench.rig.jog(0.1).expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    for _ in 0..30 {
        bench.ticks(100);
        bench.rig.jog(0.1).expect("a jog is under way");
    }
    let last_mm = displacement_mm(&bench);
    // 0.5 mm/s for 3 s; the commands are 0.1 s ahead of the rig.
    assert!((last_mm - from_mm - 1.45).abs() < 0.1, "{last_mm} mm");
    // The connection drops: the motion ends by itself, at the end of the last step.
    bench.ticks(2_000);
    let rest_mm = displacement_mm(&bench);
    assert!(rest_mm - last_mm < 0.16, "{last_mm} mm to {rest_mm} mm");
    bench.ticks(1_000);
    assert!((displacement_mm(&bench) - rest_mm).abs() < 0.01);
}

#[test]
fn a_step_of_zero_ends_a_jog_and_moves_nothing_that_has_not_begun() {
    let mut bench = ready();
    bench.rig.jog(0.0).expect("nothing is to be ended");
    assert_eq!(bench.rig.phase(), Phase::Ready);
    bench.rig.jog(2.0).expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    bench.ticks(1_000);
    let released_mm = displacement_mm(&bench);
    bench.rig.jog(0.0).expect("a jog is under way");
    bench.ticks(1_000);
    let rest_mm = displacement_mm(&bench);
    // What was sent ahead: 100 ms at 0.5 mm/s, and the servo's lag.
    assert!(rest_mm - released_mm < 0.08, "{released_mm} mm to {rest_mm} mm");
    bench.stop();
    bench.until(Phase::Ready, 10_000);
    bench.ticks(600);
    let before_mm = displacement_mm(&bench);
    bench.rig.jog(-2.0).expect("the bench is ready");
    assert_eq!(bench.rig.phase(), Phase::Arming);
    bench.rig.jog(0.0).expect("the jog is waiting");
    bench.until(Phase::Ready, 10_000);
    assert!((displacement_mm(&bench) - before_mm).abs() < 0.15);
}

#[test]
fn a_button_that_is_still_held_after_a_stop_moves_nothing() {
    let mut bench = ready();
    assert!(matches!(bench.rig.jog_on(0.1), Err(Refusal::NoJog)));
    bench.rig.jog(-0.1).expect("the bench is ready");
    bench.rig.jog_on(-0.1).expect("it is being armed");
    bench.until(Phase::Running, 1_000);
    bench.ticks(50);
    bench.rig.jog_on(-0.1).expect("it is under way");
    bench.stop();
    bench.until(Phase::Ready, 5_000);
    let rest_mm = displacement_mm(&bench);
    assert!(matches!(bench.rig.jog_on(-0.1), Err(Refusal::NoJog)));
    bench.ticks(1_000);
    assert!((displacement_mm(&bench) - rest_mm).abs() < 0.01);
    assert_eq!(bench.mock.state(), RigState::Off);
}

#[test]
fn a_jog_that_is_too_long_or_leaves_the_travel_is_refused() {
    let mut bench = ready();
    for step_mm in [2.01, -3.0, f64::NAN, f64::INFINITY] {
        assert!(
            matches!(bench.rig.jog(step_mm), Err(Refusal::JogTooLong { .. })),
            "{step_mm}"
        );
    }
    // The limits of the bench are -5 mm and 45 mm.
    let mut refused = None;
    for _ in 0..4 {
        if let Err(error) = bench.rig.jog(-1.9) {
            refused = Some(error);
            break;
        }
        bench.until(Phase::Running, 1_000);
        bench.ticks(4_200);
    }
    assert!(
        matches!(refused, Some(Refusal::JogBeyondTravel { .. })),
        "{refused:?} at {} mm",
        displacement_mm(&bench)
    );
}

#[test]
fn a_host_that_dies_in_a_jog_leaves_a_rig_that_unloads() {
    let mut bench = ready();
    bench.rig.jog(2.0).expect("the bench is ready");
    bench.until(Phase::Running, 1_000);
    bench.ticks(2_000);
    bench.host_alive = false;
    bench.ticks(60);
    assert_eq!(bench.mock.state(), RigState::Unload);
}

#[test]
fn a_hold_counts_down_to_its_end() {
    let mut bench = ready();
    bench.start(static_ramp());
    bench.ticks(2_000);
    assert_eq!(bench.rig.status().hold_left_s, None);
    bench.rig.hold().expect("a run is under way");
    bench.until(Phase::Held, 1_000);
    bench.ticks(10_000);
    let left_s = bench.rig.status().hold_left_s.expect("it holds");
    assert!((left_s - 20.0).abs() < 0.1, "{left_s} s of 30 s are left");
    bench.ticks(19_500);
    assert_eq!(bench.rig.phase(), Phase::Held);
    bench.ticks(1_000);
    assert_ne!(
        bench.rig.phase(),
        Phase::Held,
        "it lapsed when the seconds were over"
    );
}

#[test]
fn a_rig_that_is_not_heard_has_no_reading() {
    let mut bench = ready();
    bench.start(static_ramp());
    bench.ticks(5_000);
    assert!(bench.rig.status().force_n.is_some());
    bench.rig_alive = false;
    bench.until(Phase::Connecting, 2_000);
    let status = bench.rig.status();
    assert_eq!((status.force_n, status.displacement_mm), (None, None));
}

#[test]
fn a_sensor_without_reading_has_no_value_and_its_samples_are_counted() {
    let mut bench = ready();
    bench.mock.injection.force_open = true;
    bench.ticks(200);
    let status = bench.rig.status();
    assert_eq!(status.force_n, None);
    assert!(status.displacement_mm.is_some());
    assert!(
        (190..=200).contains(&status.counters.flagged),
        "{}",
        status.counters.flagged
    );
}
