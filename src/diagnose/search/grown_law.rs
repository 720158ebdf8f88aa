//! Laws that get further parameters where they leave structure: the leaves of a pack touch one after the other, and a curve with one knee
//! leaves of two what then looks like a compliance of the fixture.

use super::backward_elimination::kinks_at_the_top;
use super::lack_of_fit::LACK_POWER;
use crate::diagnose::fitting::{
    Attached, FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, PENALTY, Tangent,
};
use crate::effect::{Effect, GROWN_LAWS};

/// Share of what a set leaves above the noise that it may still leave with a larger law. In six packs that were looked at, the friction of a
/// leaf that touches and each further leaf left 2 to 35 % of it. Straight pieces follow any curve a little better with each: of a magnet that
/// catches at one place they left 44 to 99 % at each step, and it was named a helper leaf. At half, two of ten of these steps are
/// refused; at double, those of the magnet are not.
const MOST_LEFT: f64 = 0.4;

/// Mean square above that of the noise that a set may leave with a larger law, in units of the noise. Packs that were looked at left 2.2 at most,
/// but for one that hides a backlash (5.3). Of waves of the force over the displacement, pieces left 6.5 and more, and each was named a
/// helper leaf. Not tried at half and double.
const MOST_BESIDE_NOISE: f64 = 3.0;

/// True if a missing effect of a set may become a larger law; `extras`: number of effects of the baseline, which come first.
pub(super) fn can_grow(node: &Node, extras: usize) -> bool {
    let larger = |a: &Attached| {
        let of_code = GROWN_LAWS.iter().filter(|law| law.code == a.effect.code);
        of_code.max_by_key(|law| law.parameters.len())
    };
    let grows = |a: &Attached| larger(a).is_some_and(|law| law.parameters.len() > a.parameters.len());
    node.attached[extras..].iter().any(grows)
}

/// The set with its laws grown as far as that explains more than effects must; `None` if no law of it can grow, or if it then leaves more
/// than a law that is right does.
pub(super) fn grown(context: &FitContext<'_>, node: &Node) -> Option<Node> {
    let places = context.setup.extras.len()..node.attached.len();
    let mut grown: Option<(Node, Tangent)> = None;
    for place in places {
        let code = node.attached[place].effect.code;
        for law in GROWN_LAWS.iter().filter(|law| law.code == code) {
            let from = grown.as_ref().map_or(node, |(larger, _)| larger);
            let adds_part = adds_part(from, place, law);
            match with_law(context, (from, grown.as_ref()), place, law) {
                Some(better) => grown = Some(better),
                None if adds_part => break,
                None => {}
            }
        }
    }
    let (larger, _) = grown?;
    (left(context, &larger) < MOST_BESIDE_NOISE * context.data.counted() as f64).then_some(larger)
}

/// Sum of squares that a set leaves above the noise.
fn left(context: &FitContext<'_>, node: &Node) -> f64 {
    node.cost() - context.data.counted() as f64
}

/// True if a law has one more part than that of the set, not only more freedom.
fn adds_part(node: &Node, place: usize, law: &Effect) -> bool {
    law.amplitudes.len() > node.attached[place].effect.amplitudes.len()
}

/// The set with a larger law at a place, if that gains what its parameters must: a part as much as an effect. `converged`: the set with its
/// tangent, where it has one.
fn with_law(
    context: &FitContext<'_>,
    (node, converged): (&Node, Option<&(Node, Tangent)>),
    place: usize,
    law: &'static Effect,
) -> Option<(Node, Tangent)> {
    let known = node.attached[place].parameters.len();
    let more = law.parameters.len().checked_sub(known).filter(|more| *more > 0)?;
    if left(context, node) < LACK_POWER * context.data.counted() as f64 {
        return None;
    }
    let adds_part = adds_part(node, place, law);
    let must_gain = match adds_part {
        true => PENALTY + PARAMETER_PENALTY * (more - 1) as f64,
        false => PARAMETER_PENALTY * more as f64,
    };
    let (node, part) = match (adds_part, converged) {
        (false, _) => (node.clone(), Vec::new()),
        (true, Some(converged)) => with_part(context, converged, law)?,
        (true, None) => with_part(context, &context.converged(node)?, law)?,
    };
    let mut added: Vec<f64> = law.parameters[known..law.parameters.len() - part.len()]
        .iter()
        .map(|p| p.start)
        .collect();
    added.extend(part);
    let mut values = node.values.clone();
    let from = context.offset(&node.attached, place);
    values.splice(from + known..from + known, added);
    for (value, parameter) in values[from..].iter_mut().zip(law.parameters) {
        *value = value.clamp(parameter.bounds[0], parameter.bounds[1]);
    }
    let mut attached = node.attached.clone();
    attached[place] = Attached::candidate(law);
    let (larger, tangent) = context.converge(attached, values)?;
    let scale = LikelihoodScale::of(context.data, &larger.residuals);
    let explains = scale.gain(node.cost() - larger.cost()) > must_gain
        && left(context, &larger) < MOST_LEFT * left(context, &node);
    explains.then_some((larger, tangent))
}

/// The set with the part that a law has more, fitted beside it: the values of the set, and those of the part.
fn with_part(
    context: &FitContext<'_>,
    converged: &(Node, Tangent),
    law: &Effect,
) -> Option<(Node, Vec<f64>)> {
    let mut parts = context.setup.parts.iter();
    let part = parts.find(|part| part.effect.code == law.code)?;
    let beside = context.child(converged, part)?;
    let mut node = converged.0.clone();
    if kinks_at_the_top(context, &beside, node.attached.len()) {
        return None;
    }
    let mut values = beside.values;
    let zero_at = values.len() - 1;
    let of_part = values.drain(zero_at - part.parameters.len()..zero_at).collect();
    node.values = values;
    Some((node, of_part))
}
