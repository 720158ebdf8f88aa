//! Confidence of fitted values: 95 % intervals and warnings.
//!
//! ```text
//! covariance = s^2 tau (J'J)^-1     s^2 = cost / n * m / (m - p), m = n / tau, J the derivatives of the residuals at the optimum
//! tau        = 1 + 2 sum of the residuals' autocorrelations (initial positive sequence of pairs, Geyer 1992)
//! influence  z_t = (J'J)^-1 J_t' r_t               effect of sample t on the values; its long-run variance over lags
//!                                                  up to sqrt(n) (Newey and West 1987) is the second estimate
//! interval   = value +- t(0.975, n / tau - p) * sigma     sigma the larger of the two
//! ```
//! Neighbouring samples of a recording are correlated: n / tau is the number of independent ones. Only the second estimate
//! sees noise that is concentrated where a parameter acts, such as displacement noise at reversals for presliding.
//! Where n / tau - p is below one there is no degree of freedom left to estimate the noise from: no interval is given, with a warning.
//! Parameters at a bound, and directions that the data do not determine, get a warning and no interval.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::evaluator::Evaluator;
use super::jacobian::{scaled_jacobian, typical};
use crate::model::Parameter;

/// Singular values below this share of the largest count as zero: the data do not determine their direction.
const RANK_TOLERANCE: f64 = 1e-6;

/// A reason to doubt a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Warning {
    /// The parameter ended at its bound.
    AtBound {
        /// Name of the parameter.
        name: &'static str,
        /// The bound that it reached.
        value: f64,
    },
    /// The value is outside its plausible range: often physics that the model lacks.
    OutsideBelief {
        /// Name of the parameter.
        name: &'static str,
        value: f64,
        /// Believed range of the parameter.
        belief: [f64; 2],
    },
    /// The data do not determine a combination of parameters.
    NotIdentifiable {
        /// Parameters that take part.
        names: Vec<&'static str>,
        /// The combination in words: "only the product f * r_f_mm is determined".
        combination: String,
    },
    /// The interval is wider than the plausible range.
    Loose {
        /// Name of the parameter.
        name: &'static str,
    },
    /// There are fewer independent residuals than an interval needs.
    NoFreedom {
        /// Number of independent residuals.
        independent: f64,
        /// Parameters that were fitted to them.
        names: Vec<&'static str>,
    },
    /// The search ended before it met its tolerances.
    NotConverged,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Warning::AtBound { name, value } => write!(
                f,
                "{name} = {value} is at its bound: the model may lack physics; check the recordings, or run `leafbench diagnose`"
            ),
            Warning::OutsideBelief {
                name,
                value,
                belief: [low, high],
            } => write!(
                f,
                "{name} = {value:.6} is outside its plausible range ({low} to {high}): it may compensate for physics that the model lacks"
            ),
            Warning::NotIdentifiable { names, combination } => write!(
                f,
                "{} cannot be told apart by these data: {combination}",
                names.join(", ")
            ),
            Warning::Loose { name } => write!(
                f,
                "the 95 % interval of {name} is wider than its plausible range: these data hardly determine it"
            ),
            Warning::NoFreedom { independent, names } => write!(
                f,
                "the residuals have about {independent:.0} independent values for {} parameters ({}), so no interval can be given: record \
                 longer, or look for what the model lacks",
                names.len(),
                names.join(", ")
            ),
            Warning::NotConverged => {
                write!(f, "the search did not converge: start it from better values")
            }
        }
    }
}

/// Confidence at the optimum. The lists have one entry per parameter of the problem.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Confidence {
    /// 95 % intervals; `None` where the data do not give one.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// Standard deviations; infinite where there is no interval.
    pub sigma: Vec<f64>,
    /// At bounds, outside belief, not identifiable, loose.
    pub warnings: Vec<Warning>,
}

/// Evaluates the derivatives once (one evaluation per parameter) at the optimum.
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
    let (inside, mut warnings) = check_ranges(parameters, values, &scale);
    let (inverse, null) = pseudo_inverse(&jacobian, &inside);
    warnings.extend(null.iter().map(|direction| direction.warning(parameters)));
    let determined = |i: usize| !null.iter().any(|direction| direction.contains(i));

    let stretches = problem.stretches();
    let noise = ResidualNoise::new(residuals, &stretches, inside.len());
    let influence = influence(&jacobian.select_columns(&inside), &inverse, residuals);
    let mut confidence = Confidence {
        ci95: vec![None; n],
        sigma: vec![f64::INFINITY; n],
        warnings,
    };
    let Some(quantile) = noise.quantile else {
        confidence.warnings.push(Warning::NoFreedom {
            independent: noise.independent,
            names: inside.iter().map(|&i| parameters[i].name).collect(),
        });
        return confidence;
    };
    for (a, &i) in inside.iter().enumerate().filter(|&(_, &i)| determined(i)) {
        let local = long_run_variance(influence.column(a).as_slice(), &stretches);
        let sigma = (noise.variance * inverse[(a, a)]).max(local).sqrt() * scale[i];
        let [low, high] = parameters[i].bounds;
        let half = quantile * sigma;
        confidence.sigma[i] = sigma;
        confidence.ci95[i] = Some([(values[i] - half).max(low), (values[i] + half).min(high)]);
        if 2.0 * half > parameters[i].belief[1] - parameters[i].belief[0] {
            confidence.warnings.push(Warning::Loose {
                name: parameters[i].name,
            });
        }
    }
    confidence
}

/// Standard deviation of a sum of parameters, in their unit; infinite where the data do not determine it. A parameter at a bound counts as
/// known.
pub(crate) fn sigma_of_sum(
    evaluator: &mut Evaluator<'_>,
    values: &[f64],
    residuals: &[f64],
    relative_step: f64,
    summed: &[usize],
) -> f64 {
    let problem = evaluator.problem();
    let parameters = problem.parameters();
    let typical = |i: usize| typical(values[i], parameters[i].belief, parameters[i].bounds);
    let scale: Vec<f64> = (0..values.len()).map(typical).collect();
    let jacobian = scaled_jacobian(evaluator, values, residuals, &scale, relative_step);
    let (inside, _) = check_ranges(parameters, values, &scale);
    let (inverse, null) = pseudo_inverse(&jacobian, &inside);
    let weight = |i: &usize| if summed.contains(i) { scale[*i] } else { 0.0 };
    let weights = DVector::from_iterator(inside.len(), inside.iter().map(weight));
    // Along a null direction the sum must not change.
    let moved = |direction: &NullDirection| {
        direction
            .components
            .iter()
            .map(|(i, x)| weight(i) * x)
            .sum::<f64>()
    };
    let undetermined = null.iter().any(|d| moved(d).abs() > 1e-3 * weights.amax());
    let stretches = problem.stretches();
    let noise = ResidualNoise::new(residuals, &stretches, inside.len());
    if undetermined || noise.quantile.is_none() {
        return f64::INFINITY;
    }
    let influence = influence(&jacobian.select_columns(&inside), &inverse, residuals) * &weights;
    let local = long_run_variance(influence.as_slice(), &stretches);
    let global = noise.variance * weights.dot(&(&inverse * &weights));
    global.max(local).sqrt()
}

/// Indices of the parameters that are not at a bound, and the warnings about bounds and plausible ranges.
fn check_ranges(parameters: &[Parameter], values: &[f64], scale: &[f64]) -> (Vec<usize>, Vec<Warning>) {
    let (mut inside, mut warnings) = (Vec::new(), Vec::new());
    for (i, p) in parameters.iter().enumerate() {
        if p.bounds.iter().any(|b| (values[i] - b).abs() <= 1e-9 * scale[i]) {
            warnings.push(Warning::AtBound {
                name: p.name,
                value: values[i],
            });
        } else {
            inside.push(i);
        }
        if !(p.belief[0]..=p.belief[1]).contains(&values[i]) {
            warnings.push(Warning::OutsideBelief {
                name: p.name,
                value: values[i],
                belief: p.belief,
            });
        }
    }
    (inside, warnings)
}

/// What the residuals say about the noise.
struct ResidualNoise {
    /// Variance of one residual, times the correlation time.
    variance: f64,
    /// Number of independent residuals.
    independent: f64,
    /// 97.5 % point of Student's t for the degrees of freedom; `None` if there is not one.
    quantile: Option<f64>,
}

impl ResidualNoise {
    fn new(residuals: &[f64], stretches: &[usize], fitted: usize) -> Self {
        let (count, fitted) = (residuals.len() as f64, fitted as f64);
        let tau = correlation_time(residuals, stretches);
        let independent = count / tau;
        let degrees = independent - fitted;
        let squares = residuals.iter().map(|r| r * r).sum::<f64>();
        // A correlated residual takes as many degrees of freedom per parameter, but there are fewer of them.
        ResidualNoise {
            variance: squares / degrees,
            independent,
            quantile: (degrees >= 1.0).then(|| student_975(degrees)),
        }
    }
}

/// Influence of every sample (row) on every value (column), in scaled parameters.
fn influence(jacobian: &DMatrix<f64>, inverse: &DMatrix<f64>, residuals: &[f64]) -> DMatrix<f64> {
    let mut influence = jacobian * inverse;
    for (mut row, residual) in influence.row_iter_mut().zip(residuals) {
        row *= *residual;
    }
    influence
}

/// A direction in the scaled parameters along which the residuals do not change.
struct NullDirection {
    /// Parameter and its component, the largest first.
    components: Vec<(usize, f64)>,
}

impl NullDirection {
    fn contains(&self, parameter: usize) -> bool {
        self.components.iter().any(|&(i, _)| i == parameter)
    }

    fn warning(&self, parameters: &[Parameter]) -> Warning {
        let names: Vec<&'static str> = self.components.iter().map(|&(i, _)| parameters[i].name).collect();
        let combination = match self.components[..] {
            [_] => "it does not change the residuals".to_owned(),
            [(i, a), (j, b)] => {
                let (first, second) = (parameters[i.min(j)].name, parameters[i.max(j)].name);
                // Equal components are a product or a ratio; unequal ones are powers that help no reader.
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

/// Inverse of J'J over the `inside` columns without its null directions, and those directions.
fn pseudo_inverse(jacobian: &DMatrix<f64>, inside: &[usize]) -> (DMatrix<f64>, Vec<NullDirection>) {
    let m = inside.len();
    if m == 0 || jacobian.iter().any(|d| !d.is_finite()) {
        // Without derivatives no parameter is determined.
        let null = inside.iter().map(|&i| NullDirection {
            components: vec![(i, 1.0)],
        });
        return (DMatrix::zeros(m, m), null.collect());
    }
    // The triangular factor has the singular values of the tall matrix at a fraction of the work.
    let tall = jacobian.select_columns(inside);
    let small = if tall.nrows() > m { tall.qr().r() } else { tall };
    let svd = small.svd(false, true);
    let right = svd.v_t.expect("the decomposition was called with V");
    let largest = svd.singular_values.max();
    let mut inverse = DMatrix::zeros(m, m);
    let mut null = Vec::new();
    for (k, row) in right.row_iter().enumerate() {
        let singular = svd.singular_values[k];
        if singular > RANK_TOLERANCE * largest {
            inverse += row.transpose() * row / (singular * singular);
            continue;
        }
        let peak = row.amax();
        let mut components: Vec<(usize, f64)> = (0..m)
            .filter(|&a| row[a].abs() > 0.05 * peak)
            .map(|a| (inside[a], row[a]))
            .collect();
        components.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        null.push(NullDirection { components });
    }
    (inverse, null)
}

/// Integrated autocorrelation time of the residuals in samples, at least 1. Different stretches are uncorrelated.
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
    // The sum ends at the first negative pair of lags (Geyer), and at a third of the longest stretch at the latest.
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

/// Variance of the sum of a series: lags are weighted down to zero at sqrt(length). Different stretches are uncorrelated.
pub(crate) fn long_run_variance(series: &[f64], stretches: &[usize]) -> f64 {
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

/// Degrees of freedom above which `statrs` loses digits; the first terms of the expansion in 1 / degrees are exact to 1e-8.
const EXPANDED_FROM: f64 = 1e4;
/// 97.5 % point of the normal distribution.
const NORMAL_975: f64 = 1.959_963_984_540_054;

/// 97.5 % point of Student's t; `degrees` need not be a whole number and counts as 1 below 1.
pub(crate) fn student_975(degrees: f64) -> f64 {
    if degrees > EXPANDED_FROM {
        return NORMAL_975 + (NORMAL_975.powi(3) + NORMAL_975) / (4.0 * degrees);
    }
    student(degrees.max(1.0)).inverse_cdf(0.975)
}

/// Probability that Student's t lies within `-t..t`, 0 to 1.
pub(crate) fn student_within(degrees: f64, t: f64) -> f64 {
    2.0 * student(degrees.clamp(1.0, EXPANDED_FROM)).cdf(t) - 1.0
}

/// Point of Student's t below which it lies with `probability`, 0 to 1, both excluded.
pub(crate) fn student_quantile(degrees: f64, probability: f64) -> f64 {
    student(degrees.clamp(1.0, EXPANDED_FROM)).inverse_cdf(probability)
}

/// 95 % interval of a share of which `yes` of `of` were counted (E. B. Wilson 1927); `None` without cases.
pub(crate) fn wilson_interval(yes: usize, of: usize) -> Option<[f64; 2]> {
    let (n, share) = (of as f64, yes as f64 / of as f64);
    let z2 = NORMAL_975 * NORMAL_975;
    let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = NORMAL_975 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    (of > 0).then(|| [(middle - half).max(0.0), (middle + half).min(1.0)])
}

fn student(degrees: f64) -> StudentsT {
    StudentsT::new(0.0, 1.0, degrees).expect("at least one degree of freedom")
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ProductLine, StraightLine};
    use super::super::{Fit, FitControl, FitOptions, Residuals, fit};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        random.sample(StandardNormal)
    }

    fn fitted(problem: &dyn Residuals) -> Fit {
        fit(problem, &FitOptions::default(), &mut |_| FitControl::Continue).expect("a sound problem")
    }

    #[test]
    fn intervals_of_a_straight_line_are_the_textbook_ones() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let y: Vec<f64> = (0..200)
            .map(|i| 3.0 + 0.5 * f64::from(i) * 0.05 + 0.1 * normal(&mut random))
            .collect();
        let fit = fitted(&StraightLine::new(y));
        // White residuals: sigma of the slope = 0.1 / sqrt(sum (x - mean)^2) = 0.1 / sqrt(200 * 100 / 12) within the scatter
        // of s (5 %) and of the estimated correlation time (15 %).
        let expected = 0.1 / (200.0f64 * 100.0 / 12.0).sqrt();
        let [low, high] = fit.ci95[1].expect("the slope is determined");
        // 200 samples, two parameters: Student's t is 1.972.
        let sigma = 0.5 * (high - low) / 1.972;
        assert!(
            (sigma / expected - 1.0).abs() < 0.25,
            "{sigma} against {expected}"
        );
        assert!(low < 0.5 && 0.5 < high);
    }

    /// Deviations of sums of parameters at the optimum, one for each list of places.
    fn sums<const N: usize>(problem: &dyn Residuals, places: [&[usize]; N]) -> [f64; N] {
        let fit = fitted(problem);
        let mut evaluator = Evaluator::new(problem, 1);
        let mut residuals = vec![0.0; problem.count()];
        evaluator.residuals(&fit.values, &mut residuals);
        places.map(|summed| sigma_of_sum(&mut evaluator, &fit.values, &residuals, 1e-5, summed))
    }

    #[test]
    fn the_deviation_of_a_sum_has_the_covariance_of_its_parts() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let y = (0..200).map(|i| 3.0 + 0.5 * f64::from(i) * 0.05 + 0.1 * normal(&mut random));
        let [slope, sum] = sums(&StraightLine::new(y.collect()), [&[1], &[0, 1]]);
        // offset + slope is the height at x = 1: variance / s^2 = 1 / n + (1 - mean)^2 / S with S = sum (x - mean)^2, that of the slope 1 / S.
        let (mean, around) = (
            4.975f64,
            200.0 * (200.0f64 * 200.0 - 1.0) / 12.0 * 0.05f64.powi(2),
        );
        let expected = (around / 200.0 + (1.0 - mean).powi(2)).sqrt();
        // As if the two were independent it would be 5.8 in place of 4.9.
        assert!(
            (sum / slope / expected - 1.0).abs() < 0.08,
            "{} against {expected}",
            sum / slope
        );
    }

    #[test]
    fn a_sum_along_a_direction_that_is_not_determined_has_no_deviation() {
        let [product, third] = sums(&ProductLine::new(), [&[0, 1], &[2]]);
        assert_eq!(product, f64::INFINITY, "only first * second is determined");
        assert!(third > 0.0 && third < 0.1, "{third}");
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
            let [low, high] = fitted(&StraightLine::new(y)).ci95[1].expect("the slope is determined");
            covered += usize::from(low < 0.5 && 0.5 < high);
        }
        // 95 % wanted; the estimated time is itself uncertain. Binomial scatter over 200 is 1.5 %.
        assert!((176..=200).contains(&covered), "{covered} of 200");
    }

    /// One slow wave is worth three or four independent values, however often it is sampled.
    #[test]
    fn no_interval_without_a_degree_of_freedom() {
        for count in [40, 4000] {
            let wave: Vec<f64> = (0..count)
                .map(|i| (std::f64::consts::TAU * f64::from(i) / f64::from(count)).cos())
                .collect();
            let noise = |fitted: usize| ResidualNoise::new(&wave, &[wave.len()], fitted);
            assert!(
                (2.5..4.5).contains(&noise(2).independent),
                "{}",
                noise(2).independent
            );
            assert!(noise(1).quantile.is_some());
            assert_eq!(noise(4).quantile, None);
        }
        let fit = fitted(&StraightLine::new(vec![1.0, 2.0]));
        let no_freedom = |w: &Warning| matches!(w, Warning::NoFreedom { names, .. } if names.len() == 2);
        assert!(fit.warnings.iter().any(no_freedom), "{:?}", fit.warnings);
        assert_eq!(fit.ci95, [None, None]);
    }

    #[test]
    fn a_product_is_called_a_product() {
        let problem = ProductLine::new();
        let fit = fitted(&problem);
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
    fn student_quantiles_and_probabilities() {
        for (degrees, table) in [
            (1.0, 12.706),
            (2.0, 4.303),
            (3.0, 3.182),
            (5.0, 2.571),
            (10.0, 2.228),
            (30.0, 2.042),
            (1e9, 1.960),
        ] {
            let ours = student_975(degrees);
            assert!(
                (ours / table - 1.0).abs() < 5e-4,
                "{degrees}: {ours} against {table}"
            );
            assert!((student_within(degrees, ours) - 0.95).abs() < 5e-5);
        }
        let [below, above] = [0.999, 1.001].map(|share| student_975(share * EXPANDED_FROM));
        assert!((below / above - 1.0).abs() < 1e-6, "the two formulas meet");
    }
}
