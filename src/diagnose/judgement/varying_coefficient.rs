//! Is an effect one law, or the stand-in of another? The size of a true effect is the same in every recording and on both branches
//! of the loop. A stand-in takes up the error of another law's form, so its size would differ from part to part.
//!
//! The effect's force is cut into parts, one per recording and branch, and each part gets a coefficient of its own (varying-
//! coefficient model, Hastie and Tibshirani 1993). All other parameters may follow in first order. No fit is repeated.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::fitting::{FitContext, LikelihoodScale, Node};

/// Ridge as a share of a part's power: a part that the other parameters imitate keeps the common size.
const RIDGE: f64 = 1e-2;
/// Parts whose share of the effect's power is below this say nothing about its size.
const LEAST_PART: f64 = 1e-4;

/// How far the size of an effect differs between the parts of the recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Variation {
    /// Standard deviation of the size over the parts, as a share of the size; parts count by their power.
    pub spread: f64,
}

/// Spread at which an effect is as likely a stand-in as not. True effects of other formulas than the library's had up to 0.22.
const DOUBTFUL: f64 = 0.5;
/// Exponent of the doubt: half the spread above takes 6 % of the confidence.
const DOUBT_EXPONENT: i32 = 4;

impl Variation {
    /// Factor of the confidence, 0 to 1.
    pub(super) fn trust(self) -> f64 {
        1.0 / (1.0 + (self.spread / DOUBTFUL).powi(DOUBT_EXPONENT))
    }
}

/// The variation of the effect at `place` of a node; `None` where the effect has no force or the node no tangent.
pub(super) fn variation(
    context: &FitContext<'_>,
    likelihood: LikelihoodScale,
    node: &Node,
    place: usize,
) -> Option<Variation> {
    let (node, tangent) = context.converged(node)?;
    let structure = context.structure(node.attached.clone());
    let residuals = structure.fitted(&node.values)?;
    let from = context.offset(&node.attached, place);
    let neutral = node.attached[place].effect.neutral;
    let mut values = node.values.clone();
    values.splice(from..from + neutral.len(), neutral.iter().copied());
    let contribution = structure.fitted(&values)? - &residuals;
    let parts = parts(context, &contribution);
    if parts.is_empty() {
        return None;
    }
    let columns: Vec<DVector<f64>> = parts.iter().map(|part| tangent.project(part)).collect();
    let columns = DMatrix::from_columns(&columns);
    let power: Vec<f64> = parts.iter().map(DVector::norm_squared).collect();
    let mut normal = columns.tr_mul(&columns);
    for (i, power) in power.iter().enumerate() {
        normal[(i, i)] += RIDGE * power;
    }
    let right = columns.tr_mul(&residuals);
    let factor = normal.cholesky()?;
    let deviation = factor.solve(&right);
    // The noise alone makes the sizes differ by this much.
    let variance = likelihood.variance * likelihood.correlation_time;
    let by_noise = factor.inverse().diagonal() * variance;
    let weighted: f64 = (0..power.len())
        .map(|i| (deviation[i].powi(2) - by_noise[i]).max(0.0) * power[i])
        .sum();
    Some(Variation {
        spread: (weighted / power.iter().sum::<f64>()).sqrt(),
    })
}

/// The effect's weighted force, one column per recording and branch.
fn parts(context: &FitContext<'_>, contribution: &DVector<f64>) -> Vec<DVector<f64>> {
    let whole = contribution.norm_squared();
    let mut parts = Vec::new();
    let mut first = 0;
    for track in &context.data.tracks {
        for branch in [1.0, -1.0] {
            let mut part = DVector::zeros(contribution.len());
            for (i, direction) in track.direction.iter().enumerate() {
                if *direction == branch {
                    part[first + i] = contribution[first + i];
                }
            }
            if part.norm_squared() > LEAST_PART * whole {
                parts.push(part);
            }
        }
        first += track.len();
    }
    parts
}
