//! Generalises the baseline's friction law before any effect is called missing, so that its shape is not reported as missing
//! physics: which law a model has is its author's choice.

use crate::diagnose::fitting::{Attached, FitContext, Node, Tangent, generalise, with_general_law};

/// Candidates that are fitted under the baseline's own law, and the number of the best that get the general law afterwards.
const SEEDS_TRIED: usize = 6;
const SEEDS: usize = 3;

/// What the search starts from.
pub(in crate::diagnose) struct SearchStart {
    /// The baseline with its own friction law, refitted.
    pub refitted: Node,
    /// The baseline with the friction law that the search uses: the general one where that is `generalised`.
    pub base: Node,
    pub generalised: bool,
    /// Fits of one effect each, found under the baseline's own friction law.
    pub seeds: Vec<Node>,
}

/// Refits the baseline and generalises its friction law where that gains more than an effect must.
pub(super) fn search_start(context: &FitContext<'_>, first: &Node) -> Option<SearchStart> {
    let parent = context.converged(first)?;
    let refitted = parent.0.clone();
    let form = context.setup.form.as_ref();
    let general = with_general_law(context, &refitted);
    let seeds = match (&general, form) {
        (Some(general), Some(form)) => {
            let own = context.setup.model.parameters.len();
            let fitted = general.values[own..general.values.len() - 1].to_vec();
            seeds(context, parent, (form, fitted))
        }
        _ => Vec::new(),
    };
    Some(SearchStart {
        generalised: general.is_some(),
        base: general.unwrap_or_else(|| refitted.clone()),
        refitted,
        seeds,
    })
}

/// The best single effects on the baseline's own law, with the general law fitted afterwards. A general law that is fitted first
/// adapts to the missing effect and can hide it. The law starts from what it is without the effect.
fn seeds(
    context: &FitContext<'_>,
    parent: (Node, Tangent),
    (form, start): (&Attached, Vec<f64>),
) -> Vec<Node> {
    let starts = [start];
    let mut children = context.children(&[parent], &[], SEEDS_TRIED);
    children.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    children.truncate(SEEDS);
    let general = children.iter().filter_map(|child| {
        let mut node = generalise(context, child, form, &starts)?;
        // The general law comes before the effect, as in all other nodes.
        let (own, added) = (context.setup.model.parameters.len(), node.values.len() - 1);
        node.attached.rotate_right(1);
        node.values[own..added].rotate_right(form.parameters.len());
        Some(node)
    });
    general.collect()
}
