//! Takes back names that no law stands behind: an effect whose size is not the same in all parts of the recordings, and one whose kink
//! moved into the last bit of the travel when its law was brought to the simplest form.

use super::varying_coefficient::variation;
use crate::diagnose::fitting::FitContext;
use crate::diagnose::search::{SearchResult, kinks_at_the_top, without};

/// Largest spread of the size of an effect, as a share of the size. In the cases that were looked at two names had a larger one (2 and
/// 56), and both were wrong; the largest spread of a right name was 0.8.
const MOST_SPREAD: f64 = 1.0;

/// Removes these effects from the chosen set, the worst first. After each the others are judged again.
pub(super) fn take_back(context: &FitContext<'_>, search: &mut SearchResult) {
    while let Some(place) = worst(context, search) {
        search.chosen = without(context, &mut search.nodes, search.chosen, place);
    }
}

/// Place in the chosen set of the effect that is least a law; `None` if all may stay.
fn worst(context: &FitContext<'_>, search: &SearchResult) -> Option<usize> {
    let node = &search.nodes[search.chosen];
    let missing = (context.setup.extras.len()..node.attached.len()).filter(|&k| !node.attached[k].own);
    let spread = |place: usize| {
        let spread = match kinks_at_the_top(context, node, place) {
            true => f64::INFINITY,
            false => variation(context, search.likelihood, node, place)?.spread,
        };
        (spread > MOST_SPREAD).then_some((spread, place))
    };
    let worst = missing.filter_map(spread).max_by(|a, b| a.0.total_cmp(&b.0));
    worst.map(|(_, place)| place)
}
