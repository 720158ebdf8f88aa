//! Rows about the NMT states: what flows in each, and what is taken. Nothing moves.

use super::probe::{Probe, same};
use super::row::CheckRow;
use crate::protocol::message::{
    FromRig, LIMITS, Limits, NmtCommand, NmtState, RequestCode, RequestResult, RigState, ToRig, object,
};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "nmt-pre-operational",
        section: "2",
        title: "pre-operational: HEARTBEAT and answers only, requests ignored",
        moves: false,
        check: pre_operational,
    },
    CheckRow {
        id: "nmt-start",
        section: "2",
        title: "NMT start: SAMPLE, STATUS, heartbeat 0x05",
        moves: false,
        check: start,
    },
    CheckRow {
        id: "nmt-stop",
        section: "2",
        title: "NMT stop in off: samples go on, heartbeat 0x04, state off",
        moves: false,
        check: stop,
    },
    CheckRow {
        id: "nmt-stop-arm",
        section: "2",
        title: "a stopped rig refuses arm until NMT start",
        moves: false,
        check: stop_refuses_arm,
    },
    CheckRow {
        id: "nmt-other-node",
        section: "2",
        title: "NMT to another node changes nothing",
        moves: false,
        check: other_node,
    },
    CheckRow {
        id: "heartbeat-period",
        section: "10",
        title: "HEARTBEAT every 100 ms",
        moves: false,
        check: heartbeat_period,
    },
    CheckRow {
        id: "reset-node",
        section: "2",
        title: "reset node in off: boot-up, another boot id, default limits",
        moves: false,
        check: reset_node,
    },
];

fn is_stream(message: &FromRig) -> bool {
    matches!(message, FromRig::Sample(_) | FromRig::Status(_))
}

fn pre_operational(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    probe.keeps_lease = false;
    probe.pass(100);
    probe.network(NmtCommand::PreOperational);
    probe.expect_heartbeat(NmtState::PreOperational)?;
    let from = probe.heard.len();
    let ignored = probe.next_request(probe.session, RequestCode::OpenSession, 0);
    probe.send(ToRig::Request(ignored));
    probe.pass(300);
    let streamed = probe
        .heard
        .iter()
        .skip(from)
        .filter(|heard| is_stream(&heard.message));
    same("SAMPLE and STATUS in pre-operational", streamed.count(), 0)?;
    let beats = probe.heard.iter().skip(from).filter(|heard| {
        heard.message
            == FromRig::Heartbeat {
                state: NmtState::PreOperational,
            }
    });
    if beats.count() < 2 {
        return Err("fewer than 2 HEARTBEATs in 300 ms".to_owned());
    }
    probe.read(object::SAMPLE_RATE)?;
    probe.start()?;
    let status = probe.status().ok_or("no STATUS")?;
    if status.ack_counter == ignored.counter || status.session != 0 {
        return Err("a request sent in pre-operational was carried out".to_owned());
    }
    Ok("quiet, configuration answered".to_owned())
}

fn start(probe: &mut Probe) -> Result<String, String> {
    probe.network(NmtCommand::Start);
    probe.expect_status(20, "STATUS after NMT start", |_| true)?;
    probe.expect(20, "SAMPLE after NMT start", |m| matches!(m, FromRig::Sample(_)))?;
    probe.expect_heartbeat(NmtState::Operational)?;
    Ok("heartbeat 0x05".to_owned())
}

fn stop(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    probe.network(NmtCommand::Stop);
    probe.expect_heartbeat(NmtState::Stopped)?;
    let from = probe.heard.len();
    probe.pass(100);
    let kinds = |is_it: fn(&FromRig) -> bool| {
        probe
            .heard
            .iter()
            .skip(from)
            .filter(|h| is_it(&h.message))
            .count()
    };
    let samples = kinds(|m| matches!(m, FromRig::Sample(_)));
    let statuses = kinds(|m| matches!(m, FromRig::Status(_)));
    let (state, _) = probe.now()?;
    probe.start()?;
    if samples < 50 || statuses < 1 {
        return Err(format!("{samples} SAMPLE and {statuses} STATUS in 100 ms"));
    }
    same("state", state, RigState::Off)?;
    Ok(format!("{samples} samples in 100 ms"))
}

fn stop_refuses_arm(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    probe.write_limits(&Limits::defaults())?;
    probe.network(NmtCommand::Stop);
    probe.pass(20);
    // A wrong CRC-32, so that no firmware switches its pressure on here, and the right state would be told first.
    let result = probe.request(RequestCode::Arm, !Limits::defaults().crc32())?;
    probe.start()?;
    same("result of arm", result, RequestResult::WrongState)?;
    Ok("wrong_state".to_owned())
}

fn other_node(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let node = probe.node % 126 + 1;
    probe.send(ToRig::Nmt {
        command: NmtCommand::Stop,
        node,
    });
    probe.pass(150);
    probe.expect_heartbeat(NmtState::Operational)?;
    Ok(format!("node {node} stopped, this one operational"))
}

fn heartbeat_period(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let from = probe.heard.len();
    probe.pass(1_050);
    let beats: Vec<i64> = probe
        .heard
        .iter()
        .skip(from)
        .filter(|heard| matches!(heard.message, FromRig::Heartbeat { .. }))
        .map(|heard| heard.tick)
        .collect();
    let periods: Vec<i64> = beats.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (shortest, longest) = (periods.iter().min(), periods.iter().max());
    match (shortest, longest) {
        (Some(&shortest), Some(&longest))
            if (90..=110).contains(&shortest) && (90..=110).contains(&longest) =>
        {
            Ok(format!("{shortest} to {longest} ms"))
        }
        _ => Err(format!("periods {periods:?} ms")),
    }
}

fn reset_node(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let boot = probe.read(object::BOOT_ID)?;
    probe
        .try_write((object::LIMITS, 1), 31_415)?
        .map_err(|abort| format!("a limit was refused ({abort:?})"))?;
    probe.keeps_lease = false;
    probe.network(NmtCommand::ResetNode);
    probe.expect(5_000, "boot-up HEARTBEAT", |message| {
        *message
            == FromRig::Heartbeat {
                state: NmtState::BootUp,
            }
    })?;
    probe.forget_ticks();
    probe.expect_heartbeat(NmtState::PreOperational)?;
    let after = probe.read(object::BOOT_ID)?;
    if after == boot {
        return Err(format!("the boot id is {boot} again"));
    }
    for (i, limit) in LIMITS.iter().enumerate() {
        let value = probe.read((object::LIMITS, i as u8 + 1))? as i32;
        same(&format!("{} after the boot", limit.name), value, limit.default)?;
    }
    probe.start()?;
    let status = probe.status().ok_or("no STATUS")?;
    same("boot id in STATUS", status.boot, after as u8)?;
    same("acknowledged request after the boot", status.ack_counter, 15)?;
    Ok(format!("boot id {boot} -> {after}"))
}
