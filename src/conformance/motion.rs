//! Rows with motion: arm, a move of 0.25 mm, hold, resume, unload on request, and what is locked while the pressure is on.

use super::moving::{MOVE_COUNTS, MOVE_MS};
use super::probe::{Probe, same};
use super::row::CheckRow;
use crate::protocol::message::{
    Cause, ConfigAbort, LIMITS, NmtCommand, RequestCode, RequestResult, RigState, object,
};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "arm",
        section: "7",
        title: "arm keeps the present displacement",
        moves: true,
        check: arm,
    },
    CheckRow {
        id: "locked",
        section: "9",
        title: "with the pressure on, limits and calibration hash are locked",
        moves: true,
        check: locked,
    },
    CheckRow {
        id: "nmt-ignored",
        section: "2",
        title: "with the pressure on, pre-operational and reset node are ignored",
        moves: true,
        check: network_ignored,
    },
    CheckRow {
        id: "arm-again",
        section: "2",
        title: "armed, arm and reset are refused",
        moves: true,
        check: arm_again,
    },
    CheckRow {
        id: "move",
        section: "7",
        title: "a move of 0.25 mm: running, `last`, armed at the end level",
        moves: true,
        check: move_up,
    },
    CheckRow {
        id: "hold",
        section: "7",
        title: "hold on request stops the motion, resume leads to armed",
        moves: true,
        check: hold,
    },
    CheckRow {
        id: "hold-timeout",
        section: "8",
        title: "a hold unloads after its time-out",
        moves: true,
        check: hold_timeout,
    },
    CheckRow {
        id: "clear-queue",
        section: "2",
        title: "clear_queue in armed and hold, not in running",
        moves: true,
        check: clear_queue,
    },
    CheckRow {
        id: "unload",
        section: "7",
        title: "unload on request: requested, ramp at its speed, off, no cause",
        moves: true,
        check: unload,
    },
    CheckRow {
        id: "session-busy-armed",
        section: "5",
        title: "another session cannot hold, unload or take an armed rig",
        moves: true,
        check: busy,
    },
];

/// Displacement may differ from its set point by this, counts: 0.05 mm.
const STILL_COUNTS: i32 = 100;
/// A state follows its request or command within this time, ms.
const SOON_MS: i64 = 20;

/// Fails if the displacement is not near `counts`.
fn near(probe: &Probe, counts: i32) -> Result<i32, String> {
    let (displacement, _) = probe.reading().ok_or("no SAMPLE")?;
    if (displacement - counts).abs() <= STILL_COUNTS {
        Ok(displacement - counts)
    } else {
        Err(format!("displacement {displacement} counts instead of {counts}"))
    }
}

fn arm(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    probe.pass(500);
    let off_by = near(probe, at)?;
    same("state and cause", probe.now()?, (RigState::Armed, Cause::None))?;
    Ok(format!("{off_by} counts away after 1 s"))
}

fn locked(probe: &mut Probe) -> Result<String, String> {
    probe.arm(|_| {})?;
    for (i, limit) in LIMITS.iter().enumerate() {
        let answer = probe.try_write((object::LIMITS, i as u8 + 1), limit.default as u32)?;
        same(
            &format!("write of {}", limit.name),
            answer,
            Err(ConfigAbort::State),
        )?;
    }
    let hash = probe.read(object::CALIBRATION_HASH)?;
    let answer = probe.try_write(object::CALIBRATION_HASH, hash)?;
    same("write of the calibration hash", answer, Err(ConfigAbort::State))?;
    Ok("0x08000022".to_owned())
}

fn network_ignored(probe: &mut Probe) -> Result<String, String> {
    probe.arm(|_| {})?;
    for command in [NmtCommand::PreOperational, NmtCommand::ResetNode] {
        let tick = probe.tick();
        probe.network(command);
        probe.pass(150);
        if probe.tick() - tick < 100 {
            return Err(format!("the samples ended after {command:?}"));
        }
        same(
            &format!("state after {command:?}"),
            probe.now()?.0,
            RigState::Armed,
        )?;
    }
    Ok("armed".to_owned())
}

fn arm_again(probe: &mut Probe) -> Result<String, String> {
    probe.arm(|_| {})?;
    for code in [RequestCode::Arm, RequestCode::Reset, RequestCode::Resume] {
        probe.must(code, 0, RequestResult::WrongState)?;
    }
    same("state", probe.now()?.0, RigState::Armed)?;
    Ok("wrong_state".to_owned())
}

fn move_up(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    let first = probe.ramp(at, at + MOVE_COUNTS, true);
    let (_, running) = probe.expect_state(150, RigState::Running)?;
    let (_, ended) = probe.expect_state(MOVE_MS + SOON_MS, RigState::Armed)?;
    for (what, found, due) in [("running", running, first), ("armed", ended, first + MOVE_MS)] {
        if (found - due).abs() > 2 {
            return Err(format!("{what} at tick {found} instead of {due}"));
        }
    }
    probe.pass(500);
    let off_by = near(probe, at + MOVE_COUNTS)?;
    same("EMERGENCY frames", probe.emergencies().len(), 0)?;
    Ok(format!(
        "{MOVE_COUNTS} counts in {} ms, {off_by} counts away",
        ended - running
    ))
}

fn hold(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    probe.ramp(at, at + MOVE_COUNTS, false);
    probe.expect_state(150, RigState::Running)?;
    probe.pass(100);
    probe.cut_stream();
    probe.must(RequestCode::Hold, 0, RequestResult::Done)?;
    same("state and cause", probe.now()?, (RigState::Hold, Cause::None))?;
    probe.pass(500);
    let (held, _) = probe.reading().ok_or("no SAMPLE")?;
    probe.pass(500);
    near(probe, held)?;
    same(
        "state and cause after 1 s",
        probe.now()?,
        (RigState::Hold, Cause::None),
    )?;
    probe.must(RequestCode::Hold, 0, RequestResult::Done)?;
    probe.must(RequestCode::Resume, 0, RequestResult::Done)?;
    let status = probe.status().ok_or("no STATUS")?;
    same(
        "state, cause, queue",
        (status.state, status.cause, status.queue_ms),
        (RigState::Armed, Cause::None, 0),
    )?;
    same("EMERGENCY frames", probe.emergencies().len(), 0)?;
    Ok(format!("held at {} counts, armed again", held - at))
}

fn hold_timeout(probe: &mut Probe) -> Result<String, String> {
    probe.arm_up(|limits| limits.hold_timeout_ms = 300)?;
    probe.send_request(RequestCode::Hold);
    let (_, held) = probe.expect_state(SOON_MS, RigState::Hold)?;
    let (status, unloads) = probe.expect_state(320, RigState::Unload)?;
    same("cause", status.cause, Cause::HoldTimeout)?;
    let took_ms = unloads - held;
    if !(298..=302).contains(&took_ms) {
        return Err(format!("after {took_ms} ms instead of 300 ms"));
    }
    probe.expect_end(RigState::Tripped)?;
    same(
        "EMERGENCY",
        probe.emergencies(),
        vec![(Cause::HoldTimeout, RigState::Unload)],
    )?;
    Ok(format!("unload after {took_ms} ms"))
}

fn clear_queue(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    probe.must(RequestCode::ClearQueue, 0, RequestResult::Done)?;
    probe.ramp(at, at + MOVE_COUNTS, false);
    probe.expect_state(150, RigState::Running)?;
    probe.must(RequestCode::ClearQueue, 0, RequestResult::WrongState)?;
    probe.must(RequestCode::Hold, 0, RequestResult::Done)?;
    probe.must(RequestCode::ClearQueue, 0, RequestResult::Done)?;
    Ok("done, wrong_state, done".to_owned())
}

fn unload(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm_up(|_| {})?;
    probe.send_request(RequestCode::Unload);
    let (status, began) = probe.expect_state(SOON_MS, RigState::Unload)?;
    same("cause of the unload", status.cause, Cause::Requested)?;
    same("result", status.ack_result, RequestResult::Done)?;
    let (status, ended) = probe.expect_state(1_000, RigState::Off)?;
    same("cause after the unload", status.cause, Cause::None)?;
    // 500 counts at 10 000 counts per second are 50 ms; the servo loop and the filter lag.
    let took_ms = ended - began;
    if !(40..=200).contains(&took_ms) {
        return Err(format!(
            "{MOVE_COUNTS} counts in {took_ms} ms instead of about 50 ms"
        ));
    }
    probe.pass(100);
    near(probe, at)?;
    same("EMERGENCY frames", probe.emergencies().len(), 0)?;
    Ok(format!("{MOVE_COUNTS} counts in {took_ms} ms"))
}

fn busy(probe: &mut Probe) -> Result<String, String> {
    probe.arm(|_| {})?;
    probe.others_are_refused([RequestCode::OpenSession, RequestCode::Hold, RequestCode::Unload])?;
    same("state", probe.now()?, (RigState::Armed, Cause::None))?;
    Ok("busy, armed".to_owned())
}
