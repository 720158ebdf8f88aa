//! The search for effects of speed and time. Every force that follows from the path of the displacement alone is given away, so it needs
//! no friction law and no spring's curve, and it says nothing about effects of the path.

use super::beam_search::{SearchResult, search};
use super::budget::Budget;
use super::lack_of_fit::leaves_structure;
use super::second_search::{DoubtedSearch, at_likeliest_scale, cost, of_set};
use crate::diagnose::fitting::{Attached, Data, Doubt, Node, RunSettings, Setup};

/// A search with every force in doubt that follows from the path, and what it ran on.
pub(in crate::diagnose) struct PathSearch {
    /// Its extras have the effects of the path that an earlier search chose; its candidates are effects of speed and time.
    pub setup: Setup,
    pub data: Data,
    pub search: SearchResult,
    /// True where it is likelier than what was found before.
    pub likelier: bool,
}

/// Searches for effects of speed and time where a law is in doubt: where the second search was likelier than the first, or the first
/// leaves structure.
pub(super) fn path_search(
    run: &RunSettings,
    setup: &Setup,
    data: &Data,
    first: &SearchResult,
    second: Option<&DoubtedSearch>,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<PathSearch> {
    let (before, known, freedom_before) =
        second.map_or((first, data, 0.0), |s| (&s.search, &s.data, s.freedom));
    let chosen = &before.nodes[before.chosen];
    if setup.model.slow || (second.is_none() && !leaves_structure(data, before.likelihood, chosen)) {
        return None;
    }
    let (kept, values) = of_the_path(setup, chosen);
    let mut setup_of_path = setup.clone();
    setup_of_path.extras.clone_from(&kept);
    setup_of_path.candidates.retain(|c| !c.effect.follows_path);
    let plain = run.context(&setup_of_path, data);
    let node = plain.converged(&Node::new(&plain.structure(kept), values)?)?.0;
    let whole = of_set(&plain, &node, Doubt::Path)?;
    let sets = std::slice::from_ref(&node);
    let doubted = at_likeliest_scale(run, &setup_of_path, data, &whole, sets)?;
    let context = run.context(&setup_of_path, &doubted.data);
    let search = search(&context, doubted.chosen, &[], Budget::up_to(1.0), progress);
    let gain = search.likelihood.gain(1.0);
    let freedom = doubted.data.discrepancy.as_ref()?.freedom(gain);
    let cost_before = cost(
        &run.context(setup, known),
        search.likelihood,
        chosen,
        freedom_before,
    );
    // As extras, the kept effects are not in its cost, but they are in that of the search before.
    let kept = &setup_of_path.extras[setup.extras.len()..];
    let found = &search.nodes[search.chosen];
    let cost = cost(&context, search.likelihood, found, freedom) + super::penalty(kept);
    Some(PathSearch {
        setup: setup_of_path,
        data: doubted.data,
        search,
        likelier: cost < cost_before,
    })
}

/// The baseline and the effects of a set that follow from the path, with their values.
fn of_the_path(setup: &Setup, node: &Node) -> (Vec<Attached>, Vec<f64>) {
    let (mut kept, mut from) = (Vec::new(), setup.model.parameters.len());
    let mut values = node.values[..from].to_vec();
    for (k, attached) in node.attached.iter().enumerate() {
        let to = from + attached.parameters.len();
        if k < setup.extras.len() || attached.effect.follows_path {
            kept.push(attached.clone());
            values.extend(&node.values[from..to]);
        }
        from = to;
    }
    values.extend(&node.values[from..]);
    (kept, values)
}
