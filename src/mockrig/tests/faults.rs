//! Faults of host, wire, sensors and hydraulics: the reaction of the firmware alone, and its time.

use super::*;

#[test]
fn lapsed_lease_unloads_by_itself() {
    let mut bench = default_bench();
    bench.hold_at(15.0);
    assert!(bench.rig.force_n() > 1000.0);
    // The last lease is sent at a multiple of ten ticks.
    while !bench.tick.is_multiple_of(10) {
        bench.step();
    }
    bench.step();
    bench.keeps_lease = false;
    let ticks = bench.until(RigState::Unload, 100);
    assert!((45..=55).contains(&ticks), "{ticks} ms");
    assert_eq!(
        (bench.cause, bench.emergencies()),
        (Cause::LeaseLapsed, vec![Cause::LeaseLapsed])
    );
    let ticks = bench.until(RigState::Tripped, 5000);
    // 15 mm at 5 mm/s take 3 s.
    assert!((2500..3600).contains(&ticks), "{ticks} ms");
    assert!(bench.rig.force_n() < 25.0, "{} N", bench.rig.force_n());
    // Neither time nor a reset moves the rig again.
    bench.keeps_lease = true;
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Busy);
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Done);
    let at = bench.rig.displacement_mm();
    bench.run(500);
    assert_eq!(bench.state, RigState::Off);
    assert!((bench.rig.displacement_mm() - at).abs() < 0.05);
}

#[test]
fn lease_of_a_stuck_control_loop_lapses() {
    let mut bench = default_bench();
    bench.keeps_lease = false;
    let (session, control_tick) = (bench.session, bench.tick as u16);
    for _ in 0..12 {
        let counter = bench.counter(0);
        bench.send(ToRig::Lease(LeaseMessage {
            counter,
            session,
            control_tick,
        }));
        bench.run(10);
    }
    assert_eq!(bench.cause, Cause::LeaseLapsed);
}

#[test]
fn force_limit_trips_within_two_milliseconds() {
    let config = MockRigConfig::default();
    let mut bench = TestRig::new(&config);
    bench.send(ToRig::ConfigWrite {
        index: object::LIMITS,
        sub: 1,
        value: 10_000,
    });
    bench.send(ToRig::Nmt {
        command: NmtCommand::Start,
        node: 0,
    });
    bench.run(1);
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    let crc = bench.rig.limits_crc();
    assert_eq!(bench.request(RequestCode::Arm, crc), RequestResult::Done);
    bench.run(400);
    bench.sine(8.0, 6.0, 1.0);
    bench.until(RigState::Unload, 2000);
    assert_eq!(bench.cause, Cause::ForceLimit);
    let over: Vec<u64> = bench
        .samples
        .iter()
        .filter(|s| s.1 > 1000.0)
        .map(|s| s.0)
        .collect();
    let trip = bench.tick;
    // Two samples in a row over the limit: the second one trips in the same tick.
    let in_row = over.windows(2).find(|w| w[1] == w[0] + 1).expect("it was over");
    assert!(trip - in_row[0] < 2, "over at {}, tripped at {trip}", in_row[0]);
    bench.until(RigState::Tripped, 5000);
}

#[test]
fn commands_of_a_foreign_session_trip() {
    let mut bench = default_bench();
    for i in 0..6 {
        assert_eq!(bench.state, RigState::Armed);
        let tick = bench.tick as u16 + 50;
        let message = ToRig::Command(CommandMessage {
            counter: i,
            session: 9,
            tick,
            mode: WireMode::Displacement,
            counts: 0,
            last: false,
        });
        bench.send(message);
        bench.step();
    }
    assert_eq!(bench.cause, Cause::ForeignSession);
}

#[test]
fn stale_commands_move_nothing() {
    let mut bench = default_bench();
    let at = bench.rig.displacement_mm();
    for back in [0u64, 1, 200, 5000] {
        let (counter, session, tick) = (
            bench.counter(1),
            bench.session,
            (bench.tick.wrapping_sub(back)) as u16,
        );
        bench.send(ToRig::Command(CommandMessage {
            counter,
            session,
            tick,
            mode: WireMode::Displacement,
            counts: 9000,
            last: false,
        }));
        bench.run(20);
        assert_eq!((bench.state, bench.queue_ms), (RigState::Armed, 0));
    }
    assert!((bench.rig.displacement_mm() - at).abs() < 0.02);
}

#[test]
fn commands_beyond_limits_or_in_another_mode_hold() {
    for (mode, counts) in [(WireMode::Displacement, 99_000), (WireMode::Force, 100)] {
        let mut bench = default_bench();
        bench.hold_at(2.0);
        bench.motion = None;
        let (counter, session, tick) = (bench.counter(1), bench.session, bench.tick as u16 + 150);
        bench.send(ToRig::Command(CommandMessage {
            counter,
            session,
            tick,
            mode,
            counts,
            last: false,
        }));
        bench.until(RigState::Hold, 2);
        assert_eq!(bench.cause, Cause::BadCommand);
    }
}

#[test]
fn three_corrupt_frames_unload_and_two_do_not() {
    let mut bench = default_bench();
    for i in 0..3 {
        assert_eq!(bench.state, RigState::Armed, "after {i}");
        let (counter, session) = (bench.counter(0), bench.session);
        let mut frame = ToRig::Lease(LeaseMessage {
            counter,
            session,
            control_tick: bench.tick as u16,
        })
        .encode(1);
        frame.data[2] ^= 0x10;
        bench.host.send(frame);
        bench.run(15);
    }
    assert_eq!(bench.cause, Cause::CorruptFrames);
}

/// What is injected, the cause and the next state that it must lead to, and the most ticks until then.
type InjectedFault = (&'static str, fn(&mut Injection), Cause, RigState, u64);

const FAULTS: [InjectedFault; 8] = [
    (
        "LVDT open",
        |i| i.displacement_open = true,
        Cause::DisplacementSensor,
        RigState::Tripped,
        2,
    ),
    (
        "load cell open",
        |i| i.force_open = true,
        Cause::ForceSensor,
        RigState::Unload,
        2,
    ),
    (
        "LVDT stuck",
        |i| i.displacement_frozen = true,
        Cause::SensorStuck,
        RigState::Tripped,
        50,
    ),
    (
        "break",
        |i| i.specimen_broken = true,
        Cause::SpecimenBreak,
        RigState::Tripped,
        10,
    ),
    (
        "supply",
        |i| i.supply_lost = true,
        Cause::SupplyPressure,
        RigState::Tripped,
        20,
    ),
    (
        "e-stop",
        |i| i.emergency_stop = true,
        Cause::EmergencyStop,
        RigState::Tripped,
        1,
    ),
    (
        "valve",
        |i| i.valve_stuck = true,
        Cause::FollowingError,
        RigState::Unload,
        250,
    ),
    (
        "cell gain",
        |i| i.force_gain_error = 10.0,
        Cause::ForceLimit,
        RigState::Unload,
        4,
    ),
];

#[test]
fn faults_of_sensors_valve_and_supply() {
    for (name, inject, cause, state, within) in FAULTS {
        let mut bench = default_bench();
        bench.sine(12.0, 6.0, 1.0);
        bench.run(3000);
        inject(&mut bench.rig.injection);
        bench.until(state, within);
        assert_eq!(bench.cause, cause, "{name}");
        assert!(bench.emergencies().contains(&cause), "{name}");
        bench.motion = None;
        bench.until(RigState::Tripped, 6000);
    }
}

#[test]
fn unload_without_load_cell_ends_at_the_retract_displacement() {
    let mut bench = default_bench();
    bench.hold_at(10.0);
    bench.rig.injection.force_open = true;
    bench.until(RigState::Tripped, 5000);
    assert!(
        (bench.rig.displacement_mm() + 5.0).abs() < 0.2,
        "{}",
        bench.rig.displacement_mm()
    );
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::CauseStands);
}

#[test]
fn hung_firmware_loses_pressure_and_reports_it_afterwards() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    bench.rig.injection.firmware_hangs = true;
    for _ in 0..20 {
        bench.rig.tick(&mut bench.rig_link);
    }
    bench.rig.injection.firmware_hangs = false;
    bench.until(RigState::Tripped, 1);
    assert_eq!(bench.cause, Cause::Watchdog);
}
