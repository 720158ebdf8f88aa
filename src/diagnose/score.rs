//! Orthogonal scores: what a candidate would explain that the structure at hand cannot absorb, from one simulation each.
//!
//! `S` is the change of the weighted model force from a candidate's start, `S'` what is left of it after projection on
//! the sensitivities `J` of the structure's own parameters. `(r . S')^2 / (2 S' . S')` is the gain in log-likelihood that a
//! fit of the amplitude would bring; `|S'| / |S|` is the share that the structure cannot imitate (Rao 1948, Neyman's C(alpha)).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::baseline::Attached;
use super::condition::Part;
use super::problem::Structure;
use crate::effect::Span;

/// The structure's sensitivities, ready to project on.
pub(super) struct Tangent {
    jacobian: DMatrix<f64>,
    normal: Cholesky<f64, Dyn>,
    /// Weighted residuals of the points that are fitted, the prior's row last.
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
    pub fn new(structure: &Structure<'_>, values: &[f64], all: &[f64]) -> Option<Tangent> {
        let (jacobian, _) = structure.sensitivities(values);
        let mut normal = jacobian.tr_mul(&jacobian);
        for i in 0..normal.nrows() {
            // A parameter without effect must not make the matrix singular.
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + 1e-9;
        }
        let mut residuals: Vec<f64> = fitted(structure, all);
        residuals.push(-values[values.len() - 1] / structure.data.zero_sigma_n);
        Some(Tangent {
            jacobian,
            normal: normal.cholesky()?,
            residuals: DVector::from_vec(residuals),
        })
    }

    /// What is left of a signature after the structure has absorbed what it can.
    pub fn project(&self, signature: &DVector<f64>) -> DVector<f64> {
        signature - &self.jacobian * self.normal.solve(&self.jacobian.tr_mul(signature))
    }

    /// Scores every start of a candidate; the best first.
    pub fn scores(
        &self,
        structure: &Structure<'_>,
        values: &[f64],
        all: &[f64],
        index: usize,
        candidate: &Attached,
        span: &Span,
    ) -> Vec<Score> {
        let mut attached = structure.attached.clone();
        attached.push(candidate.clone());
        let with = Structure::new(structure.setup, structure.data, attached);
        let mut scores: Vec<Score> = (candidate.effect.starts)(span)
            .into_iter()
            .filter_map(|start| {
                let moved = with.residuals(&spliced(values, &start))?;
                let mut signature = fitted(structure, all);
                for (s, m) in signature.iter_mut().zip(fitted(structure, &moved)) {
                    *s -= m;
                }
                signature.push(0.0);
                let signature = DVector::from_vec(signature);
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
                let mut start = start;
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

/// Residuals of the points that are fitted, others zero.
fn fitted(structure: &Structure<'_>, all: &[f64]) -> Vec<f64> {
    all.iter()
        .zip(&structure.data.part)
        .map(|(r, p)| if *p == Part::Fit { *r } else { 0.0 })
        .collect()
}
