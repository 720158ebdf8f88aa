//! Candidates compared: beam search over sets of effects, each refitted jointly with the baseline's own parameters, judged
//! on cycles that no parameter was fitted on.
//!
//! Gains are in log-likelihood of effective samples: neighbouring residuals of the best structure found are correlated
//! over `correlation` samples, and its residuals are `spread` times the white noise. Both guard against overconfidence.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::baseline::{Attached, Setup};
use super::choose::choose;
use super::fit::{grow, settle};
use super::problem::{Data, ModelStructure};
use super::score::{Score, Tangent, spliced};
use crate::effect::Span;
use crate::identify::FitControl;
use crate::identify::confidence::correlation_time;
use crate::identify::evaluator::Evaluator;
use crate::identify::least_squares::{LeastSquaresSettings, minimise};
use crate::profile::ProfileLimits;

/// Sets kept from one size to the next.
const BEAM: usize = 3;
/// Effects at most.
const LARGEST: usize = 3;
/// Candidates grown from each set, by its size.
const FITTED: [usize; LARGEST] = [17, 8, 6];
/// Gain that an effect must bring for itself.
pub(super) const PRICE: f64 = 8.0;
/// Share of all that is explained which an effect must bring.
pub(super) const SHARE: f64 = 5e-4;

/// Candidates that are tried before the form is freed, and how many of them it is freed for.
const HEADS_TRIED: usize = 6;
const HEADS: usize = 3;

/// Codes of a set of effects, sorted.
pub(super) type Key = Vec<&'static str>;

/// A fitted set of effects.
#[derive(Clone)]
pub(super) struct Node {
    pub attached: Vec<Attached>,
    pub values: Vec<f64>,
    /// Weighted residuals of every point.
    pub residuals: Vec<f64>,
    /// Sums of squares on fitted and on selecting cycles.
    pub fit: f64,
    pub select: f64,
}

impl Node {
    /// Codes beyond the baseline, sorted, for comparing.
    pub(super) fn key(&self, extras: usize) -> Key {
        let mut key: Key = self.attached[extras..].iter().map(|a| a.effect.code).collect();
        key.sort_unstable();
        key
    }

    pub(super) fn cost(&self) -> f64 {
        self.fit + self.select
    }
}

/// Setup, data and what they cover: what every step of the search needs.
pub(super) struct FitContext<'a> {
    pub setup: &'a Setup,
    pub data: &'a Data,
    pub span: Span,
    pub threads: usize,
    /// What the bench allows a next test.
    pub limits: Option<ProfileLimits>,
}

/// What one sample is worth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Worth {
    /// Variance of the residuals of the best structure, at least that of the white noise.
    pub spread: f64,
    /// Correlation time in samples.
    pub correlation: f64,
}

impl Worth {
    pub(super) fn of(data: &Data, residuals: &[f64]) -> Worth {
        let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1);
        let spread = residuals.iter().map(|r| r * r).sum::<f64>() / counted as f64;
        Worth {
            spread: spread.max(1.0),
            correlation: correlation_time(residuals, &data.lengths),
        }
    }

    /// Gain in log-likelihood of effective samples for a sum of squares that falls by `lower`.
    pub(super) fn gain(&self, lower: f64) -> f64 {
        0.5 * lower / (self.spread * self.correlation)
    }
}

impl<'a> FitContext<'a> {
    pub(super) fn structure(&self, attached: Vec<Attached>) -> ModelStructure<'a> {
        ModelStructure::new(self.setup, self.data, attached)
    }

    /// Where the baseline begins.
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

    /// The baseline alone, from several starts: nothing is known of where it belongs.
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
            // Between its expansions a surrogate is no guide.
            screened: if self.setup.surrogate.is_some() { 0 } else { 24 },
            starts: 3,
            ..LeastSquaresSettings::default()
        };
        let mut evaluator = Evaluator::new(&structure, self.threads);
        let optimum = minimise(&mut evaluator, &start, &bounds, &settings, 1, &mut |_| {
            FitControl::Continue
        });
        Node::new(&structure, optimum.values)
    }

    /// A node at rest, with its tangent.
    pub(super) fn settled(&self, node: &Node) -> Option<(Node, Tangent)> {
        settle(&self.structure(node.attached.clone()), node.values.clone())
    }

    /// A node with the baseline's own friction in a freer form, where the data ask for one.
    pub(super) fn freed(&self, node: &Node, form: Attached) -> Option<Node> {
        let structure = self.structure(node.attached.clone()).with(&form);
        // Without the baseline's own law to begin with: one that forgets where it turned holds the fit back where it stands.
        let mut without = node.values.clone();
        if let Some(i) = self.setup.model.friction_ratio {
            without[i] = self.setup.model.parameters[i].bounds[0];
        }
        let starts: Vec<Vec<f64>> = (form.effect.starts)(&self.span)
            .into_iter()
            .map(|group| spliced(&without, &group))
            .collect();
        let free = self
            .side_by_side(&starts, |start| settle(&structure, start.clone()))
            .into_iter()
            .flatten()
            .map(|(node, _)| node)
            .min_by(|a, b| a.cost().total_cmp(&b.cost()))?;
        (0.5 * (node.cost() - free.cost()) > PRICE).then_some(free)
    }

    /// The best candidates on a settled baseline of its own law, its form freed afterwards: a form that was freed first has bent
    /// itself to what is missing, and may stand in the way of the effect that it is.
    pub(super) fn heads(&self, plain: &Node, tangent: &Tangent, form: &Attached) -> Vec<Node> {
        let mut children = self.children(plain, tangent, &[], HEADS_TRIED);
        children.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
        children.truncate(HEADS);
        let freed = children.iter().filter_map(|child| {
            let mut node = self.freed(child, form.clone())?;
            // The form first, as everywhere.
            let (own, added) = (self.setup.model.parameters.len(), node.values.len() - 1);
            node.attached.rotate_right(1);
            node.values[own..added].rotate_right(form.parameters.len());
            Some(node)
        });
        freed.collect()
    }

    /// Every candidate's starts scored against a node; best start first, one list a candidate.
    pub(super) fn scores(&self, node: &Node, tangent: &Tangent) -> Vec<Vec<Score>> {
        let structure = self.structure(node.attached.clone());
        let free: Vec<usize> = (0..self.setup.candidates.len())
            .filter(|&c| {
                let code = self.setup.candidates[c].effect.code;
                node.attached.iter().all(|a| a.effect.code != code)
            })
            .collect();
        self.side_by_side(&free, |&c| {
            tangent.scores(&structure, &node.values, c, &self.setup.candidates[c], &self.span)
        })
    }

    /// Children of a settled node: its most promising candidates, grown from their best starts.
    pub(super) fn children(&self, node: &Node, tangent: &Tangent, seen: &[Key], count: usize) -> Vec<Node> {
        let mut lists = self.scores(node, tangent);
        lists.retain(|l| l.first().is_some_and(|s| s.gain > 1.0));
        lists.sort_by(|a, b| b[0].gain.total_cmp(&a[0].gain));
        let extras = self.setup.extras.len();
        let tasks: Vec<Score> = lists
            .into_iter()
            .filter(|l| {
                let mut key = node.key(extras);
                key.push(self.setup.candidates[l[0].candidate].effect.code);
                key.sort_unstable();
                !seen.contains(&key)
            })
            .take(count)
            .flat_map(|l| {
                let best = l[0].gain;
                l.into_iter().filter(move |s| s.gain > 0.4 * best).take(3)
            })
            .collect();
        let structure = self.structure(node.attached.clone());
        let grown = self.side_by_side(&tasks, |score| {
            let candidate = &self.setup.candidates[score.candidate];
            grow(&structure, node, tangent, candidate, &score.start, &self.span)
        });
        // Of several starts of one candidate the best is kept.
        let mut children: Vec<Node> = Vec::new();
        for child in grown.into_iter().flatten() {
            match children.iter_mut().find(|c| c.key(extras) == child.key(extras)) {
                Some(known) if child.fit < known.fit => *known = child,
                Some(_) => {}
                None => children.push(child),
            }
        }
        children
    }

    /// Maps over the cores; order and result do not depend on their number.
    pub(super) fn side_by_side<T: Sync, R: Send>(&self, items: &[T], run: impl Fn(&T) -> R + Sync) -> Vec<R> {
        let next = AtomicUsize::new(0);
        let done: Mutex<Vec<(usize, R)>> = Mutex::new(Vec::with_capacity(items.len()));
        std::thread::scope(|scope| {
            for _ in 0..self.threads.min(items.len()) {
                scope.spawn(|| {
                    loop {
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        let Some(item) = items.get(i) else { break };
                        let result = run(item);
                        done.lock()
                            .expect("no worker panics while it holds the lock")
                            .push((i, result));
                    }
                });
            }
        });
        let mut done = done.into_inner().expect("all workers are done");
        done.sort_by_key(|(i, _)| *i);
        done.into_iter().map(|(_, r)| r).collect()
    }
}

/// All that the search fitted, and what it chose.
pub(super) struct Search {
    /// Baseline first.
    pub nodes: Vec<Node>,
    /// Index of the set chosen.
    pub chosen: usize,
    pub worth: Worth,
}

/// Runs the search. `progress` hears the share of sizes done.
///
/// `heads` are fits of one effect each that were found on another way; the better of two for one effect is kept.
pub(super) fn search(
    bench: &FitContext<'_>,
    baseline: Node,
    heads: &[Node],
    progress: &mut dyn FnMut(f64),
) -> Search {
    let extras = bench.setup.extras.len();
    let mut nodes = vec![baseline];
    let mut seen = vec![nodes[0].key(extras)];
    let mut beam = vec![0];
    for (size, &count) in FITTED.iter().enumerate() {
        let parents: Vec<(Node, Tangent)> = bench
            .side_by_side(&beam, |&i| bench.settled(&nodes[i]))
            .into_iter()
            .flatten()
            .collect();
        for (&i, (node, _)) in beam.iter().zip(&parents) {
            nodes[i] = node.clone();
        }
        let before = beam
            .iter()
            .map(|&i| nodes[i].cost())
            .fold(f64::INFINITY, f64::min);
        let mut grown = Vec::new();
        for (parent, tangent) in &parents {
            for child in bench.children(parent, tangent, &seen, count) {
                seen.push(child.key(extras));
                nodes.push(child);
                grown.push(nodes.len() - 1);
            }
        }
        for head in heads.iter().filter(|_| size == 0) {
            let key = head.key(extras);
            match grown.iter().find(|&&i| nodes[i].key(extras) == key) {
                Some(&known) if head.cost() < nodes[known].cost() => nodes[known] = head.clone(),
                Some(_) => {}
                None => {
                    seen.push(key);
                    nodes.push(head.clone());
                    grown.push(nodes.len() - 1);
                }
            }
        }
        grown.sort_by(|&a, &b| nodes[a].cost().total_cmp(&nodes[b].cost()));
        grown.truncate(BEAM);
        progress((size + 1) as f64 / LARGEST as f64);
        if size == 0
            && let Some(&best) = grown.first()
            && let Some(deeper) = deeper(bench, &nodes[0], &nodes[best])
        {
            return search(bench, deeper, heads, progress);
        }
        let Some(&best) = grown.first() else { break };
        // What would not be accepted is not worth going on for. Raw sums: what is not yet explained makes residuals
        // correlated, and must not end the search for it.
        let (lower, total) = (before - nodes[best].cost(), nodes[0].cost() - nodes[best].cost());
        if 0.5 * lower < PRICE || lower < 0.5 * SHARE * total {
            break;
        }
        beam = grown;
    }
    let best = least(&nodes, |n| n.cost());
    if let Some((settled, _)) = bench.settled(&nodes[best]) {
        nodes[best] = settled;
    }
    let worth = Worth::of(bench.data, &nodes[best].residuals);
    let chosen = choose(bench, &mut nodes, worth);
    Search { nodes, chosen, worth }
}

/// The baseline where a child leaves it when its effect goes: much below where it was, the baseline had further to go.
fn deeper(bench: &FitContext<'_>, root: &Node, child: &Node) -> Option<Node> {
    let extras = bench.setup.extras.len();
    let from = super::tables::offset(bench, &child.attached, extras);
    let mut values = child.values.clone();
    values.drain(from..from + child.attached[extras].parameters.len());
    let (node, _) = settle(&bench.structure(root.attached.clone()), values)?;
    (root.fit - node.fit > PRICE.max(0.01 * root.fit)).then_some(node)
}

/// Index of the node of least cost.
pub(super) fn least(nodes: &[Node], cost: impl Fn(&Node) -> f64) -> usize {
    (0..nodes.len())
        .min_by(|&a, &b| cost(&nodes[a]).total_cmp(&cost(&nodes[b])))
        .expect("the baseline is there")
}
