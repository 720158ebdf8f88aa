//! Laws that nobody wrote down: where nothing in the library explains the difference, the difference itself becomes the law. It is
//! a force over one axis ([`ForceLaw`]), same or opposed on the branches, in N or per load, with a band and the shortest equation
//! within the band.
//!
//! `curve` reads the table off the residuals, together with the baseline's parameters; `forms` finds the equation.

mod curve;
mod forms;

use super::tables::errors_of;
use crate::diagnose::course::Split;
use crate::diagnose::diagnosis::DiscoveredLaw;
use crate::diagnose::fitting::{Data, FitContext, ModelStructure, Node, Setup, converge};
use crate::effect::law::ForceLaw;
use curve::LawCurve;

/// Share of the baseline's error above the noise, on cycles that were not fitted, that a law must explain to be delivered.
const LEAST_EXPLAINED: f64 = 0.5;
/// Times that table and baseline are refitted in turn: the load that a law is in proportion to depends on both.
const ROUNDS: usize = 3;

/// A law with the setup that has it and the set that was refitted with it.
pub(super) struct Discovery {
    pub setup: Setup,
    pub node: Node,
    pub law: DiscoveredLaw,
}

/// The law that explains most of what a set leaves, refitted with the baseline's parameters; `None` if no law over one axis
/// explains at least half of it, or the model is slow.
pub(super) fn discover(context: &FitContext<'_>, node: &Node) -> Option<Discovery> {
    if context.setup.surrogate.is_some() {
        return None;
    }
    let mut best = LawCurve::best(context, node)?;
    let mut setup = context.setup.clone();
    let mut fitted = node.clone();
    for round in 0..ROUNDS {
        setup.law = Some(best.law.clone());
        let structure = ModelStructure::new(&setup, context.data, node.attached.clone());
        (fitted, _) = converge(&structure, fitted.values.clone())?;
        if round + 1 < ROUNDS {
            best = best.refitted(context, &setup, &fitted)?;
        }
    }
    let explained = explained_share(context.data, node, &fitted);
    if explained < LEAST_EXPLAINED {
        return None;
    }
    let equation = forms::shortest(&best.law, &best.band);
    let nrmse = |node: &Node| errors_of(context.data, &node.residuals).nrmse_heldout;
    let law = DiscoveredLaw {
        statement: statement(&best.law, &equation),
        equation: equation.text,
        exponent: equation.exponent,
        explained_share: explained,
        nrmse_leftout: [nrmse(node), nrmse(&fitted)],
        band: best.band,
        law: best.law,
    };
    Some(Discovery {
        setup,
        node: fitted,
        law,
    })
}

/// Share of the error above the noise that the second set takes away on cycles that were not fitted.
fn explained_share(data: &Data, before: &Node, after: &Node) -> f64 {
    let above_noise = |node: &Node| {
        [Split::Select, Split::Report]
            .into_iter()
            .map(|split| data.sum(&node.residuals, split) - data.count(split) as f64)
            .sum::<f64>()
    };
    let (before, after) = (above_noise(before), above_noise(after));
    if before <= 0.0 {
        0.0
    } else {
        (before - after) / before
    }
}

/// The law as a sentence for a technician.
fn statement(law: &ForceLaw, equation: &forms::Equation) -> String {
    let motion = if law.opposes_motion {
        "opposes the motion"
    } else {
        "is the same on both branches"
    };
    format!(
        "No effect in the library has this form: a force that depends on {} and {motion}: {}.",
        forms::axis_words(law.axis),
        equation.text
    )
}
