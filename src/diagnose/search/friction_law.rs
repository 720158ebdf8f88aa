//! Generalises the baseline's friction law before any effect is called missing, so that its shape is not reported as missing
//! physics: which law a model has is its author's choice.

use super::backward_elimination::penalty;
use super::beam_search::{SearchResult, search};
use super::budget::Budget;
use super::lack_of_fit::leaves_structure;
use super::simplest_form::simplify;
use crate::diagnose::fitting::{
    Attached, Data, FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, PENALTY, RunSettings, Setup,
    Tangent, generalise, with_general_law,
};

/// Candidates that are fitted under the baseline's own law, and the number of the best that get the general law afterwards.
const SEEDS_TRIED: usize = 6;
const SEEDS: usize = 3;

/// What the search starts from.
pub(in crate::diagnose) struct SearchStart {
    /// The baseline with its own friction law, refitted.
    pub refitted: Node,
    /// The baseline with the friction law that the search uses: the general one where that is `generalised`.
    pub base: Node,
    pub generalised: bool,
    /// Fits of one effect each, found under the baseline's own friction law.
    pub seeds: Vec<Node>,
}

/// The search with the general friction law that is likeliest, and what it started from; `setup` gets that law. The usual law comes first;
/// another is tried where that leaves structure or effects are named: what the law lacks may have been named as an effect.
pub(super) fn first_search(
    run: &RunSettings,
    setup: &mut Setup,
    data: &Data,
    fitted: &Node,
    budget: Budget,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<(SearchStart, SearchResult)> {
    let plain = setup.clone();
    let mut best = search_with(run, setup, data, (fitted, None), budget, progress)?;
    let others = plain.forms.iter().skip(1).filter(|_| !plain.model.slow);
    for form in others {
        let mut other = plain.clone();
        other.form = Some(form.clone());
        let Some(base) = likelier_base(run, (setup, &best), &other, data) else {
            continue;
        };
        let from = (&best.0.refitted, Some(base));
        let mut again = |_, step: &str| progress(1.0, step);
        let Some(found) = search_with(run, &mut other, data, from, budget, &mut again) else {
            continue;
        };
        let scale = best.1.likelihood;
        let cost = |setup: &Setup, search: &SearchResult| {
            cost_with_law(scale, &search.nodes[search.chosen], setup.extras.len())
        };
        if cost(&other, &found.1) < cost(setup, &best.1) {
            *setup = other;
            best = found;
        }
    }
    Some(best)
}

/// The search from a fitted baseline, with the general law of `setup`, which joins the extras of `setup` where the data support it. That law
/// is fitted here, or was before.
fn search_with(
    run: &RunSettings,
    setup: &mut Setup,
    data: &Data,
    (fitted, general): (&Node, Option<Node>),
    budget: Budget,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<(SearchStart, SearchResult)> {
    let start = search_start(&run.context(setup, data), fitted, general)?;
    if start.generalised {
        setup.extras.clone_from(&start.base.attached);
    }
    let context = run.context(setup, data);
    let mut found = search(&context, start.base.clone(), &start.seeds, budget, progress);
    let chosen = found.chosen;
    simplify(&context, &mut found, chosen);
    Some((start, found))
}

/// Cost of a set in log-likelihood: what it leaves, its effects, and the free parameters of the friction law (the `extras` first effects).
fn cost_with_law(likelihood: LikelihoodScale, node: &Node, extras: usize) -> f64 {
    let free = |a: &Attached| a.parameters.iter().filter(|p| p.is_free()).count() as f64;
    let of_law: f64 = node.attached[..extras].iter().map(free).sum();
    likelihood.gain(node.cost()) + penalty(&node.attached[extras..]) + PARAMETER_PENALTY * of_law
}

/// The baseline with the general law of `other`, if the set that a search chose, or that set without one or all of its effects, is likelier
/// with it. It is asked only where the set leaves structure, or so much more than noise that a law could gain what an effect must, or where
/// effects were named beside a free law.
fn likelier_base(
    run: &RunSettings,
    (setup, (start, search)): (&Setup, &(SearchStart, SearchResult)),
    other: &Setup,
    data: &Data,
) -> Option<Node> {
    let chosen = &search.nodes[search.chosen];
    let skipped = setup.extras.len();
    let named = start.generalised && chosen.attached.len() > skipped;
    // What a law leaves of a random motion, or of the turning points, follows no axis.
    let is_noise = search.likelihood.gain(chosen.cost() - data.counted() as f64) < PENALTY;
    if !named && is_noise && !leaves_structure(data, search.likelihood, chosen) {
        return None;
    }
    let its = run.context(setup, data);
    let context = run.context(other, data);
    let base = with_general_law(&context, &start.refitted)?;
    let with_all_but = |left_out: &Option<usize>| {
        let kept = (skipped..chosen.attached.len()).filter(|k| Some(*k) != *left_out);
        let node = context.with_effects_of(&base, (&its, chosen), &kept.collect::<Vec<_>>())?;
        context.converged(&node).map(|(node, _)| node)
    };
    let left_out: Vec<Option<usize>> = std::iter::once(None)
        .chain((skipped..chosen.attached.len()).map(Some))
        .collect();
    let fitted = context.parallel_map(&left_out, with_all_but);
    let costs = fitted
        .iter()
        .flatten()
        .chain([&base])
        .map(|node| cost_with_law(search.likelihood, node, base.attached.len()));
    let least = costs.fold(f64::INFINITY, f64::min);
    (least < cost_with_law(search.likelihood, chosen, skipped)).then_some(base)
}

/// Refits the baseline, and generalises its friction law where that gains more than an effect must; `general`: as fitted before.
fn search_start(context: &FitContext<'_>, first: &Node, general: Option<Node>) -> Option<SearchStart> {
    let parent = context.converged(first)?;
    let refitted = parent.0.clone();
    let form = context.setup.form.as_ref();
    let general = general.or_else(|| with_general_law(context, &refitted));
    let seeds = match (&general, form) {
        (Some(general), Some(form)) => {
            let own = context.setup.model.parameters.len();
            let fitted = general.values[own..general.values.len() - 1].to_vec();
            seeds(context, parent, (form, fitted))
        }
        _ => Vec::new(),
    };
    Some(SearchStart {
        generalised: general.is_some(),
        base: general.unwrap_or_else(|| refitted.clone()),
        refitted,
        seeds,
    })
}

/// The best single effects on the baseline's own law, with the general law fitted afterwards. A general law that is fitted first
/// adapts to the missing effect and can hide it. The law starts from what it is without the effect.
fn seeds(
    context: &FitContext<'_>,
    parent: (Node, Tangent),
    (form, start): (&Attached, Vec<f64>),
) -> Vec<Node> {
    let starts = [start];
    let mut children = context.children(&[parent], &[], SEEDS_TRIED);
    children.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    children.truncate(SEEDS);
    let general = children.iter().filter_map(|child| {
        let mut node = generalise(context, child, form, &starts)?;
        // The general law comes before the effect, as in all other nodes.
        let (own, added) = (context.setup.model.parameters.len(), node.values.len() - 1);
        node.attached.rotate_right(1);
        node.values[own..added].rotate_right(form.parameters.len());
        Some(node)
    });
    general.collect()
}
