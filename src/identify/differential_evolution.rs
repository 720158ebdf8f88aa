//! Differential evolution as Kadziela et al. (2015) print it: eqs. 10 to 12, settings of Table 5. Bounded and seeded.
//!
//! ```text
//! mutant  v = x_r3 + F (x_r1 - x_r2)                         (10)  i, r1, r2, r3 all different
//! trial   t_n = v_n where rand(0, 1) < CR or n = D, else x_n (11)  n = 1 .. D: the last element is always the mutant's
//! next    x <- t where f(t) < f(x)                           (12)
//! ```
//! The paper prints v in eq. 12; the trial t of eq. 11 is used, as in other texts. `n = D` is kept as printed (other texts draw
//! one n at random). The paper leaves open what is set here: an element outside its bounds is put on the bound; the first
//! population is uniform within the bounds, with the start as first member; it counts as the first generation, so that 25
//! generations of 12 are the 300 runs that the paper reports.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::evaluator::Evaluator;
use super::{FitControl, FitEnding, FitProgress, Optimum};

/// Settings of Table 5, and the tolerance that ends the search before the last generation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EvolutionSettings {
    /// Number of members (NP); at least 4 are used.
    pub population: usize,
    /// Weight of the difference vector (F).
    pub weight_factor: f64,
    /// Probability that an element comes from the mutant (CR).
    pub crossover_rate: f64,
    /// Number of generations, the first population included.
    pub generations: usize,
    /// Converged when the costs of a generation differ by no more than this (the paper does not print its condition).
    pub cost_spread: f64,
}

impl Default for EvolutionSettings {
    /// Settings of Table 5.
    fn default() -> Self {
        EvolutionSettings {
            population: 12,
            weight_factor: 0.7,
            crossover_rate: 0.85,
            generations: 25,
            cost_spread: 1e-9,
        }
    }
}

/// Members of one generation and their costs.
struct Population {
    members: Vec<Vec<f64>>,
    costs: Vec<f64>,
}

impl Population {
    /// `size` members: the start, and points that are uniform within the bounds.
    fn first(
        evaluator: &mut Evaluator<'_>,
        start: &[f64],
        bounds: &[[f64; 2]],
        size: usize,
        random: &mut ChaCha8Rng,
    ) -> Self {
        let mut members = vec![start.to_vec()];
        members.resize_with(size, || {
            bounds
                .iter()
                .map(|[low, high]| low + (high - low) * random.random::<f64>())
                .collect()
        });
        let costs = evaluator.costs(&members);
        Population { members, costs }
    }

    /// Index of the member with the lowest cost.
    fn best(&self) -> usize {
        (0..self.costs.len())
            .min_by(|&a, &b| self.costs[a].total_cmp(&self.costs[b]))
            .unwrap_or(0)
    }

    /// Highest cost less the lowest.
    fn cost_spread(&self) -> f64 {
        let ends = (f64::INFINITY, 0.0f64);
        let (low, high) = self
            .costs
            .iter()
            .fold(ends, |(low, high), &cost| (low.min(cost), high.max(cost)));
        high - low
    }

    /// One generation: a trial for every member, which it replaces where its cost is lower.
    fn advance(
        &mut self,
        evaluator: &mut Evaluator<'_>,
        bounds: &[[f64; 2]],
        settings: &EvolutionSettings,
        random: &mut ChaCha8Rng,
    ) {
        // All draws come before any evaluation, so that the numbers do not depend on the threads.
        let trials: Vec<Vec<f64>> = (0..self.members.len())
            .map(|i| trial(&self.members, i, bounds, settings, random))
            .collect();
        let trial_costs = evaluator.costs(&trials);
        for (i, (trial, cost)) in trials.into_iter().zip(trial_costs).enumerate() {
            if cost < self.costs[i] {
                self.members[i] = trial;
                self.costs[i] = cost;
            }
        }
    }
}

/// Searches within `bounds`, one pair per parameter.
pub(crate) fn minimise(
    evaluator: &mut Evaluator<'_>,
    start: &[f64],
    bounds: &[[f64; 2]],
    settings: &EvolutionSettings,
    seed: u64,
    watch: &mut dyn FnMut(FitProgress) -> FitControl,
) -> Optimum {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // A trial takes a parent and three other members.
    let size = settings.population.max(4);
    let mut population = Population::first(evaluator, start, bounds, size, &mut random);
    let mut generation = 1;
    let ending = loop {
        if population.cost_spread() <= settings.cost_spread {
            break FitEnding::Converged;
        }
        let progress = FitProgress {
            best_cost: population.costs[population.best()],
            share: generation as f64 / settings.generations.max(1) as f64,
        };
        if watch(progress) == FitControl::Stop {
            break FitEnding::Stopped;
        }
        if generation >= settings.generations {
            break FitEnding::Exhausted;
        }
        population.advance(evaluator, bounds, settings, &mut random);
        generation += 1;
    };
    let best = population.best();
    Optimum {
        values: population.members.swap_remove(best),
        cost: population.costs[best],
        ending,
    }
}

/// Eqs. 10 and 11 for parent `i`.
fn trial(
    population: &[Vec<f64>],
    i: usize,
    bounds: &[[f64; 2]],
    settings: &EvolutionSettings,
    random: &mut ChaCha8Rng,
) -> Vec<f64> {
    let mut picked = [i; 4];
    for place in 1..4 {
        picked[place] = loop {
            let candidate = random.random_range(0..population.len());
            if !picked[..place].contains(&candidate) {
                break candidate;
            }
        };
    }
    let [_, r1, r2, r3] = picked;
    let dimension = bounds.len();
    (0..dimension)
        .map(|n| {
            let crossed = random.random::<f64>() < settings.crossover_rate || n + 1 == dimension;
            if !crossed {
                return population[i][n];
            }
            let mutant = population[r3][n] + settings.weight_factor * (population[r1][n] - population[r2][n]);
            mutant.clamp(bounds[n][0], bounds[n][1])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::testing::Valley;
    use super::*;

    fn run(threads: usize, seed: u64, settings: &EvolutionSettings) -> (Optimum, usize) {
        let problem = Valley::new();
        let mut evaluator = Evaluator::new(&problem, threads);
        let bounds = [[-2.0, 2.0], [-2.0, 2.0]];
        let optimum = minimise(&mut evaluator, &[-1.2, 1.0], &bounds, settings, seed, &mut |_| {
            FitControl::Continue
        });
        (optimum, evaluator.evaluations())
    }

    #[test]
    fn table_5_is_300_runs() {
        let (optimum, evaluations) = run(1, 7, &EvolutionSettings::default());
        assert_eq!(evaluations, 300);
        // The cost at the start is 24.2.
        assert!(optimum.cost < 0.1, "{optimum:?}");
        assert_eq!(optimum.ending, FitEnding::Exhausted);
    }

    #[test]
    fn same_seed_same_bits_on_any_number_of_threads() {
        let settings = EvolutionSettings::default();
        let one = run(1, 11, &settings).0;
        for threads in [2, 3, 5] {
            assert_eq!(run(threads, 11, &settings).0, one);
        }
        assert_ne!(run(1, 12, &settings).0.values, one.values);
    }

    #[test]
    fn converges_in_500_generations() {
        let settings = EvolutionSettings {
            generations: 500,
            ..EvolutionSettings::default()
        };
        let (optimum, _) = run(2, 3, &settings);
        assert_eq!(optimum.ending, FitEnding::Converged);
        // A spread of 1e-9 in cost is 1e-3 in the flat direction of the valley.
        assert!((optimum.values[0] - 1.0).abs() < 5e-3, "{optimum:?}");
    }

    #[test]
    fn stops_when_the_caller_says_so() {
        let problem = Valley::new();
        let mut evaluator = Evaluator::new(&problem, 1);
        let mut generations = 0;
        let mut watch = |_| {
            generations += 1;
            if generations == 3 {
                FitControl::Stop
            } else {
                FitControl::Continue
            }
        };
        let optimum = minimise(
            &mut evaluator,
            &[-1.2, 1.0],
            &[[-2.0, 2.0]; 2],
            &EvolutionSettings::default(),
            1,
            &mut watch,
        );
        assert_eq!(
            (optimum.ending, evaluator.evaluations()),
            (FitEnding::Stopped, 36)
        );
    }
}
