//! Orthogonal scores: what a candidate would explain that the structure at hand cannot absorb, from one simulation each.
//!
//! `S` is the change of the weighted model force from a candidate's start, `S'` what is left of it after projection on
//! the sensitivities `J` of the structure's own parameters. `(r . S')^2 / (2 S' . S')` is the gain in log-likelihood that a
//! fit of the amplitude would bring; `|S'| / |S|` is the share that the structure cannot imitate (Rao 1948, Neyman's C(alpha)).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::baseline::Attached;
use super::problem::ModelStructure;
use crate::effect::Span;

/// A structure's sensitivities at its values, ready to step and to project on.
pub(super) struct Tangent {
    /// Change of the residuals for a move of each parameter by its `scale`; held-out points zero, the prior's row last.
    pub jacobian: DMatrix<f64>,
    pub normal: DMatrix<f64>,
    pub scale: Vec<f64>,
    factor: Cholesky<f64, Dyn>,
    /// Residuals in the same rows.
    residuals: DVector<f64>,
}

/// One start of one candidate against a structure.
#[derive(Clone)]
pub(super) struct Score {
    /// Index in the list of candidates.
    pub candidate: usize,
    /// Values to begin a fit from, amplitudes scaled to the best size.
    pub start: Vec<f64>,
    /// Predicted gain in log-likelihood, for independent samples.
    pub gain: f64,
    /// Share of the candidate's signature that survives the refit of the structure.
    pub surviving: f64,
}

impl Tangent {
    pub(super) fn new(structure: &ModelStructure<'_>, values: &[f64]) -> Option<Tangent> {
        let residuals = structure.fitted(values)?;
        let (jacobian, scale) = structure.sensitivities(values, &residuals);
        let normal = jacobian.tr_mul(&jacobian);
        let mut regular = normal.clone();
        for i in 0..normal.nrows() {
            // A parameter without effect must not make the matrix singular.
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

    /// What is left of a signature after the structure has absorbed what it can.
    pub(super) fn project(&self, signature: &DVector<f64>) -> DVector<f64> {
        signature - &self.jacobian * self.factor.solve(&self.jacobian.tr_mul(signature))
    }

    /// Scores every start of a candidate; the best first.
    pub(super) fn scores(
        &self,
        structure: &ModelStructure<'_>,
        values: &[f64],
        index: usize,
        candidate: &Attached,
        span: &Span,
    ) -> Vec<Score> {
        let with = structure.with(candidate);
        let mut scores: Vec<Score> = (candidate.effect.starts)(span)
            .into_iter()
            .filter_map(|mut start| {
                for (v, p) in start.iter_mut().zip(&candidate.parameters) {
                    *v = v.clamp(p.bounds[0], p.bounds[1]);
                }
                let moved = with.fitted(&spliced(values, &start))?;
                let signature = &self.residuals - moved;
                let left = self.project(&signature);
                let (whole, power) = (signature.norm_squared(), left.norm_squared());
                if !(power > 1e-12 && whole > 0.0) {
                    return None;
                }
                let along = self.residuals.dot(&left);
                let mut size = along / power;
                let amplitudes = candidate.effect.amplitudes;
                if amplitudes.is_empty() {
                    size = size.clamp(0.0, 1.0);
                } else if amplitudes
                    .iter()
                    .all(|&a| candidate.parameters[a].bounds[0] >= 0.0)
                {
                    size = size.max(0.0);
                }
                for &a in amplitudes {
                    let [low, high] = candidate.parameters[a].bounds;
                    start[a] = (start[a] * size).clamp(low, high);
                }
                Some(Score {
                    candidate: index,
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

/// Values with a candidate's group put before the zero.
pub(super) fn spliced(values: &[f64], group: &[f64]) -> Vec<f64> {
    let (zero, own) = values.split_last().expect("every structure has a zero");
    own.iter().chain(group).chain([zero]).copied().collect()
}
