//! What every step of the search needs: setup, data, threads, and the fits of single sets of effects.
//!
//! Gains are in log-likelihood of effective samples, see `likelihood`.

use std::sync::OnceLock;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::baseline::{Attached, Setup};
use super::data::Data;
use super::fit::{Parent, ScreenedChild, converge, fit_child, screen_child};
use super::node::{Key, Node};
use super::score::{CandidateScore, Tangent};
use super::structure::ModelStructure;
use crate::diagnose::conditioning::Track;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::options::DiagnoseOptions;
use crate::effect::Span;
use crate::identify::FitControl;
use crate::identify::evaluator::Evaluator;
use crate::identify::least_squares::{LeastSquaresSettings, minimise};
use crate::profile::ProfileLimits;

/// Predicted gain below which a candidate is not fitted: far below what an effect must bring (`likelihood::PENALTY`).
const LEAST_PREDICTED_GAIN: f64 = 1.0;
/// A candidate is fitted from its best start and from up to 2 others that are predicted to bring at least 0.4 of its gain.
const STARTS: usize = 3;
const START_SHARE: f64 = 0.4;

/// What stays the same from the first fit of the baseline to the verdict.
pub(in crate::diagnose) struct RunSettings {
    span: Span,
    pool: ThreadPool,
    limits: Option<ProfileLimits>,
}

impl RunSettings {
    pub(super) fn new(data: &Data, options: &DiagnoseOptions) -> Result<RunSettings, DiagnoseError> {
        let pool = ThreadPoolBuilder::new().num_threads(options.threads).build();
        Ok(RunSettings {
            span: span(data),
            pool: pool.map_err(|e| DiagnoseError::Threads(e.to_string()))?,
            limits: options.limits,
        })
    }

    pub(in crate::diagnose) fn context<'a>(&'a self, setup: &'a Setup, data: &'a Data) -> FitContext<'a> {
        FitContext {
            setup,
            data,
            span: self.span,
            limits: self.limits,
            pool: &self.pool,
            coarse: OnceLock::new(),
        }
    }
}

/// Ranges of displacement, force, speed, time and cycles in the data.
fn span(data: &Data) -> Span {
    let fold = |f: fn(&Track) -> &Vec<f64>| {
        let values = data.tracks.iter().flat_map(|t| f(t).iter().copied());
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| {
            [l.min(v), h.max(v)]
        })
    };
    let most = |f: &dyn Fn(&Track) -> f64, least: f64| data.tracks.iter().map(f).fold(least, f64::max);
    Span {
        displacement_mm: fold(|t| &t.displacement_mm),
        force_n: fold(|t| &t.force_n),
        speed_mm_s: most(&Track::top_speed_mm_s, 0.0),
        duration_s: most(&|t| t.time_s[t.len() - 1], 0.0),
        cycles: most(&|t| f64::from(t.cycles), 1.0),
    }
}

/// Setup and data with what they cover and the threads to fit on.
pub(in crate::diagnose) struct FitContext<'a> {
    pub setup: &'a Setup,
    pub data: &'a Data,
    pub span: Span,
    /// Limits of the bench for the next test.
    pub limits: Option<ProfileLimits>,
    pool: &'a ThreadPool,
    /// Fewer points of the data, made when they are first asked for.
    coarse: OnceLock<Option<Data>>,
}

impl<'a> FitContext<'a> {
    /// True if the model may deviate by terms that bend the spring's curve. They follow what further knees would.
    pub(in crate::diagnose) fn curve_is_in_doubt(&self) -> bool {
        let discrepancy = self.data.discrepancy.as_ref();
        discrepancy.is_some_and(|terms| terms.bends_the_curve())
    }

    /// The same data with another setup.
    pub(in crate::diagnose) fn with_setup<'b>(&'b self, setup: &'b Setup) -> FitContext<'b> {
        FitContext {
            setup,
            coarse: OnceLock::new(),
            ..*self
        }
    }

    pub(in crate::diagnose) fn structure(&self, attached: Vec<Attached>) -> ModelStructure<'a> {
        ModelStructure::new(self.setup, self.data, attached)
    }

    /// Fewer points of the data, on which sets are screened; `None` where there are few, or the model runs along all of them.
    pub(super) fn coarse(&self) -> Option<&Data> {
        let coarse = || self.setup.surrogate.is_none().then(|| self.data.coarse())?;
        self.coarse.get_or_init(coarse).as_ref()
    }

    pub(in crate::diagnose) fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Index of the first value of the effect at `place`.
    pub(in crate::diagnose) fn offset(&self, attached: &[Attached], place: usize) -> usize {
        self.setup.model.parameters.len()
            + attached[..place]
                .iter()
                .map(|a| a.parameters.len())
                .sum::<usize>()
    }

    /// Values of the effect at `place` of a set.
    pub(in crate::diagnose) fn effect_values<'n>(&self, node: &'n Node, place: usize) -> &'n [f64] {
        let from = self.offset(&node.attached, place);
        &node.values[from..from + node.attached[place].parameters.len()]
    }

    /// Values that the fit of the baseline starts from.
    pub(super) fn start(&self) -> Vec<f64> {
        let mut start = self.setup.start.clone();
        for extra in &self.setup.extras {
            start.extend(
                extra
                    .parameters
                    .iter()
                    .map(|p| p.start.clamp(p.bounds[0], p.bounds[1])),
            );
        }
        start.push(0.0);
        start
    }

    /// Residuals of the baseline before the fit.
    pub(in crate::diagnose) fn nominal(&self) -> Option<Vec<f64>> {
        self.structure(self.setup.extras.clone()).residuals(&self.start())
    }

    /// Fits the baseline from several starts, because its parameters may be far off.
    pub(super) fn baseline(&self) -> Option<Node> {
        let structure = self.structure(self.setup.extras.clone());
        let bounds = structure.parameters_bounds();
        let start: Vec<f64> = self
            .start()
            .iter()
            .zip(&bounds)
            .map(|(v, b)| v.clamp(b[0], b[1]))
            .collect();
        let settings = LeastSquaresSettings {
            iterations: 25,
            cost_tolerance: 1e-3,
            step_tolerance: 1e-4,
            // A surrogate is not valid far from its expansions: then only the given start is used.
            screened: if self.setup.surrogate.is_some() { 0 } else { 24 },
            starts: 3,
            ..LeastSquaresSettings::default()
        };
        let mut evaluator = Evaluator::new(&structure, self.threads());
        let optimum = minimise(&mut evaluator, &start, &bounds, &settings, 1, &mut |_| {
            FitControl::Continue
        });
        Node::new(&structure, optimum.values)
    }

    /// A node with effects of another context's set added, at the values that they have there.
    pub(in crate::diagnose) fn with_effects_of(
        &self,
        root: &Node,
        (other, set): (&FitContext<'_>, &Node),
        places: &[usize],
    ) -> Option<Node> {
        let (mut attached, mut values) = (root.attached.clone(), root.values.clone());
        let zero_n = values.pop()?;
        for &place in places {
            let from = other.offset(&set.attached, place);
            values.extend(&set.values[from..from + set.attached[place].parameters.len()]);
            attached.push(set.attached[place].clone());
        }
        values.push(zero_n);
        Node::new(&self.structure(attached), values)
    }

    /// A node fitted to convergence, with its tangent.
    pub(in crate::diagnose) fn converged(&self, node: &Node) -> Option<(Node, Tangent)> {
        self.converge(node.attached.clone(), node.values.clone())
    }

    /// A set of effects fitted to convergence from these values, on all threads, with its tangent.
    pub(in crate::diagnose) fn converge(
        &self,
        attached: Vec<Attached>,
        values: Vec<f64>,
    ) -> Option<(Node, Tangent)> {
        self.pool.install(|| converge(&self.structure(attached), values))
    }

    /// A converged node, to which effects will be added.
    fn parent<'s>(&'s self, node: &'s Node, tangent: &'s Tangent) -> Parent<'s> {
        let coarse = self.coarse().and_then(|data| {
            let structure = ModelStructure::new(self.setup, data, node.attached.clone());
            let tangent = Tangent::new(&structure, &node.values)?;
            Some((structure, tangent))
        });
        Parent {
            node,
            structure: self.structure(node.attached.clone()),
            tangent,
            coarse,
        }
    }

    /// Scores of every candidate that a node lacks; one list per candidate, its best start first.
    pub(in crate::diagnose) fn scores(&self, node: &Node, tangent: &Tangent) -> Vec<Vec<CandidateScore>> {
        self.scores_on(&self.structure(node.attached.clone()), node, tangent)
    }

    fn scores_on(
        &self,
        structure: &ModelStructure<'_>,
        node: &Node,
        tangent: &Tangent,
    ) -> Vec<Vec<CandidateScore>> {
        let lacking: Vec<usize> = (0..self.setup.candidates.len())
            .filter(|&c| {
                let code = self.setup.candidates[c].effect.code;
                node.attached.iter().all(|a| a.effect.code != code)
            })
            .collect();
        self.parallel_map(&lacking, |&c| {
            tangent.scores(structure, &node.values, c, &self.setup.candidates[c], &self.span)
        })
    }

    /// Fits up to `count` children of converged nodes: those with the smallest predicted sums of squares whose set is not in `seen`.
    pub(in crate::diagnose) fn children(
        &self,
        parents: &[(Node, Tangent)],
        seen: &[Key],
        count: usize,
    ) -> Vec<Node> {
        let every: Vec<usize> = (0..parents.len()).collect();
        let parents = self.parallel_map(&every, |&i| self.parent(&parents[i].0, &parents[i].1));
        let tasks = self.tasks(&parents, seen, count);
        let candidate = |starts: &[CandidateScore]| &self.setup.candidates[starts[0].candidate];
        let every_start = tasks.iter().enumerate();
        let every_start: Vec<(usize, &CandidateScore)> = every_start
            .flat_map(|(task, (_, starts))| starts.iter().map(move |start| (task, start)))
            .collect();
        let screened = self.parallel_map(&every_start, |&(task, start)| {
            let (parent, starts) = &tasks[task];
            screen_child(&parents[*parent], candidate(starts), start, &self.span)
        });
        // Of several starts of one set the best fit goes on to all points.
        let mut best: Vec<Option<ScreenedChild>> = tasks.iter().map(|_| None).collect();
        for ((task, _), child) in every_start.into_iter().zip(screened) {
            best[task] = better(best[task].take(), child);
        }
        let every_task: Vec<usize> = (0..tasks.len()).collect();
        let fitted = self.parallel_map(&every_task, |&task| {
            let ((parent, starts), child) = (&tasks[task], best[task].as_ref()?);
            fit_child(&parents[*parent], candidate(starts), child, &self.span)
        });
        fitted.into_iter().flatten().collect()
    }

    /// A converged node with a further effect, fitted from each of its starts: the best fit.
    pub(in crate::diagnose) fn child(
        &self,
        (node, tangent): &(Node, Tangent),
        candidate: &Attached,
    ) -> Option<Node> {
        let parent = self.parent(node, tangent);
        let (structure, tangent) = parent.screen();
        let starts = tangent.scores(structure, &node.values, 0, candidate, &self.span);
        let screened = self.parallel_map(&starts, |start| {
            screen_child(&parent, candidate, start, &self.span)
        });
        let best = screened.into_iter().fold(None, better)?;
        fit_child(&parent, candidate, &best, &self.span)
    }

    /// The starts of the `count` most promising children of all parents, each with the index of its parent. A set that several
    /// parents lead to is taken once.
    fn tasks(&self, parents: &[Parent<'_>], seen: &[Key], count: usize) -> Vec<(usize, Vec<CandidateScore>)> {
        let extras = self.setup.extras.len();
        let mut promising = Vec::new();
        for (i, parent) in parents.iter().enumerate() {
            let node = parent.node;
            let (structure, tangent) = parent.screen();
            for scores in self.scores_on(structure, node, tangent) {
                let Some(best) = scores.first().filter(|s| s.gain > LEAST_PREDICTED_GAIN) else {
                    continue;
                };
                let mut key = node.key(extras);
                key.push(self.setup.candidates[best.candidate].effect.code);
                key.sort_unstable();
                promising.push((node.cost() - 2.0 * best.gain, i, key, scores));
            }
        }
        promising.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut taken: Vec<Key> = seen.to_vec();
        let mut tasks = Vec::new();
        for (_, parent, key, scores) in promising {
            if taken.len() - seen.len() >= count {
                break;
            }
            if taken.contains(&key) {
                continue;
            }
            taken.push(key);
            let least = START_SHARE * scores[0].gain;
            let starts = scores.into_iter().filter(|s| s.gain > least).take(STARTS);
            tasks.push((parent, starts.collect()));
        }
        tasks
    }

    /// Maps over the worker threads. Order and result do not depend on their number.
    pub(in crate::diagnose) fn parallel_map<T: Sync, R: Send>(
        &self,
        items: &[T],
        run: impl Fn(&T) -> R + Sync,
    ) -> Vec<R> {
        self.pool.install(|| items.par_iter().map(&run).collect())
    }
}

/// The better of two screened fits of one set.
fn better(known: Option<ScreenedChild>, other: Option<ScreenedChild>) -> Option<ScreenedChild> {
    match (known, other) {
        (Some(known), Some(other)) => Some(if other.cost < known.cost { other } else { known }),
        (known, other) => known.or(other),
    }
}
