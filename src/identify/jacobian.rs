//! Derivatives of residuals by finite differences: one column per parameter, computed in parallel.

use nalgebra::DMatrix;

use super::evaluator::Evaluator;

/// Typical size of a parameter: its value, or one hundredth of its plausible range where the value is smaller.
pub(crate) fn typical(value: f64, belief: [f64; 2], bounds: [f64; 2]) -> f64 {
    let floor = 0.01 * (belief[1] - belief[0]).abs().min((bounds[1] - bounds[0]).abs());
    value.abs().max(floor).max(f64::MIN_POSITIVE)
}

/// Derivatives of the residuals at `values`; each column is multiplied by its parameter's `scale`.
///
/// Where the model refuses the step of a column, the step is taken backwards. If the model refuses that step too, the
/// column is zero.
pub(crate) fn scaled_jacobian(
    evaluator: &mut Evaluator<'_>,
    values: &[f64],
    residuals: &[f64],
    scale: &[f64],
    relative_step: f64,
) -> DMatrix<f64> {
    let parameters = evaluator.problem().parameters();
    let (rows, columns) = (residuals.len(), values.len());
    let mut jacobian = DMatrix::zeros(rows, columns);
    let moved = |n: usize, backwards: bool| {
        let step = relative_step * scale[n];
        let fits = values[n] + step <= parameters[n].bounds[1];
        let mut point = values.to_vec();
        point[n] += if fits != backwards { step } else { -step };
        point
    };
    let points: Vec<Vec<f64>> = (0..columns).map(|n| moved(n, false)).collect();
    let costs = evaluator.columns(&points, jacobian.as_mut_slice());
    for (n, mut column) in jacobian.column_iter_mut().enumerate() {
        let mut point = &points[n];
        let second;
        if !costs[n].is_finite() {
            second = moved(n, true);
            point = &second;
            if !evaluator.residuals(point, column.as_mut_slice()).is_finite() {
                column.fill(0.0);
                continue;
            }
        }
        // The difference of the rounded values, not the step, so that the quotient divides by the real change.
        let factor = scale[n] / (point[n] - values[n]);
        for (derivative, &before) in column.iter_mut().zip(residuals) {
            *derivative = (*derivative - before) * factor;
        }
    }
    jacobian
}

#[cfg(test)]
mod tests {
    use super::super::testing::Valley;
    use super::*;

    #[test]
    fn derivatives_of_the_valley_for_any_number_of_threads() {
        let problem = Valley::new();
        let reference = {
            let mut evaluator = Evaluator::new(&problem, 1);
            let mut residuals = vec![0.0; 2];
            evaluator.residuals(&[-1.2, 1.0], &mut residuals);
            scaled_jacobian(&mut evaluator, &[-1.2, 1.0], &residuals, &[1.0, 2.0], 1e-6)
        };
        // Residuals 10 (y - x^2) and 1 - x: columns (-20 x, -1) and (10, 0), the second for a scale of 2.
        let expected = DMatrix::from_column_slice(2, 2, &[24.0, -1.0, 20.0, 0.0]);
        // Forward difference of curvature 20 over 1e-6.
        assert!((&reference - expected).amax() < 2e-5, "{reference}");
        for threads in [2, 7] {
            let mut evaluator = Evaluator::new(&problem, threads);
            let mut residuals = vec![0.0; 2];
            evaluator.residuals(&[-1.2, 1.0], &mut residuals);
            let again = scaled_jacobian(&mut evaluator, &[-1.2, 1.0], &residuals, &[1.0, 2.0], 1e-6);
            assert_eq!(again, reference);
        }
    }
}
