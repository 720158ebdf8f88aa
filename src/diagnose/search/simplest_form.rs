//! Laws in their simplest form. A free exponent or spectrum follows laws that are not in the library, but where the recordings do not
//! ask for it, it only makes the other parameters less certain.

use super::beam_search::SearchResult;
use crate::diagnose::fitting::{FitContext, LikelihoodScale, Node, PARAMETER_PENALTY};

/// Gives a set of the search its simplest form.
pub(in crate::diagnose) fn simplify(context: &FitContext<'_>, search: &mut SearchResult, set: usize) {
    search.nodes[set] = simplest_form(context, search.nodes[set].clone(), search.likelihood);
}

/// The node with every shape at its neutral value whose freedom gains less than it must.
fn simplest_form(context: &FitContext<'_>, mut node: Node, likelihood: LikelihoodScale) -> Node {
    loop {
        let simpler = context.parallel_map(&free_shapes(context, &node), |&(place, shape)| {
            let simple = with_neutral(context, &node, place, shape)?;
            let gain = likelihood.gain(simple.cost() - node.cost());
            Some((
                gain - least_gain(node.attached[place].effect.shapes.len()),
                simple,
            ))
        });
        let least = simpler.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
        match least {
            Some((beyond, simple)) if beyond < 0.0 => node = simple,
            _ => return node,
        }
    }
}

/// Log-likelihood that the freedom of one shape must gain. The more shapes an effect has, the more often one of them gains by chance. The
/// logarithm makes up for that.
fn least_gain(shapes: usize) -> f64 {
    PARAMETER_PENALTY + (shapes as f64).ln()
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
    context.converge(attached, values).map(|(node, _)| node)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the gain of a shape that is not there has the distribution chi-square with one degree of freedom.
    #[test]
    fn chance_frees_a_shape_of_many_as_rarely_as_a_single_one() {
        let of_one = beyond_by_chance(least_gain(1));
        for shapes in 2..=6 {
            let of_any = 1.0 - (1.0 - beyond_by_chance(least_gain(shapes))).powf(shapes as f64);
            assert!(
                of_any < of_one && of_any > 0.6 * of_one,
                "{shapes}: {of_any}, {of_one}"
            );
        }
    }

    /// Probability that chance gains more than this.
    fn beyond_by_chance(gain: f64) -> f64 {
        use statrs::distribution::{ContinuousCDF, Normal};
        2.0 * Normal::standard().cdf(-(2.0 * gain).sqrt())
    }
}
