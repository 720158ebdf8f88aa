//! The surrogate of a slow model as a plant: forces along the recordings, and the hysteresis operator `H` beside them (see
//! `surrogate`).

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::model::friction::elements::Elements;
use crate::model::{Motion, Plant};

/// Number of elastic-plastic elements of `H`, with the shortest and the longest length in mm.
const ELEMENTS: usize = 16;
const LENGTHS_MM: [f64; 2] = [0.01, 20.0];
/// Number of powers of its polynomial. The strength of each element is a polynomial of three powers.
const POWERS: usize = 6;
/// Number of terms of `H`.
pub(super) const TERMS: usize = POWERS + 3 * ELEMENTS;

/// Maps displacements to about -1 to 1.
#[derive(Clone, Copy)]
pub(super) struct Scale {
    middle_mm: f64,
    half_mm: f64,
}

impl Scale {
    pub(super) fn of([low, high]: [f64; 2]) -> Scale {
        Scale {
            middle_mm: 0.5 * (low + high),
            half_mm: (0.5 * (high - low)).max(1e-9),
        }
    }
}

/// The terms of `H` with their state.
#[derive(Clone)]
pub(super) struct HysteresisOperator {
    elements: Elements<ELEMENTS>,
    at_mm: f64,
    scale: Scale,
}

impl HysteresisOperator {
    pub(super) fn new(scale: Scale) -> HysteresisOperator {
        let [shortest, longest] = LENGTHS_MM;
        let step = (longest / shortest).powf(1.0 / (ELEMENTS - 1) as f64);
        HysteresisOperator {
            elements: Elements::new(std::array::from_fn(|k| shortest * step.powi(k as i32))),
            at_mm: 0.0,
            scale,
        }
    }

    pub(super) fn reset(&mut self) {
        self.elements.reset();
        self.at_mm = 0.0;
    }

    pub(super) fn move_to(&mut self, displacement_mm: f64) {
        self.elements.advance(displacement_mm - self.at_mm);
        self.at_mm = displacement_mm;
    }

    pub(super) fn terms(&mut self) -> [f64; TERMS] {
        let drags = self.elements.advance(0.0);
        let place = (self.at_mm - self.scale.middle_mm) / self.scale.half_mm;
        let mut terms = [1.0; TERMS];
        for k in 1..POWERS {
            terms[k] = terms[k - 1] * place;
        }
        for (k, drag) in drags.iter().enumerate() {
            for power in 0..3 {
                terms[POWERS + power * ELEMENTS + k] = drag * terms[power];
            }
        }
        terms
    }
}

/// The surrogate as a plant. It counts the calls of `told` to know its point in the recordings.
#[derive(Clone)]
pub(super) struct SurrogatePlant {
    /// Force at every recorded point, N.
    force_n: Arc<DVector<f64>>,
    strengths: Arc<DVector<f64>>,
    recorded_mm: Arc<Vec<f64>>,
    recorded_terms: Arc<DMatrix<f64>>,
    operator: HysteresisOperator,
    /// Number of points announced by `told`.
    point: usize,
    /// True if an effect has shifted the displacement since the last reset. Until then `H` cancels.
    shifted: bool,
}

impl SurrogatePlant {
    /// From forces and strengths of `H`, and from displacements and terms of `H` at the recorded points.
    pub(super) fn new(
        (force_n, strengths): (Arc<DVector<f64>>, Arc<DVector<f64>>),
        (recorded_mm, recorded_terms): (Arc<Vec<f64>>, Arc<DMatrix<f64>>),
        scale: Scale,
    ) -> SurrogatePlant {
        SurrogatePlant {
            force_n,
            strengths,
            recorded_mm,
            recorded_terms,
            operator: HysteresisOperator::new(scale),
            point: 0,
            shifted: false,
        }
    }
}

impl Plant for SurrogatePlant {
    fn reset(&mut self) {
        self.operator.reset();
        self.shifted = false;
    }

    fn step(&mut self, displacement_mm: f64, _dt_s: f64) -> f64 {
        self.operator.move_to(displacement_mm);
        let here = self.point.saturating_sub(1).min(self.force_n.len() - 1);
        self.shifted |= displacement_mm != self.recorded_mm[here];
        if !self.shifted {
            return self.force_n[here];
        }
        let terms = self.operator.terms();
        let recorded = self.recorded_terms.column(here);
        let moved = terms.iter().zip(recorded.iter()).zip(self.strengths.iter());
        self.force_n[here] + moved.map(|((t, r), s)| (t - r) * s).sum::<f64>()
    }

    fn told(&mut self, _motion: &Motion) {
        self.point += 1;
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}
