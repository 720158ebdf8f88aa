//! What is written as the improved model: the named set refitted as a file can hold it, a law read off the recordings, or a two-sided
//! device.

use super::of_path::FoundOfPath;
use super::rest::Rest;
use super::tables::errors_of_model;
use super::{law, two_sided};
use crate::diagnose::course::Course;
use crate::diagnose::diagnosis::*;
use crate::diagnose::fitting::{FitContext, Node};
use crate::model::Parameter;

/// What is written as the improved model.
pub(super) struct Delivered {
    pub model: ImprovedModel,
    /// The set with its parameters; with a law, refitted beside that.
    pub node: Node,
    pub law: Option<DiscoveredLaw>,
    /// True for the model of a device that pushes and pulls.
    pub two_sided: bool,
    /// Weighted residuals of every point.
    pub residuals: Vec<f64>,
    pub errors: Errors,
}

impl Delivered {
    /// What an unexplained difference is modelled by, in words.
    pub(super) fn modelled_by(&self) -> Option<String> {
        if self.two_sided {
            return Some(
                "the model two-sided (spring, damper and ten friction elements that do not follow the load; it pushes and pulls)"
                    .to_owned(),
            );
        }
        let law = self.law.as_ref()?;
        Some(format!("a law read off the recordings, {}", law.equation))
    }
}

/// The named set. It gets a law that was read off the recordings where the rest is unexplained or larger than an error of shape, and
/// where that law lowers the error on held-out cycles. Where the rest is unexplained, a two-sided device can be better than both. What is
/// refused is neither written nor quoted.
pub(super) fn delivered(
    context: &FitContext<'_>,
    [named, refitted]: [&Node; 2],
    rest: &Rest,
    courses: &[Course],
) -> Delivered {
    let heldout = |context: &FitContext<'_>, node: &Node| errors_of_model(context, node).nrmse_heldout;
    let lowers_error = |found: &law::Discovery| {
        let with_law = heldout(&context.with_setup(&found.setup), &found.node);
        with_law < heldout(context, named) && with_law < heldout(context, refitted)
    };
    let found = (rest.unexplained || rest.is_beyond_shape())
        .then(|| law::discover(context, named))
        .flatten()
        .filter(lowers_error);
    let with_law = found.as_ref().map(|found| context.with_setup(&found.setup));
    let node = found.as_ref().map_or(named, |found| &found.node).clone();
    if rest.unexplained
        && let Some(device) = two_sided::better_than(context, courses, &node.residuals)
    {
        return Delivered {
            model: device.model,
            node: named.clone(),
            law: None,
            two_sided: true,
            residuals: device.residuals,
            errors: device.errors,
        };
    }
    let law = found.as_ref().map(|found| found.law.clone());
    Delivered {
        model: as_model(context, &node, law.as_ref()),
        errors: errors_of_model(with_law.as_ref().unwrap_or(context), &node),
        residuals: node.residuals.clone(),
        node,
        law,
        two_sided: false,
    }
}

/// The node as it can be written: a file has no discrepancy, so the baseline is fitted again without it. The effects keep their
/// values, and those that are not named are taken out.
pub(super) fn as_written(
    context: &FitContext<'_>,
    plain: &FitContext<'_>,
    node: &Node,
    of_path: &FoundOfPath,
) -> Node {
    if context.data.discrepancy.is_none() {
        return node.clone();
    }
    let extras = context.setup.extras.len();
    let (mut written, mut held) = (Vec::new(), Vec::new());
    let mut values = node.values[..context.setup.model.parameters.len()].to_vec();
    for (k, attached) in node.attached.iter().enumerate() {
        if k < extras && !attached.own && !of_path.names(attached.effect.code) {
            continue;
        }
        let own = context.effect_values(node, k);
        values.extend(own);
        written.push(attached.clone());
        let mut kept = attached.clone();
        if k >= extras {
            kept.hold(own);
        }
        held.push(kept);
    }
    values.extend(node.values.last());
    plain.converge(held, values).map_or_else(
        || node.clone(),
        |(fitted, _)| Node {
            attached: written,
            ..fitted
        },
    )
}

/// The model of a node, with its effects in the order in which they are attached.
pub(super) fn as_model(context: &FitContext<'_>, node: &Node, law: Option<&DiscoveredLaw>) -> ImprovedModel {
    let model = context.setup.model;
    let values = |parameters: &[Parameter], from: usize| -> Vec<(String, f64)> {
        parameters
            .iter()
            .enumerate()
            .map(|(i, p)| (p.name.to_owned(), node.values[from + i]))
            .collect()
    };
    let mut order: Vec<usize> = (0..node.attached.len()).collect();
    order.sort_by_key(|&k| (node.attached[k].effect.stage, node.attached[k].effect.code));
    ImprovedModel {
        model: model.name.to_owned(),
        parameters: values(model.parameters, 0),
        structure: context.setup.structure.clone(),
        effects: order
            .into_iter()
            .map(|k| AttachedEffect {
                code: node.attached[k].effect.code.to_owned(),
                parameters: values(&node.attached[k].parameters, context.offset(&node.attached, k)),
            })
            .collect(),
        law: law.map(|l| l.law.clone()),
        force_zero_n: node.values[node.values.len() - 1],
    }
}
