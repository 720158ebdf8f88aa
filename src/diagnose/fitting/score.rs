//! Score test of a candidate from one simulation: what it would explain that the fitted structure cannot.
//!
//! `S` is the change of the weighted model force that a candidate makes, `S'` what is left of it after projection on the
//! sensitivities `J` of the structure's own parameters. `(r . S')^2 / (2 S' . S')` is the gain in log-likelihood that a fit of the
//! amplitude would bring. `|S'| / |S|` is the share that the structure cannot imitate (Rao 1948, Neyman's C(alpha)).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::baseline::Attached;
use super::structure::ModelStructure;
use crate::effect::Span;

/// Sensitivities of a structure at its values, with the factors to step and to project.
pub(in crate::diagnose) struct Tangent {
    /// Change of the residuals when each parameter moves by its `scale`; held-out points are zero, the priors' rows are last.
    pub jacobian: DMatrix<f64>,
    pub normal: DMatrix<f64>,
    pub scale: Vec<f64>,
    factor: Cholesky<f64, Dyn>,
    /// Residuals in the rows of `jacobian`.
    residuals: DVector<f64>,
}

/// Score of one start of one candidate against a structure.
#[derive(Clone)]
pub(in crate::diagnose) struct CandidateScore {
    /// Index in the list of candidates.
    pub candidate: usize,
    /// Values to start a fit from, with the amplitudes scaled to the best size.
    pub start: Vec<f64>,
    /// The structure's own values, corrected for what the effect now explains in their place.
    pub moved: Vec<f64>,
    /// Predicted gain in log-likelihood, for independent samples.
    pub gain: f64,
    /// Share of the candidate's signature that a refit of the structure leaves.
    pub surviving: f64,
}

impl Tangent {
    pub(in crate::diagnose) fn new(structure: &ModelStructure<'_>, values: &[f64]) -> Option<Tangent> {
        Tangent::at(structure, values, structure.fitted(values)?)
    }

    /// The same where the residuals are known.
    pub(super) fn at(
        structure: &ModelStructure<'_>,
        values: &[f64],
        residuals: DVector<f64>,
    ) -> Option<Tangent> {
        let (jacobian, scale) = structure.sensitivities(values, &residuals);
        let normal = jacobian.tr_mul(&jacobian);
        let mut regular = normal.clone();
        for i in 0..normal.nrows() {
            // Regularised, because a parameter without effect makes the matrix singular.
            regular[(i, i)] = regular[(i, i)] * (1.0 + 1e-9) + 1e-9;
        }
        Some(Tangent {
            jacobian,
            normal,
            scale,
            factor: regular.cholesky()?,
            residuals,
        })
    }

    /// Sum of squares of the residuals, and of the priors.
    pub(super) fn cost(&self) -> f64 {
        self.residuals.norm_squared()
    }

    /// The part of a signature that is orthogonal to the structure's sensitivities.
    pub(in crate::diagnose) fn project(&self, signature: &DVector<f64>) -> DVector<f64> {
        signature - &self.jacobian * self.imitation(signature)
    }

    /// The move of the parameters, in units of their scale, that imitates a signature best.
    fn imitation(&self, signature: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(&self.jacobian.tr_mul(signature))
    }

    /// Values after a move in units of the parameters' scale, within their bounds.
    fn moved(&self, structure: &ModelStructure<'_>, values: &[f64], by: &DVector<f64>) -> Vec<f64> {
        let bounds = structure.parameters_bounds();
        let moves = by.iter().zip(&self.scale).map(|(by, scale)| by * scale);
        let moved = values.iter().zip(moves).zip(bounds);
        moved
            .map(|((v, by), [low, high])| (v + by).clamp(low, high))
            .collect()
    }

    /// Scores of every start of a candidate, best first.
    pub(super) fn scores(
        &self,
        structure: &ModelStructure<'_>,
        values: &[f64],
        index: usize,
        candidate: &Attached,
        span: &Span,
    ) -> Vec<CandidateScore> {
        let with = structure.with(candidate);
        let mut scores: Vec<CandidateScore> = (candidate.effect.starts)(span)
            .into_iter()
            .filter_map(|mut start| {
                for (v, p) in start.iter_mut().zip(&candidate.parameters) {
                    *v = v.clamp(p.bounds[0], p.bounds[1]);
                }
                let moved = with.fitted(&insert_group(values, &start))?;
                let signature = &self.residuals - moved;
                let imitation = self.imitation(&signature);
                let left = &signature - &self.jacobian * &imitation;
                let (whole, power) = (signature.norm_squared(), left.norm_squared());
                if !(power > 1e-12 && whole > 0.0) {
                    return None;
                }
                let along = self.residuals.dot(&left);
                let size = best_size(candidate, along / power);
                let amplitudes = candidate.effect.amplitudes;
                let applied = if amplitudes.is_empty() { 1.0 } else { size };
                start = candidate.effect.at_share(&start, applied, span);
                for &a in amplitudes {
                    let [low, high] = candidate.parameters[a].bounds;
                    start[a] = start[a].clamp(low, high);
                }
                Some(CandidateScore {
                    candidate: index,
                    moved: self.moved(structure, values, &(imitation * applied)),
                    start,
                    gain: size * along - 0.5 * size * size * power,
                    surviving: (power / whole).sqrt(),
                })
            })
            .collect();
        scores.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        scores
    }
}

/// The size in units of its start that an effect should have, within what its parameters allow.
fn best_size(candidate: &Attached, free: f64) -> f64 {
    let amplitudes = candidate.effect.amplitudes;
    if amplitudes.is_empty() {
        return free.clamp(0.0, 1.0);
    }
    match amplitudes
        .iter()
        .all(|&a| candidate.parameters[a].bounds[0] >= 0.0)
    {
        true => free.max(0.0),
        false => free,
    }
}

/// Values with a candidate's group inserted before the force zero.
pub(in crate::diagnose) fn insert_group(values: &[f64], group: &[f64]) -> Vec<f64> {
    let (zero, own) = values.split_last().expect("the last value is the force zero");
    own.iter().chain(group).chain([zero]).copied().collect()
}
