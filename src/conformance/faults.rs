//! Rows with motion about faults of the host and the line: abort, lapsed lease, corrupt and foreign frames, the cause and its
//! end. Each begins 0.25 mm up, so that the unload is a ramp that can be seen.

use super::asking::ANSWER_MS;
use super::probe::{Probe, same};
use super::row::CheckRow;
use super::stream::statuses_due_to;
use crate::protocol::message::{
    Cause, CommandMessage, LeaseMessage, NmtCommand, NmtState, RequestCode, RequestResult, RigState,
    StatusMessage, ToRig, WireMode,
};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "abort",
        section: "2",
        title: "NMT stop: unload with host_abort at once, EMERGENCY, then tripped",
        moves: true,
        check: abort,
    },
    CheckRow {
        id: "abort-repeated",
        section: "2",
        title: "each further NMT stop is answered and changes nothing",
        moves: true,
        check: abort_repeated,
    },
    CheckRow {
        id: "abort-in-unload",
        section: "2",
        title: "NMT stop during an unload on request ends in tripped",
        moves: true,
        check: abort_in_unload,
    },
    CheckRow {
        id: "lease-lapse",
        section: "5",
        title: "without a lease the rig unloads after 50 ms",
        moves: true,
        check: lease_lapse,
    },
    CheckRow {
        id: "corrupt-frames",
        section: "7",
        title: "2 corrupt frames change nothing, the third in 100 ms unloads",
        moves: true,
        check: corrupt_frames,
    },
    CheckRow {
        id: "foreign-frames",
        section: "5",
        title: "the sixth frame of another session in 100 ms unloads",
        moves: true,
        check: foreign_frames,
    },
    CheckRow {
        id: "cause-latched",
        section: "7",
        title: "state and cause stay until reset",
        moves: true,
        check: cause_latched,
    },
    CheckRow {
        id: "first-cause",
        section: "7",
        title: "of two causes the first one stays",
        moves: true,
        check: first_cause,
    },
];

/// The rig reacts to NMT stop, or to a frame, within this time, ms.
const AT_ONCE_MS: i64 = 1;

/// Waits for the unload, whose cause must be `cause`, and checks its EMERGENCY.
fn unloads(probe: &mut Probe, within_ms: i64, cause: Cause) -> Result<(StatusMessage, i64), String> {
    let (status, tick) = probe.expect_state(within_ms, RigState::Unload)?;
    same("cause", status.cause, cause)?;
    same("EMERGENCY", probe.emergencies(), vec![(cause, RigState::Unload)])?;
    Ok((status, tick))
}

fn abort(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|_| {})?;
    probe.network(NmtCommand::Stop);
    let (status, _) = unloads(probe, AT_ONCE_MS, Cause::HostAbort)?;
    same("queue", status.queue_ms, 0)?;
    probe.expect_end(RigState::Tripped)?;
    same("cause after the unload", probe.now()?.1, Cause::HostAbort)?;
    probe.expect_heartbeat(NmtState::Stopped)?;
    Ok("unload, tripped, heartbeat 0x04".to_owned())
}

fn abort_repeated(probe: &mut Probe) -> Result<String, String> {
    // A slow ramp, so that the unload lasts.
    probe.arm_up(|limits| limits.unload_velocity_counts_s = 500)?;
    probe.network(NmtCommand::Stop);
    probe.pass(100);
    let seen = statuses_due_to(probe, |probe| probe.network(NmtCommand::Stop))?;
    same("EMERGENCY frames", probe.emergencies().len(), 1)?;
    probe.network(NmtCommand::Start);
    probe.pass(20);
    match probe.now()? {
        (RigState::Unload | RigState::Tripped, Cause::HostAbort) => Ok(seen),
        (state, cause) => Err(format!("{state:?} with {cause:?} after NMT start")),
    }
}

fn abort_in_unload(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|limits| limits.unload_velocity_counts_s = 1_000)?;
    probe.must(RequestCode::Unload, 0, RequestResult::Done)?;
    probe.network(NmtCommand::Stop);
    probe.expect_end(RigState::Tripped)?;
    same("cause", probe.now()?.1, Cause::HostAbort)?;
    Ok("tripped, host_abort".to_owned())
}

fn lease_lapse(probe: &mut Probe) -> Result<String, String> {
    // The slow ramp lasts longer than the lease.
    probe.arm_up(|limits| {
        limits.lease_ms = 50;
        limits.unload_velocity_counts_s = 2_000;
    })?;
    probe.keeps_lease = false;
    // The newest tick that any lease carried is at most this one; the lease came after that tick.
    let leased = probe.tick();
    let (status, tick) = unloads(probe, 50, Cause::LeaseLapsed)?;
    same("session", status.session, 0)?;
    let took_ms = tick - leased;
    if took_ms < 35 {
        return Err(format!("{took_ms} ms after the last lease"));
    }
    probe.expect_end(RigState::Tripped)?;
    probe.must(RequestCode::Reset, 0, RequestResult::Busy)?;
    Ok(format!("unload {took_ms} ms later, session 0"))
}

fn corrupt_lease(probe: &mut Probe) {
    let mut frame = ToRig::Lease(LeaseMessage {
        counter: 0,
        session: probe.session,
        control_tick: 0,
    })
    .encode(probe.node);
    frame.data[0] ^= 0x55;
    probe.send_frame(frame);
}

fn corrupt_frames(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|_| {})?;
    for _ in 0..2 {
        corrupt_lease(probe);
    }
    probe.pass(150);
    same("state after 2", probe.now()?, (RigState::Armed, Cause::None))?;
    for _ in 0..3 {
        corrupt_lease(probe);
    }
    unloads(probe, AT_ONCE_MS + 2, Cause::CorruptFrames)?;
    probe.expect_end(RigState::Tripped)?;
    Ok("2 are dropped, 3 unload".to_owned())
}

fn foreign_command(probe: &mut Probe, counter: u8) {
    let (session, tick) = (probe.session % 255 + 1, (probe.tick() + 50) as u16);
    probe.send(ToRig::Command(CommandMessage {
        counter,
        session,
        tick,
        mode: WireMode::Displacement,
        counts: 0,
        last: true,
    }));
}

fn foreign_frames(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|_| {})?;
    for counter in 0..5 {
        foreign_command(probe, counter);
    }
    probe.pass(150);
    same("state after 5", probe.now()?, (RigState::Armed, Cause::None))?;
    for counter in 5..11 {
        foreign_command(probe, counter);
    }
    unloads(probe, AT_ONCE_MS + 2, Cause::ForeignSession)?;
    probe.expect_end(RigState::Tripped)?;
    Ok("5 are dropped, 6 unload".to_owned())
}

fn cause_latched(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|_| {})?;
    for _ in 0..3 {
        corrupt_lease(probe);
    }
    let (status, _) = probe.expect_state(2_000, RigState::Tripped)?;
    let cause = status.cause;
    let from = probe.heard.len();
    probe.pass(2_000);
    for code in [
        RequestCode::Arm,
        RequestCode::Resume,
        RequestCode::Unload,
        RequestCode::Hold,
    ] {
        probe.must(code, 0, RequestResult::WrongState)?;
    }
    if let Some((status, _)) = probe
        .statuses(from)
        .find(|(status, _)| (status.state, status.cause) != (RigState::Tripped, cause))
    {
        return Err(format!(
            "{:?} with {:?} without a reset",
            status.state, status.cause
        ));
    }
    probe.must(RequestCode::Reset, 0, RequestResult::Done)?;
    same(
        "state and cause after reset",
        probe.now()?,
        (RigState::Off, Cause::None),
    )?;
    Ok(format!("{cause:?} for 2 s, none after reset"))
}

fn first_cause(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|limits| limits.unload_velocity_counts_s = 1_000)?;
    for _ in 0..3 {
        corrupt_lease(probe);
    }
    let (status, _) = probe.expect_status(ANSWER_MS, "end of armed", |status| {
        status.state != RigState::Armed
    })?;
    let first = status.cause;
    probe.network(NmtCommand::Stop);
    probe.expect_end(RigState::Tripped)?;
    same("cause after a second fault", probe.now()?.1, first)?;
    same("EMERGENCY frames", probe.emergencies().len(), 1)?;
    Ok(format!("{first:?} stays"))
}
