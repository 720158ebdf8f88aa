//! Fifth room: the test that separates a finding from its rivals.
//!
//! | file | what it does |
//! |---|---|
//! | `test_profiles` | the tests that the bench can run |
//! | `separation` | how well each of them separates the finding from its rivals |

mod separation;
mod test_profiles;

use crate::diagnose::diagnosis::NextTest;
use crate::diagnose::fitting::FitContext;
use crate::diagnose::judgement::{JudgedEffect, RivalSet};
use crate::diagnose::search::SearchResult;
use separation::{Question, Rival, propose};

/// The test for the first finding that has rivals and that a test can separate from them.
pub(in crate::diagnose) fn plan(
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
