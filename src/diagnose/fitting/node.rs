//! A fitted set of effects.

use super::baseline::Attached;
use super::structure::ModelStructure;
use crate::diagnose::course::Split;

/// Codes of a set of effects, sorted.
pub(in crate::diagnose) type Key = Vec<&'static str>;

/// A fitted set of effects.
#[derive(Clone)]
pub(in crate::diagnose) struct Node {
    pub attached: Vec<Attached>,
    /// The model's parameters, one group per effect, the force zero.
    pub values: Vec<f64>,
    /// Weighted residuals of every point.
    pub residuals: Vec<f64>,
    /// Sum of squares on the cycles that are fitted, with that of the discrepancy's terms.
    pub fit: f64,
    /// Sum of squares on the cycles that sets are compared on.
    pub select: f64,
}

impl Node {
    /// Residuals and sums of squares at some values; `None` where the model has no finite force.
    pub(in crate::diagnose) fn new(structure: &ModelStructure<'_>, values: Vec<f64>) -> Option<Node> {
        let (residuals, sizes) = structure.compared(&values)?;
        Some(Node {
            fit: structure.data.sum(&residuals, Split::Fit) + sizes.norm_squared(),
            select: structure.data.sum(&residuals, Split::Select),
            residuals,
            values,
            attached: structure.attached.clone(),
        })
    }

    /// Codes after the first `extras` effects, which belong to the baseline.
    pub(in crate::diagnose) fn key(&self, extras: usize) -> Key {
        let mut key: Key = self.attached[extras..].iter().map(|a| a.effect.code).collect();
        key.sort_unstable();
        key
    }

    pub(in crate::diagnose) fn cost(&self) -> f64 {
        self.fit + self.select
    }
}
