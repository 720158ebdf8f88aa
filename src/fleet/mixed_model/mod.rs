//! Linear mixed model with one random intercept for each specimen, fitted by restricted maximum likelihood (REML).
//!
//! ```text
//! y = X b + u + e      u ~ N(0, tau^2) once for each specimen      e ~ N(0, sigma^2 + s^2) once for each run, s known
//! ```
//!
//! | symbol | meaning |
//! |---|---|
//! | b, `X` | fixed effects and their design |
//! | tau^2, sigma^2 | variance between specimens and from run to run |
//! | s | standard error of the estimate of a run |
//!
//! The covariance V of one specimen's rows is a diagonal plus a constant, so its inverse is a diagonal minus a product of two vectors,
//! and all sums over V need only weighted sums of the rows: the cost grows with the number of rows alone. Sources: Patterson &
//! Thompson 1971 (REML), Henderson 1975 (prediction of u), Kenward & Roger 1997 (standard errors and degrees of freedom where groups
//! are few).

mod block_sums;
mod next_row;

use std::ops::Range;

use block_sums::{DenseBlock, Sums};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// Columns of a row of the design that are not 0, each with its value.
pub(super) type SparseRow = Vec<(usize, f64)>;

/// Rows of a mixed model; the rows of one specimen are side by side.
#[derive(Debug, Clone)]
pub(super) struct MixedData {
    pub y: Vec<f64>,
    /// Known variance s^2 of each row, above 0.
    pub known_variance: Vec<f64>,
    pub rows: Vec<SparseRow>,
    /// Rows of each specimen.
    pub blocks: Vec<Range<usize>>,
    /// Number of columns of the design, without one that follows from the others.
    pub width: usize,
}

/// Variances that the fit estimates: tau^2 between specimens and sigma^2 from run to run, in the unit of y squared.
pub(super) type Variances = Vector2<f64>;

/// A fitted mixed model.
#[derive(Debug, Clone)]
pub(super) struct MixedFit {
    pub variances: Variances,
    /// Fixed effects, one for each column.
    pub effects: DVector<f64>,
    /// Covariance of the fixed effects for known variances.
    covariance: DMatrix<f64>,
    /// The same with what the estimated variances add (Kenward & Roger 1997).
    adjusted: DMatrix<f64>,
    /// Derivatives of the inverse covariance by the variances, with the sign turned.
    slopes: [DMatrix<f64>; 2],
    /// Covariance of the two variances; 0 for one that is not estimated.
    pub variance_covariance: Matrix2<f64>,
}

/// An estimate with its standard error and the degrees of freedom of its t statistic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contrast {
    pub estimate: f64,
    pub std_error: f64,
    pub degrees: f64,
}

impl Contrast {
    /// A mean that is no surer than the form error of its rows lets it be.
    pub(super) fn with_form_variance(self, variance: f64) -> Contrast {
        Contrast {
            std_error: (self.std_error * self.std_error + variance).sqrt(),
            ..self
        }
    }

    /// The same in another unit, of which one is `1 / factor` of the old.
    pub(super) fn times(self, factor: f64) -> Contrast {
        Contrast {
            estimate: factor * self.estimate,
            std_error: factor * self.std_error,
            ..self
        }
    }
}

/// What the rows of a specimen say about its u.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpecimenEffect {
    /// Best linear unbiased prediction of u, and its standard error.
    pub predicted: Contrast,
    /// Mean deviation of the specimen from its expectation, as if its rows did not enter the fixed effects. Its standard error
    /// includes the scatter tau between specimens: it is the residual by which an outlier is judged. 0 with an infinite standard error
    /// where the fixed effects take it up.
    pub deletion: Contrast,
}

/// Steps of the search for the variances; a smooth function of two variables needs about ten.
const MOST_STEPS: usize = 100;
/// The search ends when the variances change by a smaller share: the steps get shorter by orders of magnitude, so that the next one would
/// be lost in the rounding.
const ENOUGH: f64 = 1e-6;
/// Share of information below which it counts as none: rounding leaves no more.
const ALIASED: f64 = 1e-9;

impl MixedData {
    /// Fits the model. `None` if there are not more rows than columns, or if the columns depend on each other.
    pub(super) fn fit(&self) -> Option<MixedFit> {
        if self.y.len() <= self.width {
            return None;
        }
        let blocks = self.dense();
        let (mut at, free) = self.start(&blocks)?;
        let mut here = Likelihood::of(self.sums(&blocks, &at))?;
        for _ in 0..MOST_STEPS {
            let step = here.step(&at, free);
            let shorter = (0..40).map(|n| (at + step * 0.5f64.powi(n)).map(|v| v.max(0.0)));
            let better = shorter
                .filter_map(|next| Some((next, Likelihood::of(self.sums(&blocks, &next))?)))
                .find(|(_, there)| there.log >= here.log);
            // No step is better within the rounding: this is the maximum.
            let Some((next, there)) = better else { break };
            let moved = (next - at).abs().max();
            (at, here) = (next, there);
            if moved <= ENOUGH * at.max() {
                break;
            }
        }
        Some(here.fitted(at, free))
    }

    /// Variances to start from, and which of the two can be estimated.
    fn start(&self, blocks: &[DenseBlock]) -> Option<(Variances, [bool; 2])> {
        let known = self.known_variance.iter().sum::<f64>() / self.y.len() as f64;
        // The scatter of all rows about the design, shared out equally.
        let all = Likelihood::of(self.sums(blocks, &Variances::new(0.0, known)))?;
        let scatter = known * 2.0 * all.quadratic / (self.y.len() - self.width) as f64;
        let at = Variances::repeat(0.5 * scatter.max(0.1 * known));
        let information = Likelihood::of(self.sums(blocks, &at))?.information;
        let [tau, sigma] = [information[(0, 0)], information[(1, 1)]];
        let between = tau > ALIASED * sigma;
        let run_to_run = !between || information.determinant() > ALIASED * tau * sigma;
        let start = Variances::new(
            if between { at.x } else { 0.0 },
            if run_to_run { at.y } else { 0.0 },
        );
        Some((start, [between, run_to_run]))
    }

    /// The blocks with their rows in the columns that they use.
    fn dense(&self) -> Vec<DenseBlock> {
        self.blocks
            .iter()
            .map(|block| DenseBlock::of(self, block))
            .collect()
    }

    /// The sums over all specimens that likelihood, score and information need. The last column is y.
    fn sums(&self, blocks: &[DenseBlock], at: &Variances) -> Sums {
        let mut sums = Sums::zeros(self.width + 1);
        for block in blocks {
            let weights = block.known_variance.iter().map(|known| 1.0 / (at.y + known));
            sums.add(at.x, &weights.collect::<Vec<f64>>(), block);
        }
        sums.products
            .iter_mut()
            .for_each(DMatrix::fill_upper_triangle_with_lower_triangle);
        sums
    }
}

/// The restricted likelihood at some variances, with its score and its expected information.
struct Likelihood {
    log: f64,
    /// Half of the weighted sum of squared residuals.
    quadratic: f64,
    score: Vector2<f64>,
    information: Matrix2<f64>,
    effects: DVector<f64>,
    covariance: DMatrix<f64>,
    products: [DMatrix<f64>; 6],
}

impl Likelihood {
    fn of(sums: Sums) -> Option<Likelihood> {
        let width = sums.products[0].ncols() - 1;
        let inner = |m: &DMatrix<f64>| m.view((0, 0), (width, width)).into_owned();
        let normal = inner(&sums.products[0]).cholesky()?;
        let log_normal = 2.0 * normal.l_dirty().diagonal().map(f64::ln).sum();
        let right = sums.products[0]
            .view((0, width), (width, 1))
            .column(0)
            .into_owned();
        let effects = normal.solve(&right);
        // y - X b as a product with the columns and y.
        let residual = DVector::from_iterator(width + 1, effects.iter().map(|b| -b).chain([1.0]));
        let of_residual = |m: &DMatrix<f64>| residual.dot(&(m * &residual));
        let quadratic = 0.5 * of_residual(&sums.products[0]);
        let covariance = normal.inverse();
        let products: [DMatrix<f64>; 6] = std::array::from_fn(|i| inner(&sums.products[i]));
        let turned = [1, 2].map(|i| &covariance * &products[i]);
        let score = Vector2::from_fn(|i, _| {
            0.5 * (of_residual(&sums.products[i + 1]) - sums.first[i] + turned[i].trace())
        });
        let information = Matrix2::from_fn(|i, j| {
            let pair = covariance.dot(&products[3 + i + j]);
            let square = turned[i].dot(&turned[j].transpose());
            0.5 * (sums.second[(i, j)] - 2.0 * pair + square)
        });
        Some(Likelihood {
            log: -0.5 * (sums.log_determinant + log_normal) - quadratic,
            quadratic,
            score,
            information,
            effects,
            covariance,
            products,
        })
    }

    /// The step of Fisher scoring in the variances that are free and not held at 0.
    fn step(&self, at: &Variances, free: [bool; 2]) -> Variances {
        let moves = [0, 1].map(|i| free[i] && (at[i] > 0.0 || self.score[i] > 0.0));
        let score = Vector2::from_fn(|i, _| if moves[i] { self.score[i] } else { 0.0 });
        inverse_of(&self.information, moves) * score
    }

    fn fitted(self, variances: Variances, free: [bool; 2]) -> MixedFit {
        let between = inverse_of(&self.information, free);
        let phi = &self.covariance;
        let mut correction = DMatrix::zeros(phi.nrows(), phi.ncols());
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let [a, b] = [i, j].map(|i| &self.products[i + 1]);
            correction += (&self.products[3 + i + j] - a * phi * b) * between[(i, j)];
        }
        let adjusted = phi + (phi * correction * phi) * 2.0;
        let [_, of_tau, of_sigma, ..] = self.products;
        MixedFit {
            variances,
            effects: self.effects,
            adjusted: (&adjusted + adjusted.transpose()) * 0.5,
            covariance: self.covariance,
            slopes: [of_tau, of_sigma],
            variance_covariance: between,
        }
    }
}

/// Inverse of the part of a symmetric matrix that belongs to the chosen rows; 0 elsewhere.
fn inverse_of(matrix: &Matrix2<f64>, chosen: [bool; 2]) -> Matrix2<f64> {
    let one = |i: usize| 1.0 / matrix[(i, i)];
    match chosen {
        [true, true] => matrix.try_inverse().unwrap_or_else(Matrix2::zeros),
        [true, false] => Matrix2::new(one(0), 0.0, 0.0, 0.0),
        [false, true] => Matrix2::new(0.0, 0.0, 0.0, one(1)),
        [false, false] => Matrix2::zeros(),
    }
}

impl MixedFit {
    /// Standard deviation tau between specimens.
    pub(super) fn between_specimens(&self) -> f64 {
        self.variances.x.sqrt()
    }

    /// Standard deviation sigma from run to run, beyond the standard errors.
    pub(super) fn run_to_run(&self) -> f64 {
        self.variances.y.sqrt()
    }

    /// A combination of fixed effects: columns, each with its weight.
    pub(super) fn contrast(&self, weights: &[(usize, f64)]) -> Contrast {
        self.contrast_of_known(weights, 0.0)
    }

    /// A combination of fixed effects that holds `own` times tau^2 of a specimen which it is about: where the specimen is, is asked here, so
    /// that its u is no uncertainty.
    pub(super) fn contrast_of_known(&self, weights: &[(usize, f64)], own: f64) -> Contrast {
        let mut c = DVector::zeros(self.effects.len());
        for &(column, weight) in weights {
            c[column] += weight;
        }
        let phi_c = &self.covariance * &c;
        let scatter = own * self.variances.x;
        let variance = (c.dot(&phi_c) - scatter).max(0.0);
        let slope = Vector2::from_fn(|i, _| phi_c.dot(&(&self.slopes[i] * &phi_c))) - Vector2::new(own, 0.0);
        // The correction makes a variance larger; where rounding says otherwise, the plain one is the safe bound.
        let adjusted = (c.dot(&(&self.adjusted * &c)) - scatter).max(variance);
        Contrast {
            estimate: c.dot(&self.effects),
            std_error: adjusted.sqrt(),
            degrees: self.degrees(variance, &slope),
        }
    }

    /// Degrees of freedom of a variance with these derivatives by tau^2 and sigma^2 (Satterthwaite; for one contrast those of
    /// Kenward & Roger are the same).
    fn degrees(&self, variance: f64, slope: &Vector2<f64>) -> f64 {
        let of_variance = slope.dot(&(self.variance_covariance * slope));
        (2.0 * variance * variance / of_variance).clamp(1.0, 1e6)
    }

    /// What the rows of block `block` say about its specimen.
    pub(super) fn specimen(&self, data: &MixedData, block: usize) -> SpecimenEffect {
        let (tau2, sigma2) = (self.variances.x, self.variances.y);
        let (mut w, mut w2, mut residual) = (0.0, 0.0, 0.0);
        let mut m = DVector::<f64>::zeros(self.effects.len());
        for i in data.blocks[block].clone() {
            let d = 1.0 / (sigma2 + data.known_variance[i]);
            let expected: f64 = data.rows[i].iter().map(|&(c, x)| x * self.effects[c]).sum();
            (w, w2, residual) = (w + d, w2 + d * d, residual + d * (data.y[i] - expected));
            for &(c, x) in &data.rows[i] {
                m[c] += d * x;
            }
        }
        let g = 1.0 / (1.0 + tau2 * w);
        let taken = g * g * m.dot(&(&self.covariance * &m));
        // Where the columns take up all that the rows say, as for the only specimen of a batch, nothing is left to judge it by.
        let free = Some(w * g - taken)
            .filter(|free| *free > ALIASED * w * g)
            .unwrap_or(0.0);
        let slope = Vector2::new(1.0, w2 / (w * w));
        // What the estimate of tau^2 adds (Prasad & Rao 1990); it matters where tau is estimated as 0.
        let of_variances = 2.0 * g.powi(3) * w * self.variance_covariance[(0, 0)];
        let degrees = self.degrees(tau2 + 1.0 / w, &slope);
        SpecimenEffect {
            predicted: Contrast {
                estimate: tau2 * g * residual,
                std_error: (tau2 - tau2 * tau2 * free + of_variances).max(0.0).sqrt(),
                degrees,
            },
            deletion: Contrast {
                estimate: if free > 0.0 { g * residual / free } else { 0.0 },
                std_error: free.sqrt().recip(),
                degrees,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// Specimens with `runs` runs each, an intercept and a column that runs from 0 to 1 over the runs of a specimen.
    pub(super) fn data(
        specimens: usize,
        runs: usize,
        tau: f64,
        known_variance: impl Fn(usize) -> f64,
    ) -> MixedData {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut normal = || -> f64 { random.sample(StandardNormal) };
        let mut y = Vec::new();
        for _ in 0..specimens {
            let own = tau * normal();
            y.extend((0..runs).map(|_| 10.0 + own + normal()));
        }
        MixedData {
            rows: (0..y.len())
                .map(|i| vec![(0, 1.0), (1, (i % runs) as f64 / runs as f64)])
                .collect(),
            known_variance: (0..y.len()).map(known_variance).collect(),
            blocks: (0..specimens).map(|s| s * runs..(s + 1) * runs).collect(),
            width: 2,
            y,
        }
    }

    /// The restricted log-likelihood with full matrices.
    fn direct(data: &MixedData, at: &Variances) -> f64 {
        let n = data.y.len();
        let mut v = DMatrix::<f64>::zeros(n, n);
        for block in &data.blocks {
            for i in block.clone() {
                for j in block.clone() {
                    v[(i, j)] = at.x;
                }
                v[(i, i)] += at.y + data.known_variance[i];
            }
        }
        let mut x = DMatrix::<f64>::zeros(n, data.width);
        for (i, row) in data.rows.iter().enumerate() {
            row.iter().for_each(|&(c, value)| x[(i, c)] = value);
        }
        let y = DVector::from_column_slice(&data.y);
        let inverse = v.clone().try_inverse().expect("regular");
        let normal = x.transpose() * &inverse * &x;
        let effects = normal.clone().try_inverse().expect("regular") * x.transpose() * &inverse * &y;
        let residual = &y - &x * effects;
        let quadratic = residual.dot(&(&inverse * &residual));
        -0.5 * (v.determinant().ln() + normal.determinant().ln() + quadratic)
    }

    #[test]
    fn sums_over_blocks_give_the_likelihood_of_full_matrices_and_its_score() {
        let data = data(5, 4, 1.0, |i| 0.1 + 0.05 * (i % 3) as f64);
        let blocks = data.dense();
        let log = |at: Variances| Likelihood::of(data.sums(&blocks, &at)).expect("regular").log;
        let at = Variances::new(0.7, 0.9);
        assert!((log(at) - direct(&data, &at)).abs() < 1e-9);
        let here = Likelihood::of(data.sums(&blocks, &at)).expect("regular");
        for i in 0..2 {
            let mut step = Variances::zeros();
            step[i] = 1e-5;
            let slope = (log(at + step) - log(at - step)) / 2e-5;
            // The difference quotient is exact to the square of the step and the rounding over the step.
            assert!((slope - here.score[i]).abs() < 1e-6, "{slope} {}", here.score[i]);
        }
    }

    #[test]
    fn a_balanced_table_gives_the_variances_of_the_analysis_of_variance() {
        let (specimens, runs) = (12, 6);
        let mut data = data(specimens, runs, 2.0, |_| 1e-9);
        // Without the second column.
        data.rows.iter_mut().for_each(|row| row.truncate(1));
        data.width = 1;
        let fit = data.fit().expect("a fit");
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let means: Vec<f64> = data.blocks.iter().map(|b| mean(&data.y[b.clone()])).collect();
        let all = mean(&data.y);
        let between =
            means.iter().map(|m| (m - all).powi(2)).sum::<f64>() * runs as f64 / (specimens - 1) as f64;
        let within = (data.blocks.iter().zip(&means))
            .flat_map(|(b, m)| data.y[b.clone()].iter().map(move |y| (y - m).powi(2)))
            .sum::<f64>()
            / (specimens * (runs - 1)) as f64;
        assert!(
            (fit.variances.y - within).abs() < 1e-5 * within,
            "{:?}",
            fit.variances
        );
        let tau2 = (between - within) / runs as f64;
        assert!(
            (fit.variances.x - tau2).abs() < 1e-5 * tau2,
            "{:?}",
            fit.variances
        );
        let mean = fit.contrast(&[(0, 1.0)]);
        assert!((mean.std_error - (between / (specimens * runs) as f64).sqrt()).abs() < 1e-6);
        assert!((mean.degrees - (specimens - 1) as f64).abs() < 0.01, "{mean:?}");
    }

    #[test]
    fn the_deletion_residual_is_that_of_a_fit_without_the_specimen() {
        let all = data(6, 4, 1.0, |i| 0.2 + 0.1 * (i % 2) as f64);
        let fit = all.fit().expect("a fit");
        let judged = fit.specimen(&all, 2).deletion;
        // The same variances, but a column of its own for specimen 2.
        let mut shifted = all.clone();
        shifted.width = 3;
        all.blocks[2].clone().for_each(|i| shifted.rows[i].push((2, 1.0)));
        let own = Likelihood::of(shifted.sums(&shifted.dense(), &fit.variances)).expect("regular");
        assert!((own.effects[2] - judged.estimate).abs() < 1e-9);
        assert!((own.covariance[(2, 2)].sqrt() - judged.std_error).abs() < 1e-9);
    }

    #[test]
    fn too_few_rows_give_no_fit() {
        let mut few = data(1, 2, 1.0, |_| 1.0);
        assert!(few.fit().is_none());
        few.width = 1;
        few.rows.iter_mut().for_each(|row| row.truncate(1));
        assert!(few.fit().is_some_and(|fit| fit.variances.x == 0.0));
    }
}
