//! Compares the values of a run with the limits of its profile.

use super::measure::{points, slope};
use super::{CycleRow, LimitResult, LimitVerdict, RunResult, RunVerdict, with_unit};
use crate::profile::accept::{AcceptLimit, CycleValue, JudgedValue, LimitSide, SampleCount};
use crate::recording::Ending;

/// What was measured for one limit.
struct Found {
    measured: Option<f64>,
    at_cycle: Option<u32>,
    /// What is missing for a verdict, in words; empty if nothing is.
    missing: String,
}

/// Judges one limit. A broken limit is broken whatever is missing; a limit is kept only if everything that it is about was
/// recorded.
pub(super) fn judge(limit: &AcceptLimit, result: &RunResult) -> LimitResult {
    let found = match limit.judged {
        JudgedValue::Cycle(value) => worst_cycle(value, limit, result),
        JudgedValue::Trend(value) => trend(value, limit, result),
        JudgedValue::Samples(count) => number_of_samples(count, result),
    };
    let broken = found.measured.is_some_and(|measured| match limit.side {
        LimitSide::Min => measured < limit.limit,
        LimitSide::Max => measured > limit.limit,
    });
    // The slope through some of the cycles is not that through all of them.
    let counts = found.missing.is_empty() || !matches!(limit.judged, JudgedValue::Trend(_));
    let verdict = match (broken && counts, found.missing.is_empty()) {
        (true, _) => LimitVerdict::Fail,
        (false, true) => LimitVerdict::Pass,
        (false, false) => LimitVerdict::NotJudged,
    };
    LimitResult {
        key: limit.key.to_owned(),
        what: limit.judged.words(),
        side: limit.side,
        limit: limit.limit,
        unit: limit.judged.unit().to_owned(),
        cycles: match limit.judged {
            JudgedValue::Samples(_) => None,
            _ => limit
                .cycles
                .or((result.cycles_planned > 0).then_some([1, result.cycles_planned])),
        },
        measured: found.measured,
        at_cycle: found.at_cycle,
        verdict,
        why: match verdict {
            LimitVerdict::NotJudged => found.missing,
            _ => String::new(),
        },
    }
}

/// The loops that a limit is about, and what is missing of them.
fn loops_of<'a>(limit: &AcceptLimit, result: &'a RunResult) -> (Vec<&'a CycleRow>, String) {
    if result.cycles_planned == 0 {
        let missing = match &result.whole {
            None => "no sample of the motion is usable",
            Some(row) if !row.complete => "the motion did not run to its end",
            Some(_) => "",
        };
        return (result.loops(), missing.to_owned());
    }
    let [from, to] = limit.cycles.unwrap_or([1, result.cycles_planned]);
    if to < result.first_cycle {
        let missing = format!(
            "the run began at cycle {}: cycles {from} to {to} are in the run that it resumes",
            result.first_cycle
        );
        return (Vec::new(), missing);
    }
    let from = from.max(result.first_cycle);
    let mut loops = result.loops();
    loops.retain(|row| (from..=to).contains(&row.cycle));
    let wanted = (to - from + 1) as usize;
    let missing = match loops.len() {
        complete if complete < wanted => {
            format!("{complete} of {wanted} cycles from {from} to {to} are complete")
        }
        _ => String::new(),
    };
    (loops, missing)
}

/// The cycle whose value is nearest to the limit, or farthest beyond it.
fn worst_cycle(value: CycleValue, limit: &AcceptLimit, result: &RunResult) -> Found {
    let (loops, mut missing) = loops_of(limit, result);
    let with_value: Vec<(u32, f64)> = loops
        .iter()
        .filter_map(|row| Some((row.cycle, row.value(value)?)))
        .collect();
    let worst = match limit.side {
        LimitSide::Min => with_value.iter().min_by(|a, b| a.1.total_cmp(&b.1)),
        LimitSide::Max => with_value.iter().max_by(|a, b| a.1.total_cmp(&b.1)),
    };
    if missing.is_empty() && with_value.len() < loops.len() {
        missing = match value {
            CycleValue::TwinNrmse => "the twin was off or late".to_owned(),
            _ => format!("not every loop has a {}", value.words()),
        };
    }
    Found {
        measured: worst.map(|(_, value)| *value),
        at_cycle: worst.map(|(cycle, _)| *cycle).filter(|cycle| *cycle > 0),
        missing,
    }
}

fn trend(value: CycleValue, limit: &AcceptLimit, result: &RunResult) -> Found {
    let (loops, mut missing) = loops_of(limit, result);
    let points = points(&loops, value);
    let measured = slope(&points);
    if missing.is_empty() && (measured.is_none() || points.len() < loops.len()) {
        missing = format!(
            "{} of {} cycles have a {}",
            points.len(),
            loops.len(),
            value.words()
        );
    }
    Found {
        measured,
        at_cycle: None,
        missing,
    }
}

fn number_of_samples(count: SampleCount, result: &RunResult) -> Found {
    let number = match count {
        SampleCount::Lost => result.lost,
        SampleCount::Late => result.late,
        SampleCount::Flagged => result.flagged,
    };
    let missing = match result.ending {
        Some(Ending::Completed) => "",
        _ => "the run did not run to its end",
    };
    Found {
        measured: Some(number as f64),
        at_cycle: None,
        missing: missing.to_owned(),
    }
}

/// The verdict on all limits together, and a sentence.
pub(super) fn verdict(result: &RunResult) -> (RunVerdict, String) {
    let all = result.limits.len();
    let of = |verdict: LimitVerdict| {
        result
            .limits
            .iter()
            .filter(|l| l.verdict == verdict)
            .collect::<Vec<_>>()
    };
    let (broken, open) = (of(LimitVerdict::Fail), of(LimitVerdict::NotJudged));
    let first = |limits: &[&LimitResult], tell: fn(&LimitResult) -> String| {
        let more = match limits.len() {
            1 => String::new(),
            n => format!(", and {} more", n - 1),
        };
        limits.first().map_or(String::new(), |l| tell(l)) + &more
    };
    if all == 0 {
        return (RunVerdict::NoLimits, "the profile has no accept block".to_owned());
    }
    if !broken.is_empty() {
        let told = first(&broken, |l| {
            let measured = l.measured.map_or(String::new(), |m| with_unit(m, &l.unit));
            format!("{}, measured {measured}", l.words())
        });
        let why = format!("{} of {all} limits broken: {told}", broken.len());
        return (RunVerdict::Fail, why);
    }
    let not_whole = match (result.ending, result.problem.as_str()) {
        (None, _) => "the run has no end yet",
        (Some(Ending::Completed), "") => "",
        (Some(Ending::Completed), problem) => problem,
        (Some(Ending::Stopped), _) => "the run was stopped",
        (Some(Ending::Aborted), _) => "the run was aborted",
    };
    match (not_whole, open.is_empty()) {
        ("", true) => (
            RunVerdict::Pass,
            format!("{all} limit{} kept", if all == 1 { " is" } else { "s are" }),
        ),
        ("", false) => {
            let told = first(&open, |l| format!("{} ({})", l.what, l.why));
            (
                RunVerdict::NotJudged,
                format!("{} of {all} limits could not be judged: {told}", open.len()),
            )
        }
        (why, _) => (
            RunVerdict::NotJudged,
            format!("{why}, and no limit is broken so far"),
        ),
    }
}
