//! Beam search over sets of effects. Each set is refitted together with the baseline's own parameters and compared on fitted and
//! selecting cycles.

use super::backward_elimination::{LEAST_SHARE, choose, lowest};
use super::budget::Budget;
use super::grown_law::{growing_code, grown};
use crate::diagnose::fitting::{FitContext, Key, LikelihoodScale, Node, PENALTY, Tangent};

/// Sets that are kept from one size to the next. More would cost time in proportion.
const BEAM_WIDTH: usize = 3;
/// Largest number of missing effects.
const MOST_EFFECTS: usize = 3;
/// Sets of each size that are fitted: all single effects, then those with the smallest predicted sums of squares.
const CHILDREN: [usize; MOST_EFFECTS] = [usize::MAX, 12, 8];
/// Fall of the baseline's sum of squares, as a share, from which its fit had not converged to its lowest minimum.
const BETTER_ROOT: f64 = 0.01;

/// What is being compared, by the size of the sets.
const STEPS: [&str; MOST_EFFECTS] = [
    "comparing single effects",
    "comparing pairs of effects",
    "comparing sets of three effects",
];

/// All fitted sets and the one that is chosen.
pub(in crate::diagnose) struct SearchResult {
    /// Fitted sets; the baseline alone is the first.
    pub nodes: Vec<Node>,
    /// Index of the chosen set.
    pub chosen: usize,
    pub likelihood: LikelihoodScale,
    /// True where the budget was spent before all sizes of sets were compared.
    pub cut_short: bool,
}

/// Runs the search. `progress` gets the share of set sizes that are done, and what is done next.
///
/// `seeds` are fits of one effect each that were found in another way; of two fits of one effect the better is kept.
pub(super) fn search(
    context: &FitContext<'_>,
    baseline: Node,
    seeds: &[Node],
    budget: Budget,
    progress: &mut dyn FnMut(f64, &str),
) -> SearchResult {
    search_from(context, (baseline, true), seeds, budget, progress)
}

/// The search from one fit of the baseline. If a single effect shows a lower minimum of the baseline, it begins again from there, where
/// `may_restart`. It does so once: along a narrow valley, each further search would find a minimum that is a little lower.
fn search_from(
    context: &FitContext<'_>,
    (baseline, may_restart): (Node, bool),
    seeds: &[Node],
    budget: Budget,
    progress: &mut dyn FnMut(f64, &str),
) -> SearchResult {
    let mut cut_short = false;
    let mut nodes = vec![baseline];
    let mut seen = vec![nodes[0].key(context.setup.extras.len())];
    let mut beam = vec![0];
    let mut may_grow = None;
    for (size, &count) in CHILDREN.iter().enumerate() {
        cut_short = size > 0 && budget.is_spent(context.setup);
        if cut_short {
            break;
        }
        progress(size as f64 / MOST_EFFECTS as f64, STEPS[size]);
        let parents = converge_beam(context, &mut nodes, &beam);
        let before = beam
            .iter()
            .map(|&i| nodes[i].cost())
            .fold(f64::INFINITY, f64::min);
        let mut added = Vec::new();
        for child in context.children(&parents, &seen, count) {
            seen.push(child.key(context.setup.extras.len()));
            nodes.push(child);
            added.push(nodes.len() - 1);
        }
        if size == 0 {
            add_seeds(context, &mut nodes, &mut seen, &mut added, seeds);
        }
        added.sort_by(|&a, &b| nodes[a].cost().total_cmp(&nodes[b].cost()));
        added.truncate(BEAM_WIDTH);
        let Some(&best) = added.first() else { break };
        if size == 0
            && may_restart
            && let Some(root) = better_root(context, &nodes[0], &nodes[best])
        {
            return search_from(context, (root, false), seeds, budget, progress);
        }
        if size == 0 && !context.curve_is_in_doubt() {
            may_grow = growing_code(&nodes[best], context.setup.extras.len());
        }
        if let Some(code) = may_grow
            && grow(context, &mut nodes, &mut added, code)
        {
            may_grow = None;
        }
        let best = added[0];
        // Stops where the largest gain would not be accepted. Sums of squares are compared, not effective samples, because
        // unexplained physics correlates the residuals and would end the search too early.
        let (fall, total) = (before - nodes[best].cost(), nodes[0].cost() - nodes[best].cost());
        if 0.5 * fall < PENALTY || fall < 0.5 * LEAST_SHARE * total {
            break;
        }
        beam = added;
    }
    chosen(context, nodes, cut_short)
}

/// Replaces the law of this code in the best set of the beam that has it by a larger one, where that explains enough, and sorts the beam
/// again. True if the law has grown. Only one set: to try all cost more than the search itself.
fn grow(context: &FitContext<'_>, nodes: &mut [Node], beam: &mut [usize], code: &str) -> bool {
    let extras = context.setup.extras.len();
    let has_code = |i: &usize| nodes[*i].attached[extras..].iter().any(|a| a.effect.code == code);
    let Some(set) = beam.iter().copied().find(has_code) else {
        return false;
    };
    let Some(converged) = context.converged(&nodes[set]) else {
        return false;
    };
    let larger = grown(context, &converged, code);
    let has_grown = larger.is_some();
    nodes[set] = larger.unwrap_or(converged.0);
    beam.sort_by(|&a, &b| nodes[a].cost().total_cmp(&nodes[b].cost()));
    has_grown
}

/// Fits the sets of the beam to convergence, in place, and returns them with their tangents.
fn converge_beam(context: &FitContext<'_>, nodes: &mut [Node], beam: &[usize]) -> Vec<(Node, Tangent)> {
    let parents: Vec<(Node, Tangent)> = context
        .parallel_map(beam, |&i| context.converged(&nodes[i]))
        .into_iter()
        .flatten()
        .collect();
    for (&i, (node, _)) in beam.iter().zip(&parents) {
        nodes[i] = node.clone();
    }
    parents
}

/// Adds the seeds, or puts them in the place of a worse fit of the same effect.
fn add_seeds(
    context: &FitContext<'_>,
    nodes: &mut Vec<Node>,
    seen: &mut Vec<Key>,
    added: &mut Vec<usize>,
    seeds: &[Node],
) {
    let extras = context.setup.extras.len();
    for seed in seeds {
        let key = seed.key(extras);
        match added.iter().find(|&&i| nodes[i].key(extras) == key) {
            Some(&known) if seed.cost() < nodes[known].cost() => nodes[known] = seed.clone(),
            Some(_) => {}
            None => {
                seen.push(key);
                nodes.push(seed.clone());
                added.push(nodes.len() - 1);
            }
        }
    }
}

/// Converges the best set, takes the likelihood scale from it and chooses.
fn chosen(context: &FitContext<'_>, mut nodes: Vec<Node>, cut_short: bool) -> SearchResult {
    let best = lowest(&nodes, |_, n| n.cost());
    if let Some((converged, _)) = context.converged(&nodes[best]) {
        nodes[best] = converged;
    }
    let likelihood = LikelihoodScale::of(context.data, &nodes[best].residuals);
    let chosen = choose(context, &mut nodes, likelihood);
    SearchResult {
        nodes,
        chosen,
        likelihood,
        cut_short,
    }
}

/// The baseline refitted from where a child with one effect leaves it, if that is a lower minimum than the one it was in.
fn better_root(context: &FitContext<'_>, root: &Node, child: &Node) -> Option<Node> {
    let extras = context.setup.extras.len();
    let from = context.offset(&child.attached, extras);
    let mut values = child.values.clone();
    values.drain(from..from + child.attached[extras].parameters.len());
    let (node, _) = context.converge(root.attached.clone(), values)?;
    (root.fit - node.fit > PENALTY.max(BETTER_ROOT * root.fit)).then_some(node)
}
