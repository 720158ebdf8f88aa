//! How far the fitted values are to be trusted: 95 % intervals, correlations, and warnings in words.
//!
//! ```text
//! covariance = s^2 tau (J'J)^-1     s^2 = cost / (n - p), J the derivatives of the residuals at the optimum
//! tau        = 1 + 2 sum of the residuals' autocorrelations (initial positive sequence of pairs, Geyer 1992)
//! influence  z_t = (J'J)^-1 J_t' r_t               what sample t moves the values by; its long-run variance over lags
//!                                                  up to sqrt(n) (Newey and West 1987) is the covariance's other estimate
//! interval   = value +- t(0.975, n / tau - p) * sigma     sigma the larger of the two
//! ```
//! Neighbouring samples of a recording say nearly the same thing: n / tau is the number of independent ones. Noise that acts
//! where a parameter is seen (the displacement's noise at reversals, on presliding) only the second estimate notices.
//! Parameters at a bound, and directions that the data do not see, get no interval but a warning.

use nalgebra::DMatrix;

use super::evaluator::Evaluator;
use super::jacobian::{scaled_jacobian, typical};
use crate::model::Parameter;

/// Singular values below this share of the largest belong to directions that the data do not see.
const BLIND: f64 = 1e-6;

/// Something a person should know before believing a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Warning {
    /// The fit wanted to go further than the equations hold.
    AtBound {
        /// Parameter.
        name: &'static str,
        /// Where it stands.
        value: f64,
    },
    /// A value that a person would not believe: often physics that the model lacks.
    OutsideBelief {
        /// Parameter.
        name: &'static str,
        /// As fitted.
        value: f64,
        /// What would be believed.
        belief: [f64; 2],
    },
    /// The recordings do not say anything about this combination.
    NotIdentifiable {
        /// Parameters that take part.
        names: Vec<&'static str>,
        /// The combination in words: "only the product f * r_f_mm is determined".
        combination: String,
    },
    /// The interval is wider than what one believed beforehand: the recordings hardly add anything.
    Loose {
        /// Parameter.
        name: &'static str,
    },
    /// The search ended before it settled.
    NotConverged,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Warning::AtBound { name, value } => write!(
                f,
                "{name} = {value} lies at its bound: the recordings ask for something that this parameter cannot give"
            ),
            Warning::OutsideBelief {
                name,
                value,
                belief: [low, high],
            } => write!(
                f,
                "{name} = {value:.6} is outside what is believable ({low} to {high}): another effect may hide in it"
            ),
            Warning::NotIdentifiable { names, combination } => write!(
                f,
                "{} cannot be told apart by these recordings: {combination}",
                names.join(", ")
            ),
            Warning::Loose { name } => write!(
                f,
                "{name} is hardly seen by these recordings: its interval is wider than what is believed anyway"
            ),
            Warning::NotConverged => {
                write!(f, "the search ended before it settled: allow more evaluations")
            }
        }
    }
}

/// What the derivatives at the optimum say. Everything has one entry a parameter of the problem.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Confidence {
    /// 95 % intervals; `None` where the data do not give one.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// Standard deviations; infinite where there is no interval.
    pub sigma: Vec<f64>,
    /// Correlations of the estimates; zero beside the diagonal where there is no interval.
    pub correlation: DMatrix<f64>,
    /// Number of independent samples that the residuals are worth.
    pub effective_samples: f64,
    /// At bounds, outside belief, not identifiable, loose.
    pub warnings: Vec<Warning>,
}

/// Evaluates the derivatives once (one evaluation a parameter) at the optimum.
pub(crate) fn confidence(
    evaluator: &mut Evaluator<'_>,
    values: &[f64],
    residuals: &[f64],
    relative_step: f64,
) -> Confidence {
    let problem = evaluator.problem();
    let parameters = problem.parameters();
    let n = values.len();
    let scale: Vec<f64> = (0..n)
        .map(|i| typical(values[i], parameters[i].belief, parameters[i].bounds))
        .collect();
    let jacobian = scaled_jacobian(evaluator, values, residuals, &scale, relative_step);
    let mut warnings = Vec::new();
    let mut seen: Vec<usize> = Vec::new();
    for (i, p) in parameters.iter().enumerate() {
        let at_bound = p.bounds.iter().any(|b| (values[i] - b).abs() <= 1e-9 * scale[i]);
        if at_bound {
            warnings.push(Warning::AtBound {
                name: p.name,
                value: values[i],
            });
        } else {
            seen.push(i);
        }
        if !(p.belief[0]..=p.belief[1]).contains(&values[i]) {
            warnings.push(Warning::OutsideBelief {
                name: p.name,
                value: values[i],
                belief: p.belief,
            });
        }
    }
    let (inverse, blind) = pseudo_inverse(&jacobian, parameters, &seen);
    let mut lost = vec![false; n];
    for direction in &blind {
        direction.names_into(&mut lost);
        warnings.push(direction.warning(parameters));
    }

    let count = residuals.len() as f64;
    let stretches = problem.stretches();
    let tau = correlation_time(residuals, &stretches);
    let effective_samples = (count / tau).max(1.0);
    let fitted = seen.len() as f64;
    let variance =
        residuals.iter().map(|r| r * r).sum::<f64>() / (count - fitted).max(1.0) * tau.min(count.max(1.0));
    let quantile = student_975((effective_samples - fitted).max(1.0));

    let mut influence = jacobian.select_columns(&seen) * &inverse;
    for (mut row, residual) in influence.row_iter_mut().zip(residuals) {
        row *= *residual;
    }

    let mut confidence = Confidence {
        ci95: vec![None; n],
        sigma: vec![f64::INFINITY; n],
        correlation: DMatrix::identity(n, n),
        effective_samples,
        warnings,
    };
    for (a, &i) in seen.iter().enumerate() {
        if lost[i] {
            continue;
        }
        let local = long_run_variance(influence.column(a).as_slice(), &stretches);
        let sigma = (variance * inverse[(a, a)]).max(local).sqrt() * scale[i];
        let [low, high] = parameters[i].bounds;
        let half = quantile * sigma;
        confidence.sigma[i] = sigma;
        confidence.ci95[i] = Some([(values[i] - half).max(low), (values[i] + half).min(high)]);
        if 2.0 * half > parameters[i].belief[1] - parameters[i].belief[0] {
            confidence.warnings.push(Warning::Loose {
                name: parameters[i].name,
            });
        }
        for (b, &j) in seen.iter().enumerate().filter(|&(b, &j)| b != a && !lost[j]) {
            confidence.correlation[(i, j)] = inverse[(a, b)] / (inverse[(a, a)] * inverse[(b, b)]).sqrt();
        }
    }
    confidence
}

/// A direction in the logarithms of the parameters that leaves the residuals as they are.
struct BlindDirection {
    /// Parameter and its component, the largest first.
    components: Vec<(usize, f64)>,
}

impl BlindDirection {
    fn names_into(&self, lost: &mut [bool]) {
        for &(i, _) in &self.components {
            lost[i] = true;
        }
    }

    fn warning(&self, parameters: &[Parameter]) -> Warning {
        let names: Vec<&'static str> = self.components.iter().map(|&(i, _)| parameters[i].name).collect();
        let combination = match self.components[..] {
            [_] => "they do not react to it at all".to_owned(),
            [(i, a), (j, b)] => {
                let (first, second) = (parameters[i.min(j)].name, parameters[i.max(j)].name);
                // Equal shares: what one gains the other loses. Unequal ones are powers that nobody would recognise.
                let even = (a.abs() / b.abs() - 1.0).abs() < 0.05;
                match (even, a * b < 0.0) {
                    (true, true) => format!("only the product {first} * {second} is determined"),
                    (true, false) => format!("only the ratio {first} / {second} is determined"),
                    (false, _) => format!("only a combination of {first} and {second} is determined"),
                }
            }
            _ => format!("only a combination of {} is determined", names.join(", ")),
        };
        Warning::NotIdentifiable { names, combination }
    }
}

/// Inverse of J'J over the `seen` columns without the directions that the data do not see, and those directions.
fn pseudo_inverse(
    jacobian: &DMatrix<f64>,
    parameters: &[Parameter],
    seen: &[usize],
) -> (DMatrix<f64>, Vec<BlindDirection>) {
    let m = seen.len();
    if m == 0 || jacobian.iter().any(|d| !d.is_finite()) {
        // Nothing to be said about any of them.
        let blind = seen.iter().map(|&i| BlindDirection {
            components: vec![(i, 1.0)],
        });
        return (DMatrix::zeros(m, m), blind.collect());
    }
    debug_assert_eq!(jacobian.ncols(), parameters.len());
    // Triangular factor first: the singular values are those of the tall matrix, the work is not.
    let tall = jacobian.select_columns(seen);
    let small = if tall.nrows() > m { tall.qr().r() } else { tall };
    let svd = small.svd(false, true);
    let right = svd.v_t.expect("asked for");
    let largest = svd.singular_values.max();
    let mut inverse = DMatrix::zeros(m, m);
    let mut blind = Vec::new();
    for (k, row) in right.row_iter().enumerate() {
        let singular = svd.singular_values[k];
        if singular > BLIND * largest {
            inverse += row.transpose() * row / (singular * singular);
            continue;
        }
        let peak = row.amax();
        let mut components: Vec<(usize, f64)> = (0..m)
            .filter(|&a| row[a].abs() > 0.05 * peak)
            .map(|a| (seen[a], row[a]))
            .collect();
        components.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        blind.push(BlindDirection { components });
    }
    (inverse, blind)
}

/// Integrated autocorrelation time of the residuals in samples, at least 1, over stretches that do not know each other.
pub(crate) fn correlation_time(residuals: &[f64], stretches: &[usize]) -> f64 {
    let variance = residuals.iter().map(|r| r * r).sum::<f64>();
    let longest = stretches.iter().copied().max().unwrap_or(0);
    if variance <= 0.0 {
        return 1.0;
    }
    let autocorrelation = |lag: usize| {
        let mut rest = residuals;
        let mut sum = 0.0;
        for &length in stretches {
            let (stretch, after) = rest.split_at(length.min(rest.len()));
            rest = after;
            if lag < stretch.len() {
                sum += stretch
                    .iter()
                    .zip(&stretch[lag..])
                    .map(|(a, b)| a * b)
                    .sum::<f64>();
            }
        }
        sum / variance
    };
    // Pairs of neighbouring lags stay positive until noise takes over; longer than a third of a stretch nothing is learnt.
    let mut time = -1.0;
    for lag in (0..longest / 3 + 1).step_by(2) {
        let pair = autocorrelation(lag) + autocorrelation(lag + 1);
        if pair <= 0.0 {
            break;
        }
        time += 2.0 * pair;
    }
    time.max(1.0)
}

/// Variance of the sum of a series whose stretches do not know each other, lags weighted down to zero at sqrt(length).
fn long_run_variance(series: &[f64], stretches: &[usize]) -> f64 {
    let mut rest = series;
    let mut sum = 0.0;
    for &length in stretches {
        let (stretch, after) = rest.split_at(length.min(rest.len()));
        rest = after;
        let lags = (stretch.len() as f64).sqrt() as usize;
        sum += stretch.iter().map(|z| z * z).sum::<f64>();
        for lag in 1..=lags.min(stretch.len().saturating_sub(1)) {
            let weight = 2.0 * (1.0 - lag as f64 / (lags + 1) as f64);
            sum += weight
                * stretch
                    .iter()
                    .zip(&stretch[lag..])
                    .map(|(a, b)| a * b)
                    .sum::<f64>();
        }
    }
    sum.max(0.0)
}

/// 97.5 % point of Student's t: Cornish-Fisher expansion (Abramowitz and Stegun 26.7.5), within 1 % from 3 degrees on.
pub(crate) fn student_975(degrees: f64) -> f64 {
    let z = 1.959_963_985f64;
    let (z3, z5) = (z.powi(3), z.powi(5));
    let n = degrees.max(2.0);
    z + (z3 + z) / (4.0 * n)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * n * n)
        + (3.0 * z.powi(7) + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * n.powi(3))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ProductLine, StraightLine};
    use super::super::{FitOptions, Residuals, fit};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Sum of twelve uniform numbers: normal enough for two standard deviations.
    fn normal(random: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    #[test]
    fn intervals_of_a_straight_line_are_the_textbook_ones() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let y: Vec<f64> = (0..200)
            .map(|i| 3.0 + 0.5 * f64::from(i) * 0.05 + 0.1 * normal(&mut random))
            .collect();
        let problem = StraightLine::new(y);
        let fit = fit(&problem, &FitOptions::default(), &mut |_| {
            super::super::FitControl::Continue
        })
        .expect("a fair problem");
        // White residuals: sigma of the slope = 0.1 / sqrt(sum (x - mean)^2) = 0.1 / sqrt(200 * 100 / 12) within the scatter
        // of s (5 %) and of the estimated correlation time (15 %).
        let expected = 0.1 / (200.0f64 * 100.0 / 12.0).sqrt();
        let sigma = fit.sigma[1];
        assert!(
            (sigma / expected - 1.0).abs() < 0.25,
            "{sigma} against {expected}"
        );
        let [low, high] = fit.ci95[1].expect("seen");
        assert!(low < 0.5 && 0.5 < high);
        assert!((fit.correlation[(0, 1)] + 0.866).abs() < 0.02);
    }

    #[test]
    fn coverage_under_correlated_noise() {
        // First-order noise with coefficient 0.9: 200 samples are worth about ten. Without the correlation time the
        // intervals would cover a third of the cases.
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let mut covered = 0;
        for _ in 0..200 {
            let mut noise = 0.0;
            let y: Vec<f64> = (0..400)
                .map(|i| {
                    noise = 0.9 * noise + 0.1 * normal(&mut random);
                    3.0 + 0.5 * f64::from(i) * 0.05 + noise
                })
                .collect();
            let fit = fit(&StraightLine::new(y), &FitOptions::default(), &mut |_| {
                super::super::FitControl::Continue
            })
            .expect("a fair problem");
            let [low, high] = fit.ci95[1].expect("seen");
            covered += usize::from(low < 0.5 && 0.5 < high);
        }
        // 95 % wanted; the estimated time is itself uncertain. Binomial scatter over 200 is 1.5 %.
        assert!((176..=200).contains(&covered), "{covered} of 200");
    }

    #[test]
    fn a_product_is_called_a_product() {
        let problem = ProductLine::new();
        let fit = fit(&problem, &FitOptions::default(), &mut |_| {
            super::super::FitControl::Continue
        })
        .expect("a fair problem");
        let text: Vec<String> = fit.warnings.iter().map(ToString::to_string).collect();
        assert!(
            text.iter()
                .any(|t| t.contains("only the product first * second is determined")),
            "{text:?}"
        );
        assert!(fit.ci95[0].is_none() && fit.ci95[1].is_none() && fit.ci95[2].is_some());
        // The zigzag tilts the line by a few thousandths.
        assert!((fit.values[0] * fit.values[1] - 6.0).abs() < 0.02);
        assert_eq!(problem.parameters().len(), 3);
    }

    #[test]
    fn student_quantiles() {
        for (degrees, table) in [
            (3.0, 3.182),
            (5.0, 2.571),
            (10.0, 2.228),
            (30.0, 2.042),
            (1e9, 1.960),
        ] {
            let ours = student_975(degrees);
            assert!(
                (ours / table - 1.0).abs() < 0.02,
                "{degrees}: {ours} against {table}"
            );
        }
    }
}
