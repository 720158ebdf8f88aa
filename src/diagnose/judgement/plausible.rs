//! Effects that a specimen or rig may have. A search goes by the fit alone.

use crate::diagnose::fitting::{FitContext, Node};
use crate::diagnose::search::kink_is_recorded;

/// True if every missing effect of a set is plausible.
pub(super) fn is_plausible_set(context: &FitContext<'_>, node: &Node) -> bool {
    (context.setup.extras.len()..node.attached.len()).all(|place| is_plausible(context, node, place))
}

/// True if a specimen or rig may have the effect at `place`, and a kink of it lies within what was recorded.
pub(super) fn is_plausible(context: &FitContext<'_>, node: &Node, place: usize) -> bool {
    let plausible = node.attached[place].effect.plausible;
    plausible(context.effect_values(node, place), &context.span) && kink_is_recorded(context, node, place)
}
