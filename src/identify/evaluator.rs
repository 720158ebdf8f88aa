//! Evaluates a problem at many points at once, on several cores. The results do not depend on the number of cores.

use rayon::iter::{IndexedParallelIterator, IntoParallelRefMutIterator, ParallelIterator};
use rayon::slice::{ParallelSlice, ParallelSliceMut};

use super::objective::Residuals;

/// A problem, the cores that evaluate it, and the number of evaluations so far.
pub(crate) struct Evaluator<'a> {
    problem: &'a dyn Residuals,
    threads: usize,
    /// One buffer per thread, for the residuals of points of which only the cost is wanted.
    buffers: Vec<Vec<f64>>,
    evaluations: usize,
}

impl<'a> Evaluator<'a> {
    /// `threads` is the largest number of cores to use; 0 for all.
    pub(crate) fn new(problem: &'a dyn Residuals, threads: usize) -> Self {
        let threads = match threads {
            0 => rayon::current_num_threads(),
            n => n,
        };
        Evaluator {
            problem,
            threads,
            buffers: vec![vec![0.0; problem.count()]; threads],
            evaluations: 0,
        }
    }

    pub(crate) fn problem(&self) -> &'a dyn Residuals {
        self.problem
    }

    /// Number of evaluations so far.
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
        let chunk = chunk(points.len(), self.threads);
        let problem = self.problem;
        points
            .par_chunks(chunk)
            .zip(costs.par_chunks_mut(chunk))
            .zip(self.buffers.par_iter_mut())
            .for_each(|((points, costs), buffer)| {
                for (values, cost) in points.iter().zip(costs) {
                    *cost = cost_at(problem, values, buffer);
                }
            });
        costs
    }

    /// Residuals at each point, in order, into consecutive columns of `out` (`count` long each); costs as in [`Self::costs`].
    pub(crate) fn columns(&mut self, points: &[Vec<f64>], out: &mut [f64]) -> Vec<f64> {
        self.evaluations += points.len();
        let mut costs = vec![f64::INFINITY; points.len()];
        let count = self.problem.count().max(1);
        let chunk = chunk(points.len(), self.threads);
        let problem = self.problem;
        points
            .par_chunks(chunk)
            .zip(costs.par_chunks_mut(chunk))
            .zip(out.par_chunks_mut(chunk * count))
            .for_each(|((points, costs), columns)| {
                for ((values, cost), column) in points.iter().zip(costs).zip(columns.chunks_mut(count)) {
                    *cost = cost_at(problem, values, column);
                }
            });
        costs
    }
}

/// Applies `map` to every item on at most `threads` cores (0 for all); results in the order of the items.
pub(crate) fn parallel_map<T: Sync, R: Send>(
    items: &[T],
    threads: usize,
    map: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let threads = match threads {
        0 => rayon::current_num_threads(),
        n => n,
    };
    items
        .par_chunks(chunk(items.len(), threads))
        .flat_map_iter(|items| items.iter().map(&map))
        .collect()
}

/// Length of chunks of `count` items, so that there is at most one chunk per thread.
fn chunk(count: usize, threads: usize) -> usize {
    count.div_ceil(threads).max(1)
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn a_parallel_map_keeps_the_order_and_the_number_of_threads() {
        let items: Vec<usize> = (0..20).collect();
        for threads in [0, 1, 2, 7, 50] {
            let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
            let squares = parallel_map(&items, threads, |i| {
                most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                std::thread::yield_now();
                running.fetch_sub(1, Ordering::SeqCst);
                i * i
            });
            assert_eq!(squares, items.iter().map(|i| i * i).collect::<Vec<_>>());
            assert!(threads == 0 || most.into_inner() <= threads);
        }
    }
}
