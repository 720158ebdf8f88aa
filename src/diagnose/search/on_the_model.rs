//! The choice on a slow model itself: the search runs on its surrogate, and the sets that matter are fitted again without it.

use super::backward_elimination::{choose, without};
use super::beam_search::{SearchResult, search};
use super::budget::Budget;
use crate::diagnose::fitting::{
    Data, FitContext, Key, LikelihoodScale, Node, RunSettings, Setup, Tangent, expand, refine,
};

/// RMS error, in units of the noise, at which the surrogate is accurate enough at the chosen set: larger than at the baseline,
/// because that set is refitted on the model itself.
const CHOSEN_ERROR: f64 = 0.5;
/// Largest number of searches.
const SEARCHES: usize = 2;
/// Largest number of choices that are confirmed on the model itself, and of rivals per finding.
const CHOICES: usize = 4;
const RIVALS: usize = 4;

/// Repeats the search if the surrogate was not accurate at the chosen set, then chooses on the model itself. The baseline with its
/// own friction law (`refitted`) is refitted on the model too; `base` is the start of the search.
pub(super) fn confirm(
    setup: &mut Setup,
    data: &Data,
    run: &RunSettings,
    (refitted, base): (&mut Node, &Node),
    mut found: SearchResult,
    budget: Budget,
) -> SearchResult {
    for round in 1..=SEARCHES {
        let chosen = found.nodes[found.chosen].clone();
        let error = expand(setup, data, run, &chosen);
        if round == SEARCHES || error.is_none_or(|error| error < CHOSEN_ERROR) {
            break;
        }
        let context = run.context(setup, data);
        let converged = context
            .converged(base)
            .map_or_else(|| base.clone(), |(node, _)| node);
        found = search(&context, converged, &[], budget, &mut |_, _| {});
    }
    let context = run.context(setup, data);
    refit(&context, std::slice::from_mut(refitted), &[0]);
    choose_on_model(&context, &mut found);
    found
}

/// Refits the chosen set and all its subsets on the model itself, and chooses again.
fn choose_on_model(context: &FitContext<'_>, search: &mut SearchResult) {
    let extras = context.setup.extras.len();
    let mut done: Vec<usize> = Vec::new();
    for _ in 0..CHOICES {
        let mut open = vec![search.chosen];
        let mut fresh: Vec<usize> = Vec::new();
        while let Some(i) = open.pop() {
            if done.contains(&i) || fresh.contains(&i) {
                continue;
            }
            fresh.push(i);
            for place in extras..search.nodes[i].attached.len() {
                open.push(without(context, &mut search.nodes, i, place));
            }
        }
        refit(context, &mut search.nodes, &fresh);
        done.extend(fresh);
        search.likelihood = LikelihoodScale::of(context.data, &search.nodes[search.chosen].residuals);
        search.chosen = choose(context, &mut search.nodes, search.likelihood);
        if done.contains(&search.chosen) {
            break;
        }
    }
}

/// Refits the best sets with one effect more than `base` on the model itself, except the chosen one.
pub(in crate::diagnose) fn refit_rivals(context: &FitContext<'_>, search: &mut SearchResult, base: &Key) {
    if context.setup.surrogate.is_none() {
        return;
    }
    let extras = context.setup.extras.len();
    let mut rivals: Vec<usize> = (0..search.nodes.len())
        .filter(|&i| {
            let key = search.nodes[i].key(extras);
            i != search.chosen && key.len() == base.len() + 1 && base.iter().all(|c| key.contains(c))
        })
        .collect();
    rivals.sort_by(|&a, &b| search.nodes[a].cost().total_cmp(&search.nodes[b].cost()));
    rivals.truncate(RIVALS);
    refit(context, &mut search.nodes, &rivals);
}

/// Refits some nodes on the model itself, with the slopes of the surrogate.
fn refit(context: &FitContext<'_>, nodes: &mut [Node], which: &[usize]) {
    let fitted = context.parallel_map(which, |&i| {
        let node = &nodes[i];
        let tangent = Tangent::new(&context.structure(node.attached.clone()), &node.values)?;
        refine(
            &context.structure(node.attached.clone()).exact(),
            &tangent,
            node.values.clone(),
        )
    });
    for (&i, fitted) in which.iter().zip(fitted) {
        if let Some(node) = fitted {
            nodes[i] = node;
        }
    }
}
