//! Rows about session, lease, requests and protection. Nothing moves: the pressure stays off.

use super::asking::ANSWER_MS;
use super::probe::{Probe, same};
use super::row::CheckRow;
use super::stream::statuses_due_to;
use crate::protocol::frame::Frame;
use crate::protocol::message::{
    Cause, LeaseMessage, Limits, RequestCode, RequestResult, RigState, ToRig, next_counter, object,
};
use crate::protocol::protection::{FrameKind, crc8, data_id};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "session-open",
        section: "5",
        title: "open_session gives the rig, the lease keeps it",
        moves: false,
        check: open,
    },
    CheckRow {
        id: "session-busy",
        section: "5",
        title: "another session is refused while the lease lives",
        moves: false,
        check: busy,
    },
    CheckRow {
        id: "session-lapse",
        section: "5",
        title: "in off, a lapsed lease ends the session and nothing else",
        moves: false,
        check: lapse,
    },
    CheckRow {
        id: "session-restarts-counters",
        section: "3",
        title: "open_session restarts the counter check of LEASE",
        moves: false,
        check: restarts_counters,
    },
    CheckRow {
        id: "lease-first-tick",
        section: "5",
        title: "the first LEASE may have any control_tick",
        moves: false,
        check: first_tick,
    },
    CheckRow {
        id: "lease-stuck",
        section: "5",
        title: "a LEASE whose control_tick is not newer renews nothing",
        moves: false,
        check: stuck_lease,
    },
    CheckRow {
        id: "corrupt-ignored",
        section: "3",
        title: "a LEASE with a wrong CRC-8 renews nothing and is counted",
        moves: false,
        check: corrupt_ignored,
    },
    CheckRow {
        id: "wrong-length",
        section: "7",
        title: "a frame of another length is dropped and not counted",
        moves: false,
        check: wrong_length,
    },
    CheckRow {
        id: "request-repeated",
        section: "2",
        title: "a repeated request is answered again at once",
        moves: false,
        check: repeat_is_answered,
    },
    CheckRow {
        id: "request-not-twice",
        section: "2",
        title: "a repeated request is not carried out again",
        moves: false,
        check: repeat_is_not_carried_out,
    },
    CheckRow {
        id: "request-unknown",
        section: "2",
        title: "an unknown request is answered with unknown",
        moves: false,
        check: unknown_request,
    },
    CheckRow {
        id: "request-wrong-state",
        section: "2",
        title: "in off, hold, resume, reset and clear_queue are refused",
        moves: false,
        check: wrong_state,
    },
    CheckRow {
        id: "arm-wrong-crc",
        section: "2",
        title: "arm with another CRC-32 is refused",
        moves: false,
        check: arm_wrong_crc,
    },
    CheckRow {
        id: "arm-contradiction",
        section: "9",
        title: "arm with limits that contradict each other is refused",
        // A firmware that arms here switches its pressure on.
        moves: true,
        check: arm_contradiction,
    },
    CheckRow {
        id: "command-in-off",
        section: "7",
        title: "a COMMAND in off is dropped and counted",
        moves: false,
        check: command_in_off,
    },
];

/// The default lease, ms, with a rig's own turn.
const LEASE_MS: i64 = 50;

/// At rest with the default limits, so with the default lease.
fn with_defaults(probe: &mut Probe) -> Result<(), String> {
    probe.rest()?;
    probe.write_limits(&Limits::defaults())
}

/// At rest, with limits whose lease is the longest: this computer may be slow.
fn with_a_long_lease(probe: &mut Probe) -> Result<(), String> {
    probe.rest()?;
    let limits = Limits {
        lease_ms: 500,
        ..Limits::defaults()
    };
    probe.write_limits(&limits)
}

fn owner(probe: &Probe) -> Result<u8, String> {
    Ok(probe.status().ok_or("no STATUS")?.session)
}

fn open(probe: &mut Probe) -> Result<String, String> {
    with_a_long_lease(probe)?;
    for _ in 0..10 {
        probe.pass(100);
        same("session in STATUS", owner(probe)?, probe.session)?;
        same("state", probe.now()?, (RigState::Off, Cause::None))?;
    }
    Ok(format!("session {} for 1 s", probe.session))
}

fn busy(probe: &mut Probe) -> Result<String, String> {
    with_a_long_lease(probe)?;
    probe.others_are_refused([RequestCode::OpenSession, RequestCode::Reset, RequestCode::Unload])?;
    same("session in STATUS", owner(probe)?, probe.session)?;
    Ok("busy".to_owned())
}

fn lapse(probe: &mut Probe) -> Result<String, String> {
    with_defaults(probe)?;
    probe.let_session_lapse(LEASE_MS + ANSWER_MS)?;
    same("state and cause", probe.now()?, (RigState::Off, Cause::None))?;
    // A lease after that changes nothing.
    probe.send_lease();
    probe.pass(30);
    same("session after a late lease", owner(probe)?, 0)?;
    probe.must(RequestCode::Reset, 0, RequestResult::Busy)?;
    Ok("session 0, requests busy".to_owned())
}

/// Opens the session anew without a running lease, under a lease of 500 ms.
fn reopened(probe: &mut Probe) -> Result<(), String> {
    with_a_long_lease(probe)?;
    probe.pass(50);
    probe.keeps_lease = false;
    probe.must(RequestCode::OpenSession, 0, RequestResult::Done)
}

/// Whether the session is still open when it would have lapsed without the renewal after 350 ms.
fn renewed(probe: &mut Probe) -> Result<bool, String> {
    probe.pass(250);
    Ok(owner(probe)? == probe.session)
}

fn restarts_counters(probe: &mut Probe) -> Result<String, String> {
    reopened(probe)?;
    probe.pass(350);
    // Eight ahead is out of sequence, except for the first frame of a session.
    for _ in 0..7 {
        probe.lease_counter = next_counter(probe.lease_counter);
    }
    probe.send_lease();
    match renewed(probe)? {
        true => Ok("a counter 8 ahead was taken".to_owned()),
        false => Err("a counter 8 ahead was refused as wrong sequence".to_owned()),
    }
}

fn send_lease_with(probe: &mut Probe, control_tick: u16) {
    probe.lease_counter = next_counter(probe.lease_counter);
    let (counter, session) = (probe.lease_counter, probe.session);
    probe.send(ToRig::Lease(LeaseMessage {
        counter,
        session,
        control_tick,
    }));
}

fn first_tick(probe: &mut Probe) -> Result<String, String> {
    for away in [0x4000u16, 0x8000, 0xC000] {
        reopened(probe)?;
        probe.pass(350);
        let tick = (probe.tick() as u16).wrapping_add(away);
        send_lease_with(probe, tick);
        if !renewed(probe)? {
            return Err(format!(
                "a first control_tick {away} away from the rig's tick renewed nothing"
            ));
        }
    }
    Ok("three far ticks taken".to_owned())
}

fn stuck_lease(probe: &mut Probe) -> Result<String, String> {
    reopened(probe)?;
    let tick = probe.tick() as u16;
    let start = probe.tick();
    while probe.tick() - start < 700 {
        send_lease_with(probe, tick);
        probe.pass(20);
    }
    same("session after 0.7 s of leases with one tick", owner(probe)?, 0)?;
    Ok("lapsed".to_owned())
}

fn corrupt_ignored(probe: &mut Probe) -> Result<String, String> {
    reopened(probe)?;
    let before = probe.read(object::FRAMES_REFUSED)?;
    let start = probe.tick();
    let mut sent = 0;
    while probe.tick() - start < 700 {
        let (counter, session, control_tick) = (
            next_counter(probe.lease_counter),
            probe.session,
            probe.tick() as u16,
        );
        let mut frame = ToRig::Lease(LeaseMessage {
            counter,
            session,
            control_tick,
        })
        .encode(probe.node);
        frame.data[0] ^= 0x01;
        probe.send_frame(frame);
        sent += 1;
        probe.pass(20);
    }
    same("session after 0.7 s of corrupt leases", owner(probe)?, 0)?;
    let counted = probe.read(object::FRAMES_REFUSED)?.wrapping_sub(before);
    same("frames counted in 0x2005:1", counted, sent)?;
    Ok(format!("lapsed, {counted} counted"))
}

fn wrong_length(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let before = probe.read(object::FRAMES_REFUSED)?;
    let whole = ToRig::Lease(LeaseMessage {
        counter: 0,
        session: probe.session,
        control_tick: 0,
    })
    .encode(probe.node);
    for len in 0..8 {
        let bytes = whole.data.get(..len).unwrap_or_default();
        probe.send_frame(Frame::new(whole.id, bytes));
    }
    probe.pass(30);
    let counted = probe.read(object::FRAMES_REFUSED)?.wrapping_sub(before);
    same("frames counted in 0x2005:1", counted, 0)?;
    Ok("8 short frames dropped".to_owned())
}

fn repeat_is_answered(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let request = probe.next_request(probe.session, RequestCode::Resume, 0);
    probe.ask(request)?;
    statuses_due_to(probe, |probe| probe.send(ToRig::Request(request)))
}

fn repeat_is_not_carried_out(probe: &mut Probe) -> Result<String, String> {
    with_defaults(probe)?;
    let open = probe.next_request(probe.session, RequestCode::OpenSession, 0);
    same("open_session", probe.ask(open)?, RequestResult::Done)?;
    probe.let_session_lapse(LEASE_MS + ANSWER_MS)?;
    probe.send(ToRig::Request(open));
    probe.pass(30);
    // Carried out again, it would have opened the session.
    same("session after a repeated open_session", owner(probe)?, 0)?;
    Ok("answered only".to_owned())
}

fn unknown_request(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let message = probe.next_request(probe.session, RequestCode::Resume, 0);
    let mut frame = ToRig::Request(message).encode(probe.node);
    frame.data[3] = 200;
    frame.data[0] = crc8(data_id(FrameKind::Request, probe.node), &frame.data[1..]);
    probe.send_frame(frame);
    let (status, _) = probe.expect_status(ANSWER_MS, "answer to request code 200", |status| {
        status.ack_counter == message.counter
    })?;
    same("result", status.ack_result, RequestResult::Unknown)?;
    Ok("unknown".to_owned())
}

fn wrong_state(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    for code in [
        RequestCode::Hold,
        RequestCode::Resume,
        RequestCode::Reset,
        RequestCode::ClearQueue,
    ] {
        probe.must(code, 0, RequestResult::WrongState)?;
    }
    probe.must(RequestCode::Unload, 0, RequestResult::Done)?;
    same("state", probe.now()?.0, RigState::Off)?;
    Ok("wrong_state four times, unload done".to_owned())
}

fn arm_wrong_crc(probe: &mut Probe) -> Result<String, String> {
    with_defaults(probe)?;
    let crc = Limits::defaults().crc32();
    probe.must(RequestCode::Arm, !crc, RequestResult::WrongConfiguration)?;
    same("state", probe.now()?.0, RigState::Off)?;
    Ok("wrong_configuration".to_owned())
}

fn arm_contradiction(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let defaults = Limits::defaults();
    // A firmware that armed here could move nowhere: the limits of travel exclude each other.
    let limits = Limits {
        displacement_max_counts: defaults.displacement_min_counts,
        displacement_min_counts: defaults.displacement_max_counts,
        ..defaults
    };
    probe.write_limits(&limits)?;
    let result = probe.request(RequestCode::Arm, limits.crc32());
    let state = probe.now()?.0;
    if state != RigState::Off {
        probe.rest()?;
    }
    probe.write_limits(&defaults)?;
    same("result of arm", result?, RequestResult::WrongConfiguration)?;
    same("state", state, RigState::Off)?;
    Ok("wrong_configuration".to_owned())
}

fn command_in_off(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let before = probe.read(object::COMMANDS_DROPPED)?;
    for ahead in 50..60 {
        probe.send_command(probe.tick() + ahead, 0, false);
    }
    probe.pass(100);
    same("state and cause", probe.now()?, (RigState::Off, Cause::None))?;
    let counted = probe.read(object::COMMANDS_DROPPED)?.wrapping_sub(before);
    same("commands counted in 0x2005:2", counted, 10)?;
    Ok(format!("{counted} dropped"))
}
