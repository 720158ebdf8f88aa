//! Prediction of a row that is not there yet (Henderson 1975; the variance of a predicted combination of fixed and random effects).
//!
//! ```text
//! y_new = l'b + u + e        predicted = l'b + u^        c = l - tau^2 X'V^-1 1
//! variance = c'Phi c + tau^2 / (1 + tau^2 w) + variance of tau^2 + sigma^2 + s_new^2        w = sum of 1 / (sigma^2 + s^2)
//! ```
//! The sums are over the rows of the specimen. Without rows w = 0 and u^ = 0: the specimen is one of its family, and tau^2 counts fully.

use nalgebra::{DVector, Vector2};

use super::{Contrast, MixedData, MixedFit};

/// Most that the correction of Kenward & Roger makes of a variance. It is a second-order term: where it is larger than the first, as in a
/// design with hardly more specimens than columns, its expansion does not hold.
const MOST_CORRECTION: f64 = 2.0;

impl MixedFit {
    /// Predicts a new row with these entries of the design: of the specimen of block `block`, or of one that has no row yet.
    /// `more_variance` is what the row has beside tau^2 and sigma^2: the square of its own standard error, and what else is not known.
    pub(in crate::fleet) fn next_row(
        &self,
        data: &MixedData,
        block: Option<usize>,
        entries: &[(usize, f64)],
        more_variance: f64,
    ) -> Contrast {
        let (tau2, sigma2) = (self.variances.x, self.variances.y);
        let mut c = DVector::<f64>::zeros(self.effects.len());
        for &(column, value) in entries {
            c[column] += value;
        }
        let mean = c.dot(&self.effects);
        let (mut w, mut w2, mut residual) = (0.0, 0.0, 0.0);
        let mut m = DVector::<f64>::zeros(self.effects.len());
        for i in block.map_or(0..0, |block| data.blocks[block].clone()) {
            let d = 1.0 / (sigma2 + data.known_variance[i]);
            let expected: f64 = data.rows[i].iter().map(|&(k, x)| x * self.effects[k]).sum();
            (w, w2, residual) = (w + d, w2 + d * d, residual + d * (data.y[i] - expected));
            for &(k, x) in &data.rows[i] {
                m[k] += d * x;
            }
        }
        let g = 1.0 / (1.0 + tau2 * w);
        c -= m * (tau2 * g);
        let phi_c = &self.covariance * &c;
        let of_effects = c.dot(&phi_c);
        let adjusted = c
            .dot(&(&self.adjusted * &c))
            .clamp(of_effects, MOST_CORRECTION * of_effects);
        // Prasad & Rao 1990: what the estimate of tau^2 adds to the prediction of u. The mean of the own rows alone has the variance 1 / w.
        let of_variances = 2.0 * g.powi(3) * w * self.variance_covariance[(0, 0)];
        let of_specimen = tau2 * g + if w > 0.0 { of_variances.min(1.0 / w) } else { 0.0 };
        let variance = adjusted + of_specimen + sigma2 + more_variance;
        let of_scatter = Vector2::new(g * g, 1.0 + (tau2 * g).powi(2) * w2);
        let slope = Vector2::from_fn(|i, _| of_scatter[i] + phi_c.dot(&(&self.slopes[i] * &phi_c)));
        Contrast {
            estimate: mean + tau2 * g * residual,
            std_error: variance.sqrt(),
            degrees: self.degrees(variance, &slope),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::super::tests::data;
    use super::*;

    /// The prediction and its variance with full matrices, for known variances.
    fn direct(data: &MixedData, fit: &MixedFit, block: usize, l: &DVector<f64>) -> (f64, f64) {
        let n = data.y.len();
        let (tau2, sigma2) = (fit.variances.x, fit.variances.y);
        let mut v = DMatrix::<f64>::zeros(n, n);
        for rows in &data.blocks {
            rows.clone()
                .for_each(|i| rows.clone().for_each(|j| v[(i, j)] = tau2));
        }
        (0..n).for_each(|i| v[(i, i)] += sigma2 + data.known_variance[i]);
        let mut x = DMatrix::<f64>::zeros(n, data.width);
        for (i, row) in data.rows.iter().enumerate() {
            row.iter().for_each(|&(c, value)| x[(i, c)] = value);
        }
        let inverse = v.try_inverse().expect("regular");
        let phi = (x.transpose() * &inverse * &x).try_inverse().expect("regular");
        let b = &phi * x.transpose() * &inverse * DVector::from_column_slice(&data.y);
        // Covariance of the new row with the rows of its specimen.
        let mut k = DVector::<f64>::zeros(n);
        data.blocks[block].clone().for_each(|i| k[i] = tau2);
        let weights = &inverse * &k;
        let predicted = l.dot(&b) + weights.dot(&(DVector::from_column_slice(&data.y) - &x * &b));
        let c = l - x.transpose() * &weights;
        (predicted, c.dot(&(&phi * &c)) + tau2 - k.dot(&weights) + sigma2)
    }

    #[test]
    fn the_prediction_is_that_of_full_matrices() {
        let data = data(8, 4, 1.0, |i| 0.1 + 0.05 * (i % 3) as f64);
        let mut fit = data.fit().expect("a fit");
        let l = DVector::from_vec(vec![1.0, 1.5]);
        let (estimate, variance) = direct(&data, &fit, 2, &l);
        // Without what the estimation of the variances adds.
        fit.adjusted = fit.covariance.clone();
        fit.variance_covariance.fill(0.0);
        let next = fit.next_row(&data, Some(2), &[(0, 1.0), (1, 1.5)], 0.3);
        assert!((next.estimate - estimate).abs() < 1e-9, "{next:?} {estimate}");
        assert!(
            (next.std_error.powi(2) - variance - 0.3).abs() < 1e-9,
            "{next:?} {variance}"
        );
    }

    #[test]
    fn a_specimen_without_rows_has_the_scatter_between_specimens() {
        let data = data(8, 4, 1.0, |_| 0.1);
        let fit = data.fit().expect("a fit");
        let [seen, unseen] = [Some(0), None].map(|block| fit.next_row(&data, block, &[(0, 1.0)], 0.1));
        assert!((unseen.estimate - fit.effects[0]).abs() < 1e-12);
        let least = fit.variances.x + fit.variances.y + 0.1;
        assert!(
            unseen.std_error.powi(2) > least && unseen.std_error > seen.std_error,
            "{unseen:?} {seen:?}"
        );
        assert!(seen.degrees > 1.0 && unseen.degrees > 1.0);
    }
}
