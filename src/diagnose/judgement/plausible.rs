//! Effects that a specimen or rig may have. A search goes by the fit alone.

use crate::diagnose::conditioning::median;
use crate::diagnose::fitting::{Data, FitContext, Node};
use crate::diagnose::search::kink_is_recorded;
use crate::effect::Recorded;

/// True if every missing effect of a set is plausible.
pub(super) fn is_plausible_set(context: &FitContext<'_>, node: &Node) -> bool {
    (context.setup.extras.len()..node.attached.len()).all(|place| is_plausible(context, node, place))
}

/// True if a specimen or rig may have the effect at `place`, and a kink of it lies within what was recorded.
pub(super) fn is_plausible(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let zero_n = node.values.last().copied().unwrap_or(0.0);
    let recorded = Recorded {
        span: context.span,
        noise_n: median(context.data.tracks.iter().map(|t| t.noise_n).collect()),
        force_n: &|range_mm| force_n(context.data, range_mm),
        force_below_n: &|displacement_mm| {
            force_n(context.data, [f64::NEG_INFINITY, displacement_mm]).map(|n| nearer_to_none(n, zero_n))
        },
    };
    let plausible = node.attached[place].effect.plausible;
    plausible(context.effect_values(node, place), &recorded) && kink_is_recorded(context, node, place)
}

/// Median force in N, as it was recorded, at displacements in a range in mm.
fn force_n(data: &Data, [from_mm, to_mm]: [f64; 2]) -> Option<f64> {
    let displacements = data.tracks.iter().flat_map(|t| &t.displacement_mm);
    let points = displacements.zip(&data.force_n);
    let within = points.filter(|(x, _)| (from_mm..to_mm).contains(*x));
    let forces: Vec<f64> = within.map(|(_, force_n)| *force_n).collect();
    (!forces.is_empty()).then(|| median(forces))
}

/// A force as it was recorded, or less the zero of its channel as a set has it: whichever is nearer to no force. A set that misses the points
/// below a contact has a poor zero as well. In a case that was looked at, its zero was off by 14 N; as recorded, the median was -2 N, and the
/// contact was there.
fn nearer_to_none(as_recorded_n: f64, zero_n: f64) -> f64 {
    let from_zero_n = as_recorded_n - zero_n;
    match from_zero_n.abs() < as_recorded_n.abs() {
        true => from_zero_n,
        false => as_recorded_n,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_force_is_recorded_below_a_contact_whatever_zero_a_poor_set_has() {
        // A contact that was there, in a set that missed the points below it by 14 N.
        assert_eq!(nearer_to_none(-2.0, -14.0), -2.0);
        // A channel that reads 150 N without load.
        assert_eq!(nearer_to_none(151.0, 150.0), 1.0);
        assert_eq!(nearer_to_none(40.0, -1.0), 40.0);
    }
}
