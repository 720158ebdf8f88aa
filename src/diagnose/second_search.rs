//! A second search, in which the shape of the friction law is in doubt ([`Discrepancy`]): what is left of the friction law shall not be
//! named as further physics.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::baseline::Setup;
use super::context::{FitContext, Node, RunSettings};
use super::data::Data;
use super::discrepancy::Discrepancy;
use super::fit::converge;
use super::friction_law::SearchStart;
use super::search::{SearchResult, search};
use super::simplest_form;
use super::splits::Split;

/// The terms are needed if on selecting cycles they take away this mean square, in units of the noise, and this log-likelihood.
const LEAST_POWER: f64 = 0.06;
const LEAST_GAIN: f64 = 10.0;

/// Root mean square of the terms in their standard deviations above which the difference is more than a doubt about a shape.
const MOST_SIZE: f64 = 2.0;

/// A search with the discrepancy, and the data that it ran on.
pub(super) struct DoubtedSearch {
    pub data: Data,
    pub search: SearchResult,
}

/// Searches again with the discrepancy, where what the chosen set leaves has the shape of the friction law, or where a second name may
/// be no more than that. `None` where the search finds nothing better.
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
    let extras = setup.extras.len();
    let chosen = &first.nodes[first.chosen];
    let mut data = data.clone();
    data.discrepancy = Some(Arc::new(of_set(&run.context(setup, &data), chosen)?));
    let count = data.discrepancy.as_ref().map_or(0, |d| d.count());
    let context = run.context(setup, &data);
    let again = |node: &Node| {
        let structure = context.structure(node.attached.clone());
        converge(&structure, node.values.clone()).map(|(node, _)| node)
    };
    let names = |node: &Node| node.attached.len() - extras;
    let fall = chosen.select - again(chosen)?.select;
    let leaves_shape = fall >= LEAST_POWER * data.count(Split::Select).max(1) as f64
        && first.likelihood.gain(fall) >= LEAST_GAIN;
    if !leaves_shape && names(chosen) < 2 {
        return None;
    }
    let seeds: Vec<Node> = start.seeds.iter().filter_map(again).collect();
    let mut search = search(&context, again(&first.nodes[0])?, &seeds, progress);
    let set = search.chosen;
    simplest_form::simplify(&context, &mut search, set);
    let doubted = &search.nodes[search.chosen];
    let (_, squares) = context
        .structure(doubted.attached.clone())
        .compared(&doubted.values)?;
    if squares > MOST_SIZE * MOST_SIZE * count as f64 {
        return None;
    }
    let better = doubted.cost() < chosen.cost();
    (leaves_shape || (names(doubted) < names(chosen) && better)).then_some(DoubtedSearch { search, data })
}

/// The discrepancy of the friction in a set.
fn of_set(context: &FitContext<'_>, node: &Node) -> Option<Discrepancy> {
    let mut force_n = vec![0.0; context.data.len()];
    let structure = context.structure(node.attached.clone());
    structure.predict(&node.values, &mut force_n).ok()?;
    let data = context.data;
    let ratio = friction_ratio(data, &force_n)?;
    Discrepancy::new(&data.tracks, &data.weight, &data.split, &force_n, ratio)
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
    use super::super::binning::tests::case;
    use super::*;

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
