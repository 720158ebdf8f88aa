//! The general friction laws, fitted in place of the baseline's own: which law a model has is its author's choice.

use super::baseline::{Attached, Setup};
use super::context::FitContext;
use super::data::Data;
use super::fit::converge;
use super::likelihood::PENALTY;
use super::node::Node;
use super::score::insert_group;
use super::structure::ModelStructure;

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
    let starts: Vec<Vec<f64>> = starts
        .iter()
        .map(|group| insert_group(&frictionless, group))
        .collect();
    // The way from a start is long: on fewer points where there are many.
    let data = context.coarse().unwrap_or(context.data);
    let straight = fitted(context, data, node, &without_bends(form), &starts);
    let starts: Vec<Vec<f64>> = straight.into_iter().take(STRAIGHT).map(|n| n.values).collect();
    let mut bent = fitted(context, data, node, form, &starts);
    if context.coarse().is_some() {
        let start = bent.into_iter().next()?.values;
        bent = fitted(context, context.data, node, form, &[start]);
    }
    let general = bent.into_iter().next()?;
    (0.5 * (node.cost() - general.cost()) > PENALTY).then_some(general)
}

/// The node with a law, fitted from each start to these points; the best first.
fn fitted(
    context: &FitContext<'_>,
    data: &Data,
    node: &Node,
    form: &Attached,
    starts: &[Vec<f64>],
) -> Vec<Node> {
    let structure = ModelStructure::new(context.setup, data, node.attached.clone()).with(form);
    let ends = context.parallel_map(starts, |start| converge(&structure, start.clone()));
    let mut ends: Vec<Node> = ends.into_iter().flatten().map(|(node, _)| node).collect();
    ends.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    ends
}

/// The law with its bends at their neutral values: the fit begins with the few parameters that matter most.
fn without_bends(form: &Attached) -> Attached {
    let mut held = form.clone();
    for &k in form.effect.shapes {
        held.parameters[k].bounds = [form.effect.neutral[k]; 2];
    }
    held
}
