//! Nelder-Mead simplex in relative parameters, as Polach and Hajzman used it (MATLAB's fminsearch: Lagarias et al., SIAM J.
//! Optim. 9, 1998). Each coordinate is `value / start` (their eq. 3), so its start is 1.
//!
//! Reflection 1, expansion 2, contraction 0.5, shrinkage 0.5; the first simplex is 5 % wide. The cost is infinite for values
//! that the model refuses and for values outside the bounds.

use super::evaluator::Evaluator;
use super::{FitControl, FitEnding, FitProgress, Optimum};

/// Tolerances; the defaults are those of fminsearch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SimplexSettings {
    /// Converged when every corner is within this of the best one, in relative parameters,
    pub size_tolerance: f64,
    /// and every cost within this of the best one.
    pub cost_tolerance: f64,
    /// Largest number of evaluations; 0 for 200 per parameter.
    pub evaluations: usize,
}

impl Default for SimplexSettings {
    fn default() -> Self {
        SimplexSettings {
            size_tolerance: 1e-4,
            cost_tolerance: 1e-4,
            evaluations: 0,
        }
    }
}

/// The corners in relative parameters with their costs, best first.
struct Simplex<'e, 'p> {
    evaluator: &'e mut Evaluator<'p>,
    scale: Vec<f64>,
    bounds: Vec<[f64; 2]>,
    corners: Vec<(Vec<f64>, f64)>,
}

impl<'e, 'p> Simplex<'e, 'p> {
    /// The first simplex: the start, and one corner per parameter that is moved along it.
    fn new(evaluator: &'e mut Evaluator<'p>, start: &[f64], bounds: &[[f64; 2]]) -> Self {
        let n = start.len();
        // A start of zero has no ratio: its coordinate is the share of the bounds' width.
        let scale: Vec<f64> = start
            .iter()
            .zip(bounds)
            .map(|(&s, [low, high])| if s == 0.0 { high - low } else { s })
            .collect();
        let first: Vec<f64> = start.iter().map(|&s| if s == 0.0 { 0.0 } else { 1.0 }).collect();
        let mut simplex = Simplex {
            evaluator,
            scale,
            bounds: bounds.to_vec(),
            corners: Vec::with_capacity(n + 1),
        };
        for corner in 0..=n {
            let mut relative = first.clone();
            if corner > 0 {
                let moved = &mut relative[corner - 1];
                *moved = if *moved == 0.0 { 0.00025 } else { 1.05 };
            }
            let cost = simplex.cost(&relative);
            simplex.corners.push((relative, cost));
        }
        simplex.corners.sort_by(|a, b| a.1.total_cmp(&b.1));
        simplex
    }

    fn values(&self, relative: &[f64]) -> Vec<f64> {
        relative.iter().zip(&self.scale).map(|(r, s)| r * s).collect()
    }

    fn cost(&mut self, relative: &[f64]) -> f64 {
        let values = self.values(relative);
        let inside = values
            .iter()
            .zip(&self.bounds)
            .all(|(v, [low, high])| v >= low && v <= high);
        if inside {
            self.evaluator.cost(&values)
        } else {
            f64::INFINITY
        }
    }

    /// Point on the line from the worst corner through the mean of the others: 0 is the mean, -1 the worst.
    fn along(&self, how_far: f64) -> Vec<f64> {
        let (worst, others) = self.corners.split_last().expect("a simplex has corners");
        (0..self.scale.len())
            .map(|n| {
                let mean = others.iter().map(|c| c.0[n]).sum::<f64>() / others.len() as f64;
                mean + how_far * (mean - worst.0[n])
            })
            .collect()
    }

    /// One iteration of the method; the corners are sorted before and after.
    fn improve(&mut self) {
        let n = self.scale.len();
        let (best, second_worst, worst) = (self.corners[0].1, self.corners[n - 1].1, self.corners[n].1);
        let reflected = self.along(1.0);
        let cost = self.cost(&reflected);
        if cost < best {
            let expanded = self.along(2.0);
            let further = self.cost(&expanded);
            self.corners[n] = if further < cost {
                (expanded, further)
            } else {
                (reflected, cost)
            };
        } else if cost < second_worst {
            self.corners[n] = (reflected, cost);
        } else {
            let contracted = self.along(if cost < worst { 0.5 } else { -0.5 });
            let nearer = self.cost(&contracted);
            if nearer <= cost.min(worst) && nearer.is_finite() {
                self.corners[n] = (contracted, nearer);
            } else {
                self.shrink();
            }
        }
        self.corners.sort_by(|a, b| a.1.total_cmp(&b.1));
    }

    fn shrink(&mut self) {
        for i in 1..self.corners.len() {
            let moved: Vec<f64> = self.corners[i]
                .0
                .iter()
                .zip(&self.corners[0].0)
                .map(|(c, b)| b + 0.5 * (c - b))
                .collect();
            let cost = self.cost(&moved);
            self.corners[i] = (moved, cost);
        }
    }

    fn converged(&self, settings: &SimplexSettings) -> bool {
        let (best, best_cost) = &self.corners[0];
        self.corners[1..].iter().all(|(corner, cost)| {
            (cost - best_cost).abs() <= settings.cost_tolerance
                && corner
                    .iter()
                    .zip(best)
                    .all(|(c, b)| (c - b).abs() <= settings.size_tolerance)
        })
    }
}

/// Searches from `start`.
pub(crate) fn minimise(
    evaluator: &mut Evaluator<'_>,
    start: &[f64],
    bounds: &[[f64; 2]],
    settings: &SimplexSettings,
    watch: &mut dyn FnMut(FitProgress) -> FitControl,
) -> Optimum {
    let n = start.len();
    let most = evaluator.evaluations()
        + match settings.evaluations {
            0 => 200 * n,
            given => given,
        };
    let mut simplex = Simplex::new(evaluator, start, bounds);
    let begun = simplex.evaluator.evaluations();
    let ending = loop {
        if simplex.converged(settings) {
            break FitEnding::Converged;
        }
        let evaluations = simplex.evaluator.evaluations();
        if evaluations >= most || n == 0 {
            break FitEnding::Exhausted;
        }
        let progress = FitProgress {
            best_cost: simplex.corners[0].1,
            share: (evaluations - begun) as f64 / (most - begun).max(1) as f64,
        };
        if watch(progress) == FitControl::Stop {
            break FitEnding::Stopped;
        }
        simplex.improve();
    };
    Optimum {
        values: simplex.values(&simplex.corners[0].0),
        cost: simplex.corners[0].1,
        ending,
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::Valley;
    use super::*;

    fn run(settings: &SimplexSettings, bounds: &[[f64; 2]; 2]) -> (Optimum, usize) {
        let problem = Valley::new();
        let mut evaluator = Evaluator::new(&problem, 1);
        let optimum = minimise(&mut evaluator, &[-1.2, 1.0], bounds, settings, &mut |_| {
            FitControl::Continue
        });
        (optimum, evaluator.evaluations())
    }

    #[test]
    fn finds_the_end_of_the_valley_like_fminsearch() {
        let (optimum, evaluations) = run(&SimplexSettings::default(), &[[-5.0, 5.0]; 2]);
        assert_eq!(optimum.ending, FitEnding::Converged);
        // fminsearch's tolerance of 1e-4 a coordinate; its own documentation reports 159 evaluations for this start.
        assert!(
            optimum.values.iter().all(|v| (v - 1.0).abs() < 2e-4),
            "{optimum:?}"
        );
        assert_eq!(evaluations, 159);
    }

    #[test]
    fn stays_within_bounds_and_evaluations() {
        let settings = SimplexSettings {
            evaluations: 60,
            ..SimplexSettings::default()
        };
        let (optimum, evaluations) = run(&settings, &[[-2.0, 0.5], [-2.0, 2.0]]);
        assert!(optimum.values[0] <= 0.5);
        // A shrink may exceed the limit by one evaluation per parameter.
        assert!(evaluations <= 62, "{evaluations}");
        assert_eq!(optimum.ending, FitEnding::Exhausted);
    }
}
