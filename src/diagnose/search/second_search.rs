//! The second search: the model may deviate by the terms of [`Discrepancy`], so that its error of shape is not named as further physics.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::backward_elimination::{penalty, without};
use super::beam_search::{SearchResult, search};
use super::budget::Budget;
use super::friction_law::SearchStart;
use super::lack_of_fit::{LACK_GAIN, LACK_POWER};
use super::simplest_form;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{
    Data, Discrepancy, Doubt, FitContext, LikelihoodScale, Node, RunSettings, Setup,
};

/// Scales of the friction's terms that are compared, in units of the largest; the smallest first.
const SCALES: [f64; 4] = [0.03, 0.1, 0.3, 1.0];

/// What is in doubt, and the share of the budget after which that search compares no larger sets. The first was 0.6 before laws could grow.
/// In a pack that was looked at, the two searches before took 4 % of the budget each for that, and 0.6 ended this search at pairs. At half,
/// it compares single effects only; at double, these searches have no limit of their own.
const DOUBTS: [(Doubt, f64); 2] = [(Doubt::Friction, 0.7), (Doubt::FrictionAndCurve, 0.8)];

/// A search with the discrepancy, and the data that it ran on.
pub(in crate::diagnose) struct DoubtedSearch {
    pub data: Data,
    pub search: SearchResult,
    /// What the freedom of the discrepancy costs in log-likelihood.
    pub(super) freedom: f64,
}

/// Searches again with the shape of the friction law in doubt, then with the spring's curve in doubt as well: each where
/// [`is_asked_for`]. `None` if no result is likelier than the first.
pub(super) fn search_again(
    run: &RunSettings,
    setup: &Setup,
    data: &Data,
    start: &SearchStart,
    first: &SearchResult,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<DoubtedSearch> {
    if setup.model.slow {
        return None;
    }
    let mut best: Option<DoubtedSearch> = None;
    for (doubt, share) in DOUBTS {
        let (before, known, freedom_before) = best
            .as_ref()
            .map_or((first, data, 0.0), |b| (&b.search, &b.data, b.freedom));
        let whole = of_set(&run.context(setup, data), &first.nodes[first.chosen], doubt)?;
        let sets = chosen_and_without_one(&run.context(setup, known), before);
        let Some(doubted) = at_likeliest_scale(run, setup, data, &whole, &sets) else {
            continue;
        };
        let context = run.context(setup, &doubted.data);
        if !is_asked_for(&context, (before, freedom_before), &doubted, doubt) {
            continue;
        }
        let budget = Budget::up_to(share);
        let Some((search, freedom)) = doubted_search(&context, start, first, budget, progress) else {
            continue;
        };
        let cost = |result: &SearchResult, freedom: f64| {
            let node = &result.nodes[result.chosen];
            cost(&context, search.likelihood, node, freedom)
        };
        if cost(&search, freedom) < cost(before, freedom_before) {
            best = Some(DoubtedSearch {
                data: doubted.data,
                search,
                freedom,
            });
        }
    }
    best
}

/// What a set leaves, its effects and the freedom of a discrepancy cost in log-likelihood.
pub(super) fn cost(context: &FitContext<'_>, likelihood: LikelihoodScale, node: &Node, freedom: f64) -> f64 {
    likelihood.gain(node.cost()) + penalty(&node.attached[context.setup.extras.len()..]) + freedom
}

/// The set that a search chose, then that set without each of its effects.
fn chosen_and_without_one(context: &FitContext<'_>, of: &SearchResult) -> Vec<Node> {
    let mut nodes = of.nodes.clone();
    let places = context.setup.extras.len()..nodes[of.chosen].attached.len();
    let smaller: Vec<usize> = places
        .map(|place| without(context, &mut nodes, of.chosen, place))
        .collect();
    let sets = std::iter::once(of.chosen).chain(smaller);
    sets.map(|i| nodes[i].clone()).collect()
}

/// Data with a discrepancy, and what is known of it before a search.
pub(super) struct DoubtedData {
    pub data: Data,
    /// The set that the search before chose, refitted.
    pub chosen: Node,
    likelihood: LikelihoodScale,
    /// Cost of the likeliest set.
    cost: f64,
}

/// The discrepancy at the scale at which the likeliest of some sets is likeliest (empirical Bayes). At one fixed scale, a law that is
/// nearly right pays for freedom that it does not use, and a further name is cheaper than the doubt. The cost falls towards one scale and
/// rises beyond it, so larger scales are tried until it rises.
pub(super) fn at_likeliest_scale(
    run: &RunSettings,
    setup: &Setup,
    data: &Data,
    whole: &Discrepancy,
    sets: &[Node],
) -> Option<DoubtedData> {
    let mut likeliest: Option<(Data, Vec<Node>)> = None;
    let mut likelihood = None;
    for scale in SCALES {
        let discrepancy = whole.scaled(scale, &data.split)?;
        let mut doubted = data.clone();
        doubted.discrepancy = Some(Arc::new(discrepancy));
        let context = run.context(setup, &doubted);
        // Each scale starts from the fits of the one before.
        let starts = likeliest.as_ref().map_or(sets, |(_, fitted)| fitted);
        let fitted: Vec<Node> = context
            .parallel_map(starts, |set| context.converged(set).map(|(node, _)| node))
            .into_iter()
            .collect::<Option<_>>()?;
        // Two scales are compared by what the larger one leaves, because it explains more.
        let of_larger = LikelihoodScale::of(&doubted, &fitted[0].residuals);
        likelihood = Some(of_larger);
        let cost =
            |(data, fitted): &(Data, Vec<Node>)| least_cost(&run.context(setup, data), of_larger, fitted);
        let larger = (doubted, fitted);
        if likeliest
            .as_ref()
            .is_some_and(|known| cost(known) <= cost(&larger))
        {
            break;
        }
        likeliest = Some(larger);
    }
    let ((data, fitted), likelihood) = likeliest.zip(likelihood)?;
    let cost = least_cost(&run.context(setup, &data), likelihood, &fitted);
    Some(DoubtedData {
        data,
        chosen: fitted.into_iter().next()?,
        likelihood,
        cost,
    })
}

/// Cost of the likeliest of some sets on data with a discrepancy.
fn least_cost(context: &FitContext<'_>, likelihood: LikelihoodScale, sets: &[Node]) -> f64 {
    let discrepancy = context.data.discrepancy.as_ref();
    let freedom = discrepancy.map_or(0.0, |d| d.freedom(likelihood.gain(1.0)));
    let costs = sets.iter().map(|node| cost(context, likelihood, node, freedom));
    costs.fold(f64::INFINITY, f64::min)
}

/// True if the discrepancy is likelier than what was found before; or if it explains, on cycles that it is not fitted to, what the
/// chosen set leaves, by the same limits as structure that no candidate explains; or, of the friction, if two or more effects are
/// named.
fn is_asked_for(
    context: &FitContext<'_>,
    (before, freedom_before): (&SearchResult, f64),
    doubted: &DoubtedData,
    doubt: Doubt,
) -> bool {
    let chosen = &before.nodes[before.chosen];
    let fall = chosen.select - doubted.chosen.select;
    let names = chosen.attached.len() - context.setup.extras.len();
    doubted.cost < cost(context, doubted.likelihood, chosen, freedom_before)
        || (names >= 2 && doubt == Doubt::Friction)
        || (fall >= LACK_POWER * context.data.count(Split::Select).max(1) as f64
            && before.likelihood.gain(fall) >= LACK_GAIN)
}

/// A search with the discrepancy, and what its freedom costs; `None` if the terms are too large for an error of shape.
fn doubted_search(
    context: &FitContext<'_>,
    start: &SearchStart,
    first: &SearchResult,
    budget: Budget,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<(SearchResult, f64)> {
    let again = |node: &Node| context.converged(node).map(|(node, _)| node);
    let seeds: Vec<Node> = start.seeds.iter().filter_map(again).collect();
    let mut search = search(context, again(&first.nodes[0])?, &seeds, budget, progress);
    let set = search.chosen;
    simplest_form::simplify(context, &mut search, set);
    let chosen = &search.nodes[search.chosen];
    let structure = context.structure(chosen.attached.clone());
    let (_, sizes) = structure.compared(&chosen.values)?;
    let discrepancy = context.data.discrepancy.as_ref()?;
    let freedom = discrepancy.freedom(search.likelihood.gain(1.0));
    let shares = discrepancy.shares(&sizes, &context.data.weight);
    shares.are_errors_of_shape().then_some((search, freedom))
}

/// The data with one set's shape in doubt, at the scale at which the set is likeliest, and the set refitted; `None` if the model has no
/// friction.
pub(in crate::diagnose) fn in_doubt(
    run: &RunSettings,
    setup: &Setup,
    data: &Data,
    node: &Node,
    doubt: Doubt,
) -> Option<(Data, Node)> {
    let whole = of_set(&run.context(setup, data), node, doubt)?;
    let doubted = at_likeliest_scale(run, setup, data, &whole, std::slice::from_ref(node))?;
    Some((doubted.data, doubted.chosen))
}

/// The discrepancy of the model in a set.
pub(super) fn of_set(context: &FitContext<'_>, node: &Node, doubt: Doubt) -> Option<Discrepancy> {
    let mut force_n = vec![0.0; context.data.len()];
    let structure = context.structure(node.attached.clone());
    structure.predict(&node.values, &mut force_n).ok()?;
    let data = context.data;
    let ratio = friction_ratio(data, &force_n)?;
    Discrepancy::new(&data.tracks, &data.weight, &data.split, &force_n, ratio, doubt)
}

/// Friction divided by load: what changes its sign with the direction, beside a cubic curve of the displacement.
fn friction_ratio(data: &Data, force_n: &[f64]) -> Option<f64> {
    let top_mm = data
        .tracks
        .iter()
        .flat_map(|t| &t.displacement_mm)
        .fold(0.0f64, |most, x| most.max(x.abs()));
    let (mut normal, mut right) = (DMatrix::zeros(5, 5), DVector::zeros(5));
    let points = data
        .tracks
        .iter()
        .flat_map(|t| t.displacement_mm.iter().zip(&t.direction));
    for ((displacement_mm, direction), (force_n, weight)) in points.zip(force_n.iter().zip(&data.weight)) {
        let x = displacement_mm / top_mm.max(f64::MIN_POSITIVE);
        let row = DVector::from_row_slice(&[1.0, x, x * x, x * x * x, force_n * direction]) * *weight;
        normal.ger(1.0, &row, &row, 1.0);
        right.axpy(force_n * weight, &row, 1.0);
    }
    Some(normal.cholesky()?.solve(&right)[4])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fitting::case;

    const RATIO: f64 = 0.05;

    #[test]
    fn the_friction_ratio_is_read_off_a_force() {
        let (data, _) = case(|_, _| 0.0);
        let track = &data.tracks[0];
        let with: Vec<f64> = track
            .displacement_mm
            .iter()
            .zip(&track.direction)
            .map(|(x, direction)| (100.0 + 80.0 * x) * (1.0 + RATIO * direction))
            .collect();
        let ratio = friction_ratio(&data, &with).expect("regular");
        assert!((ratio - RATIO).abs() < 0.1 * RATIO, "{ratio}");
    }
}
