//! The polynomial of a calibration: reference over reading, least squares, the lowest order that is enough.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Highest order that is tried.
pub(crate) const HIGHEST_ORDER: usize = 3;
/// A term stays if it differs from zero at this level.
const SIGNIFICANCE: f64 = 0.01;

/// A fitted polynomial.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PolynomialFit {
    /// Factors of the powers of the reading, from the constant on, in N or mm.
    pub coefficients: Vec<f64>,
    /// Standard deviation of the residuals, with its degrees of freedom, N or mm.
    pub sigma: f64,
    /// Student's t of the highest term.
    highest_t: f64,
    degrees_of_freedom: usize,
}

impl PolynomialFit {
    /// Order of the polynomial; 1 is a straight line.
    pub(crate) fn order(&self) -> usize {
        self.coefficients.len() - 1
    }

    /// The value for a reading.
    pub(crate) fn value(&self, reading: f64) -> f64 {
        value(&self.coefficients, reading)
    }
}

/// Value of a polynomial given by the factors of its powers.
pub(crate) fn value(coefficients: &[f64], reading: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * reading + c)
}

/// Fits a polynomial to pairs of reading and reference. `None` if they do not determine it: too few, or too few different readings.
pub(crate) fn fit(pairs: &[(f64, f64)], order: usize) -> Option<PolynomialFit> {
    let (rows, terms) = (pairs.len(), order + 1);
    let degrees_of_freedom = rows.checked_sub(terms).filter(|free| *free > 0)?;
    // In units of the largest reading, so that the powers have one size.
    let largest = pairs.iter().map(|(reading, _)| reading.abs()).fold(0.0, f64::max);
    if largest == 0.0 || !largest.is_finite() {
        return None;
    }
    let powers = DMatrix::from_fn(rows, terms, |row, power| {
        (pairs[row].0 / largest).powi(power as i32)
    });
    let references = DVector::from_iterator(rows, pairs.iter().map(|(_, reference)| *reference));
    let inverse = (powers.transpose() * &powers).cholesky()?.inverse();
    let scaled = &inverse * powers.transpose() * &references;
    let residuals = references - powers * &scaled;
    let sigma = (residuals.norm_squared() / degrees_of_freedom as f64).sqrt();
    let highest = scaled[order].abs() / (sigma * inverse[(order, order)].sqrt());
    let coefficients: Vec<f64> = scaled
        .iter()
        .enumerate()
        .map(|(power, c)| c / largest.powi(power as i32))
        .collect();
    coefficients
        .iter()
        .all(|c| c.is_finite())
        .then_some(PolynomialFit {
            coefficients,
            sigma,
            highest_t: highest,
            degrees_of_freedom,
        })
}

/// The polynomial of the lowest order that is enough, at most of `highest_order`. A term is left out if it does not differ from zero
/// by a t test, or if it changes no point by more than `resolution`.
pub(crate) fn lowest_sufficient(
    pairs: &[(f64, f64)],
    highest_order: usize,
    resolution: f64,
) -> Option<PolynomialFit> {
    let mut kept = fit(pairs, 1)?;
    for order in 2..=highest_order.min(HIGHEST_ORDER) {
        let Some(higher) = fit(pairs, order) else { break };
        // The terms between were not enough by themselves, but may be needed by this one.
        if is_needed(&higher, &kept, pairs, resolution) {
            kept = higher;
        }
    }
    Some(kept)
}

fn is_needed(higher: &PolynomialFit, lower: &PolynomialFit, pairs: &[(f64, f64)], resolution: f64) -> bool {
    let change = |(reading, _): &(f64, f64)| (higher.value(*reading) - lower.value(*reading)).abs();
    let largest_change = pairs.iter().map(change).fold(0.0, f64::max);
    let critical = StudentsT::new(0.0, 1.0, higher.degrees_of_freedom as f64)
        .map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - 0.5 * SIGNIFICANCE));
    largest_change > resolution && higher.highest_t > critical
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings of a sensor whose true value is a polynomial of its reading, with a scatter that is fixed.
    fn pairs(coefficients: &[f64], scatter: f64) -> Vec<(f64, f64)> {
        let signs = [1.0, -1.0, -0.5, 1.0, 0.3, -1.0, 0.7, -0.6, 0.2, -0.4, 0.9];
        let readings = [
            0.0, 400.0, 800.0, 1200.0, 1600.0, 2000.0, 1600.0, 1200.0, 800.0, 400.0, 0.0,
        ];
        let point = |(reading, sign): (f64, f64)| (reading, value(coefficients, reading) + scatter * sign);
        readings.into_iter().zip(signs).map(point).collect()
    }

    #[test]
    fn the_order_is_that_of_the_sensor() {
        for (truth, order) in [
            (vec![3.0, 1.02], 1),
            (vec![3.0, 0.98, 1e-5], 2),
            (vec![-2.0, 1.01, 0.0, 4e-9], 3),
            (vec![-2.0, 1.01, 1e-5, -4e-9], 3),
        ] {
            let found = lowest_sufficient(&pairs(&truth, 0.05), 3, 0.1).expect("determined");
            assert_eq!(found.order(), order, "{truth:?}: {found:?}");
            for reading in [0.0, 700.0, 2000.0] {
                // The scatter, not more.
                assert!(
                    (found.value(reading) - value(&truth, reading)).abs() < 0.1,
                    "{truth:?} {reading}"
                );
            }
        }
    }

    #[test]
    fn a_curvature_below_the_resolution_or_the_scatter_is_left_out() {
        let bow = [0.0, 1.0, 1e-7];
        assert_eq!(
            lowest_sufficient(&pairs(&bow, 0.0), 3, 1.0)
                .expect("fits")
                .order(),
            1
        );
        assert_eq!(
            lowest_sufficient(&pairs(&[0.0, 1.0, 1e-5], 0.0), 1, 0.1)
                .expect("fits")
                .order(),
            1
        );
    }

    #[test]
    fn scatter_alone_is_hardly_ever_taken_for_curvature() {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let straight = (0..400).filter(|_| {
            let mut pairs = pairs(&[0.0, 1.0], 0.0);
            for (_, reference) in &mut pairs {
                *reference += random.random_range(-5.0..5.0);
            }
            lowest_sufficient(&pairs, 3, 0.01).expect("fits").order() == 1
        });
        // Two tests at 1 %: 2 % of 400 is 8; 5 standard deviations more are 22.
        assert!(400 - straight.count() <= 22);
    }

    #[test]
    fn too_few_points_are_no_calibration() {
        assert_eq!(fit(&[(0.0, 0.0), (1.0, 1.0)], 1), None);
        assert_eq!(fit(&[(0.0, 0.0), (0.0, 1.0), (0.0, 2.0)], 1), None);
        assert_eq!(fit(&[(1.0, 1.0), (1.0, 1.0), (1.0, 2.0)], 1), None);
    }
}
