//! Rows about the stream: SAMPLE, STATUS, their counters and periods. Nothing moves.

use super::probe::{Probe, same};
use super::row::CheckRow;
use crate::protocol::message::{FromRig, RequestCode, SampleMessage, next_counter, object};

pub(super) const ROWS: &[CheckRow] = &[
    CheckRow {
        id: "sample-ticks",
        section: "2",
        title: "one SAMPLE for each tick",
        moves: false,
        check: sample_ticks,
    },
    CheckRow {
        id: "counters",
        section: "3",
        title: "the counters of SAMPLE and STATUS count 0 to 14",
        moves: false,
        check: counters,
    },
    CheckRow {
        id: "status-period",
        section: "2",
        title: "STATUS every 10 ms",
        moves: false,
        check: status_period,
    },
    CheckRow {
        id: "status-at-once",
        section: "2",
        title: "STATUS at once on a request",
        moves: false,
        check: status_at_once,
    },
    CheckRow {
        id: "boot-in-status",
        section: "2",
        title: "STATUS carries the low 8 bits of the boot id",
        moves: false,
        check: boot_in_status,
    },
];

/// Time that the stream is watched, ms.
const WATCHED_MS: i64 = 2_000;
/// Requests whose answers are counted.
const REQUESTS: usize = 10;

fn samples(probe: &Probe, from: usize) -> Vec<SampleMessage> {
    let sample = |message: &FromRig| match *message {
        FromRig::Sample(sample) => Some(sample),
        _ => None,
    };
    probe
        .heard
        .iter()
        .skip(from)
        .filter_map(|heard| sample(&heard.message))
        .collect()
}

fn sample_ticks(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let from = probe.heard.len();
    probe.pass(WATCHED_MS);
    let samples = samples(probe, from);
    let breaks: Vec<String> = samples
        .windows(2)
        .filter(|pair| pair[1].tick != pair[0].tick.wrapping_add(1))
        .map(|pair| format!("{} -> {}", pair[0].tick, pair[1].tick))
        .collect();
    match breaks.first() {
        None => Ok(format!("{} samples without a gap", samples.len())),
        Some(first) => Err(format!(
            "{} gaps in {} samples, the first {first}",
            breaks.len(),
            samples.len()
        )),
    }
}

fn counters(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let from = probe.heard.len();
    probe.pass(WATCHED_MS);
    let in_order = |counters: Vec<u8>, what: &str| match counters
        .windows(2)
        .find(|pair| pair[1] != next_counter(pair[0]))
    {
        None => Ok(counters.len()),
        Some(pair) => Err(format!("counter of {what}: {} after {}", pair[1], pair[0])),
    };
    let of_samples = in_order(samples(probe, from).iter().map(|s| s.counter).collect(), "SAMPLE")?;
    let of_statuses = in_order(probe.statuses(from).map(|(s, _)| s.counter).collect(), "STATUS")?;
    Ok(format!("{of_samples} SAMPLE, {of_statuses} STATUS"))
}

fn status_period(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let from = probe.heard.len();
    probe.pass(WATCHED_MS);
    let ticks: Vec<i64> = probe.statuses(from).map(|(_, tick)| tick).collect();
    let longest = ticks.windows(2).map(|pair| pair[1] - pair[0]).max();
    match longest {
        Some(longest) if longest <= 11 => Ok(format!("{} in 2 s, {longest} ms apart at most", ticks.len())),
        Some(longest) => Err(format!("{longest} ms between two STATUS")),
        None => Err("no STATUS in 2 s".to_owned()),
    }
}

/// STATUS frames that come because of `send`: their number while it is called some times, minus their number in the same time
/// without.
pub(super) fn statuses_due_to(probe: &mut Probe, mut send: impl FnMut(&mut Probe)) -> Result<String, String> {
    let mut counts = [0; 2];
    for (count, sends) in counts.iter_mut().zip([false, true]) {
        let from = probe.heard.len();
        for _ in 0..REQUESTS {
            if sends {
                send(probe);
            }
            // Not a multiple of the period, so that each answer falls elsewhere in it.
            probe.pass(23);
        }
        *count = probe.statuses(from).count();
    }
    let [before, during] = counts;
    let seen = format!("{during} STATUS instead of {before} with {REQUESTS} frames");
    // Some answers coincide with a periodic STATUS, or the period starts anew with them.
    if during >= before + REQUESTS - 4 {
        Ok(seen)
    } else {
        Err(seen)
    }
}

fn status_at_once(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    // Resume is refused in off, so these requests change nothing.
    statuses_due_to(probe, |probe| probe.send_request(RequestCode::Resume))
}

fn boot_in_status(probe: &mut Probe) -> Result<String, String> {
    probe.rest()?;
    let boot = probe.read(object::BOOT_ID)?;
    let status = probe.status().ok_or("no STATUS")?;
    same("boot in STATUS", status.boot, boot as u8)?;
    Ok(format!("{boot}"))
}
