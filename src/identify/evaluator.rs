//! Evaluates a problem at many points at once, over the cores, with results that do not depend on how many there are.

use super::objective::Residuals;

/// Points for one thread, and the places of their costs.
type Share<'a> = (&'a [Vec<f64>], &'a mut [f64]);

/// Where the work is done, and how often it was.
pub(crate) struct Evaluator<'a> {
    problem: &'a dyn Residuals,
    threads: usize,
    /// One buffer a thread: residuals of a point whose cost alone is asked for.
    buffers: Vec<Vec<f64>>,
    evaluations: usize,
}

impl<'a> Evaluator<'a> {
    /// `threads`: 0 takes as many as there are cores.
    pub(crate) fn new(problem: &'a dyn Residuals, threads: usize) -> Self {
        let threads = match threads {
            0 => std::thread::available_parallelism().map_or(1, |n| n.get()),
            n => n,
        };
        Evaluator {
            problem,
            threads,
            buffers: vec![vec![0.0; problem.count()]; threads],
            evaluations: 0,
        }
    }

    /// The problem.
    pub(crate) fn problem(&self) -> &'a dyn Residuals {
        self.problem
    }

    /// Evaluations so far.
    pub(crate) fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Residuals at one point into `out`; the cost, infinite where the model refuses the values or a residual is not finite.
    pub(crate) fn residuals(&mut self, values: &[f64], out: &mut [f64]) -> f64 {
        self.evaluations += 1;
        cost_at(self.problem, values, out)
    }

    /// Cost at one point.
    pub(crate) fn cost(&mut self, values: &[f64]) -> f64 {
        self.evaluations += 1;
        cost_at(self.problem, values, &mut self.buffers[0])
    }

    /// Cost at each point, in order.
    pub(crate) fn costs(&mut self, points: &[Vec<f64>]) -> Vec<f64> {
        self.evaluations += points.len();
        let mut costs = vec![f64::INFINITY; points.len()];
        let share = points.len().div_ceil(self.threads).max(1);
        let problem = self.problem;
        let work = points
            .chunks(share)
            .zip(costs.chunks_mut(share))
            .zip(&mut self.buffers);
        let run = |((points, costs), buffer): (Share<'_>, &mut Vec<f64>)| {
            for (values, cost) in points.iter().zip(costs) {
                *cost = cost_at(problem, values, buffer);
            }
        };
        side_by_side(work, run);
        costs
    }

    /// Residuals at each point, in order, into consecutive columns of `out` (`count` long each); costs as in [`Self::costs`].
    pub(crate) fn columns(&mut self, points: &[Vec<f64>], out: &mut [f64]) -> Vec<f64> {
        self.evaluations += points.len();
        let mut costs = vec![f64::INFINITY; points.len()];
        let count = self.problem.count().max(1);
        let share = points.len().div_ceil(self.threads).max(1);
        let problem = self.problem;
        let work = points
            .chunks(share)
            .zip(costs.chunks_mut(share))
            .zip(out.chunks_mut(share * count));
        let run = |((points, costs), columns): (Share<'_>, &mut [f64])| {
            for ((values, cost), column) in points.iter().zip(costs).zip(columns.chunks_mut(count)) {
                *cost = cost_at(problem, values, column);
            }
        };
        side_by_side(work, run);
        costs
    }
}

/// Runs every item: the first here, the others each on a thread of its own.
fn side_by_side<T: Send>(items: impl Iterator<Item = T>, run: impl Fn(T) + Sync) {
    std::thread::scope(|scope| {
        let mut items = items;
        let first = items.next();
        let run = &run;
        for item in items {
            scope.spawn(move || run(item));
        }
        if let Some(item) = first {
            run(item);
        }
    });
}

fn cost_at(problem: &dyn Residuals, values: &[f64], out: &mut [f64]) -> f64 {
    match problem.evaluate(values, out) {
        Ok(()) => {
            let cost = problem.cost(out);
            if cost.is_finite() { cost } else { f64::INFINITY }
        }
        Err(_) => f64::INFINITY,
    }
}
