//! The second search: the model may deviate by the terms of [`Discrepancy`], so that its error of shape is not named as further physics.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::backward_elimination::penalty;
use super::beam_search::{SearchResult, search};
use super::budget::Budget;
use super::friction_law::SearchStart;
use super::lack_of_fit::{LACK_GAIN, LACK_POWER};
use super::simplest_form;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, Discrepancy, Doubt, FitContext, Node, RunSettings, Setup};

/// A search with the discrepancy, and the data that it ran on.
pub(in crate::diagnose) struct DoubtedSearch {
    pub data: Data,
    pub search: SearchResult,
    /// What the freedom of the discrepancy costs in log-likelihood.
    freedom: f64,
}

/// Searches again with the shape of the friction law in doubt, then with the spring's curve in doubt as well: each if what the search
/// before leaves has that shape, the first also if two or more effects were named. `None` if no result is likelier than the first.
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
    for (doubt, share) in [(Doubt::Friction, 0.7), (Doubt::FrictionAndCurve, 1.0)] {
        let set = &first.nodes[first.chosen];
        let mut doubted = data.clone();
        doubted.discrepancy = Some(Arc::new(of_set(&run.context(setup, data), set, doubt)?));
        let context = run.context(setup, &doubted);
        let before = best.as_ref().map_or(first, |b| &b.search);
        if !is_asked_for(&context, before, doubt) {
            continue;
        }
        let budget = Budget::up_to(share);
        let Some((search, freedom)) = doubted_search(&context, start, first, budget, progress) else {
            continue;
        };
        let cost = |result: &SearchResult, freedom: f64| {
            let node = &result.nodes[result.chosen];
            search.likelihood.gain(node.cost()) + penalty(&node.attached[setup.extras.len()..]) + freedom
        };
        let freedom_before = best.as_ref().map_or(0.0, |b| b.freedom);
        if cost(&search, freedom) < cost(before, freedom_before) {
            best = Some(DoubtedSearch {
                data: doubted,
                search,
                freedom,
            });
        }
    }
    best
}

/// True if the discrepancy explains, on cycles that it is not fitted to, what the chosen set leaves: by the same limits as structure
/// that no candidate explains. The friction law is in doubt also where two or more effects are named.
fn is_asked_for(context: &FitContext<'_>, before: &SearchResult, doubt: Doubt) -> bool {
    let chosen = &before.nodes[before.chosen];
    let Some((with, _)) = context.converged(chosen) else {
        return false;
    };
    let fall = chosen.select - with.select;
    let names = chosen.attached.len() - context.setup.extras.len();
    (names >= 2 && doubt == Doubt::Friction)
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
    discrepancy
        .is_error_of_shape(sizes.norm_squared())
        .then_some((search, freedom))
}

/// The discrepancy of the model in a set.
fn of_set(context: &FitContext<'_>, node: &Node, doubt: Doubt) -> Option<Discrepancy> {
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
