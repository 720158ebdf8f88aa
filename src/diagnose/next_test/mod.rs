//! Fifth room: the test that tells most: it separates a finding from its rivals, else the axes of what no name explains, else it shows
//! what the recordings cannot.
//!
//! | file | what it does |
//! |---|---|
//! | `test_profiles` | the tests that the bench can run |
//! | `separation` | how well each of them separates the finding from its rivals |
//! | `separated_axes` | the test that separates the axes of a located difference, where no name or several explain it |
//! | `repeated_ramp` | the test for a difference that only a single sweep shows |
//! | `testability` | the test that shows effects that the recordings cannot |

mod repeated_ramp;
mod separated_axes;
mod separation;
mod test_profiles;
mod testability;

use crate::diagnose::diagnosis::{Diagnosis, NextTest, Verdict};
use crate::diagnose::fitting::FitContext;
use crate::diagnose::judgement::{JudgedEffect, Judgement, RivalSet};
use crate::diagnose::search::SearchResult;
use separation::{Question, Rival, propose};

/// The diagnosis with the test to run next, or with the reason why there is none.
pub(in crate::diagnose) fn planned(context: &FitContext<'_>, judgement: Judgement) -> Diagnosis {
    let Judgement {
        mut diagnosis,
        search,
        effects,
    } = judgement;
    match plan(context, &search, &effects, &diagnosis) {
        Ok(test) => diagnosis.next_test = test,
        Err(why) => diagnosis.no_next_test = Some(why),
    }
    diagnosis
}

/// What is open is asked in the order of its urgency: a single sweep, the unknown, rivals, a group, what could not be tested.
fn plan(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
    diagnosis: &Diagnosis,
) -> Result<Option<NextTest>, String> {
    let chosen = &search.nodes[search.chosen];
    let unexplained = diagnosis.verdict == Verdict::Unexplained;
    if let Some(recording) = &diagnosis.single_sweep
        && let Some(test) = repeated_ramp::propose(context, chosen, recording)
    {
        return Ok(Some(test));
    }
    if unexplained {
        return separated_axes::propose(context, chosen, &diagnosis.location).map(Some);
    }
    if let Some(test) = against_rivals(context, search, judged) {
        return Ok(Some(test));
    }
    if diagnosis.settled().is_none() {
        // A group without a rival: the place is searched as if nothing were named. Rivals that no test separates need a physical check.
        let grouped = judged.iter().any(|j| !j.group.is_empty());
        let test = grouped.then(|| separated_axes::propose(context, chosen, &diagnosis.location));
        return Ok(test.and_then(Result::ok));
    }
    let codes: Vec<String> = diagnosis.not_testable.iter().map(|n| n.code.clone()).collect();
    testability::propose(context, chosen, &codes)
}

/// The test for the first finding that has rivals and that a test can separate from them.
fn against_rivals(
    context: &FitContext<'_>,
    search: &SearchResult,
    judged: &[JudgedEffect],
) -> Option<NextTest> {
    let rival = |code, node: usize, lack| Rival {
        code,
        node: &search.nodes[node],
        lack,
    };
    let chosen = &search.nodes[search.chosen];
    judged.iter().filter(|j| !j.rivals.is_empty()).find_map(|j| {
        let of_set = |r: &RivalSet| rival(r.code, r.node, r.lack);
        let question = Question {
            chosen,
            code: chosen.attached[j.place].effect.code,
            without: rival("nothing", j.without, j.loss),
            rivals: j.rivals.iter().map(of_set).collect(),
        };
        propose(context, &question)
    })
}
