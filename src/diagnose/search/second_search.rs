//! The second search: the friction law may deviate by the terms of [`Discrepancy`], so that its error of shape is not named as further
//! physics.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::beam_search::{SearchResult, search};
use super::friction_law::SearchStart;
use super::lack_of_fit::{LACK_GAIN, LACK_POWER};
use super::simplest_form;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, Discrepancy, FitContext, Node, RunSettings, Setup, converge};

/// Largest RMS of the terms, in their standard deviations: a larger difference is no error of shape.
const MOST_SIZE: f64 = 2.0;

/// A search with the discrepancy, and the data that it ran on.
pub(in crate::diagnose) struct DoubtedSearch {
    pub data: Data,
    pub search: SearchResult,
}

/// Searches again if what the first search leaves has the shape of the friction law, or if the first search named two or more effects.
/// `None` if neither is so, or if the result is no better.
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
    let context = run.context(setup, &data);
    let again = |node: &Node| {
        let structure = context.structure(node.attached.clone());
        converge(&structure, node.values.clone()).map(|(node, _)| node)
    };
    let names = |node: &Node| node.attached.len() - extras;
    // The same limits as for structure that no candidate explains.
    let fall = chosen.select - again(chosen)?.select;
    let leaves_shape = fall >= LACK_POWER * data.count(Split::Select).max(1) as f64
        && first.likelihood.gain(fall) >= LACK_GAIN;
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
    let better = leaves_shape || (names(doubted) < names(chosen) && doubted.cost() < chosen.cost());
    (better && is_error_of_shape(squares)).then_some(DoubtedSearch { search, data })
}

/// True if terms with this sum of squares, in their standard deviations, are small enough for an error of shape.
fn is_error_of_shape(squares: f64) -> bool {
    squares <= MOST_SIZE * MOST_SIZE * Discrepancy::COUNT as f64
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
    use super::*;
    use crate::diagnose::fitting::case;

    const RATIO: f64 = 0.05;

    /// All terms at two standard deviations are the limit; one term may be larger.
    #[test]
    fn a_large_difference_is_no_error_of_shape() {
        let all = |sigmas: f64| sigmas * sigmas * Discrepancy::COUNT as f64;
        assert!(is_error_of_shape(all(1.9)) && !is_error_of_shape(all(2.1)));
        assert!(is_error_of_shape(10.0 * 10.0));
    }

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
