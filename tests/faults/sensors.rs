//! Rows X: load cell and LVDT.

use super::{
    Inject, Measured, account_is_closed, is_aborted_and_latched, is_as_documented, measure, moving, outcome,
    rig_is_off, rig_unloads, run_ended, told,
};
use crate::control::Phase;
use crate::mockrig::Injection;
use crate::protocol::message::{Cause, RigState};
use crate::recording::{Ending, Flags};
use crate::tests::support::virtual_rig::{VirtualRig, sine, static_ramp};

fn flagged(bench: &VirtualRig, flag: Flags) -> usize {
    bench
        .memory
        .samples
        .iter()
        .filter(|s| s.flags.contains(flag))
        .count()
}

#[test]
fn x1_a_load_cell_without_reading_unloads() {
    is_as_documented("X1", x1());
}

pub(super) fn x1() -> Measured {
    let mut bench = moving();
    let measured = measure(&mut bench, |i| i.force_open = true, run_ended, rig_unloads, 2);
    assert_eq!(bench.mock.cause(), Cause::ForceSensor);
    bench.ticks(50);
    assert!(flagged(&bench, Flags::FORCE_INVALID) >= 50, "kept and flagged");
    is_aborted_and_latched(&mut bench, "force sensor");
    account_is_closed(&bench);
    measured
}

#[test]
fn x2_an_lvdt_without_reading_switches_off() {
    is_as_documented("X2", x2());
}

pub(super) fn x2() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.displacement_open = true,
        run_ended,
        rig_is_off,
        2,
    );
    assert_eq!(bench.mock.cause(), Cause::DisplacementSensor);
    bench.ticks(50);
    assert!(
        flagged(&bench, Flags::DISPLACEMENT_INVALID) >= 50,
        "kept and flagged"
    );
    is_aborted_and_latched(&mut bench, "displacement sensor");
    measured
}

#[test]
fn x3_an_lvdt_that_stands_still_switches_off() {
    is_as_documented("X3", x3());
}

pub(super) fn x3() -> Measured {
    let mut bench = VirtualRig::new();
    bench.start(sine(6.0, 1.0, 10));
    // In the middle of a stroke of the full amplitude.
    bench.ticks(8_000);
    let measured = measure(
        &mut bench,
        |i| i.displacement_frozen = true,
        run_ended,
        rig_is_off,
        50,
    );
    assert_eq!(bench.mock.cause(), Cause::SensorStuck);
    is_aborted_and_latched(&mut bench, "sensor stuck");
    measured
}

#[test]
fn x3_a_load_cell_that_stands_still_aborts() {
    is_as_documented("X3 daemon", x3_daemon());
}

pub(super) fn x3_daemon() -> Measured {
    let mut bench = moving();
    let measured = measure(&mut bench, |i| i.force_frozen = true, run_ended, rig_unloads, 200);
    is_aborted_and_latched(&mut bench, "the load cell has read");
    assert!(flagged(&bench, Flags::STUCK) > 0, "flagged");
    measured
}

/// A load that is held keeps both readings, and a piston that moves without contact keeps the force at zero.
#[test]
fn x3_a_hold_and_a_free_stroke_are_not_stuck() {
    let mut bench = moving();
    bench.rig.hold().expect("running");
    bench.until(Phase::Held, 100);
    bench.ticks(5_000);
    assert_eq!(flagged(&bench, Flags::STUCK), 0);
    bench.rig.resume().expect("held");
    bench.until(Phase::Ready, 60_000);
    assert_eq!(
        outcome(&bench).ending,
        Ending::Completed,
        "{}",
        outcome(&bench).cause
    );
    assert_eq!(flagged(&bench, Flags::STUCK), 0);
}

#[test]
fn x4_spikes_are_flagged_and_three_abort() {
    is_as_documented("X4", x4());
}

pub(super) fn x4() -> Measured {
    for inject in [
        (|i: &mut Injection| i.force_spike_n = 900.0) as fn(&mut Injection),
        |i| i.displacement_spike_mm = 3.0,
    ] {
        let mut bench = moving();
        inject(&mut bench.mock.injection);
        bench.tick();
        bench.mock.injection = Injection::default();
        bench.ticks(200);
        assert_eq!(
            bench.rig.phase(),
            Phase::Running,
            "one spike is no reason: {:#?}",
            bench.rig.status()
        );
        assert_eq!(flagged(&bench, Flags::SPIKE), 1, "kept and flagged");
    }
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.force_spike_n = 900.0,
        run_ended,
        rig_unloads,
        100,
    );
    is_aborted_and_latched(&mut bench, "spikes within 100 ms, the last one of the load cell");
    assert_eq!(flagged(&bench, Flags::SPIKE), 3);
    measured
}

/// The first spike of a cycle would be its peak, and the next cycles would be too small.
#[test]
fn x4_a_spike_does_not_change_the_amplitude() {
    let peaks = |spike_n: f64| {
        let mut bench = VirtualRig::new();
        bench.start(sine(6.0, 1.0, 4));
        bench.ticks(7_700);
        bench.mock.injection.displacement_spike_mm = spike_n;
        bench.tick();
        bench.mock.injection = Injection::default();
        bench.until(Phase::Ready, 60_000);
        let peak = |m: f64, s: &crate::recording::Sample| m.max(s.command.map_or(0.0, |c| c.value()));
        bench.memory.samples.iter().fold(0.0, peak)
    };
    assert!((peaks(4.0) - peaks(0.0)).abs() < 0.01);
}

#[test]
fn x5_a_force_at_zero_displacement_is_told_with_its_channel() {
    is_as_documented("X5", x5());
}

pub(super) fn x5() -> Measured {
    let mut sound = VirtualRig::new();
    sound.start(sine(2.0, 1.0, 1));
    assert_eq!(told(&sound, "at zero displacement"), 0);
    let mut bench = VirtualRig::new();
    bench.mock.injection.force_offset_n = 60.0;
    bench.start(sine(2.0, 1.0, 1));
    assert_eq!(
        told(&bench, "the load cell reads"),
        1,
        "{:#?}",
        bench.memory.events
    );
    assert!(bench.rig.status().notice.contains("at zero displacement"));
    Measured {
        detected_ms: 0,
        reacted_ms: 0,
        lost: 0,
        allowed_ms: 0,
    }
}

#[test]
fn x6_an_inverted_sensor_ends_the_run_within_its_first_millimetre() {
    is_as_documented("X6", x6());
}

pub(super) fn x6() -> Measured {
    let cases: [(Inject, bool, &str); 4] = [
        (|i| i.force_inverted = true, false, "opposite directions"),
        (
            |i| i.displacement_inverted = true,
            false,
            "the LVDT moves against the command",
        ),
        (
            |i| i.force_inverted = true,
            true,
            "the load cell moves against the command",
        ),
        (|i| i.displacement_inverted = true, true, "opposite directions"),
    ];
    let mut longest_ms = 0;
    for (inject, in_force, words) in cases {
        let mut bench = VirtualRig::new();
        inject(&mut bench.mock.injection);
        bench.start(if in_force {
            static_ramp()
        } else {
            sine(6.0, 1.0, 3)
        });
        let (mut furthest_mm, mut ms) = (0.0f64, 0);
        while bench.rig.phase() == Phase::Running && ms < 3_000 {
            bench.tick();
            furthest_mm = furthest_mm.max(bench.mock.displacement_mm().abs());
            ms += 1;
        }
        assert!(furthest_mm < 1.0, "{words}: {furthest_mm} mm after {ms} ms");
        longest_ms = longest_ms.max(ms);
        bench.ticks(3);
        assert_ne!(bench.mock.state(), RigState::Running);
        bench.until(Phase::Interlocked, 30_000);
        assert!(
            outcome(&bench).cause.contains(words),
            "{words}: {}",
            outcome(&bench).cause
        );
        assert!(
            bench.mock.displacement_mm().abs() < 4.0,
            "{words}: {} mm",
            bench.mock.displacement_mm()
        );
    }
    Measured {
        detected_ms: longest_ms,
        reacted_ms: longest_ms + 1,
        lost: 0,
        allowed_ms: 2_000,
    }
}

#[test]
fn x7_noise_is_told_and_marks_the_run() {
    is_as_documented("X7", x7());
}

pub(super) fn x7() -> Measured {
    let mut bench = moving();
    let noisy = |b: &VirtualRig| told(b, "the noise of the load cell") > 0;
    let measured = measure(&mut bench, |i| i.force_noise = 99.0, noisy, noisy, 2_000);
    assert!(
        bench
            .rig
            .status()
            .notice
            .contains("five times the noise in its calibration")
    );
    bench.until(Phase::Ready, 60_000);
    assert_eq!(outcome(&bench).ending, Ending::Completed, "the run goes on");
    assert_eq!(told(&bench, "the noise of the load cell"), 1, "once in a run");
    measured
}
