//! Fourth room: what the chosen set says, how sure that is, and how large the errors are.
//!
//! | file | what it does |
//! |---|---|
//! | `alternatives`, `look_alikes` | what could replace a finding, or the general friction law |
//! | `groups` | effects that the recordings cannot tell apart, because the axes of the recordings go together |
//! | `varying_coefficient`, `intervals` | whether the size of an effect is the same everywhere; confidence intervals |
//! | `location` | where on the loop model and recordings differ |
//! | `tables` | errors, candidates, parameters, curves and maps |
//! | `law` | a law read off the recordings where no candidate explains them |
//! | `yardsticks` | the errors of simple models on the same points |
//! | `two_sided` | the model of a device that pushes and pulls, where that is better than a spring |
//! | `left_out` | errors on points that no parameter was fitted to |
//! | `rest` | what the chosen set leaves: structure above the noise, the shape of laws in doubt |
//! | `few_points` | points that are missed by far where all others fit |
//! | `single_sweeps` | what is left of recordings that have no cycle to hold out |
//! | `error_of_form` | how much of what an effect explains may be the error of form of the other laws |
//! | `trust` | the confidence in a named effect |
//! | `plausible` | whether a specimen or rig may have an effect |
//! | `further_names` | takes back names that are not plausible or hardly believed, and a doubtful name beside a sure one |
//! | `delivered` | what is written as the improved model |
//! | `summary` | the diagnosis in a few sentences |
//! | `of_path` | effects of the path, as they were judged before the path was in doubt |
//! | `taken_back` | names whose size is not the same everywhere, or whose knee is only at the upper turning points, are taken back |
//! | `beside_path` | names of speed and time that bring nothing beside every force of the path are taken back |
//! | `verdict` | the diagnosis, but for the next test |

mod alternatives;
mod beside_path;
mod delivered;
mod error_of_form;
mod few_points;
mod further_names;
mod groups;
mod intervals;
mod law;
mod left_out;
mod location;
mod look_alikes;
mod of_path;
mod plausible;
mod rest;
mod single_sweeps;
mod summary;
mod tables;
mod taken_back;
mod trust;
mod two_sided;
mod varying_coefficient;
mod verdict;
mod yardsticks;

pub(in crate::diagnose) use alternatives::{DISTINCT_POWER, JudgedEffect, RivalSet, distinguishable_lack};
pub(in crate::diagnose) use beside_path::confirmed_beside_path;
pub(in crate::diagnose) use left_out::courses;
pub(crate) use left_out::{left_out, nrmse_leftout};
pub(in crate::diagnose) use tables::TESTABLE;
pub(in crate::diagnose) use verdict::{Judgement, Known, conclude, conclude_of_path};
pub(crate) use yardsticks::YARDSTICKS;
pub(in crate::diagnose) use yardsticks::errors as yardstick_errors;

use std::borrow::Cow;

use crate::diagnose::fitting::{Data, FitContext, Node, RunSettings};
use crate::diagnose::search::{DoubtedSearch, SearchResult};

/// The search that is judged, with its data: the second if it explains the recordings, else the first. `plain` is the context of the
/// first search, `base` the baseline that it started from, `refitted` that with its own friction law.
pub(in crate::diagnose) fn search_to_judge<'a>(
    run: &RunSettings,
    plain: &FitContext<'a>,
    [base, refitted]: [&Node; 2],
    first: SearchResult,
    second: Option<DoubtedSearch>,
) -> (Cow<'a, Data>, SearchResult) {
    let explains = |doubted: &DoubtedSearch| {
        let context = run.context(plain.setup, &doubted.data);
        rest::is_explained(&context, &doubted.search, [base, refitted])
    };
    match second.filter(explains) {
        Some(doubted) => (Cow::Owned(doubted.data), doubted.search),
        None => (Cow::Borrowed(plain.data), first),
    }
}
