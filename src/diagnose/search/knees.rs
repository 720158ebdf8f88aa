//! Knees of the missing effects: whether a knee was recorded with both its sides, and whether it may be one of the specimen.

use crate::diagnose::fitting::{FitContext, Node};
use crate::effect::{Axis, Place, Span};

/// An effect with a kink acts on at most this share of its axis, unless the kink is a corner and both its sides are recorded: a knee below
/// nearly all that was recorded is a smooth curve. Leaves of packs touch at 2 to 15 % of the travel.
const MOST_OF_AXIS: f64 = 0.85;
/// A knee must have this share of the travel above it. A vibration that rounds the turning points made a knee in the last 0.7 %.
const LEAST_AT_THE_TOP: f64 = 0.015;
/// A leaf that touches adds at most this share of the rate above the knee: three times the rate below. What nearly begins to be a spring
/// there was not in contact before. Of 158 knees that were named in cases that were looked at, those of leaves added up to 66 %, one beside a
/// soft fixture 78 %; five contacts that close added 75 to 100 %. At half, more than a quarter of the leaves would be contacts; at double,
/// no knee is.
const MOST_OF_RATE: f64 = 0.75;

/// True if every kink of the missing effects lies well within what was recorded.
pub(in crate::diagnose) fn kinks_are_recorded(context: &FitContext<'_>, node: &Node) -> bool {
    (context.setup.extras.len()..node.attached.len()).all(|k| is_recorded(context, node, k))
}

/// True if the kink of the effect at `place` lies well within what was recorded, or if it has none.
fn is_recorded(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    knee(context, node, place).is_none_or(|knee| {
        is_in_what_is_recorded(&context.span, knee.acts, knee.reach)
            && !is_at_the_top(&context.span, knee.acts)
    })
}

/// True if the knee of the effect at `place` may be one of the specimen: it lies within what was recorded, and there is a spring below it. A
/// search may end at one that does not, because a smaller set has its knee elsewhere than the set that it was chosen from.
pub(in crate::diagnose) fn knee_is_plausible(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let leaves = |knee: Knee| leaves_a_spring(&context.span, knee.acts, knee.added_n_per_mm);
    is_recorded(context, node, place) && knee(context, node, place).is_none_or(leaves)
}

/// True if a knee adds so little that a spring is there before it.
fn leaves_a_spring(span: &Span, acts: Place, added_n_per_mm: f64) -> bool {
    let before = 1.0 - (acts.to - acts.from) / span.width(acts.axis);
    let mean_n_per_mm = span.width(Axis::ForceN) / span.travel_mm();
    let above_n_per_mm = mean_n_per_mm + before * added_n_per_mm;
    added_n_per_mm <= MOST_OF_RATE * above_n_per_mm
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
    knee(context, node, place).is_some_and(|knee| is_at_the_top(&context.span, knee.acts))
}

/// The first kink of an effect.
struct Knee {
    /// Where the effect acts: from the kink on, or up to it.
    acts: Place,
    /// How far its corner reaches; `None` for one that is no corner.
    reach: Option<f64>,
    /// Rate that begins there.
    added_n_per_mm: f64,
}

/// The kink of the effect at `place`; `None` for one without, and for one that acts everywhere.
fn knee(context: &FitContext<'_>, node: &Node, place: usize) -> Option<Knee> {
    let attached = &node.attached[place];
    let from = context.offset(&node.attached, place);
    let values = &node.values[from..from + attached.parameters.len()];
    let kink = attached.effect.kinks.first()?;
    Some(Knee {
        acts: (attached.effect.place)(values, &context.span)?,
        reach: (kink.reach)(values),
        added_n_per_mm: (kink.added_n_per_mm)(values),
    })
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

    /// 3080 N over 22 mm are 140 N/mm.
    #[test]
    fn a_leaf_leaves_a_spring_below_its_knee_and_a_contact_does_not() {
        let (span, beyond) = travel(22.0);
        assert!(leaves_a_spring(&span, beyond(1.1), 100.0));
        assert!(!leaves_a_spring(&span, beyond(1.1), 120.0));
        // A leaf that touches half way up: 100 N/mm, then 280.
        assert!(leaves_a_spring(&span, beyond(11.0), 180.0));
        // No knee of the stiffness.
        assert!(leaves_a_spring(&span, beyond(0.2), 0.0));
    }
}
