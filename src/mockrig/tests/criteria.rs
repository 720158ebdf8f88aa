//! The numbers of the table "Criteria" in `firmware-protocol.md`: the detectors trip in the sample that it says, and one
//! count or one sample less does not trip them.

use super::*;
use crate::mockrig::guard::{Following, SafetyGuard};
use crate::protocol::message::{COUNTS_INVALID, Limits};

/// Samples before the fault; the LVDT changes in each, as a real one does.
const QUIET: u64 = 40;

const READING: SensorReading = SensorReading {
    force_counts: -4_000,
    displacement_counts: 0,
    supply_ratio: 1.0,
    emergency_stop: false,
};
const FOLLOWING: Following = Following {
    mode: WireMode::Displacement,
    error_counts: 0.0,
    rate_counts_s: 0.0,
    speed_mm_s: 0.0,
    pressure_ticks: 1_000,
    holds: false,
};

/// The sample, counted from 1, in which the first fault is found, and its cause. `at` gives the inputs of sample n.
fn first_fault(at: impl Fn(u64, &mut SensorReading, &mut Following)) -> Option<(u64, Cause)> {
    let mut guard = SafetyGuard::default();
    let limits = Limits::defaults();
    (0..QUIET + 100).find_map(|i| {
        let (mut reading, mut following) = (READING, FOLLOWING);
        reading.displacement_counts = (i % 2) as i32;
        if let Some(n) = (i + 1).checked_sub(QUIET).filter(|&n| n > 0) {
            at(n, &mut reading, &mut following);
        }
        guard.observe(&reading);
        let fault = guard.check(&reading, &limits, &following);
        fault.map(|(cause, _)| ((i + 1).saturating_sub(QUIET), cause))
    })
}

#[test]
fn levels_and_missing_readings_trip_in_two_samples() {
    assert_eq!(first_fault(|_, _, _| {}), None);
    for (counts, fault) in [
        (100_000, None),
        (100_001, Some(2)),
        (-5_000, None),
        (-5_001, Some(2)),
    ] {
        let found = first_fault(|_, reading, _| reading.force_counts = counts);
        assert_eq!(found, fault.map(|n| (n, Cause::ForceLimit)), "{counts}");
    }
    let spike = first_fault(|n, reading, _| reading.force_counts += i32::from(n == 5) * 120_000);
    assert_eq!(spike, None);
    let open = first_fault(|_, reading, _| reading.force_counts = COUNTS_INVALID);
    assert_eq!(open, Some((2, Cause::ForceSensor)));
    let open = first_fault(|_, reading, _| reading.displacement_counts = COUNTS_INVALID);
    assert_eq!(open, Some((2, Cause::DisplacementSensor)));
    let stop = first_fault(|_, reading, _| reading.emergency_stop = true);
    assert_eq!(stop, Some((1, Cause::EmergencyStop)));
}

#[test]
fn the_travel_limit_trips_in_two_samples_and_before_the_speed() {
    for (counts, fault) in [(98_000, None), (98_001, Some(2)), (-98_001, Some(2))] {
        let found = first_fault(|_, reading, _| reading.displacement_counts = counts);
        assert_eq!(found, fault.map(|n| (n, Cause::DisplacementLimit)), "{counts}");
    }
}

#[test]
fn the_speed_trips_in_three_samples_of_one_direction() {
    for (step, fault) in [(600, None), (601, Some((3, Cause::VelocityLimit)))] {
        // The first step starts from a reading of 1.
        let found = first_fault(|n, reading, _| {
            reading.displacement_counts = 1 + n.min(20) as i32 * step;
        });
        assert_eq!(found, fault, "{step} counts per ms");
    }
    let to_and_fro = first_fault(|n, reading, _| reading.displacement_counts = (n % 2) as i32 * 5_000);
    assert_eq!(to_and_fro, None);
}

#[test]
fn the_following_error_trips_in_twenty_samples() {
    let fault = Some((20, Cause::FollowingError));
    for (mode, error, rate, expected) in [
        (WireMode::Displacement, 2_000.0, 0.0, None),
        (WireMode::Displacement, -2_001.0, 0.0, fault),
        (WireMode::Force, 5_000.0, 0.0, None),
        (WireMode::Force, 5_001.0, 0.0, fault),
        // 20 ms of 100 000 counts per second are 2000 counts more.
        (WireMode::Displacement, 4_000.0, -100_000.0, None),
        (WireMode::Displacement, 4_001.0, 100_000.0, fault),
    ] {
        let found = first_fault(|_, _, following| {
            (following.mode, following.error_counts, following.rate_counts_s) = (mode, error, rate);
        });
        assert_eq!(found, expected, "{mode:?} {error} at {rate}");
    }
    let interrupted = first_fault(|n, _, following| following.error_counts = 9_000.0 * f64::from(n % 20 > 0));
    assert_eq!(interrupted, None);
}

#[test]
fn a_stuck_lvdt_trips_in_twenty_equal_samples_and_half_a_millimetre() {
    let stuck_at = |speed_mm_s: f64| {
        first_fault(move |_, reading, following| {
            // The last quiet reading is 1, so all of these equal the one before.
            reading.displacement_counts = 1;
            following.speed_mm_s = speed_mm_s;
        })
    };
    // 20 samples of 26 mm/s are 0.52 mm; of 24 mm/s, 21 samples are needed.
    assert_eq!(stuck_at(26.0), Some((20, Cause::SensorStuck)));
    assert_eq!(stuck_at(-24.0), Some((21, Cause::SensorStuck)));
    assert_eq!(stuck_at(4.0), None);
    let wobble = first_fault(|n, reading, following| {
        reading.displacement_counts = i32::from(n % 20 == 0);
        following.speed_mm_s = 100.0;
    });
    assert_eq!(wobble, None);
}

#[test]
fn the_supply_trips_in_five_samples_after_its_grace() {
    for (ratio, pressure_ticks, fault) in [
        (0.8, 1_000, None),
        (0.79, 1_000, Some((5, Cause::SupplyPressure))),
        (0.0, 300, None),
    ] {
        let found = first_fault(|_, reading, following| {
            reading.supply_ratio = ratio;
            following.pressure_ticks = pressure_ticks;
        });
        assert_eq!(found, fault, "{ratio} at {pressure_ticks}");
    }
}

#[test]
fn a_break_is_a_fall_by_half_by_200_n_and_by_more_than_the_retreat_explains() {
    // Counts of 0.1 N before and after, retreat in counts of 0.0005 mm over 10 ms.
    for (before, after, retreat, trips) in [
        (10_000, 4_999, 0, true),
        (10_000, 5_000, 0, false),
        (3_000, 999, 0, true),
        (3_000, 1_001, 0, false),
        // 11 samples are 0.66 mm, which explain 660 N, and 0.44 mm.
        (10_000, 4_900, 1_200, false),
        (10_000, 4_900, 800, true),
    ] {
        let found = first_fault(|n, reading, _| {
            // A steady retreat, slower than the limit of the speed, and a fall in sample 21.
            reading.force_counts = if n > 20 { after } else { before };
            reading.displacement_counts -= retreat / 10 * n as i32;
        });
        let expected = trips.then_some((22, Cause::SpecimenBreak));
        assert_eq!(found, expected, "{before} -> {after}, {retreat} in 10 ms");
    }
}
