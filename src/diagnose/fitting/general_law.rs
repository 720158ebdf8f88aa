//! The general friction law, fitted in place of the baseline's own: which law a model has is its author's choice.

use super::baseline::Attached;
use super::context::FitContext;
use super::fit::converge;
use super::likelihood::PENALTY;
use super::node::Node;
use super::score::insert_group;
use super::structure::ModelStructure;

/// A node with the general friction law of the setup, where the data support one and the node does not have it yet.
pub(in crate::diagnose) fn with_general_law(context: &FitContext<'_>, node: &Node) -> Option<Node> {
    let form = context.setup.form.as_ref()?;
    let has = node.attached.iter().any(|a| a.effect.code == form.effect.code);
    let starts = (form.effect.starts)(&context.span);
    (!has).then(|| generalise(context, node, form, &starts)).flatten()
}

/// A node with the general friction law, fitted from these starts of its parameters, where the data support one.
pub(in crate::diagnose) fn generalise(
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
    // A start is far from the minimum, so the fit begins on fewer points where there are many.
    let coarse = context
        .coarse()
        .map(|data| ModelStructure::new(context.setup, data, structure.attached.clone()));
    let general = context
        .parallel_map(&starts, |start| {
            let near = coarse.as_ref().and_then(|coarse| converge(coarse, start.clone()));
            converge(
                &structure,
                near.map_or_else(|| start.clone(), |(node, _)| node.values),
            )
        })
        .into_iter()
        .flatten()
        .map(|(node, _)| node)
        .min_by(|a, b| a.cost().total_cmp(&b.cost()))?;
    (0.5 * (node.cost() - general.cost()) > PENALTY).then_some(general)
}
