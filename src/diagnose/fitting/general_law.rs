//! The general friction law, fitted in place of the baseline's own: which law a model has is its author's choice.

use super::baseline::Attached;
use super::context::FitContext;
use super::fit::converge;
use super::likelihood::PENALTY;
use super::node::Node;
use super::score::insert_group;
use super::structure::ModelStructure;

/// Number of fits without bends that are fitted further with them.
const STRAIGHT: usize = 2;

/// A node with the general friction law of the setup, where the data support one and the node has none yet.
pub(in crate::diagnose) fn with_general_law(context: &FitContext<'_>, node: &Node) -> Option<Node> {
    with_form(context, node, context.setup.form.as_ref()?)
}

/// The same with one of the general friction laws.
pub(super) fn with_form(context: &FitContext<'_>, node: &Node, form: &Attached) -> Option<Node> {
    let is_form = |a: &Attached| context.setup.forms.iter().any(|f| f.effect.code == a.effect.code);
    let starts = (form.effect.starts)(&context.span);
    (!node.attached.iter().any(is_form))
        .then(|| generalise(context, node, form, &starts))
        .flatten()
}

/// A node with the general friction law, fitted from these starts of its parameters, where the data support one.
pub(in crate::diagnose) fn generalise(
    context: &FitContext<'_>,
    node: &Node,
    form: &Attached,
    starts: &[Vec<f64>],
) -> Option<Node> {
    let structure = context.structure(node.attached.clone()).with(form);
    // The fit begins without the baseline's own friction. Where that law is nearer than the new one still is, the fit would go back to it
    // and stay there: a new law of size zero has no slopes.
    let mut frictionless = node.values.clone();
    if let Some(i) = context.setup.model.friction_ratio {
        frictionless[i] = context.setup.model.parameters[i].bounds[0];
    }
    let starts: Vec<Vec<f64>> = starts
        .iter()
        .map(|group| insert_group(&frictionless, group))
        .collect();
    // A start is far from the minimum, so the fits begin on fewer points where there are many, and the best goes on to all.
    let data = context.coarse().unwrap_or(context.data);
    let without_own =
        ModelStructure::new(context.setup, data, structure.attached.clone()).without_own_friction();
    let starts = straight(context, node, form, starts);
    let fitted = |structure: &ModelStructure<'_>, starts: &[Vec<f64>]| {
        let fitted = context.parallel_map(starts, |start| converge(structure, start.clone()));
        let fitted = fitted.into_iter().flatten().map(|(node, _)| node);
        fitted.min_by(|a, b| a.cost().total_cmp(&b.cost()))
    };
    let near = fitted(&without_own, &starts)?;
    let general = fitted(&structure, &[near.values])?;
    (0.5 * (node.cost() - general.cost()) > PENALTY).then_some(general)
}

/// Starts for a fit of a law with bends: the best of its fits without them, which are few parameters that matter most.
fn straight(context: &FitContext<'_>, node: &Node, form: &Attached, starts: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    if form.effect.shapes.is_empty() || starts.len() <= STRAIGHT {
        return starts;
    }
    let mut held = form.clone();
    for &k in form.effect.shapes {
        held.parameters[k].bounds = [form.effect.neutral[k]; 2];
    }
    let data = context.coarse().unwrap_or(context.data);
    let structure = ModelStructure::new(context.setup, data, node.attached.clone())
        .with(&held)
        .without_own_friction();
    let fitted = context.parallel_map(&starts, |start| converge(&structure, start.clone()));
    let mut fitted: Vec<Node> = fitted.into_iter().flatten().map(|(node, _)| node).collect();
    fitted.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    fitted
        .into_iter()
        .take(STRAIGHT)
        .map(|node| node.values)
        .collect()
}
