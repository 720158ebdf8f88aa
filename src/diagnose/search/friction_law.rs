//! Generalises the baseline's friction law before any effect is called missing, so that its shape is not reported as missing
//! physics: which law a model has is its author's choice.

use super::backward_elimination::penalty;
use super::beam_search::SearchResult;
use crate::diagnose::fitting::{
    Attached, FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, Tangent, general_laws, with_form,
};

/// Candidates that are fitted under the baseline's own law, and the number of the best that get the general law afterwards.
const SEEDS_TRIED: usize = 6;
const SEEDS: usize = 3;

/// The baseline with each friction law that the data support.
pub(super) struct FrictionLaws {
    /// The baseline with its own law, converged.
    own: (Node, Tangent),
    /// The best single effects on its own law.
    children: Vec<Node>,
    /// The baseline with each general law, the best first.
    general: Vec<Node>,
}

/// What a search starts from.
pub(in crate::diagnose) struct SearchStart {
    /// The baseline with its own friction law, refitted.
    pub refitted: Node,
    /// The baseline with the friction law that the search uses.
    pub base: Node,
    /// Fits of one effect each, found under the baseline's own friction law.
    pub seeds: Vec<Node>,
}

impl FrictionLaws {
    /// Refits the baseline, and with each general law that gains more than an effect must.
    pub(super) fn new(context: &FitContext<'_>, first: &Node) -> Option<FrictionLaws> {
        let own = context.converged(first)?;
        let general = general_laws(context, &own.0);
        let mut children = Vec::new();
        if !general.is_empty() {
            children = context.children(std::slice::from_ref(&own), &[], SEEDS_TRIED);
            children.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
            children.truncate(SEEDS);
        }
        Some(FrictionLaws {
            own,
            children,
            general,
        })
    }

    /// Number of laws that a search can start from.
    pub(super) fn count(&self) -> usize {
        self.general.len().max(1)
    }

    /// The start of a search with law number `k`, in the order of how well they fit.
    pub(super) fn start(&self, context: &FitContext<'_>, k: usize) -> SearchStart {
        let refitted = self.own.0.clone();
        let Some(base) = self.general.get(k) else {
            return SearchStart {
                base: refitted.clone(),
                refitted,
                seeds: Vec::new(),
            };
        };
        SearchStart {
            seeds: self.seeds(context, base),
            base: base.clone(),
            refitted,
        }
    }

    /// The best single effects on the baseline's own law, with a general law fitted afterwards. A general law that is fitted first
    /// adapts to the missing effect and can hide it. The law starts from what it is without the effect.
    fn seeds(&self, context: &FitContext<'_>, base: &Node) -> Vec<Node> {
        let Some(form) = base.attached.last() else {
            return Vec::new();
        };
        let from = context.offset(&base.attached, base.attached.len() - 1);
        let starts = [base.values[from..base.values.len() - 1].to_vec()];
        let general = self.children.iter().filter_map(|child| {
            let mut node = with_form(context, child, form, &starts)?;
            // The general law comes before the effect, as in all other nodes.
            let (own, added) = (context.setup.model.parameters.len(), node.values.len() - 1);
            node.attached.rotate_right(1);
            node.values[own..added].rotate_right(form.parameters.len());
            Some(node)
        });
        general.collect()
    }
}

/// Cost of a set in log-likelihood: what it leaves, its effects, and the parameters of the friction law (the `extras` first effects).
pub(super) fn cost_with_law(likelihood: LikelihoodScale, node: &Node, extras: usize) -> f64 {
    let free = |a: &Attached| a.parameters.iter().filter(|p| p.is_free()).count() as f64;
    let of_law: f64 = node.attached[..extras].iter().map(free).sum();
    likelihood.gain(node.cost()) + penalty(&node.attached[extras..]) + PARAMETER_PENALTY * of_law
}

/// True if the set that a search chose, or that set without one or all of its effects, is likelier with the friction law of
/// `context`: what the law of the search lacked may have been named as an effect. `before` has the context of that search.
pub(super) fn explains_better(
    context: &FitContext<'_>,
    base: &Node,
    before: (&FitContext<'_>, &SearchResult),
) -> bool {
    let (its, search) = before;
    let chosen = &search.nodes[search.chosen];
    let skipped = its.setup.extras.len();
    let effects = chosen.attached.len() - skipped;
    let with = |left_out: Option<usize>| {
        let kept: Vec<usize> = (0..effects).filter(|k| Some(*k) != left_out).collect();
        let mut attached = base.attached.clone();
        let (zero, own) = base.values.split_last()?;
        let mut values = own.to_vec();
        for k in kept {
            let place = skipped + k;
            let from = its.offset(&chosen.attached, place);
            values.extend(&chosen.values[from..from + chosen.attached[place].parameters.len()]);
            attached.push(chosen.attached[place].clone());
        }
        values.push(*zero);
        let node = Node::new(&context.structure(attached), values)?;
        context.converged(&node).map(|(node, _)| node)
    };
    let sets: Vec<Option<usize>> = std::iter::once(None).chain((0..effects).map(Some)).collect();
    let mut fitted = context.parallel_map(&sets, |left_out| with(*left_out));
    fitted.push(Some(base.clone()));
    let extras = context.setup.extras.len();
    let costs = fitted.iter().flatten();
    let least = costs.map(|node| cost_with_law(search.likelihood, node, extras));
    least.fold(f64::INFINITY, f64::min) < cost_with_law(search.likelihood, chosen, skipped)
}
