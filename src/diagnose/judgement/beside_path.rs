//! Names of speed and time beside every force that follows from the path. Where a law is in doubt, what its error of shape adds to one
//! recording may look like friction that warms or runs in. Once every force of the path is given away, such a name brings nothing, or
//! the size that was named is less likely than none.

use crate::diagnose::fitting::{FitContext, Node};
use crate::diagnose::search::{SearchResult, penalty, without};

/// The search without the effects of speed and time that are refused beside every force of the path. `path` is the search in which all
/// of these forces are in doubt, on its own data.
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

/// Costs of some effects beside every force of the path.
struct BesideCosts {
    /// With the sizes that were named.
    as_named: f64,
    /// With the sizes that are likeliest there.
    refitted: f64,
}

/// Codes of the effects of speed and time in a set that bring less than their penalty beside every force of the path, or whose size is
/// less likely than none; the worst first. Each is judged beside those that are left: of two that imitate each other one may be real.
fn refused(
    context: &FitContext<'_>,
    set: &Node,
    (path, of_path): (&FitContext<'_>, &SearchResult),
) -> Vec<&'static str> {
    let mut places: Vec<usize> = (context.setup.extras.len()..set.attached.len())
        .filter(|&k| !set.attached[k].own && !set.attached[k].effect.follows_path)
        .collect();
    let costs = |places: &[usize]| {
        let named = beside(context, set, places, path, &of_path.nodes[0])?;
        Some(BesideCosts {
            as_named: named.cost(),
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

/// Effects of a set beside the baseline whose path is in doubt, with the values that they have in the set.
fn beside(
    context: &FitContext<'_>,
    set: &Node,
    places: &[usize],
    path: &FitContext<'_>,
    root: &Node,
) -> Option<Node> {
    let (mut attached, mut values) = (root.attached.clone(), root.values.clone());
    let zero_n = values.pop()?;
    for &place in places {
        let from = context.offset(&set.attached, place);
        values.extend(&set.values[from..from + set.attached[place].parameters.len()]);
        attached.push(set.attached[place].clone());
    }
    values.push(zero_n);
    Node::new(&path.structure(attached), values)
}
