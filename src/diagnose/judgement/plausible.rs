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
    let recorded = Recorded {
        span: context.span,
        force_below_n: &|displacement_mm| force_below_n(context.data, node, displacement_mm),
    };
    let plausible = node.attached[place].effect.plausible;
    plausible(context.effect_values(node, place), &recorded) && kink_is_recorded(context, node, place)
}

/// Median force in N at displacements below one in mm, from the zero of the channel as a set has it.
fn force_below_n(data: &Data, node: &Node, displacement_mm: f64) -> Option<f64> {
    let displacements = data.tracks.iter().flat_map(|t| &t.displacement_mm);
    let points = displacements.zip(&data.force_n);
    let below = points.filter(|(x, _)| **x < displacement_mm);
    let forces: Vec<f64> = below.map(|(_, force_n)| *force_n).collect();
    let zero_n = node.values.last()?;
    (!forces.is_empty()).then(|| median(forces) - zero_n)
}
