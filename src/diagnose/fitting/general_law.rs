//! The general friction laws, fitted in place of the baseline's own: which law a model has is its author's choice.

use super::baseline::{Attached, Setup};
use super::context::FitContext;
use super::fit::converge;
use super::likelihood::PENALTY;
use super::node::Node;
use super::score::insert_group;

/// Number of fits without bends that are fitted further with them.
const STRAIGHT: usize = 2;

/// A node with each general friction law that the data support, the best first.
pub(in crate::diagnose) fn general_laws(context: &FitContext<'_>, node: &Node) -> Vec<Node> {
    let fitted = context.setup.forms.iter().filter_map(|form| {
        let known = context
            .setup
            .known_forms
            .iter()
            .find(|(code, _)| *code == form.effect.code);
        let starts = known.map_or_else(
            || (form.effect.starts)(&context.span),
            |(_, values)| vec![values.clone()],
        );
        with_form(context, node, form, &starts)
    });
    let mut general: Vec<Node> = fitted.collect();
    general.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    general
}

/// Remembers the general friction law that was attached last to each of these nodes: later fits start from there.
pub(super) fn remember(setup: &mut Setup, nodes: &[Node]) {
    let law = |node: &Node| {
        let form = node.attached.last()?;
        let end = node.values.len() - 1;
        Some((
            form.effect.code,
            node.values[end - form.parameters.len()..end].to_vec(),
        ))
    };
    setup.known_forms = nodes.iter().filter_map(law).collect();
}

/// The best of them, or the node itself.
pub(super) fn generalised(context: &FitContext<'_>, node: Node) -> Node {
    general_laws(context, &node).into_iter().next().unwrap_or(node)
}

/// A node with one general friction law, fitted from these starts of its parameters, where the data support it.
pub(in crate::diagnose) fn with_form(
    context: &FitContext<'_>,
    node: &Node,
    form: &Attached,
    starts: &[Vec<f64>],
) -> Option<Node> {
    // The fit starts without the baseline's own friction: a law without memory of the last reversal would stop it early.
    let mut frictionless = node.values.clone();
    if let Some(i) = context.setup.model.friction_ratio {
        frictionless[i] = context.setup.model.parameters[i].bounds[0];
    }
    let starts = starts
        .iter()
        .map(|group| insert_group(&frictionless, group))
        .collect();
    let fitted = |form: &Attached, starts: &Vec<Vec<f64>>| {
        let structure = context.structure(node.attached.clone()).with(form);
        let ends = context.parallel_map(starts, |start| converge(&structure, start.clone()));
        let mut ends: Vec<Node> = ends.into_iter().flatten().map(|(node, _)| node).collect();
        ends.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
        ends
    };
    let straight = fitted(&without_bends(form), &starts);
    let bent_starts = straight
        .into_iter()
        .take(STRAIGHT)
        .map(|node| node.values)
        .collect();
    let general = fitted(form, &bent_starts).into_iter().next()?;
    (0.5 * (node.cost() - general.cost()) > PENALTY).then_some(general)
}

/// The law with its bends at their neutral values: the fit begins with the few parameters that matter most.
fn without_bends(form: &Attached) -> Attached {
    let mut held = form.clone();
    for &k in form.effect.shapes {
        held.parameters[k].bounds = [form.effect.neutral[k]; 2];
    }
    held
}
