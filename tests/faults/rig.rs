//! Rows H: rig and specimen.

use super::{
    Measured, account_is_closed, is_aborted_and_latched, is_as_documented, measure, moving, rig_is_off,
    rig_unloads, run_ended, told,
};
use crate::control::Phase;
use crate::profile::{CycleSegment, Level, Profile, Segment, Wave};
use crate::protocol::message::{Cause, FromRig, RigState};
use crate::tests::support::virtual_rig::{NODE, VirtualRig, profile};
use crate::units::Mode;

#[test]
fn h1_a_stuck_valve_unloads() {
    is_as_documented("H1", h1());
}

pub(super) fn h1() -> Measured {
    let mut bench = VirtualRig::new();
    bench.start(without_correction());
    // At a peak: a valve that is stuck open would follow the sine for a while.
    bench.ticks(8_350);
    let measured = measure(&mut bench, |i| i.valve_stuck = true, run_ended, rig_unloads, 250);
    assert_eq!(bench.mock.cause(), Cause::FollowingError);
    is_aborted_and_latched(&mut bench, "following error");
    measured
}

#[test]
fn h2_a_force_beyond_its_limit_unloads() {
    is_as_documented("H2", h2());
}

pub(super) fn h2() -> Measured {
    let mut bench = moving();
    // The specimen becomes so stiff that the force crosses 4000 N at once; the filter of the load cell takes about 1 ms.
    let measured = measure(
        &mut bench,
        |i| i.specimen_stiffer = 5.0,
        run_ended,
        rig_unloads,
        4,
    );
    assert_eq!(bench.mock.cause(), Cause::ForceLimit);
    is_aborted_and_latched(&mut bench, "force limit");
    account_is_closed(&bench);
    measured
}

#[test]
fn h3_a_displacement_beyond_its_limit_switches_off() {
    is_as_documented("H3", h3());
}

pub(super) fn h3() -> Measured {
    let mut bench = moving();
    bench.rig.hold().expect("running");
    bench.until(Phase::Held, 100);
    bench.ticks(200);
    let measured = measure(
        &mut bench,
        |i| i.displacement_gain_error = 2.7,
        run_ended,
        rig_is_off,
        4,
    );
    assert_eq!(bench.mock.cause(), Cause::DisplacementLimit);
    is_aborted_and_latched(&mut bench, "displacement limit");
    measured
}

#[test]
fn h4_a_broken_specimen_switches_off() {
    is_as_documented("H4", h4());
}

pub(super) fn h4() -> Measured {
    let mut bench = moving();
    let measured = measure(
        &mut bench,
        |i| i.specimen_broken = true,
        run_ended,
        rig_is_off,
        10,
    );
    assert_eq!(bench.mock.cause(), Cause::SpecimenBreak);
    is_aborted_and_latched(&mut bench, "specimen break");
    account_is_closed(&bench);
    measured
}

/// Three seconds to 18 mm, then cycles whose amplitude nobody corrects.
fn without_correction() -> Profile {
    profile(
        Mode::Displacement,
        vec![
            Segment::Ramp {
                to: Level::Absolute(18.0),
                duration_s: 3.0,
            },
            Segment::Cycles(CycleSegment {
                wave: Wave::Sine,
                mean: Level::Absolute(18.0),
                amplitude: 6.0,
                frequency_hz: 1.0,
                cycles: 8,
                taper_cycles: 2,
                correct: false,
            }),
        ],
    )
}

#[test]
fn h5_an_amplitude_that_is_not_reached_marks_its_cycles_and_holds() {
    is_as_documented("H5", h5());
}

pub(super) fn h5() -> Measured {
    let mut bench = VirtualRig::new();
    bench.start(without_correction());
    // The host reads an amplitude that is 10 % too small.
    bench.to_host = Box::new(|frame| {
        let Ok(FromRig::Sample(mut sample)) = FromRig::decode(&frame, NODE) else {
            return Some(frame);
        };
        sample.displacement_counts -= (sample.displacement_counts - 36_000) / 10;
        Some(FromRig::Sample(sample).encode(NODE))
    });
    let held = |b: &VirtualRig| b.mock.state() == RigState::Hold;
    let measured = measure(
        &mut bench,
        |_| {},
        |b| told(b, "the cycle is not valid") > 0,
        held,
        10_000,
    );
    bench.ticks(20);
    assert_eq!(
        told(&bench, "the amplitude of cycle 1 is"),
        1,
        "{:#?}",
        bench.memory.events
    );
    assert_eq!(told(&bench, "the amplitude of cycle 2 is"), 1);
    assert_eq!(told(&bench, "the amplitude of cycle 3 is"), 0);
    // From the start of the run: two cycles after the ramp and the taper.
    measured
}

#[test]
fn h6_a_lost_supply_switches_off() {
    is_as_documented("H6", h6());
}

pub(super) fn h6() -> Measured {
    let mut bench = moving();
    let measured = measure(&mut bench, |i| i.supply_lost = true, run_ended, rig_is_off, 20);
    assert_eq!(bench.mock.cause(), Cause::SupplyPressure);
    is_aborted_and_latched(&mut bench, "supply pressure");
    measured
}

#[test]
fn h7_the_emergency_stop_switches_off() {
    is_as_documented("H7", h7());
}

pub(super) fn h7() -> Measured {
    let mut bench = moving();
    let measured = measure(&mut bench, |i| i.emergency_stop = true, run_ended, rig_is_off, 2);
    assert_eq!(bench.mock.cause(), Cause::EmergencyStop);
    bench.ticks(100);
    assert_eq!(bench.mock.state(), RigState::Tripped);
    is_aborted_and_latched(&mut bench, "emergency stop");
    measured
}

#[test]
fn h8_creep_during_a_hold_unloads() {
    is_as_documented("H8", h8());
}

pub(super) fn h8() -> Measured {
    let mut bench = moving();
    bench.rig.hold().expect("running");
    bench.until(Phase::Held, 100);
    bench.ticks(3_000);
    assert_eq!(bench.mock.state(), RigState::Hold, "a sound rig holds");
    let measured = measure(&mut bench, |i| i.leak_mm_s = 30.0, rig_unloads, rig_unloads, 200);
    assert_eq!(bench.mock.cause(), Cause::FollowingError);
    is_aborted_and_latched(&mut bench, "following error");
    measured
}
