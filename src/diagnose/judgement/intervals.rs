//! 95 % confidence intervals of the parameters of a set.

use crate::diagnose::course::Split;
use crate::diagnose::fitting::{FitContext, LikelihoodScale, ModelStructure, Node, profile_interval};
use crate::identify::Residuals;
use crate::identify::confidence::{Confidence, confidence};
use crate::identify::evaluator::Evaluator;

/// Rise of the sum of squares, in variances, at the ends of a 95 % interval: the 95 % quantile of chi-square, one degree of freedom.
const RISE: f64 = 3.84;
/// Step of the difference quotients as a share of a parameter's scale.
const RELATIVE_STEP: f64 = 1e-5;

/// Linear intervals; for kinks the wider of these and the profile likelihood intervals.
pub(super) fn intervals(context: &FitContext<'_>, node: &Node, likelihood: LikelihoodScale) -> Confidence {
    let structure = ModelStructure::new(context.setup, context.data, node.attached.clone());
    let mut evaluator = Evaluator::new(&structure, context.threads());
    let mut residuals = vec![0.0; structure.count()];
    evaluator.residuals(&node.values, &mut residuals);
    let mut found = confidence(&mut evaluator, &node.values, &residuals, RELATIVE_STEP);
    // Held-out points are rows of zeros, as if they were fitted exactly: the variance follows from the fitted points alone.
    let wider = (residuals.len() as f64 / context.data.count(Split::Fit).max(1) as f64).sqrt();
    for ((interval, sigma), value) in found.ci95.iter_mut().zip(&mut found.sigma).zip(&node.values) {
        *sigma *= wider;
        if let Some(ends) = interval {
            *ends = ends.map(|end| value + wider * (end - value));
        }
    }
    if let Some((converged, tangent)) = context.converged(node) {
        let rise = RISE * likelihood.variance * likelihood.correlation_time;
        for (k, attached) in node.attached.iter().enumerate() {
            for kink in attached.effect.kinks {
                let place = context.offset(&node.attached, k) + kink.position;
                let width = context.span.width(kink.axis);
                let profiled = profile_interval(&structure, &converged, &tangent, place, width, rise);
                found.ci95[place] = match (found.ci95[place], profiled) {
                    (Some(a), Some(b)) => Some([a[0].min(b[0]), a[1].max(b[1])]),
                    (a, b) => a.or(b),
                };
            }
        }
    }
    found
}
