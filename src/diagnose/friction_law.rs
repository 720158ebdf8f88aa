//! Generalises the baseline's friction law before any effect is called missing, so that its shape is not reported as missing
//! physics: which law a model has is its author's choice.

use super::backward_elimination::PENALTY;
use super::baseline::Attached;
use super::context::{FitContext, Node};
use super::data::Data;
use super::diagnosis::Alternative;
use super::fit::converge;
use super::score::{Tangent, insert_group};
use super::tables::errors_of;
use crate::effect::LookAlike;

/// Candidates that are fitted under the baseline's own law, and the number of the best that get the general law afterwards.
const SEEDS_TRIED: usize = 6;
const SEEDS: usize = 3;
/// Share of the sum of squares that a general friction law must not leave, to be called the main explanation.
const EXPLAINED_LEAVES: f64 = 0.5;

/// What the search starts from.
pub(super) struct SearchStart {
    /// The baseline with its own friction law, refitted.
    pub refitted: Node,
    /// The baseline with the friction law that the search uses: the general one where that is `generalised`.
    pub base: Node,
    pub generalised: bool,
    /// Fits of one effect each, found under the baseline's own friction law.
    pub seeds: Vec<Node>,
}

/// Refits the baseline and generalises its friction law where that gains more than an effect must.
pub(super) fn search_start(context: &FitContext<'_>, first: &Node) -> Option<SearchStart> {
    let (refitted, tangent) = context.converged(first)?;
    let form = context.setup.form.as_ref();
    let general =
        form.and_then(|form| generalise(context, &refitted, form, &(form.effect.starts)(&context.span)));
    let seeds = match (&general, form) {
        (Some(general), Some(form)) => {
            let own = context.setup.model.parameters.len();
            let fitted = general.values[own..general.values.len() - 1].to_vec();
            seeds(context, &refitted, &tangent, (form, fitted))
        }
        _ => Vec::new(),
    };
    Some(SearchStart {
        generalised: general.is_some(),
        base: general.unwrap_or_else(|| refitted.clone()),
        refitted,
        seeds,
    })
}

/// A node with the general friction law, fitted from these starts of its parameters, where the data support one.
pub(super) fn generalise(
    context: &FitContext<'_>,
    node: &Node,
    form: &Attached,
    starts: &[Vec<f64>],
) -> Option<Node> {
    let structure = context.structure(node.attached.clone()).with(form);
    // The fit starts without the baseline's own friction: a law without memory of the last reversal would stop it early.
    let mut frictionless = node.values.clone();
    if let Some(i) = context.setup.model.friction_ratio {
        frictionless[i] = context.setup.model.parameters[i].bounds[0];
    }
    let starts: Vec<Vec<f64>> = starts
        .iter()
        .map(|group| insert_group(&frictionless, group))
        .collect();
    let general = context
        .parallel_map(&starts, |start| converge(&structure, start.clone()))
        .into_iter()
        .flatten()
        .map(|(node, _)| node)
        .min_by(|a, b| a.cost().total_cmp(&b.cost()))?;
    (0.5 * (node.cost() - general.cost()) > PENALTY).then_some(general)
}

/// The best single effects on the baseline's own law, with the general law fitted afterwards. A general law that is fitted first
/// adapts to the missing effect and can hide it. The law starts from what it is without the effect.
fn seeds(
    context: &FitContext<'_>,
    refitted: &Node,
    tangent: &Tangent,
    (form, start): (&Attached, Vec<f64>),
) -> Vec<Node> {
    let starts = [start];
    let mut children = context.children(refitted, tangent, &[], SEEDS_TRIED);
    children.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    children.truncate(SEEDS);
    let general = children.iter().filter_map(|child| {
        let mut node = generalise(context, child, form, &starts)?;
        // The general law comes before the effect, as in all other nodes.
        let (own, added) = (context.setup.model.parameters.len(), node.values.len() - 1);
        node.attached.rotate_right(1);
        node.values[own..added].rotate_right(form.parameters.len());
        Some(node)
    });
    general.collect()
}

/// True where the general friction law takes away at least half of what the baseline leaves.
pub(super) fn explains_most(context: &FitContext<'_>, refitted: &Node, base: &Node) -> bool {
    let generalised = refitted.attached.len() < context.setup.extras.len();
    generalised && base.select <= EXPLAINED_LEAVES * refitted.select
}

/// The look-alikes of the general friction law, where it explains most and nothing in the library explains the rest.
pub(super) fn look_alikes(context: &FitContext<'_>, refitted: &Node, base: &Node) -> Vec<Alternative> {
    let Some(form) = &context.setup.form else {
        return Vec::new();
    };
    if !explains_most(context, refitted, base) {
        return Vec::new();
    }
    let held_out = |data: &Data, node: &Node| 100.0 * errors_of(data, &node.residuals).nrmse_heldout;
    let (own, general) = (held_out(context.data, refitted), held_out(context.data, base));
    let alternative = |r: &LookAlike| Alternative {
        code: r.code.to_owned(),
        instead_of: "unknown".to_owned(),
        why: format!(
            "{}: with a general friction law the error on held-out cycles falls from {own:.2} % to {general:.2} %",
            r.why
        ),
        test: r.test.to_owned(),
    };
    form.effect.confusable_with.iter().map(alternative).collect()
}
