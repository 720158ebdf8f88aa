//! Candidates compared: beam search over sets of effects, each refitted jointly with the baseline's own parameters, judged
//! on cycles that no parameter was fitted on.
//!
//! Gains are in log-likelihood of effective samples: neighbouring residuals of the best structure found are correlated
//! over `correlation` samples, and its residuals are `spread` times the white noise. Both guard against overconfidence.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::baseline::{Attached, Setup};
use super::condition::Part;
use super::problem::{Data, Structure};
use super::score::{Score, Tangent, spliced};
use crate::effect::Span;
use crate::identify::confidence::correlation_time;
use crate::identify::evaluator::Evaluator;
use crate::identify::least_squares::{Settings, minimise};
use crate::identify::{Control, Residuals};

/// Sets kept from one size to the next.
const BEAM: usize = 3;
/// Candidates fitted from each set.
const FITTED: usize = 7;
/// Effects at most, the baseline's own friction in another form not counted.
const LARGEST: usize = 3;
/// Gain that an effect must bring for itself; that of the baseline's own physics in another form.
const PRICE: f64 = 8.0;
const OWN_PRICE: f64 = 4.0;
/// Share of all that is explained which an effect must bring.
const SHARE: f64 = 0.015;
/// Share of what is left above the noise without it that an effect must bring: less is the misfit of another's form.
const LEFTOVER: f64 = 0.4;
/// Mean square that an effect must take away, in units of the noise: a seventh of the noise in RMS is no finding.
const MATERIAL: f64 = 0.02;

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
    /// Codes beyond the baseline, own forms in brackets; sorted, for comparing.
    pub fn key(&self, extras: usize) -> Vec<(bool, &'static str)> {
        let mut key: Vec<_> = self.attached[extras..]
            .iter()
            .map(|a| (a.own, a.effect.code))
            .collect();
        key.sort_unstable();
        key
    }

    pub fn cost(&self) -> f64 {
        self.fit + self.select
    }
}

/// Setup, data and what they cover: what every step of the search needs.
pub(super) struct Bench<'a> {
    pub setup: &'a Setup,
    pub data: &'a Data,
    pub span: Span,
    pub threads: usize,
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
    pub fn of(data: &Data, residuals: &[f64]) -> Worth {
        let counted = data.weight.iter().filter(|w| **w > 0.0).count().max(1);
        let spread = residuals.iter().map(|r| r * r).sum::<f64>() / counted as f64;
        Worth {
            spread: spread.max(1.0),
            correlation: correlation_time(residuals, &data.lengths),
        }
    }

    /// Gain in log-likelihood of effective samples for a sum of squares that falls by `lower`.
    pub fn gain(&self, lower: f64) -> f64 {
        0.5 * lower / (self.spread * self.correlation)
    }
}

impl<'a> Bench<'a> {
    /// Fits a structure from `start`.
    pub fn fit(
        &self,
        attached: Vec<Attached>,
        start: &[f64],
        iterations: usize,
        screened: usize,
    ) -> Option<Node> {
        let structure = Structure::new(self.setup, self.data, attached);
        let bounds: Vec<[f64; 2]> = structure.parameters().iter().map(|p| p.bounds).collect();
        let start: Vec<f64> = start
            .iter()
            .zip(&bounds)
            .map(|(v, b)| v.clamp(b[0], b[1]))
            .collect();
        let settings = Settings {
            iterations,
            cost_tolerance: 1e-4,
            step_tolerance: 1e-4,
            screened,
            starts: if screened > 0 { 3 } else { 1 },
            ..Settings::default()
        };
        let mut evaluator = Evaluator::new(&structure, 1);
        let optimum = minimise(&mut evaluator, &start, &bounds, &settings, 1, &mut |_| {
            Control::Continue
        });
        let residuals = structure.residuals(&optimum.values)?;
        Some(Node {
            fit: self.data.sum(&residuals, Part::Fit),
            select: self.data.sum(&residuals, Part::Select),
            residuals,
            values: optimum.values,
            attached: structure.attached,
        })
    }

    /// Where the baseline begins.
    pub fn start(&self) -> Vec<f64> {
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

    /// The baseline alone, from several starts.
    pub fn baseline(&self) -> Option<Node> {
        self.fit(self.setup.extras.clone(), &self.start(), 40, 24)
    }

    /// Every candidate's starts scored against a node; best start first, one list a candidate.
    pub fn scores(&self, node: &Node) -> Vec<Vec<Score>> {
        let structure = Structure::new(self.setup, self.data, node.attached.clone());
        let Some(tangent) = Tangent::new(&structure, &node.values, &node.residuals) else {
            return Vec::new();
        };
        let free: Vec<usize> = (0..self.setup.candidates.len())
            .filter(|&c| {
                let candidate = &self.setup.candidates[c];
                !node
                    .attached
                    .iter()
                    .any(|a| a.effect.code == candidate.effect.code && a.own == candidate.own)
            })
            .collect();
        self.side_by_side(&free, |&c| {
            let candidate = &self.setup.candidates[c];
            tangent.scores(
                &structure,
                &node.values,
                &node.residuals,
                c,
                candidate,
                &self.span,
            )
        })
    }

    /// Children of a node: its most promising candidates, fitted.
    pub fn children(&self, node: &Node, seen: &[Vec<(bool, &'static str)>], count: usize) -> Vec<Node> {
        let mut lists = self.scores(node);
        lists.retain(|l| l.first().is_some_and(|s| s.gain > 1.0));
        lists.sort_by(|a, b| b[0].gain.total_cmp(&a[0].gain));
        let extras = self.setup.extras.len();
        let tasks: Vec<Vec<Score>> = lists
            .into_iter()
            .filter(|l| {
                let candidate = &self.setup.candidates[l[0].candidate];
                let mut key = node.key(extras);
                key.push((candidate.own, candidate.effect.code));
                key.sort_unstable();
                !seen.contains(&key)
            })
            .take(count)
            .collect();
        self.side_by_side(&tasks, |list| self.child(node, list))
            .into_iter()
            .flatten()
            .collect()
    }

    /// The better of the fits from a candidate's two best starts.
    fn child(&self, node: &Node, starts: &[Score]) -> Option<Node> {
        let candidate = &self.setup.candidates[starts[0].candidate];
        let mut attached = node.attached.clone();
        attached.push(candidate.clone());
        starts
            .iter()
            .take(2)
            .filter(|s| s.gain > 0.5 * starts[0].gain)
            .filter_map(|s| self.fit(attached.clone(), &spliced(&node.values, &s.start), 8, 0))
            .min_by(|a, b| a.fit.total_cmp(&b.fit))
    }

    /// Maps over the cores; order and result do not depend on their number.
    pub fn side_by_side<T: Sync, R: Send>(&self, items: &[T], run: impl Fn(&T) -> R + Sync) -> Vec<R> {
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
pub(super) fn search(bench: &Bench<'_>, baseline: Node, progress: &mut dyn FnMut(f64)) -> Search {
    let extras = bench.setup.extras.len();
    let mut nodes = vec![baseline];
    let mut seen = vec![nodes[0].key(extras)];
    let mut beam = vec![0];
    for size in 0..=LARGEST {
        let before = beam
            .iter()
            .map(|&i| nodes[i].cost())
            .fold(f64::INFINITY, f64::min);
        let mut grown = Vec::new();
        for &i in &beam {
            let parent = nodes[i].clone();
            let count = if size == 0 { FITTED } else { FITTED - 3 };
            for child in bench.children(&parent, &seen, count) {
                seen.push(child.key(extras));
                nodes.push(child);
                grown.push(nodes.len() - 1);
            }
        }
        grown.sort_by(|&a, &b| nodes[a].cost().total_cmp(&nodes[b].cost()));
        grown.truncate(BEAM);
        progress((size + 1) as f64 / (LARGEST + 1) as f64);
        let Some(&best) = grown.first() else { break };
        // What would not be accepted is not worth going on for. Raw sums: what is not yet explained makes residuals
        // correlated, and must not end the search for it.
        let (lower, total) = (before - nodes[best].cost(), nodes[0].cost() - nodes[best].cost());
        let counted = (bench.data.count(Part::Fit) + bench.data.count(Part::Select)) as f64;
        let leftover = 0.5 * LEFTOVER * (before - counted).max(0.0);
        if 0.5 * lower < OWN_PRICE || lower < leftover.max(0.5 * SHARE * total) {
            break;
        }
        beam = grown;
    }
    let best = least(&nodes, |n| n.cost());
    let worth = Worth::of(bench.data, &nodes[best].residuals);
    let chosen = choose(bench, &mut nodes, worth);
    Search { nodes, chosen, worth }
}

fn least(nodes: &[Node], cost: impl Fn(&Node) -> f64) -> usize {
    (0..nodes.len())
        .min_by(|&a, &b| cost(&nodes[a]).total_cmp(&cost(&nodes[b])))
        .expect("the baseline is there")
}

/// The set with the largest gain less its price, then whatever can be spared leaves it.
fn choose(bench: &Bench<'_>, nodes: &mut Vec<Node>, worth: Worth) -> usize {
    let extras = bench.setup.extras.len();
    let price = |node: &Node| -> f64 {
        node.attached[extras..]
            .iter()
            .map(|a| if a.own { OWN_PRICE } else { PRICE })
            .sum()
    };
    let counted = (bench.data.count(Part::Fit) + bench.data.count(Part::Select)) as f64;
    let mut chosen = least(nodes, |n| worth.gain(n.cost()) + price(n));
    loop {
        let total = worth.gain(nodes[0].cost() - nodes[chosen].cost());
        let mut spared: Option<(f64, usize)> = None;
        for leave in extras..nodes[chosen].attached.len() {
            let own = nodes[chosen].attached[leave].own;
            let code = nodes[chosen].attached[leave].effect.code;
            let mut i = without(bench, nodes, chosen, leave);
            // Two effects that cancel each other each look needed: a smaller set without this one may do as well.
            for (k, node) in nodes.iter().enumerate() {
                let lacks = node.attached[extras..].iter().all(|a| a.effect.code != code);
                let smaller = node.attached.len() < nodes[chosen].attached.len();
                if !own && lacks && smaller && node.cost() < nodes[i].cost() {
                    i = k;
                }
            }
            let loss = worth.gain(nodes[i].cost() - nodes[chosen].cost());
            let material = worth.gain(MATERIAL * worth.spread * counted);
            let leftover = worth.gain(LEFTOVER * (nodes[i].cost() - counted).max(0.0));
            let needed = if own {
                OWN_PRICE
            } else {
                PRICE.max(SHARE * total).max(material).max(leftover)
            };
            let held_out = worth.gain(nodes[i].select - nodes[chosen].select);
            let excess = loss - needed;
            if (excess < 0.0 || held_out < 0.25 * needed.min(PRICE))
                && spared.is_none_or(|(least, _)| excess < least)
            {
                spared = Some((excess, i));
            }
        }
        match spared {
            Some((_, i)) => chosen = i,
            None => return chosen,
        }
    }
}

/// Index of the node that lacks one effect of another; fitted if it is not there yet.
pub(super) fn without(bench: &Bench<'_>, nodes: &mut Vec<Node>, of: usize, leave: usize) -> usize {
    let extras = bench.setup.extras.len();
    let mut attached = nodes[of].attached.clone();
    let own = bench.setup.model.parameters.len();
    let from = own
        + attached[..leave]
            .iter()
            .map(|a| a.parameters.len())
            .sum::<usize>();
    let mut values = nodes[of].values.clone();
    values.drain(from..from + attached[leave].parameters.len());
    attached.remove(leave);
    let key = {
        let mut key: Vec<_> = attached[extras..]
            .iter()
            .map(|a| (a.own, a.effect.code))
            .collect();
        key.sort_unstable();
        key
    };
    if let Some(i) = (0..nodes.len())
        .filter(|&i| nodes[i].key(extras) == key)
        .min_by(|&a, &b| nodes[a].fit.total_cmp(&nodes[b].fit))
    {
        return i;
    }
    match bench.fit(attached, &values, 15, 0) {
        Some(node) => {
            nodes.push(node);
            nodes.len() - 1
        }
        None => 0,
    }
}
