//! Laws that get further parameters during a search. The leaves of a pack touch one after the other. A law with one knee cannot follow
//! that, and what it leaves looks like a compliance of the fixture.

use super::knees::kinks_at_the_top;
use super::lack_of_fit::LACK_POWER;
use crate::diagnose::fitting::{
    Attached, FitContext, LikelihoodScale, Node, PARAMETER_PENALTY, PENALTY, Tangent,
};
use crate::effect::{Effect, GROWN_LAWS};

/// Largest share of the sum of squares above the noise that may remain when a law gets larger. In six packs that were looked at, the friction of a
/// leaf that touches and each further leaf left 2 to 35 % of it. Straight pieces follow any curve a little better with each: of a magnet that
/// catches at one place they left 44 to 99 % at each step, and it was named a helper leaf. At half, two of ten of these steps are
/// refused; at double, those of the magnet are not.
const MOST_LEFT: f64 = 0.4;

/// Largest mean square above the noise that a set with a larger law may leave, in units of the noise. It is not zero, because a second
/// hidden effect may still have to be found.
/// Packs that were looked at left 3.9 at most. Of waves of the force over the displacement, pieces left 6.5 and more, and each was named a
/// helper leaf. At half, three of 25 packs grow only beside a second effect; not tried at double.
const MOST_BESIDE_NOISE: f64 = 5.0;

/// Code of the effect of a set whose law may grow; `extras`: number of effects of the baseline, which come first.
///
/// Only the law that explains most by itself grows: a curve beside other curves has the freedom to follow what they leave. Beside a geometric
/// stiffness and a delay, the friction of a leaf that touches explained the waves of a force that no effect has, and all three were sure.
pub(super) fn growing_code(best_single: &Node, extras: usize) -> Option<&'static str> {
    let mut codes = best_single.attached[extras..].iter().map(|a| a.effect.code);
    codes.find(|code| GROWN_LAWS.iter().any(|law| law.code == *code))
}

/// The converged set with the largest law of this code that gains enough; `None` if no larger law does, or if the set with it still leaves
/// too much.
pub(super) fn grown(context: &FitContext<'_>, converged: &(Node, Tangent), code: &str) -> Option<Node> {
    let extras = context.setup.extras.len();
    let place = extras
        + converged.0.attached[extras..]
            .iter()
            .position(|a| a.effect.code == code)?;
    let mut grown: Option<(Node, Tangent)> = None;
    for law in GROWN_LAWS.iter().filter(|law| law.code == code) {
        let from = grown.as_ref().unwrap_or(converged);
        let adds_part = adds_part(&from.0, place, law);
        match with_law(context, from, place, law) {
            Some(better) => grown = Some(better),
            None if adds_part => break,
            None => {}
        }
    }
    let (larger, _) = grown?;
    may_be_right(left(context, &larger), context.data.counted()).then_some(larger)
}

/// Sum of squares that a set leaves above the noise.
fn left(context: &FitContext<'_>, node: &Node) -> f64 {
    node.cost() - context.data.counted() as f64
}

/// True if a larger law leaves little of what was left above the noise: sums of squares before and after.
fn explains_most([before, after]: [f64; 2]) -> bool {
    after < MOST_LEFT * before
}

/// True if what a set leaves above the noise at `counted` points may be another effect that is still to be found.
fn may_be_right(left: f64, counted: usize) -> bool {
    left < MOST_BESIDE_NOISE * counted as f64
}

/// True if a law has one more part than that of the set, not only more freedom.
fn adds_part(node: &Node, place: usize, law: &Effect) -> bool {
    law.amplitudes.len() > node.attached[place].effect.amplitudes.len()
}

/// The set with the next law that has a part more at a place, however little that gains; `None` if there is no such law.
pub(in crate::diagnose) fn with_a_part_more(
    context: &FitContext<'_>,
    converged: &(Node, Tangent),
    place: usize,
) -> Option<(Node, Tangent)> {
    let code = converged.0.attached[place].effect.code;
    let mut laws = GROWN_LAWS.iter().filter(|law| law.code == code);
    let law = laws.find(|law| adds_part(&converged.0, place, law))?;
    larger(context, converged, place, law)
}

/// The set with a larger law at a place, if that gains what its parameters must: a part as much as an effect.
fn with_law(
    context: &FitContext<'_>,
    converged: &(Node, Tangent),
    place: usize,
    law: &'static Effect,
) -> Option<(Node, Tangent)> {
    let node = &converged.0;
    let known = node.attached[place].parameters.len();
    let more = law.parameters.len().checked_sub(known).filter(|more| *more > 0)?;
    if left(context, node) < LACK_POWER * context.data.counted() as f64 {
        return None;
    }
    let must_gain = match adds_part(node, place, law) {
        true => PENALTY + PARAMETER_PENALTY * (more - 1) as f64,
        false => PARAMETER_PENALTY * more as f64,
    };
    let (larger, tangent) = larger(context, converged, place, law)?;
    let scale = LikelihoodScale::of(context.data, &larger.residuals);
    let gains = scale.gain(node.cost() - larger.cost()) > must_gain;
    let explains = explains_most([node, &larger].map(|set| left(context, set)));
    (gains && explains).then_some((larger, tangent))
}

/// The set with a larger law at a place, fitted from the values that it has.
fn larger(
    context: &FitContext<'_>,
    converged: &(Node, Tangent),
    place: usize,
    law: &'static Effect,
) -> Option<(Node, Tangent)> {
    let node = &converged.0;
    let known = node.attached[place].parameters.len();
    let (mut values, part) = match adds_part(node, place, law) {
        false => (node.values.clone(), Vec::new()),
        true => with_part(context, converged, law)?,
    };
    let mut added: Vec<f64> = law.parameters[known..law.parameters.len() - part.len()]
        .iter()
        .map(|p| p.start)
        .collect();
    added.extend(part);
    let from = context.offset(&node.attached, place);
    values.splice(from + known..from + known, added);
    for (value, parameter) in values[from..].iter_mut().zip(law.parameters) {
        *value = value.clamp(parameter.bounds[0], parameter.bounds[1]);
    }
    let mut attached = node.attached.clone();
    attached[place] = Attached::candidate(law);
    context.converge(attached, values)
}

/// The values of a set beside the part that a law has more, and those of the part.
fn with_part(
    context: &FitContext<'_>,
    converged: &(Node, Tangent),
    law: &Effect,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut parts = context.setup.parts.iter();
    let part = parts.find(|part| part.effect.code == law.code)?;
    let beside = context.child(converged, part)?;
    if kinks_at_the_top(context, &beside, converged.0.attached.len()) {
        return None;
    }
    let mut values = beside.values;
    let zero_at = values.len() - 1;
    let of_part = values.drain(zero_at - part.parameters.len()..zero_at).collect();
    Some((values, of_part))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::find;

    fn set(codes: &[&str]) -> Node {
        let candidate = |code: &&str| Attached::candidate(find(code).expect("a code"));
        Node {
            attached: codes.iter().map(candidate).collect(),
            values: Vec::new(),
            residuals: Vec::new(),
            fit: 0.0,
            select: 0.0,
        }
    }

    #[test]
    fn only_a_missing_effect_that_explains_most_by_itself_grows() {
        assert_eq!(
            growing_code(&set(&["progressive_stiffness"]), 0),
            Some("progressive_stiffness")
        );
        assert_eq!(growing_code(&set(&["channel_delay"]), 0), None);
        // The baseline has it already.
        assert_eq!(
            growing_code(&set(&["progressive_stiffness", "channel_delay"]), 1),
            None
        );
    }

    #[test]
    fn a_leaf_that_touches_leaves_little_and_a_magnet_most() {
        // Sums of squares above the noise of a pack and of a magnet that catches at one place.
        assert!(explains_most([64.2, 9.0]) && explains_most([9.0, 0.6]));
        assert!(!explains_most([64.2, 28.3]));
        // Chance may leave less than the noise.
        assert!(explains_most([1.7, -0.3]));
    }

    #[test]
    fn what_is_left_beside_a_leaf_may_be_another_effect_but_no_waves() {
        assert!(may_be_right(3.9 * 600.0, 600) && may_be_right(-10.0, 600));
        assert!(!may_be_right(6.5 * 600.0, 600));
    }
}
