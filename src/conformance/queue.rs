//! Rows with motion about the command queue: what it takes, drops and counts, and how it ends in a hold.

use super::moving::MOVE_COUNTS;
use super::probe::{Probe, same};
use super::row::CheckRow;
use crate::protocol::message::{
    Cause, CommandMessage, RequestCode, RequestResult, RigState, ToRig, WireMode, next_counter, object,
};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "queue-count",
        section: "2",
        title: "queue in STATUS is the newest command's tick minus the present one",
        moves: true,
        check: count,
    },
    CheckRow {
        id: "command-late",
        section: "7",
        title: "a late COMMAND is dropped, counted and never executed",
        moves: true,
        check: late,
    },
    CheckRow {
        id: "command-far",
        section: "7",
        title: "a COMMAND more than 250 ms ahead is dropped and counted",
        moves: true,
        check: far,
    },
    CheckRow {
        id: "command-gaps",
        section: "7",
        title: "missing slots are interpolated",
        moves: true,
        check: gaps,
    },
    CheckRow {
        id: "queue-dry",
        section: "7",
        title: "less than 30 ms left: hold, queue_dry, EMERGENCY",
        moves: true,
        check: dry,
    },
    CheckRow {
        id: "bad-command-limit",
        section: "7",
        title: "a COMMAND beyond the limits: hold, bad_command, EMERGENCY",
        moves: true,
        check: beyond_limit,
    },
    CheckRow {
        id: "bad-command-mode",
        section: "7",
        title: "a COMMAND of another mode: hold, bad_command",
        moves: true,
        check: other_mode,
    },
];

fn count(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    let (from, newest) = (probe.heard.len(), probe.tick() + 240);
    let due = newest - 20;
    probe.send_command(due, at, false);
    probe.send_command(newest, at, true);
    let (_, running) =
        probe.expect_status(300, "STATUS running", |status| status.state == RigState::Running)?;
    if (running - due).abs() > 2 {
        return Err(format!("running at tick {running} instead of {due}"));
    }
    let wrong: Vec<String> = probe
        .statuses(from)
        .filter(|(status, tick)| status.queue_ms > 0 && i64::from(status.queue_ms) != newest - tick)
        .map(|(status, tick)| format!("{} with {} ms to go", status.queue_ms, newest - tick))
        .collect();
    let counted = probe
        .statuses(from)
        .filter(|(status, _)| status.queue_ms > 0)
        .count();
    match wrong.first() {
        Some(first) => Err(format!(
            "{} of {counted} STATUS differ, the first says {first}",
            wrong.len()
        )),
        None if counted == 0 => Err("queue stayed 0".to_owned()),
        None => Ok(format!("{counted} STATUS")),
    }
}

/// Sends commands that must be dropped; the rig stays armed and counts them.
fn dropped(probe: &mut Probe, ahead: &[i64]) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    let (from, before) = (probe.heard.len(), probe.read(object::COMMANDS_DROPPED)?);
    for &ahead in ahead {
        let tick = probe.tick() + ahead;
        probe.send_command(tick, at + MOVE_COUNTS, true);
        probe.pass(10);
    }
    probe.pass(400);
    let ran = probe
        .statuses(from)
        .any(|(status, _)| status.state == RigState::Running);
    same("a dropped command was executed", ran, false)?;
    let (displacement, _) = probe.reading().ok_or("no SAMPLE")?;
    if (displacement - at).abs() > MOVE_COUNTS / 4 {
        return Err(format!(
            "a dropped command moved the rig by {} counts",
            displacement - at
        ));
    }
    same("state and cause", probe.now()?, (RigState::Armed, Cause::None))?;
    let counted = probe.read(object::COMMANDS_DROPPED)?.wrapping_sub(before);
    same("commands counted in 0x2005:2", counted as usize, ahead.len())?;
    Ok(format!("{counted} dropped"))
}

fn late(probe: &mut Probe) -> Result<String, String> {
    dropped(probe, &[0, -1, -50, -5_000])
}

fn far(probe: &mut Probe) -> Result<String, String> {
    // In real time the rig is some ticks ahead of the newest sample that was heard.
    dropped(probe, &[1_000, 5_000, 30_000])
}

fn gaps(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    let first = probe.tick() + 20;
    // Every tenth command of a ramp over 200 ms, all at once.
    for step in 0..=20 {
        probe.send_command(first + 10 * step, at + 25 * step as i32, step == 20);
    }
    probe.expect_state(100, RigState::Running)?;
    let from = probe.heard.len();
    probe.expect_state(250, RigState::Armed)?;
    let held = probe
        .statuses(from)
        .any(|(status, _)| status.state == RigState::Hold);
    same("held on the way", held, false)?;
    same("EMERGENCY frames", probe.emergencies().len(), 0)?;
    probe.pass(300);
    let (displacement, _) = probe.reading().ok_or("no SAMPLE")?;
    if (displacement - at - MOVE_COUNTS).abs() > 100 {
        return Err(format!(
            "ended {} counts up instead of {MOVE_COUNTS}",
            displacement - at
        ));
    }
    Ok("21 commands for 200 ms".to_owned())
}

fn dry(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    probe.ramp(at, at + MOVE_COUNTS, false);
    probe.expect_state(150, RigState::Running)?;
    probe.pass(100);
    probe.cut_stream();
    let newest = probe.streamed_until();
    let (status, held) = probe.expect_state(250, RigState::Hold)?;
    same("cause", status.cause, Cause::QueueDry)?;
    same(
        "EMERGENCY",
        probe.emergencies(),
        vec![(Cause::QueueDry, RigState::Hold)],
    )?;
    let left_ms = newest - held;
    if !(27..=30).contains(&left_ms) {
        return Err(format!("held with {left_ms} ms left instead of just below 30 ms"));
    }
    probe.must(RequestCode::Resume, 0, RequestResult::Done)?;
    same("state and cause", probe.now()?, (RigState::Armed, Cause::None))?;
    Ok(format!("held with {left_ms} ms left"))
}

fn bad_command(probe: &mut Probe, counts: i32, mode: WireMode) -> Result<String, String> {
    probe.command_counter = next_counter(probe.command_counter);
    let (counter, session, tick) = (probe.command_counter, probe.session, (probe.tick() + 150) as u16);
    probe.send(ToRig::Command(CommandMessage {
        counter,
        session,
        tick,
        mode,
        counts,
        last: true,
    }));
    let (status, _) = probe.expect_state(20, RigState::Hold)?;
    same("cause", status.cause, Cause::BadCommand)?;
    same(
        "EMERGENCY",
        probe.emergencies(),
        vec![(Cause::BadCommand, RigState::Hold)],
    )?;
    probe.must(RequestCode::Resume, 0, RequestResult::Done)?;
    same("state and cause", probe.now()?, (RigState::Armed, Cause::None))?;
    Ok("hold, bad_command".to_owned())
}

fn beyond_limit(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    // The limits are 2000 counts away.
    bad_command(probe, at + 2_001, WireMode::Displacement)
}

fn other_mode(probe: &mut Probe) -> Result<String, String> {
    let at = probe.arm(|_| {})?;
    let (_, force) = probe.reading().ok_or("no SAMPLE")?;
    probe.send_command(probe.tick() + 200, at, true);
    probe.pass(5);
    bad_command(probe, force, WireMode::Force)
}
