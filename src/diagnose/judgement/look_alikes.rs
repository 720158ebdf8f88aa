//! Effects that a general friction law looks like, where that law explains most of what the baseline leaves.

use super::tables::errors_of;
use crate::diagnose::diagnosis::Alternative;
use crate::diagnose::fitting::{Data, FitContext, Node};
use crate::effect::LookAlike;

/// Share of the sum of squares that a general friction law must not leave, to be called the main explanation.
const EXPLAINED_LEAVES: f64 = 0.5;

/// True where the general friction law takes away at least half of what the baseline leaves.
pub(super) fn explains_most(context: &FitContext<'_>, refitted: &Node, base: &Node) -> bool {
    let generalised = refitted.attached.len() < context.setup.extras.len();
    generalised && base.select <= EXPLAINED_LEAVES * refitted.select
}

/// The look-alikes of the general friction law, where it explains most and nothing in the library explains the rest.
pub(super) fn look_alikes(context: &FitContext<'_>, refitted: &Node, base: &Node) -> Vec<Alternative> {
    let Some(form) = &context.setup.form else {
        return Vec::new();
    };
    if !explains_most(context, refitted, base) {
        return Vec::new();
    }
    let held_out = |data: &Data, node: &Node| 100.0 * errors_of(data, &node.residuals).nrmse_heldout;
    let (own, general) = (held_out(context.data, refitted), held_out(context.data, base));
    let alternative = |r: &LookAlike| Alternative {
        code: r.code.to_owned(),
        instead_of: "unknown".to_owned(),
        why: format!(
            "{}: with a general friction law the error on held-out cycles falls from {own:.2} % to {general:.2} %",
            r.why
        ),
        test: r.test.to_owned(),
    };
    form.effect.confusable_with.iter().map(alternative).collect()
}
