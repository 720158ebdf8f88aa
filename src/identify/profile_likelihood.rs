//! Profile likelihood: how far one parameter can go while all others follow. Honest where the intervals of `confidence`
//! assume a straight line: curved valleys, bounds, open ends.

use super::evaluator::Evaluator;
use super::objective::Residuals;
use super::{Fit, FitControl, FitOptions, IdentifyError, Method, fit, least_squares};

/// 95 % point of chi-square with one degree of freedom.
const CHI2_95: f64 = 3.841;

/// Where the profile crosses 95 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProfileInterval {
    /// Lower end; `None` where the parameter's bound is reached first: open.
    pub low: Option<f64>,
    /// Upper end; `None` where open.
    pub high: Option<f64>,
    /// Evaluations it took.
    pub evaluations: usize,
}

/// Profile of parameter `index` about `best`, with the noise and the effective number of samples that the fit found.
pub(crate) fn profile(
    problem: &dyn Residuals,
    best: &Fit,
    index: usize,
    options: &FitOptions,
) -> Result<ProfileInterval, IdentifyError> {
    let parameter = *best
        .parameters
        .get(index)
        .ok_or_else(|| IdentifyError::UnknownParameter {
            name: format!("number {index}"),
            known: best
                .parameters
                .iter()
                .map(|p| p.name)
                .collect::<Vec<_>>()
                .join(", "),
        })?;
    let mut residuals = vec![0.0; problem.count()];
    Evaluator::new(problem, 1).residuals(&best.values, &mut residuals);
    let least = residuals.iter().map(|r| r * r).sum::<f64>();
    let fitted = best.free.iter().filter(|&&free| free).count() as f64;
    let samples = residuals.len() as f64;
    let noise = least / (samples - fitted).max(1.0) * samples / best.effective_samples;
    let limit = least + CHI2_95 * noise;

    let mut search = Search {
        problem,
        options: FitOptions {
            method: match options.method {
                Method::LeastSquares(settings) => Method::LeastSquares(least_squares::LeastSquaresSettings {
                    screened: 0,
                    starts: 1,
                    ..settings
                }),
                _ => Method::LeastSquares(least_squares::LeastSquaresSettings::default()),
            },
            fixed: best
                .parameters
                .iter()
                .zip(&best.free)
                .enumerate()
                .filter(|(i, (_, free))| !**free || *i == index)
                .map(|(_, (p, _))| p.name.to_owned())
                .collect(),
            intervals: false,
            ..options.clone()
        },
        index,
        limit,
        evaluations: 1,
    };
    let first = match best.sigma[index] {
        sigma if sigma.is_finite() && sigma > 0.0 => 1.96 * sigma,
        _ => 0.05 * (parameter.belief[1] - parameter.belief[0]),
    };
    let low = search.end(&best.values, -first, parameter.bounds[0])?;
    let high = search.end(&best.values, first, parameter.bounds[1])?;
    Ok(ProfileInterval {
        low,
        high,
        evaluations: search.evaluations,
    })
}

struct Search<'a> {
    problem: &'a dyn Residuals,
    options: FitOptions,
    index: usize,
    limit: f64,
    evaluations: usize,
}

impl Search<'_> {
    /// Sum of squares above the limit with the parameter held at `value`, the others fitted from `start` on.
    fn excess(&mut self, start: &mut Vec<f64>, value: f64) -> Result<f64, IdentifyError> {
        start[self.index] = value;
        self.options.start = Some(start.clone());
        let held = match fit(self.problem, &self.options, &mut |_| FitControl::Continue) {
            Ok(held) => held,
            // The model does not go there: as good as infinitely unlikely.
            Err(IdentifyError::Build(_) | IdentifyError::Start { .. }) => return Ok(f64::INFINITY),
            Err(error) => return Err(error),
        };
        self.evaluations += held.evaluations;
        let mut residuals = vec![0.0; self.problem.count()];
        self.problem.evaluate(&held.values, &mut residuals)?;
        start.clone_from(&held.values);
        Ok(residuals.iter().map(|r| r * r).sum::<f64>() - self.limit)
    }

    /// Walks outwards, twice as far each time, then halves into the crossing.
    fn end(&mut self, best: &[f64], first: f64, bound: f64) -> Result<Option<f64>, IdentifyError> {
        let centre = best[self.index];
        let mut values = best.to_vec();
        let (mut inside, mut offset) = (0.0, first);
        let outside = loop {
            let reached = (centre + offset - bound) * first.signum() >= 0.0;
            let tried = if reached { bound - centre } else { offset };
            if self.excess(&mut values, centre + tried)? > 0.0 {
                break tried;
            }
            if reached {
                return Ok(None);
            }
            inside = tried;
            offset *= 2.0;
        };
        let (mut inside, mut outside) = (inside, outside);
        // 1 % of the interval's half is more than anybody reads off it.
        while (outside - inside).abs() > 0.01 * outside.abs() {
            let middle = 0.5 * (inside + outside);
            let mut from_best = values.clone();
            if self.excess(&mut from_best, centre + middle)? > 0.0 {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        Ok(Some(centre + 0.5 * (inside + outside)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{ProductLine, StraightLine};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn agrees_with_the_interval_of_a_linear_problem() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let y = (0..300)
            .map(|i| 1.0 + 0.1 * f64::from(i) + random.random::<f64>() - 0.5)
            .collect();
        let problem = StraightLine::new(y);
        let best = fit(&problem, &FitOptions::default(), &mut |_| FitControl::Continue).expect("fair");
        let profile = profile(&problem, &best, 1, &FitOptions::default()).expect("fair");
        let [low, high] = best.ci95[1].expect("seen");
        let (half, centre) = (0.5 * (high - low), best.values[1]);
        // Same quadratic; Student's 1.97 against chi-square's 1.96, and 1 % of the search.
        assert!((profile.high.expect("closed") - centre - half).abs() < 0.02 * half);
        assert!((centre - profile.low.expect("closed") - half).abs() < 0.02 * half);
    }

    #[test]
    fn a_factor_of_a_product_is_open() {
        let problem = ProductLine::new();
        let best = fit(&problem, &FitOptions::default(), &mut |_| FitControl::Continue).expect("fair");
        let interval = profile(&problem, &best, 0, &FitOptions::default()).expect("fair");
        // second = 6 / first stays within its bounds of 0.1 to 10 for first from 0.6 to its own upper bound.
        assert_eq!(interval.high, None);
        assert!(
            interval.low.is_some_and(|low| (low - 0.6).abs() < 0.05),
            "{interval:?}"
        );
    }
}
