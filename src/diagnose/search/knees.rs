//! Knees of the missing effects: whether a knee was recorded, with both its sides.

use crate::diagnose::fitting::{FitContext, Node};
use crate::effect::{Axis, Place, Span};

/// An effect with a kink acts on at most this share of its axis, unless the kink is a corner and both its sides are recorded: a knee below
/// nearly all that was recorded is a smooth curve. Leaves of packs touch at 2 to 15 % of the travel.
const MOST_OF_AXIS: f64 = 0.85;
/// A knee must have this share of the travel above it. A vibration that rounds the turning points made a knee in the last 0.7 %.
const LEAST_AT_THE_TOP: f64 = 0.015;

/// True if every kink of the missing effects lies well within what was recorded.
pub(in crate::diagnose) fn kinks_are_recorded(context: &FitContext<'_>, node: &Node) -> bool {
    (context.setup.extras.len()..node.attached.len()).all(|k| kink_is_recorded(context, node, k))
}

/// True if the kink of the effect at `place` lies well within what was recorded, or if it has none. A search may end at one that does not,
/// because a smaller set has its knee elsewhere than the set that it was chosen from.
pub(in crate::diagnose) fn kink_is_recorded(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    kink(context, node, place).is_none_or(|(acts, reach)| {
        is_in_what_is_recorded(&context.span, acts, reach) && !is_at_the_top(&context.span, acts)
    })
}

/// True if enough is recorded before a kink: a share of the axis or, for a corner, the distance at which it is over (`reach`).
fn is_in_what_is_recorded(span: &Span, acts: Place, reach: Option<f64>) -> bool {
    let axis = span.width(acts.axis);
    let before = axis - (acts.to - acts.from);
    let has_corner = reach.is_some_and(|reach| before >= reach.max(LEAST_AT_THE_TOP * axis));
    has_corner || acts.to - acts.from <= MOST_OF_AXIS * axis
}

/// True for an effect with a knee in the last bit of the travel, where the turning points and a vibration round the loop.
pub(in crate::diagnose) fn kinks_at_the_top(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    kink(context, node, place).is_some_and(|(acts, _)| is_at_the_top(&context.span, acts))
}

/// Where an effect with a kink acts, and how far its corner reaches; `None` for one without, and for one that acts everywhere.
fn kink(context: &FitContext<'_>, node: &Node, place: usize) -> Option<(Place, Option<f64>)> {
    let (effect, values) = (node.attached[place].effect, context.effect_values(node, place));
    let kink = effect.kinks.first()?;
    let acts = (effect.place)(values, &context.span)?;
    Some((acts, (kink.reach)(values)))
}

/// True for a place that is only the last bit before the upper turning points.
fn is_at_the_top(span: &Span, place: Place) -> bool {
    place.axis == Axis::DisplacementMm
        && place.to >= span.displacement_mm[1]
        && place.to - place.from < LEAST_AT_THE_TOP * span.travel_mm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::Branch;

    /// A travel from 0 to `top_mm`, and all of it beyond a displacement.
    fn travel(top_mm: f64) -> (Span, impl Fn(f64) -> Place) {
        let span = Span {
            displacement_mm: [0.0, top_mm],
            force_n: [0.0, 3080.0],
            speed_mm_s: 30.0,
            duration_s: 60.0,
            cycles: 10.0,
        };
        let beyond = move |from| Place {
            axis: Axis::DisplacementMm,
            from,
            to: top_mm,
            branch: Branch::Both,
        };
        (span, beyond)
    }

    #[test]
    fn a_knee_in_the_last_bit_of_the_travel_is_at_the_top() {
        let (span, beyond) = travel(34.34);
        assert!(is_at_the_top(&span, beyond(34.1)));
        assert!(!is_at_the_top(&span, beyond(30.0)));
        // A contact near the lower end is far from the upper turning points.
        let contact = Place {
            from: 0.0,
            to: 0.2,
            ..beyond(0.0)
        };
        assert!(!is_at_the_top(&span, contact));
    }

    #[test]
    fn a_corner_low_in_the_travel_is_recorded_on_both_sides_and_a_curve_is_not() {
        let (span, beyond) = travel(22.0);
        // A leaf touches at 1.5 mm, within 0.5 mm. A curve of any power that begins there is no knee.
        assert!(is_in_what_is_recorded(&span, beyond(1.5), Some(0.5)));
        assert!(!is_in_what_is_recorded(&span, beyond(1.5), None));
        assert!(is_in_what_is_recorded(&span, beyond(4.0), None));
        // The corner is not over where the recording begins, or is in the last bit before it.
        assert!(!is_in_what_is_recorded(&span, beyond(1.5), Some(2.0)));
        assert!(!is_in_what_is_recorded(&span, beyond(0.2), Some(0.01)));
    }
}
