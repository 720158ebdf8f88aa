//! The rules of `firmware-protocol.md` that the author of a firmware would otherwise guess: NMT states, abort and restart,
//! causes, the queue, the lease, refusals.

use super::*;
use crate::protocol::cob;
use crate::protocol::frame::Frame;
use crate::protocol::protection::{FrameKind, crc8, data_id};

impl TestRig {
    fn network(&mut self, command: NmtCommand) {
        self.send(ToRig::Nmt { command, node: 1 });
        self.run(1);
    }

    /// The answer to a configuration access.
    fn configure(&mut self, access: ToRig) -> FromRig {
        self.received.clear();
        self.send(access);
        self.run(1);
        self.received.first().copied().expect("an answer")
    }

    fn read(&mut self, index: u16, sub: u8) -> u32 {
        match self.configure(ToRig::ConfigRead { index, sub }) {
            FromRig::ConfigValue { value, .. } => value,
            other => panic!("{index:#06x}:{sub}: {other:?}"),
        }
    }

    fn set_limit(&mut self, sub: u8, value: i32) -> FromRig {
        let (index, value) = (object::LIMITS, value as u32);
        self.configure(ToRig::ConfigWrite { index, sub, value })
    }

    /// Started, with an open session, pressure off.
    fn opened(config: &MockRigConfig) -> Self {
        let mut bench = TestRig::new(config);
        bench.network(NmtCommand::Start);
        assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
        bench
    }

    fn arm(&mut self) -> RequestResult {
        let crc = self.rig.limits_crc();
        self.request(RequestCode::Arm, crc)
    }

    fn command(&mut self, ahead: u64, counts: i32) {
        let (counter, session) = (self.counter(1), self.session);
        self.send(ToRig::Command(CommandMessage {
            counter,
            session,
            tick: (self.tick + ahead) as u16,
            mode: WireMode::Displacement,
            counts,
            last: false,
        }));
    }

    fn at_counts(&self) -> i32 {
        (self.rig.displacement_mm() / DISPLACEMENT_MM_PER_COUNT).round() as i32
    }
}

/// Sub-indices of the dropped frames, object 0x2005.
const CORRUPT: u8 = 1;
const COMMANDS: u8 = 2;
const FOREIGN: u8 = 3;
const DROPPED: u16 = 0x2005;

fn written(sub: u8) -> FromRig {
    FromRig::ConfigWritten {
        index: object::LIMITS,
        sub,
    }
}

#[test]
fn a_stopped_rig_reports_and_does_not_arm() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    bench.network(NmtCommand::Stop);
    let samples = bench.samples.len();
    bench.run(200);
    assert_eq!(bench.samples.len(), samples + 200, "samples go on");
    assert!(bench.received.contains(&FromRig::Heartbeat {
        state: NmtState::Stopped
    }));
    assert_eq!((bench.state, bench.cause), (RigState::Off, Cause::None));
    assert_eq!(bench.arm(), RequestResult::WrongState);
    bench.network(NmtCommand::Start);
    assert_eq!(bench.arm(), RequestResult::Done);
}

#[test]
fn a_pre_operational_rig_answers_configuration_only() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    bench.network(NmtCommand::PreOperational);
    bench.samples.clear();
    let counter = bench.counter(2);
    let session = 99;
    bench.keeps_lease = false;
    bench.run(100);
    bench.send(ToRig::Request(RequestMessage {
        counter,
        session,
        code: RequestCode::OpenSession,
        argument: 0,
    }));
    bench.run(20);
    assert!(bench.samples.is_empty());
    assert_eq!(bench.read(0x2002, 0), 1000);
    bench.network(NmtCommand::Start);
    bench.run(20);
    assert_ne!(bench.ack.0, counter, "requests are ignored, not answered later");
    assert_eq!(bench.rig.firmware.host.session, 0);
}

#[test]
fn an_abort_is_confirmed_each_time_and_start_and_reset_lead_back() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    bench.motion = None;
    for _ in 0..3 {
        bench.network(NmtCommand::Stop);
        assert_eq!((bench.state, bench.cause), (RigState::Unload, Cause::HostAbort));
        assert_eq!(bench.queue_ms, 0);
    }
    assert_eq!(bench.emergencies(), [Cause::HostAbort]);
    // The lease ends with the abort. The cause of the unload stays, the session does not.
    bench.keeps_lease = false;
    bench.until(RigState::Tripped, 3000);
    assert_eq!(
        (bench.cause, bench.rig.firmware.host.session),
        (Cause::HostAbort, 0)
    );
    bench.keeps_lease = true;
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Done);
    assert_eq!((bench.state, bench.cause), (RigState::Off, Cause::None));
    assert_eq!(bench.arm(), RequestResult::WrongState, "start comes first");
    bench.network(NmtCommand::Start);
    assert_eq!(bench.arm(), RequestResult::Done);
}

#[test]
fn an_abort_during_a_requested_unload_ends_in_tripped() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    bench.motion = None;
    assert_eq!(bench.request(RequestCode::Unload, 0), RequestResult::Done);
    assert_eq!((bench.state, bench.cause), (RigState::Unload, Cause::Requested));
    bench.network(NmtCommand::Stop);
    assert_eq!(bench.cause, Cause::HostAbort);
    bench.until(RigState::Tripped, 3000);
}

#[test]
fn a_cause_lasts_until_reset_or_resume_and_the_first_one_stays() {
    let mut bench = default_bench();
    bench.hold_at(3.0);
    bench.motion = None;
    bench.until(RigState::Hold, 200);
    assert_eq!(
        (bench.cause, bench.emergencies()),
        (Cause::QueueDry, vec![Cause::QueueDry])
    );
    assert_eq!(bench.request(RequestCode::Hold, 0), RequestResult::Done);
    assert_eq!(bench.cause, Cause::QueueDry);
    assert_eq!(bench.request(RequestCode::Resume, 0), RequestResult::Done);
    assert_eq!(bench.cause, Cause::None);
    bench.command(100, 99_000);
    bench.until(RigState::Hold, 2);
    assert_eq!(bench.cause, Cause::BadCommand);
    // An unload out of a hold with a cause is one after a fault, and is not announced a second time.
    assert_eq!(bench.request(RequestCode::Unload, 0), RequestResult::Done);
    bench.keeps_lease = false;
    bench.until(RigState::Tripped, 3000);
    bench.run(1000);
    assert_eq!(bench.cause, Cause::BadCommand);
    assert_eq!(bench.emergencies(), [Cause::QueueDry, Cause::BadCommand]);
    bench.keeps_lease = true;
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Done);
    assert_eq!((bench.state, bench.cause), (RigState::Off, Cause::None));
}

#[test]
fn a_requested_hold_is_not_announced() {
    let mut bench = default_bench();
    assert_eq!(bench.request(RequestCode::Hold, 0), RequestResult::Done);
    bench.run(50);
    assert_eq!((bench.state, bench.cause), (RigState::Hold, Cause::None));
    assert!(bench.emergencies().is_empty());
}

#[test]
fn a_travel_limit_is_left_with_wider_limits() {
    let mut bench = default_bench();
    bench.hold_at(5.0);
    bench.motion = None;
    bench.rig.actuator.displacement_mm += 60.0;
    bench.until(RigState::Tripped, 50);
    assert_eq!(bench.cause, Cause::DisplacementLimit);
    let mm = bench.rig.displacement_mm();
    assert!(mm > 49.0, "{mm} mm is beyond the limit of 49 mm");
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::CauseStands);
    assert_eq!(bench.set_limit(3, 110_000), written(3));
    assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Done);
    // The old limit again: the rig does not arm beyond it.
    assert_eq!(bench.set_limit(3, 98_000), written(3));
    assert_eq!(bench.arm(), RequestResult::CauseStands);
    assert_eq!(bench.set_limit(3, 110_000), written(3));
    assert_eq!(bench.arm(), RequestResult::Done);
    bench.run(400);
    assert_eq!(bench.request(RequestCode::Unload, 0), RequestResult::Done);
    bench.until(RigState::Off, 15_000);
    assert!(bench.rig.displacement_mm() < 2.0);
}

#[test]
fn limits_that_contradict_each_other_do_not_arm() {
    // Sub-index and value: upper below lower, unloaded force or end of the retract outside.
    for (sub, value) in [
        (1, -6_000),
        (3, -98_000),
        (12, 100_000),
        (12, -5_001),
        (13, 98_000),
        (13, -98_001),
    ] {
        let mut bench = TestRig::opened(&MockRigConfig::default());
        assert_eq!(bench.set_limit(sub, value), written(sub));
        assert_eq!(bench.arm(), RequestResult::WrongConfiguration, "{sub} = {value}");
        assert_eq!(bench.state, RigState::Off);
    }
}

#[test]
fn limits_of_a_tared_bench_may_pass_zero() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    for (sub, value) in [(2, -21_000), (12, -19_000), (1, -2_000), (2, -21_000)] {
        assert_eq!(bench.set_limit(sub, value), written(sub), "{sub} = {value}");
    }
    assert_eq!(bench.set_limit(1, 40_000), written(1));
    for (sub, value) in [(2, 1_300), (12, 1_700)] {
        assert_eq!(bench.set_limit(sub, value), written(sub), "{sub} = {value}");
    }
}

#[test]
fn a_boot_brings_the_default_limits_and_keeps_the_calibration_hash() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    let (defaults, boot) = (bench.rig.limits_crc(), bench.read(0x2001, 0));
    let (index, sub) = object::CALIBRATION_HASH;
    bench.configure(ToRig::ConfigWrite {
        index,
        sub,
        value: 0xA1B2_C3D4,
    });
    bench.set_limit(1, 30_000);
    bench.send(ToRig::Nmt {
        command: NmtCommand::ResetNode,
        node: 1,
    });
    bench.rig.tick(&mut bench.rig_link);
    while bench.host.receive().is_some() {}
    bench.tick = 1;
    assert_eq!(bench.read(0x2004, 0), defaults);
    assert_ne!(bench.read(0x2001, 0), boot);
    assert_eq!(bench.read(index, sub), 0xA1B2_C3D4);
}

#[test]
fn the_queue_counts_the_ticks_to_its_newest_command() {
    let mut bench = default_bench();
    let at = bench.at_counts();
    // Two commands with a gap of 99 slots between them: the gap counts.
    let newest = bench.tick + 200;
    bench.command(100, at);
    bench.command(200, at);
    for _ in 0..15 {
        bench.run(10 - bench.tick % 10);
        assert_eq!(u64::from(bench.queue_ms), newest - bench.tick);
    }
}

#[test]
fn commands_late_too_far_or_in_another_state_are_dropped_and_counted() {
    let mut bench = default_bench();
    let at = bench.at_counts();
    let before = bench.read(DROPPED, COMMANDS);
    // The command arrives before the rig's next tick: one ahead of the host's tick is due now.
    for (ahead, level) in [(0, 0), (251, 0), (250, 249)] {
        bench.command(ahead, at);
        bench.run(1);
        let firmware = &bench.rig.firmware;
        assert_eq!(firmware.queue.level(firmware.tick), level, "{ahead} ahead");
    }
    assert_eq!(bench.read(DROPPED, COMMANDS), before + 2);
    assert_eq!(bench.request(RequestCode::Hold, 0), RequestResult::Done);
    bench.command(50, at);
    bench.run(20);
    assert_eq!((bench.state, bench.cause), (RigState::Hold, Cause::None));
    assert_eq!(bench.read(DROPPED, COMMANDS), before + 3);
}

#[test]
fn refused_and_foreign_frames_are_counted() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    let lease = |counter, session| {
        ToRig::Lease(LeaseMessage {
            counter,
            session,
            control_tick: 0,
        })
        .encode(1)
    };
    bench.keeps_lease = false;
    let mut corrupt = lease(0, bench.session);
    corrupt.data[2] ^= 4;
    let short = Frame::new(corrupt.id, &corrupt.data[..7]);
    bench.host.send(corrupt);
    bench.host.send(short);
    bench.host.send(lease(0, bench.session + 1));
    // Another host may ask; its requests are answered and do not count.
    bench.send(ToRig::Request(RequestMessage {
        counter: 9,
        session: bench.session + 1,
        code: RequestCode::Reset,
        argument: 0,
    }));
    bench.run(1);
    assert_eq!(bench.ack, (9, RequestResult::Busy));
    assert_eq!(bench.read(DROPPED, CORRUPT), 1);
    assert_eq!(bench.read(DROPPED, FOREIGN), 1);
}

#[test]
fn the_first_lease_of_a_session_may_have_any_tick() {
    for first in [0u16, 1, 40_000, 65_535] {
        let mut bench = TestRig::opened(&MockRigConfig::default());
        bench.keeps_lease = false;
        bench.run(40);
        let session = bench.session;
        for (counter, control_tick) in [(3, first), (4, first), (5, first.wrapping_sub(1))] {
            bench.send(ToRig::Lease(LeaseMessage {
                counter,
                session,
                control_tick,
            }));
            bench.run(20);
        }
        // The first one renewed at 40 ms; the others, not newer, did not.
        assert_eq!(bench.rig.firmware.host.session, 0, "first tick {first}");
        assert_eq!(bench.rig.firmware.host.renewed_at, 43, "first tick {first}");
    }
}

#[test]
fn a_new_session_restarts_the_checks_of_lease_and_command() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    bench.run(40);
    // Eight ahead is out of sequence, except for the first frame of a session.
    bench.keeps_lease = false;
    assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
    bench.run(30);
    let (counter, session) = ((bench.counters[0] + 8) % 15, bench.session);
    bench.send(ToRig::Lease(LeaseMessage {
        counter,
        session,
        control_tick: 5,
    }));
    bench.run(40);
    assert_eq!(bench.rig.firmware.host.session, session);
}

#[test]
fn fifteen_lost_commands_are_interpolated_by_their_ticks() {
    let mut bench = default_bench();
    let at = bench.at_counts();
    // 60 commands, of which 15 in a row are lost: the counter shows nothing, 200 counts in 60 ms are slow.
    for ahead in 2..=61u64 {
        bench.command(ahead + 40, at + (ahead as i32 - 2) * 3);
        if (20..35).contains(&ahead) {
            // Taken off the wire before the rig sees it.
            bench.rig_link.receive();
        } else {
            bench
                .rig
                .firmware
                .handle(ToRig::decode(&bench.rig_link.receive().expect("sent"), 1).expect("whole"));
        }
    }
    bench.run(65);
    assert_eq!((bench.state, bench.cause), (RigState::Running, Cause::None));
    assert_eq!(bench.rig.firmware.queue.level(bench.tick), 36);
}

#[test]
fn malformed_configuration_requests_are_refused_and_aborts_are_not_answered() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    let malformed = FromRig::ConfigRefused {
        index: 0x2000,
        sub: 0,
        abort: ConfigAbort::Command,
    };
    for bytes in [[0x2F, 0, 0x20, 0, 1, 0, 0, 0], [0x40, 0, 0x20, 0, 1, 0, 0, 0]] {
        bench.received.clear();
        bench
            .host
            .send(Frame::new(cob::id(cob::CONFIG_REQUEST, 1), &bytes));
        bench.run(1);
        assert_eq!(bench.received, [malformed], "{bytes:02x?}");
    }
    bench.received.clear();
    bench.host.send(Frame::new(
        cob::id(cob::CONFIG_REQUEST, 1),
        &[0x80, 0, 0x20, 0, 0, 0, 0, 0],
    ));
    bench.run(1);
    assert_eq!(bench.received, []);
    assert_eq!(bench.read(DROPPED, CORRUPT), 0, "no corrupt frames");
}

#[test]
fn an_unknown_request_is_answered() {
    let mut bench = TestRig::opened(&MockRigConfig::default());
    let mut frame = ToRig::Request(RequestMessage {
        counter: 11,
        session: bench.session,
        code: RequestCode::Unload,
        argument: 0,
    })
    .encode(1);
    frame.data[3] = 200;
    frame.data[0] = crc8(data_id(FrameKind::Request, 1), &frame.data[1..]);
    bench.host.send(frame);
    bench.run(1);
    assert_eq!(bench.ack, (11, RequestResult::Unknown));
    assert_eq!(bench.read(DROPPED, CORRUPT), 0);
}

#[test]
fn a_negative_force_counts_as_unloaded() {
    let mut config = MockRigConfig::default();
    config.load_cell.zero_counts = -3_000.0;
    let mut bench = TestRig::armed(&config);
    assert!(bench.samples.last().is_some_and(|s| s.1 < -250.0));
    let at = bench.rig.displacement_mm();
    assert_eq!(bench.request(RequestCode::Unload, 0), RequestResult::Done);
    // 1 ms to the speed of the ramp, 5 ms below the unloaded force.
    assert!(bench.until(RigState::Off, 20) <= 8);
    assert!((bench.rig.displacement_mm() - at).abs() < 0.05);
}

#[test]
fn an_emergency_stop_trips_in_off_and_at_boot() {
    for ticks_before in [0, 50] {
        let mut bench = TestRig::new(&MockRigConfig::default());
        bench.run(ticks_before);
        bench.network(NmtCommand::Start);
        bench.rig.injection.emergency_stop = true;
        bench.until(RigState::Tripped, 1);
        assert_eq!(bench.emergencies(), [Cause::EmergencyStop]);
        assert_eq!(bench.request(RequestCode::OpenSession, 0), RequestResult::Done);
        assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::CauseStands);
        bench.rig.injection.emergency_stop = false;
        bench.run(1);
        assert_eq!(bench.request(RequestCode::Reset, 0), RequestResult::Done);
    }
}
