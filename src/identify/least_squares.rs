//! Bounded Levenberg-Marquardt, from one start or from many.
//!
//! Minimises `|r(p)|^2` over `low <= p <= high` in scaled parameters. A step solves `(J'J + lambda diag(J'J)) d = -J'r` on
//! the parameters that are free to move; a parameter that would leave its bounds is put on the bound, and the others are
//! solved again. Damping after Nielsen (1999); a step that the model refuses has infinite cost and raises the damping.
//! Several starts: the costs at a seeded Latin hypercube over the plausible ranges are compared, and the best points are
//! followed to their minimum.

use nalgebra::{DMatrix, DVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::evaluator::Evaluator;
use super::jacobian::{scaled_jacobian, typical};
use super::{FitControl, FitEnding, FitProgress, Optimum};

/// Tolerances, step of the finite differences, and number of starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LeastSquaresSettings {
    /// Largest number of iterations per start (one Jacobian each).
    pub iterations: usize,
    /// Converged when an accepted step lowers the cost by less than this share.
    pub cost_tolerance: f64,
    /// Converged when a step moves every parameter by less than this share of its size.
    pub step_tolerance: f64,
    /// Finite-difference step as a share of a parameter's size.
    pub relative_step: f64,
    /// Points of the hypercube, besides the given start; 0 for the start alone.
    pub screened: usize,
    /// Number of points, the given start included, that are followed to their minimum.
    pub starts: usize,
}

impl Default for LeastSquaresSettings {
    fn default() -> Self {
        LeastSquaresSettings {
            iterations: 60,
            cost_tolerance: 1e-9,
            step_tolerance: 1e-7,
            relative_step: 1e-5,
            screened: 0,
            starts: 1,
        }
    }
}

/// Searches within `bounds` from `start` and, where `settings` ask for them, from points of the plausible ranges.
pub(crate) fn minimise(
    evaluator: &mut Evaluator<'_>,
    start: &[f64],
    bounds: &[[f64; 2]],
    settings: &LeastSquaresSettings,
    seed: u64,
    watch: &mut dyn FnMut(FitProgress) -> FitControl,
) -> Optimum {
    let mut points = vec![start.to_vec()];
    if settings.screened > 0 {
        points.extend(latin_hypercube(evaluator, bounds, settings.screened, seed));
        let costs = evaluator.costs(&points);
        // The given start is always followed. The sort is stable.
        let mut order: Vec<usize> = (1..points.len()).collect();
        order.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        let best = order.into_iter().take(settings.starts.saturating_sub(1));
        points = std::iter::once(0)
            .chain(best)
            .map(|i| points[i].clone())
            .collect();
    }
    let total = points.len();
    let mut best: Option<Optimum> = None;
    for (i, point) in points.into_iter().enumerate() {
        let known = best
            .as_ref()
            .map_or(f64::INFINITY, |optimum: &Optimum| optimum.cost);
        let mut descent = Descent::new(evaluator, point, bounds, settings);
        let optimum = descent.run(known, (i, total), watch);
        let stopped = optimum.ending == FitEnding::Stopped;
        let better = best
            .as_ref()
            .is_none_or(|so_far| optimum.cost < so_far.cost || (stopped && !so_far.cost.is_finite()));
        if better {
            best = Some(optimum);
        } else if let (true, Some(so_far)) = (stopped, best.as_mut()) {
            so_far.ending = FitEnding::Stopped;
        }
        if stopped {
            break;
        }
    }
    best.expect("there is at least the given start")
}

/// `count` points with one value in each of `count` equal slices of every plausible range; the slices are shuffled.
fn latin_hypercube(evaluator: &Evaluator<'_>, bounds: &[[f64; 2]], count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut points = vec![Vec::with_capacity(bounds.len()); count];
    for (parameter, &[low, high]) in evaluator.problem().parameters().iter().zip(bounds) {
        let low = low.max(parameter.belief[0]);
        let high = high.min(parameter.belief[1]);
        let mut slices: Vec<usize> = (0..count).collect();
        slices.shuffle(&mut random);
        for (point, slice) in points.iter_mut().zip(slices) {
            let share = (slice as f64 + random.random::<f64>()) / count as f64;
            // A wide positive range is sampled by its logarithm.
            let value = if low > 0.0 && high / low > 30.0 {
                low * (high / low).powf(share)
            } else {
                low + (high - low) * share
            };
            point.push(value);
        }
    }
    points
}

/// The search from one start.
struct Descent<'e, 'p, 'b> {
    evaluator: &'e mut Evaluator<'p>,
    bounds: &'b [[f64; 2]],
    settings: LeastSquaresSettings,
    values: Vec<f64>,
    residuals: Vec<f64>,
    trial: Vec<f64>,
    cost: f64,
    damping: f64,
    raise: f64,
}

/// Result of the steps that were tried with one Jacobian.
enum Attempt {
    /// The cost fell.
    Lower,
    /// The cost fell by less than its tolerance, or the step was below its tolerance.
    Settled,
    /// No damping gave a lower cost.
    Stuck,
}

impl<'e, 'p, 'b> Descent<'e, 'p, 'b> {
    fn new(
        evaluator: &'e mut Evaluator<'p>,
        start: Vec<f64>,
        bounds: &'b [[f64; 2]],
        settings: &LeastSquaresSettings,
    ) -> Self {
        let count = evaluator.problem().count();
        let mut residuals = vec![0.0; count];
        let cost = sum_of_squares(evaluator.residuals(&start, &mut residuals), &residuals);
        Descent {
            evaluator,
            bounds,
            settings: *settings,
            values: start,
            residuals,
            trial: vec![0.0; count],
            cost,
            damping: 1e-3,
            raise: 2.0,
        }
    }

    fn run(
        &mut self,
        known_cost: f64,
        (turn, turns): (usize, usize),
        watch: &mut dyn FnMut(FitProgress) -> FitControl,
    ) -> Optimum {
        let mut ending = FitEnding::Exhausted;
        let mut idle = 0;
        for iteration in 0..self.settings.iterations {
            let done = iteration as f64 / self.settings.iterations as f64;
            let progress = FitProgress {
                best_cost: self.cost.min(known_cost),
                share: (turn as f64 + done) / turns as f64,
            };
            if watch(progress) == FitControl::Stop {
                ending = FitEnding::Stopped;
                break;
            }
            if self.cost == 0.0 || !self.cost.is_finite() {
                ending = if self.cost == 0.0 {
                    FitEnding::Converged
                } else {
                    FitEnding::Exhausted
                };
                break;
            }
            match self.attempt() {
                Attempt::Lower => idle = 0,
                // The search has converged only after two such steps in a row, because high damping can make a single step
                // very small.
                Attempt::Settled if idle == 0 => idle = 1,
                Attempt::Settled | Attempt::Stuck => {
                    ending = FitEnding::Converged;
                    break;
                }
            }
        }
        Optimum {
            values: self.values.clone(),
            cost: self.cost,
            ending,
        }
    }

    /// Computes one Jacobian and raises the damping until a step lowers the cost.
    fn attempt(&mut self) -> Attempt {
        let parameters = self.evaluator.problem().parameters();
        let scale: Vec<f64> = (0..self.values.len())
            .map(|n| typical(self.values[n], parameters[n].belief, self.bounds[n]))
            .collect();
        let jacobian = scaled_jacobian(
            self.evaluator,
            &self.values,
            &self.residuals,
            &scale,
            self.settings.relative_step,
        );
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&DVector::from_column_slice(&self.residuals));
        let room: Vec<[f64; 2]> = (0..scale.len())
            .map(|i| self.bounds[i].map(|bound| (bound - self.values[i]) / scale[i]))
            .collect();
        for _ in 0..12 {
            let step = bounded_step(&normal, &gradient, self.damping, &room);
            let predicted = -(2.0 * gradient.dot(&step) + step.dot(&(&normal * &step)));
            let values: Vec<f64> = (0..scale.len())
                .map(|n| (self.values[n] + step[n] * scale[n]).clamp(self.bounds[n][0], self.bounds[n][1]))
                .collect();
            let small = step.amax() <= self.settings.step_tolerance;
            let raw = self.evaluator.residuals(&values, &mut self.trial);
            let cost = sum_of_squares(raw, &self.trial);
            if cost < self.cost {
                let gain = self.cost - cost;
                let ratio = if predicted > 0.0 { gain / predicted } else { 1.0 };
                let nothing =
                    gain <= self.settings.cost_tolerance * self.cost && predicted <= 10.0 * gain.abs();
                self.damping *= (1.0 - (2.0 * ratio - 1.0).powi(3)).clamp(0.1, 2.0);
                self.damping = self.damping.max(1e-12);
                self.raise = 2.0;
                self.values = values;
                self.cost = cost;
                std::mem::swap(&mut self.residuals, &mut self.trial);
                return if small || nothing {
                    Attempt::Settled
                } else {
                    Attempt::Lower
                };
            }
            // A step along bounds may predict a higher cost: it is tried again with more damping.
            if small || (0.0..=1e-14 * self.cost).contains(&predicted) {
                return Attempt::Stuck;
            }
            self.damping *= self.raise;
            self.raise *= 2.0;
        }
        Attempt::Stuck
    }
}

/// Damped step in scaled parameters that ends within `room`, the distances to the lower and to the upper bound.
///
/// Minimises `d'(N + damping diag N) d / 2 + g'd` in the box by active sets: a parameter stays on a bound until the slope
/// there points back inside (Lawson and Hanson 1974, chapter 23; with upper bounds Stark and Parker 1995).
pub(crate) fn bounded_step(
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    damping: f64,
    room: &[[f64; 2]],
) -> DVector<f64> {
    let n = room.len();
    let least = 1e-9 * normal.diagonal().amax();
    let mut damped = normal.clone();
    for i in 0..n {
        damped[(i, i)] += damping * normal[(i, i)].max(least);
    }
    let mut step = DVector::zeros(n);
    let mut free: Vec<usize> = (0..n).filter(|&i| !held(&step, gradient, room, i)).collect();
    // Each round frees one parameter; more rounds than this repeat themselves because of rounding.
    for _ in 0..3 * n {
        if !solve_free(&damped, gradient, room, &mut free, &mut step) {
            return step;
        }
        let slope = gradient + &damped * &step;
        // Of the parameters that could move back inside, the one that lowers the cost most.
        let gain = |i: usize| slope[i] * slope[i] / damped[(i, i)];
        let Some(next) = (0..n)
            .filter(|i| !free.contains(i) && !held(&step, &slope, room, *i))
            .max_by(|&a, &b| gain(a).total_cmp(&gain(b)))
            .filter(|&i| gain(i) > 1e-12 * gradient.dot(&step).abs())
        else {
            break;
        };
        free.push(next);
    }
    step
}

/// True where parameter `i` is on a bound and the slope points out of it.
fn held(step: &DVector<f64>, slope: &DVector<f64>, room: &[[f64; 2]], i: usize) -> bool {
    let [low, high] = room[i];
    step[i] <= low && slope[i] >= 0.0 || step[i] >= high && slope[i] <= 0.0
}

/// Moves the `free` parameters of `step` to their minimum; those that meet a bound stay on it and leave `free`. False where
/// the matrix is not positive definite.
fn solve_free(
    damped: &DMatrix<f64>,
    gradient: &DVector<f64>,
    room: &[[f64; 2]],
    free: &mut Vec<usize>,
    step: &mut DVector<f64>,
) -> bool {
    while !free.is_empty() {
        let m = free.len();
        let inner = DMatrix::from_fn(m, m, |r, c| damped[(free[r], free[c])]);
        let slope = gradient + damped * &*step;
        let right = DVector::from_fn(m, |r, _| -slope[free[r]]);
        let Some(way) = inner.cholesky().map(|c| c.solve(&right)) else {
            return false;
        };
        // Share of the way to the minimum at which a parameter meets its bound.
        let share = |r: usize| {
            let [low, high] = room[free[r]];
            let end = if way[r] < 0.0 { low } else { high };
            let there = (end - step[free[r]]) / way[r];
            if there.is_finite() {
                there.max(0.0)
            } else {
                f64::INFINITY
            }
        };
        let first = (0..m).map(share).fold(1.0, f64::min);
        let met: Vec<bool> = (0..m).map(|r| share(r) <= first && first < 1.0).collect();
        for (r, &i) in free.iter().enumerate() {
            let [low, high] = room[i];
            step[i] = match (met[r], way[r] < 0.0) {
                (true, true) => low,
                (true, false) => high,
                _ => (step[i] + first * way[r]).clamp(low, high),
            };
        }
        let mut met = met.into_iter();
        free.retain(|_| !met.next().unwrap_or(false));
        if first >= 1.0 {
            break;
        }
    }
    true
}

/// The sum of squares, also for a problem whose own cost is another one; infinite where that cost is.
fn sum_of_squares(reported: f64, residuals: &[f64]) -> f64 {
    if reported.is_finite() {
        residuals.iter().map(|r| r * r).sum()
    } else {
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Valley, Waves};
    use super::*;

    fn go(
        problem: &dyn super::super::Residuals,
        threads: usize,
        start: &[f64],
        bounds: &[[f64; 2]],
        settings: &LeastSquaresSettings,
    ) -> (Optimum, usize) {
        let mut evaluator = Evaluator::new(problem, threads);
        let optimum = minimise(&mut evaluator, start, bounds, settings, 5, &mut |_| {
            FitControl::Continue
        });
        (optimum, evaluator.evaluations())
    }

    #[test]
    fn end_of_the_valley() {
        let (optimum, evaluations) = go(
            &Valley::new(),
            1,
            &[-1.2, 1.0],
            &[[-5.0, 5.0]; 2],
            &LeastSquaresSettings::default(),
        );
        assert_eq!(optimum.ending, FitEnding::Converged);
        // Residuals vanish there: converged quadratically, to the step tolerance or better.
        assert!(
            optimum.values.iter().all(|v| (v - 1.0).abs() < 1e-7),
            "{optimum:?}"
        );
        assert!(evaluations < 100, "{evaluations}");
    }

    #[test]
    fn constrained_minimum_lies_on_the_bound() {
        // With x <= 0.5 the least of (1 - x)^2 + 100 (y - x^2)^2 is at x = 0.5, y = 0.25.
        let bounds = [[-2.0, 0.5], [-2.0, 2.0]];
        let (optimum, _) = go(
            &Valley::new(),
            1,
            &[-1.2, 1.0],
            &bounds,
            &LeastSquaresSettings::default(),
        );
        assert_eq!(optimum.values[0], 0.5);
        assert!((optimum.values[1] - 0.25).abs() < 1e-6, "{optimum:?}");
        // And back from a start on the wrong bound.
        let (optimum, _) = go(
            &Valley::new(),
            1,
            &[-2.0, 2.0],
            &bounds,
            &LeastSquaresSettings::default(),
        );
        assert_eq!(optimum.values[0], 0.5);
    }

    #[test]
    fn several_starts_find_the_deepest_of_many_minima() {
        let bounds = [[0.0, 20.0]];
        let (alone, _) = go(
            &Waves::new(),
            1,
            &[6.9],
            &bounds,
            &LeastSquaresSettings::default(),
        );
        assert!(
            (alone.values[0] - 13.0).abs() > 1.0,
            "the start alone must end in another minimum"
        );
        let settings = LeastSquaresSettings {
            screened: 30,
            starts: 4,
            ..LeastSquaresSettings::default()
        };
        let (optimum, _) = go(&Waves::new(), 1, &[6.9], &bounds, &settings);
        assert!((optimum.values[0] - 13.0).abs() < 1e-6, "{optimum:?}");
        for threads in [2, 4] {
            assert_eq!(go(&Waves::new(), threads, &[6.9], &bounds, &settings).0, optimum);
        }
    }

    #[test]
    fn hypercube_has_one_point_a_slice() {
        let problem = Valley::new();
        let evaluator = Evaluator::new(&problem, 1);
        let points = latin_hypercube(&evaluator, &[[-2.0, 2.0]; 2], 8, 1);
        for n in 0..2 {
            let mut slices: Vec<usize> = points.iter().map(|p| ((p[n] + 2.0) / 0.5) as usize).collect();
            slices.sort_unstable();
            assert_eq!(slices, (0..8).collect::<Vec<_>>());
        }
    }
}
