//! Boot, session, configuration, requests, hold and the end of a motion.

use super::*;

#[test]
fn boots_into_off_and_sends_samples_after_nmt_start() {
    let mut bench = TestRig::new(&MockRigConfig::default());
    bench.run(250);
    let beats: Vec<_> = bench.received.clone();
    assert_eq!(
        beats,
        [
            NmtState::BootUp,
            NmtState::PreOperational,
            NmtState::PreOperational
        ]
        .map(|state| FromRig::Heartbeat { state })
    );
    assert!(bench.samples.is_empty());
    bench.send(ToRig::Nmt {
        command: NmtCommand::Start,
        node: 1,
    });
    bench.run(100);
    assert_eq!(bench.samples.len(), 100);
    assert_eq!(bench.state, RigState::Off);
}

#[test]
fn arm_needs_a_session_and_the_right_configuration() {
    let mut bench = TestRig::new(&MockRigConfig::default());
    bench.send(ToRig::Nmt {
        command: NmtCommand::Start,
        node: 0,
    });
    let crc = bench.rig.limits_crc();
    assert_eq!(bench.request(RequestCode::Arm, crc), RequestResult::Busy);
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    assert_eq!(
        bench.request(RequestCode::Arm, crc ^ 1),
        RequestResult::WrongConfiguration
    );
    assert_eq!(bench.request(RequestCode::Resume, 0), RequestResult::WrongState);
    assert_eq!(bench.state, RigState::Off);
    bench.rig.injection.displacement_open = true;
    bench.run(5);
    assert_eq!(bench.request(RequestCode::Arm, crc), RequestResult::CauseStands);
}

#[test]
fn configuration_is_read_checked_and_guarded() {
    let mut bench = TestRig::new(&MockRigConfig::default());
    let (limits, sub) = (object::LIMITS, 1);
    bench.send(ToRig::ConfigWrite {
        index: limits,
        sub,
        value: 24_000,
    });
    bench.send(ToRig::ConfigRead { index: limits, sub });
    bench.send(ToRig::ConfigWrite {
        index: limits,
        sub: 8,
        value: 5,
    });
    bench.send(ToRig::ConfigWrite {
        index: object::SERIAL.0,
        sub: object::SERIAL.1,
        value: 5,
    });
    bench.send(ToRig::ConfigRead {
        index: limits,
        sub: 14,
    });
    bench.send(ToRig::ConfigRead {
        index: 0x3000,
        sub: 0,
    });
    bench.run(1);
    let refused = |index, sub, abort| FromRig::ConfigRefused { index, sub, abort };
    assert_eq!(
        bench.received[1..],
        [
            FromRig::ConfigWritten { index: limits, sub },
            FromRig::ConfigValue {
                index: limits,
                sub,
                value: 24_000
            },
            refused(limits, 8, ConfigAbort::Range),
            refused(object::SERIAL.0, object::SERIAL.1, ConfigAbort::ReadOnly),
            refused(limits, 14, ConfigAbort::NoSubIndex),
            refused(0x3000, 0, ConfigAbort::NoObject),
        ]
    );
    let mut bench = default_bench();
    bench.send(ToRig::ConfigWrite {
        index: limits,
        sub,
        value: 24_000,
    });
    bench.run(1);
    assert_eq!(
        bench.received.last(),
        Some(&refused(limits, sub, ConfigAbort::State))
    );
}

#[test]
fn an_empty_queue_holds_and_resumes_only_on_request() {
    let mut bench = default_bench();
    bench.sine(8.0, 6.0, 2.5);
    bench.run(2000);
    bench.motion = None;
    let ticks = bench.until(RigState::Hold, 120);
    // 100 ms ahead minus the low level of 30 ms.
    assert!((68..=74).contains(&ticks), "{ticks}");
    assert_eq!(bench.cause, Cause::QueueDry);
    // The integral part of the servo loop settles within about 0.4 s.
    bench.run(400);
    let at = bench.rig.displacement_mm();
    bench.run(500);
    assert!((bench.rig.displacement_mm() - at).abs() < 0.02);
    assert_eq!(bench.state, RigState::Hold);
    assert_eq!(bench.request(RequestCode::Resume, 0), RequestResult::Done);
    bench.run(20);
    assert_eq!((bench.state, bench.cause), (RigState::Armed, Cause::None));
}

#[test]
fn a_hold_unloads_after_its_time_out() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    assert_eq!(bench.request(RequestCode::Hold, 0), RequestResult::Done);
    bench.motion = None;
    assert_eq!(bench.until(RigState::Hold, 10), 1);
    let ticks = bench.until(RigState::Unload, 31_000);
    assert!((29_990..=30_010).contains(&ticks), "{ticks}");
    bench.until(RigState::Tripped, 3000);
    assert_eq!(bench.cause, Cause::HoldTimeout);
}

#[test]
fn last_slot_ends_a_motion_without_fault() {
    let mut bench = default_bench();
    let start = bench.tick;
    bench.motion = Some((
        WireMode::Force,
        Box::new(move |tick| {
            let done = tick - start;
            (done <= 1000).then_some((done as i32 * 2, done == 1000))
        }),
    ));
    bench.run(50);
    assert_eq!(bench.state, RigState::Running);
    bench.run(1500);
    assert_eq!((bench.state, bench.cause), (RigState::Armed, Cause::None));
    // 2000 counts are 200 N; force control keeps the value.
    assert!(
        (bench.rig.force_n() - 200.0).abs() < 2.0,
        "{}",
        bench.rig.force_n()
    );
    assert_eq!(bench.request(RequestCode::Unload, 0), RequestResult::Done);
    bench.until(RigState::Off, 3000);
    assert_eq!(bench.cause, Cause::None);
    assert!(bench.emergencies().is_empty());
}

#[test]
fn second_session_is_refused_while_the_first_lives() {
    let mut bench = default_bench();
    bench.hold_at(3.0);
    let first = bench.session;
    let counter = bench.counter(2);
    bench.send(ToRig::Request(RequestMessage {
        counter,
        session: 9,
        code: RequestCode::OpenSession,
        argument: 0,
    }));
    bench.run(2);
    assert_eq!(bench.ack, (counter, RequestResult::Busy));
    let counter = bench.counter(2);
    bench.send(ToRig::Request(RequestMessage {
        counter,
        session: 9,
        code: RequestCode::Unload,
        argument: 0,
    }));
    bench.run(2);
    assert_eq!(
        (bench.ack, bench.state),
        ((counter, RequestResult::Busy), RigState::Running)
    );
    // Any host may abort, and open a session once the lease of the first one has lapsed.
    bench.send(ToRig::Nmt {
        command: NmtCommand::Stop,
        node: 1,
    });
    bench.until(RigState::Unload, 2);
    assert_eq!(bench.cause, Cause::HostAbort);
    assert_eq!(first, bench.session);
    bench.keeps_lease = false;
    bench.run(60);
    bench.session = 9;
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
}

#[test]
fn repeated_request_is_answered_but_not_done_again() {
    let mut bench = default_bench();
    assert_eq!(bench.request(RequestCode::Hold, 0), RequestResult::Done);
    assert_eq!(bench.request(RequestCode::Resume, 0), RequestResult::Done);
    let (counter, session) = (bench.counters[2], bench.session);
    bench.hold_at(1.0);
    bench.send(ToRig::Request(RequestMessage {
        counter,
        session,
        code: RequestCode::Resume,
        argument: 0,
    }));
    bench.run(2);
    // A second execution would be refused in Running.
    assert_eq!(
        (bench.ack, bench.state),
        ((counter, RequestResult::Done), RigState::Running)
    );
}

#[test]
fn a_reboot_has_another_boot_id_and_no_motion() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    let before = bench.rig.firmware.identity.boot_id;
    bench.rig.firmware.reboot();
    (bench.tick, bench.motion) = (0, None);
    bench.run(200);
    assert_eq!(bench.rig.state(), RigState::Off);
    assert_ne!(bench.rig.firmware.identity.boot_id, before);
}

#[test]
fn impossible_configurations_are_refused() {
    let plant = || Box::new(Equivalent::new(&[0.0, 80.0, 0.1, 0.5], 0.0).expect("four values"));
    let mut config = MockRigConfig::default();
    config.actuator.supply_mpa = f64::INFINITY;
    let error = MockRig::new(&config, plant()).err().expect("refused");
    assert!(
        error.to_string().contains("mock_rig.actuator.supply_mpa"),
        "{error}"
    );
    let typed = "seed = 5\n[lvdt]\nnoise_rms_counts = 2.0\n";
    let config: MockRigConfig = toml::from_str(typed).expect("partial tables take defaults");
    assert_eq!(
        (config.seed, config.lvdt.noise_rms_counts, config.lvdt.filter_hz),
        (5, 2.0, 300.0)
    );
    assert!(toml::from_str::<MockRigConfig>("sede = 5").is_err());
}
