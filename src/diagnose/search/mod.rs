//! Third room: which set of effects explains the data. It is searched with the baseline's friction law made general, and once more
//! with the shape of that law in doubt.
//!
//! | file | what it does |
//! |---|---|
//! | `friction_law` | generalises the baseline's friction law before any effect is called missing |
//! | `beam_search` | beam search over sets of effects |
//! | `grown_law` | laws that get further parameters during the search |
//! | `knees` | whether a knee was recorded, with both its sides |
//! | `budget` | how much of it there may be |
//! | `binning`, `near_replicates`, `lack_of_fit` | the structure that a set leaves, which no candidate explains |
//! | `confounding` | which axes go together over the recorded points |
//! | `backward_elimination` | the set that is chosen: largest penalised gain, then effects that bring too little are removed |
//! | `simplest_form` | shapes of laws that the recordings do not ask for go back to their neutral values |
//! | `on_the_model` | the choice on a slow model itself |
//! | `path_search` | a search for effects of speed and time in which everything that follows from the path is in doubt |
//! | `second_search` | a search in which the shape of the friction law is in doubt |

mod backward_elimination;
mod beam_search;
mod binning;
mod budget;
mod confounding;
mod friction_law;
mod grown_law;
mod knees;
mod lack_of_fit;
mod near_replicates;
mod on_the_model;
mod path_search;
mod second_search;
mod simplest_form;

pub(in crate::diagnose) use backward_elimination::{left_as_it_is, penalty, without};
pub(in crate::diagnose) use beam_search::SearchResult;
pub(in crate::diagnose) use binning::{AXES, BinnedAxis, binned, coordinate};
pub(in crate::diagnose) use confounding::{
    AxisPoint, axis_in_words, confounding, go_together, recorded_points,
};
pub(in crate::diagnose) use grown_law::with_a_part_more;
pub(in crate::diagnose) use knees::{kink_is_recorded, kinks_are_recorded, kinks_at_the_top};
pub(in crate::diagnose) use lack_of_fit::{
    LACK_GAIN, LACK_POWER, LackOfFit, beyond_friction, lack_of_fit, rest,
};
pub(in crate::diagnose) use on_the_model::refit_rivals;
pub(in crate::diagnose) use path_search::PathSearch;
pub(in crate::diagnose) use second_search::{DoubtedSearch, in_doubt};
pub(in crate::diagnose) use simplest_form::simplify;

use crate::diagnose::fitting::{Data, Node, RunSettings, Setup};
use budget::Budget;
use friction_law::SearchStart;

/// Share of the budget after which the first search compares no larger sets: what is in doubt needs the rest.
const FIRST_SHARE: f64 = 0.4;

/// The searches, with what they started from.
pub(in crate::diagnose) struct Searches {
    pub start: SearchStart,
    pub first: SearchResult,
    /// `None` where the friction law is not in doubt, or the doubt makes the search no better.
    pub second: Option<DoubtedSearch>,
    /// `None` where no law is in doubt.
    pub path: Option<PathSearch>,
}

/// Searches from the fitted baseline (`fitted`); `None` if the model has no finite force. `progress` gets the share of the diagnosis.
pub(in crate::diagnose) fn searches(
    run: &RunSettings,
    setup: &mut Setup,
    data: &Data,
    fitted: &Node,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<Searches> {
    let budget = Budget::up_to(FIRST_SHARE);
    let (mut start, mut first) =
        friction_law::first_search(run, setup, data, fitted, budget, &mut |share, step| {
            progress(0.15 + 0.6 * share, step);
        })?;
    if setup.model.slow {
        progress(0.75, "refitting the best sets on the model itself");
        let fits = (&mut start.refitted, &start.base);
        first = on_the_model::confirm(setup, data, run, fits, first, budget);
    }
    let second = second_search::search_again(run, setup, data, &start, &first, &mut |share, step| {
        progress(0.75 + 0.03 * share, step);
    });
    let path = path_search::path_search(run, setup, data, &first, second.as_ref(), &mut |share, step| {
        progress(0.78 + 0.02 * share, step);
    });
    Some(Searches {
        start,
        first,
        second,
        path,
    })
}
