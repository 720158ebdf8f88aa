//! Laws in their simplest form. A free exponent or spectrum follows laws that are not in the library, but where the recordings do not
//! ask for it, it only makes the other parameters less certain.

use super::beam_search::SearchResult;
use crate::diagnose::fitting::{FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, converge};

/// Gives a set of the search its simplest form.
pub(in crate::diagnose) fn simplify(context: &FitContext<'_>, search: &mut SearchResult, set: usize) {
    search.nodes[set] = simplest_form(context, search.nodes[set].clone(), search.likelihood);
}

/// The node with every shape at its neutral value whose freedom gains less than a parameter must.
fn simplest_form(context: &FitContext<'_>, mut node: Node, likelihood: LikelihoodScale) -> Node {
    loop {
        let simpler = context.parallel_map(&free_shapes(context, &node), |&(place, shape)| {
            with_neutral(context, &node, place, shape)
        });
        let least = simpler
            .into_iter()
            .flatten()
            .min_by(|a, b| a.cost().total_cmp(&b.cost()));
        match least {
            Some(simple) if likelihood.gain(simple.cost() - node.cost()) < PARAMETER_PENALTY => node = simple,
            _ => return node,
        }
    }
}

/// Places of the missing effects with the indices of their shapes that are free.
fn free_shapes(context: &FitContext<'_>, node: &Node) -> Vec<(usize, usize)> {
    (context.setup.extras.len()..node.attached.len())
        .flat_map(|place| {
            let attached = &node.attached[place];
            let free = attached.effect.shapes.iter().copied();
            free.filter(|&shape| attached.parameters[shape].is_free())
                .map(move |shape| (place, shape))
        })
        .collect()
}

/// The set with one shape held at its neutral value, fitted again.
fn with_neutral(context: &FitContext<'_>, node: &Node, place: usize, shape: usize) -> Option<Node> {
    let mut attached = node.attached.clone();
    let neutral = attached[place].effect.neutral[shape];
    attached[place].parameters[shape].bounds = [neutral; 2];
    let mut values = node.values.clone();
    values[context.offset(&attached, place) + shape] = neutral;
    converge(&context.structure(attached), values).map(|(node, _)| node)
}
