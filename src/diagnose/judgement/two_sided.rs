//! A device that a leaf spring under a pusher cannot be, such as a damper: where no effect explains the recordings and the model
//! `two-sided` predicts them better than the improved baseline, that model is what the diagnosis delivers.

use super::tables::errors_of;
use super::yardsticks::maxwell_slip::device;
use crate::diagnose::course::{Course, Split};
use crate::diagnose::diagnosis::{Errors, ImprovedModel};
use crate::diagnose::fitting::{Data, FitContext};
use crate::model::two_sided;

/// The fitted device.
pub(super) struct TwoSidedFit {
    pub model: ImprovedModel,
    /// Weighted residuals of every point.
    pub residuals: Vec<f64>,
    pub errors: Errors,
}

/// The device, if it predicts the points that sets are compared on better than a model with these residuals.
pub(super) fn better_than(
    context: &FitContext<'_>,
    courses: &[Course],
    residuals: &[f64],
) -> Option<TwoSidedFit> {
    let device = device(courses)?;
    let structure = two_sided::structure(device.shortest_mm, device.longest_mm);
    let mut plant = two_sided::MODEL.plant(&device.strengths, &structure).ok()?;
    let data = context.data;
    let model_n: Vec<f64> = courses.iter().flat_map(|c| c.simulated_n(&mut *plant)).collect();
    let compared = data.force_n.iter().zip(&model_n).zip(&data.weight);
    let own: Vec<f64> = compared.map(|((f, m), w)| (f - m) * w).collect();
    if squares_n2(data, &own) >= squares_n2(data, residuals) {
        return None;
    }
    let names = two_sided::MODEL.parameters.iter().map(|p| p.name.to_owned());
    Some(TwoSidedFit {
        model: ImprovedModel {
            model: two_sided::NAME.to_owned(),
            parameters: names.zip(device.strengths).collect(),
            structure,
            effects: Vec::new(),
            law: None,
            force_zero_n: 0.0,
        },
        errors: errors_of(data, &own),
        residuals: own,
    })
}

/// Sum of squares in N2 over the points that sets are compared on.
fn squares_n2(data: &Data, residuals: &[f64]) -> f64 {
    (0..data.len())
        .filter(|&i| data.weight[i] > 0.0 && data.split[i] == Split::Select)
        .map(|i| (residuals[i] / data.weight[i]).powi(2))
        .sum()
}
