//! Laws that get further parameters where they leave structure: the leaves of a pack touch one after the other, and a curve with one knee
//! leaves of two what then looks like a compliance of the fixture.

use super::backward_elimination::kinks_at_the_top;
use crate::diagnose::fitting::{Attached, FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, PENALTY};
use crate::effect::{Effect, GROWN_LAWS};

/// The set with its laws grown as far as that explains more than effects must; `None` if no law of it can grow.
pub(super) fn grown(context: &FitContext<'_>, node: &Node) -> Option<Node> {
    let places = context.setup.extras.len()..node.attached.len();
    let mut grown: Option<Node> = None;
    for place in places {
        let code = node.attached[place].effect.code;
        for law in GROWN_LAWS.iter().filter(|law| law.code == code) {
            let from = grown.as_ref().unwrap_or(node);
            match with_law(context, from, place, law) {
                Some(better) => grown = Some(better),
                None if adds_part(from, place, law) => break,
                None => {}
            }
        }
    }
    grown
}

/// True if a law has one more part than that of the set, not only more freedom.
fn adds_part(node: &Node, place: usize, law: &Effect) -> bool {
    law.amplitudes.len() > node.attached[place].effect.amplitudes.len()
}

/// The set with a larger law at a place, if that gains what its parameters must: a part as much as an effect.
fn with_law(context: &FitContext<'_>, node: &Node, place: usize, law: &'static Effect) -> Option<Node> {
    let known = node.attached[place].parameters.len();
    let more = law.parameters.len().checked_sub(known).filter(|more| *more > 0)?;
    let adds_part = adds_part(node, place, law);
    let must_gain = match adds_part {
        true => PENALTY + PARAMETER_PENALTY * (more - 1) as f64,
        false => PARAMETER_PENALTY * more as f64,
    };
    let scale = LikelihoodScale::of(context.data, &node.residuals);
    if scale.gain(node.cost() - context.data.counted() as f64) < must_gain {
        return None;
    }
    let (node, part) = match adds_part {
        true => with_part(context, node, law)?,
        false => (node.clone(), Vec::new()),
    };
    let mut added: Vec<f64> = law.parameters[known..law.parameters.len() - part.len()]
        .iter()
        .map(|p| p.start)
        .collect();
    added.extend(part);
    let mut values = node.values.clone();
    let after = context.offset(&node.attached, place) + known;
    values.splice(after..after, added);
    let mut attached = node.attached.clone();
    let mut parameters = attached[place].parameters.clone();
    parameters.extend_from_slice(&law.parameters[known..]);
    attached[place] = Attached {
        effect: law,
        parameters,
        own: false,
    };
    let (larger, _) = context.converge(attached, values)?;
    let scale = LikelihoodScale::of(context.data, &larger.residuals);
    (scale.gain(node.cost() - larger.cost()) > must_gain).then_some(larger)
}

/// The set with the part that a law has more, fitted beside it: the values of the set, and those of the part.
fn with_part(context: &FitContext<'_>, node: &Node, law: &Effect) -> Option<(Node, Vec<f64>)> {
    let part = context
        .setup
        .parts
        .iter()
        .find(|part| part.effect.code == law.code)?;
    let converged = context.converged(node)?;
    let beside = context.child(&converged, part)?;
    let mut node = converged.0;
    if kinks_at_the_top(context, &beside, node.attached.len()) {
        return None;
    }
    let mut values = beside.values;
    let zero_at = values.len() - 1;
    let of_part = values.drain(zero_at - part.parameters.len()..zero_at).collect();
    node.values = values;
    Some((node, of_part))
}
