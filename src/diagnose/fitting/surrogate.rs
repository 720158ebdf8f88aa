//! Replaces a slow model during the search: its force along the recordings, how that changes with its parameters, and an operator
//! for displacements beside the recorded ones. A leaf pack takes 0.1 s for all recordings, and a search runs it thousands of times.
//!
//! ```text
//! F(x, p) = sum w_e (F_e + S_e (p - p_e)) + H(x) - H(recorded x),      w_e as 1 / |p - p_e|^2, of sum 1
//! ```
//! At every point of the recordings `F_e` and `S_e` are the model's own force and slopes with the parameters of expansion e. Between
//! expansions they are blended (Shepard 1968), so force and slopes are exact at each. Where effects leave the displacement as
//! recorded, `H` cancels and only the curvature in the parameters is neglected; each expansion makes that error smaller. `H` is for
//! effects that shift the displacement: a polynomial and elastic-plastic elements (Prandtl and Ishlinskii), with strengths
//! quadratic in the displacement, fitted to `F_e`. The final result is fitted and compared on the model itself.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::surrogate_plant::{HysteresisOperator, Scale, SurrogatePlant, TERMS};
use crate::diagnose::conditioning::Track;
use crate::model::{Parameter, Plant};

/// An expansion with a smaller share of the blend is left out.
const LEAST_BLEND: f64 = 1e-9;

/// Forces and slopes of the model at some parameters.
#[derive(Clone)]
struct Expansion {
    values: Vec<f64>,
    force_n: DVector<f64>,
    /// One column per parameter, N per unit; zero where it is fixed.
    slopes: DMatrix<f64>,
    /// Coefficients of the terms of `H`.
    strengths: DVector<f64>,
}

/// The surrogate of a slow model.
#[derive(Clone)]
pub(in crate::diagnose) struct Surrogate {
    expansions: Vec<Expansion>,
    /// For each parameter why it is not identifiable and fixed; `None` where it is fitted.
    fixed: Vec<Option<&'static str>>,
    parameters: &'static [Parameter],
    /// Terms of `H`, one column per recorded point.
    terms: Arc<DMatrix<f64>>,
    /// Recorded displacement, mm.
    recorded_mm: Arc<Vec<f64>>,
    scale: Scale,
}

impl Surrogate {
    /// Without an expansion: the terms of `H` along the tracks, which lie in this range of displacement.
    pub(super) fn new(parameters: &'static [Parameter], tracks: &[Track], range_mm: [f64; 2]) -> Surrogate {
        let scale = Scale::of(range_mm);
        let mut operator = HysteresisOperator::new(scale);
        let recorded_mm: Vec<f64> = tracks.iter().flat_map(|t| t.displacement_mm.clone()).collect();
        let mut terms = Vec::with_capacity(recorded_mm.len() * TERMS);
        for track in tracks {
            operator.reset();
            for &x in &track.displacement_mm {
                operator.move_to(x);
                terms.extend(operator.terms());
            }
        }
        Surrogate {
            expansions: Vec::new(),
            fixed: vec![None; parameters.len()],
            parameters,
            terms: Arc::new(DMatrix::from_vec(TERMS, recorded_mm.len(), terms)),
            recorded_mm: Arc::new(recorded_mm),
            scale,
        }
    }

    /// Adds an expansion: force and slopes of the model at some values of its parameters. Returns the RMS error that the surrogate
    /// had there, in units of the noise.
    pub(super) fn add(
        &mut self,
        values: &[f64],
        force_n: DVector<f64>,
        slopes: DMatrix<f64>,
        weight: &[f64],
    ) -> Option<f64> {
        let error = if self.expansions.is_empty() {
            f64::INFINITY
        } else {
            let (blended_n, _) = self.blend(values);
            let squares = (0..weight.len()).map(|i| ((blended_n[i] - force_n[i]) * weight[i]).powi(2));
            let counted = weight.iter().filter(|w| **w > 0.0).count().max(1);
            (squares.sum::<f64>() / counted as f64).sqrt()
        };
        let mut normal = &*self.terms * self.terms.transpose();
        for i in 0..TERMS {
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-6) + 1e-9;
        }
        let strengths = normal.cholesky()?.solve(&(&*self.terms * &force_n));
        self.expansions.push(Expansion {
            values: values.to_vec(),
            force_n,
            slopes,
            strengths,
        });
        Some(error)
    }

    /// Fixes the parameters that the slopes of the first expansion do not identify; `why_not` gives for each parameter the reason.
    pub(super) fn fix(&mut self, why_not: impl FnOnce(&DMatrix<f64>) -> Vec<Option<&'static str>>) {
        let slopes = &mut self.expansions[0].slopes;
        self.fixed = why_not(slopes);
        for (p, _) in self.fixed.iter().enumerate().filter(|(_, h)| h.is_some()) {
            slopes.column_mut(p).fill(0.0);
        }
    }

    /// Force at every recorded point, and strengths of `H`, for some values.
    fn blend(&self, values: &[f64]) -> (DVector<f64>, DVector<f64>) {
        let moves: Vec<DVector<f64>> = self
            .expansions
            .iter()
            .map(|e| DVector::from_iterator(values.len(), values.iter().zip(&e.values).map(|(v, o)| v - o)))
            .collect();
        let near: Vec<f64> = moves
            .iter()
            .map(|m| {
                let free = (0..m.len()).filter(|&i| self.fixed[i].is_none());
                let square = free
                    .map(|i| (m[i] / belief_width(&self.parameters[i])).powi(2))
                    .sum::<f64>();
                1.0 / (square + 1e-12)
            })
            .collect();
        let all: f64 = near.iter().sum();
        let mut force_n = DVector::zeros(self.terms.ncols());
        let mut strengths = DVector::zeros(TERMS);
        for ((e, m), near) in self.expansions.iter().zip(&moves).zip(near) {
            let share = near / all;
            if share < LEAST_BLEND {
                continue;
            }
            force_n.axpy(share, &e.force_n, 1.0);
            force_n.gemv(share, &e.slopes, m, 1.0);
            strengths.axpy(share, &e.strengths, 1.0);
        }
        (force_n, strengths)
    }

    /// A plant that is stepped along the recordings in their order, with `told` called before every step.
    pub(super) fn plant(&self, values: &[f64]) -> Box<dyn Plant> {
        let (force_n, strengths) = self.blend(values);
        Box::new(SurrogatePlant::new(
            (Arc::new(force_n), Arc::new(strengths)),
            (Arc::clone(&self.recorded_mm), Arc::clone(&self.terms)),
            self.scale,
        ))
    }

    /// Which parameters are fixed, and why.
    pub(in crate::diagnose) fn remarks(&self) -> Vec<String> {
        let values = &self.expansions[0].values;
        self.parameters
            .iter()
            .zip(&self.fixed)
            .zip(values)
            .filter_map(|((p, why), value)| {
                why.map(|why| format!("{} is not identifiable and held at {value}: {why}", p.name))
            })
            .collect()
    }

    /// True for a parameter of the model that is fixed.
    pub(in crate::diagnose) fn is_fixed(&self, parameter: usize) -> bool {
        self.fixed.get(parameter).is_some_and(Option::is_some)
    }
}

/// Width of the plausible range of a parameter.
pub(super) fn belief_width(p: &Parameter) -> f64 {
    p.belief[1] - p.belief[0]
}
