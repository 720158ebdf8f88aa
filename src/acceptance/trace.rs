//! The loops that are drawn of a run: thinned, and broken where samples are missing or not usable.

use super::RunResult;
use super::measure::is_of_the_profile;
use crate::recording::run_file::RunFile;
use crate::recording::{Flags, Sample};

/// Most points of one loop.
const MOST_POINTS: u64 = 600;

/// One loop to draw. Where it is broken, a point has numbers that are not finite.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoopTrace {
    /// What it shows: "cycle 3", "whole motion".
    pub name: String,
    /// Displacement in mm, force in N.
    pub measured: Vec<(f64, f64)>,
    /// Displacement in mm, force of the twin in N.
    pub twin: Vec<(f64, f64)>,
}

const BREAK: (f64, f64) = (f64::NAN, f64::NAN);

/// The first and the last complete counted cycle, or the whole motion of a profile that counts none.
pub(crate) fn traces(run: &RunFile, result: &RunResult) -> Vec<LoopTrace> {
    let loops = result.loops();
    if result.cycles_planned == 0 {
        return loops
            .first()
            .map(|_| traced("whole motion".to_owned(), run, &is_of_the_profile))
            .into_iter()
            .collect();
    }
    let mut cycles: Vec<u32> = [loops.first(), loops.last()]
        .into_iter()
        .flatten()
        .map(|row| row.cycle)
        .collect();
    cycles.dedup();
    let survey = run.survey();
    let spans = cycles.into_iter().filter_map(|cycle| survey.span_of(cycle));
    spans
        .map(|span| traced(format!("cycle {}", span.cycle), run, &|s| span.has(s)))
        .collect()
}

fn traced(name: String, run: &RunFile, takes: &dyn Fn(&Sample) -> bool) -> LoopTrace {
    let number = run.samples().filter(|s| takes(s)).count() as u64;
    let every = number.div_ceil(MOST_POINTS).max(1);
    let mut trace = LoopTrace {
        name,
        measured: Vec::new(),
        twin: Vec::new(),
    };
    // The tick of the sample before, and whether a piece of the motion is missing since the last point.
    let (mut before, mut broken) = (None, false);
    let samples = run.samples().filter(|s| takes(s));
    for (i, sample) in samples.enumerate() {
        broken |= before.is_some_and(|tick| sample.tick != tick + 1);
        before = Some(sample.tick);
        if sample.flags.intersects(Flags::UNUSABLE) {
            broken = true;
            continue;
        }
        if !(i as u64).is_multiple_of(every) && !broken {
            continue;
        }
        if std::mem::take(&mut broken) && !trace.measured.is_empty() {
            trace.measured.push(BREAK);
            trace.twin.push(BREAK);
        }
        trace.measured.push((sample.displacement_mm, sample.force_n));
        let twin = sample.twin_force_n.map(|force| (sample.displacement_mm, force));
        trace.twin.push(twin.unwrap_or(BREAK));
    }
    trace
}
