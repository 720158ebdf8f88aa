//! Takes back effects of speed and time that are only the error of a law's shape.
//!
//! A friction law or a spring's curve with a wrong shape leaves an error that differs from recording to recording. That may look like
//! friction that warms or runs in. In the search beside the path, linear terms explain every force that follows from the path. There such
//! an effect improves the fit by too little, or the size that was named fits worse than no effect at all.

use crate::diagnose::fitting::{FitContext, Node};
use crate::diagnose::search::{SearchResult, penalty, without};

/// The search, with a chosen set from which the refused effects were removed. `path` has the data of the search beside the path, and
/// `of_path` is that search.
pub(in crate::diagnose) fn confirmed_beside_path(
    context: &FitContext<'_>,
    mut search: SearchResult,
    (path, of_path): (&FitContext<'_>, &SearchResult),
) -> SearchResult {
    for code in refused(context, &search.nodes[search.chosen], (path, of_path)) {
        let attached = &search.nodes[search.chosen].attached;
        let place = (context.setup.extras.len()..attached.len()).find(|&k| attached[k].effect.code == code);
        if let Some(place) = place {
            search.chosen = without(context, &mut search.nodes, search.chosen, place);
        }
    }
    search
}

/// Costs of a set of effects in the search beside the path.
struct BesideCosts {
    /// With the sizes that were named, and all else fitted again: friction law and curve are others here, which says nothing about a size.
    as_named: f64,
    /// With all sizes fitted again.
    refitted: f64,
}

/// Codes of the refused effects of a set, the worst first. An effect of speed or time is refused if it gains less than its penalty when
/// all is fitted again, or if the cost is lower without it than with the size that was named. After each refusal the others are judged
/// again: of two effects that imitate each other, one may be real.
fn refused(
    context: &FitContext<'_>,
    set: &Node,
    (path, of_path): (&FitContext<'_>, &SearchResult),
) -> Vec<&'static str> {
    let mut places: Vec<usize> = (context.setup.extras.len()..set.attached.len())
        .filter(|&k| !set.attached[k].own && !set.attached[k].effect.follows_path)
        .collect();
    let costs = |places: &[usize]| {
        let named = path.with_effects_of(&of_path.nodes[0], (context, set), places)?;
        let named_sizes = held(path, named.clone(), of_path.nodes[0].attached.len());
        Some(BesideCosts {
            as_named: path.converged(&named_sizes)?.0.cost(),
            refitted: path.converged(&named)?.0.cost(),
        })
    };
    let mut refused = Vec::new();
    while let Some(all) = (!places.is_empty()).then(|| costs(&places)).flatten() {
        let excess = |&place: &usize| {
            let others: Vec<usize> = places.iter().copied().filter(|other| *other != place).collect();
            let without = costs(&others)?;
            let gain = |with: f64, without: f64| of_path.likelihood.gain(without - with);
            let as_named = gain(all.as_named, without.as_named);
            let refitted = gain(all.refitted, without.refitted);
            Some((
                as_named.min(refitted - penalty(&set.attached[place..=place])),
                place,
            ))
        };
        let worst = places
            .iter()
            .filter_map(excess)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, place)) = worst.filter(|(excess, _)| *excess < 0.0) else {
            break;
        };
        refused.push(set.attached[place].effect.code);
        places.retain(|kept| *kept != place);
    }
    refused
}

/// The node with the values of its effects from this place on held.
fn held(path: &FitContext<'_>, mut node: Node, first: usize) -> Node {
    for place in first..node.attached.len() {
        let from = path.offset(&node.attached, place);
        let values = &node.values[from..];
        node.attached[place].hold(values);
    }
    node
}
