//! A slow model made cheap: what it answers along the recordings, how that changes with its parameters, and an operator for
//! what it would answer beside them. A leaf pack takes a tenth of a second for all recordings, a search asks thousands of times.
//!
//! ```text
//! F(x, p) = sum w_e (F_e + S_e (p - p_e)) + H(x) - H(recorded x),      w_e as 1 / |p - p_e|^2, of sum 1
//! ```
//! At every point of the recordings `F_e` and `S_e` are the model's own force and slopes with the parameters of expansion e;
//! between expansions they are blended (Shepard 1968), so each is met exactly, slopes too. Where effects leave the displacement
//! as recorded, `H` cancels and only the parameters' curvature is left out; that shrinks with every expansion. `H` answers for
//! effects that shift it: a polynomial and elastic-plastic elements (Prandtl and Ishlinskii), their strengths quadratic in
//! the displacement, fitted to `F_e`. What is reported in the end is checked on the model itself.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::Means;
use super::baseline::Setup;
use super::choose::{choose, without};
use super::condition::{Split, Track};
use super::fit::polish;
use super::problem::Data;
use super::score::Tangent;
use super::select::{FitContext, Key, Node, Search, Worth};
use super::traced::{Operator, Scale, TERMS, Traced};
use crate::model::{Parameter, Plant};

/// Step of a slope as a share of what is believed of a parameter: far above what the model's solver leaves open.
const STEP: f64 = 0.01;
/// A parameter is held where a move over all that is believed changes the force by less than this after the others have
/// followed, in units of the noise (root of the sum of squares), or by less than this share of what it does alone.
const UNSEEN: f64 = 10.0;
const IMITATED: f64 = 0.01;

/// The model at some parameters.
#[derive(Clone)]
struct Expansion {
    values: Vec<f64>,
    force_n: DVector<f64>,
    /// One column a parameter, N for each of its units; zero where it is held.
    slopes: DMatrix<f64>,
    /// What each term of `H` counts for.
    strengths: DVector<f64>,
}

/// A slow model along the recordings.
#[derive(Clone)]
pub(super) struct Surrogate {
    expansions: Vec<Expansion>,
    /// Parameters that the recordings do not tell from the others, with the reason; they stay as they are.
    held: Vec<Option<&'static str>>,
    parameters: &'static [Parameter],
    /// Terms of `H` at every point as recorded, one column a point.
    terms: Arc<DMatrix<f64>>,
    /// Displacement as recorded, mm.
    recorded_mm: Arc<Vec<f64>>,
    scale: Scale,
}

impl Surrogate {
    /// From one expansion, at the values that the baseline begins with; `None` where the model cannot follow.
    pub(super) fn new(bench: &FitContext<'_>) -> Option<Surrogate> {
        let parameters = bench.setup.model.parameters;
        let scale = Scale::of(bench.span.displacement_mm);
        let mut operator = Operator::new(scale);
        let tracks = &bench.data.tracks;
        let recorded_mm: Vec<f64> = tracks.iter().flat_map(|t| t.displacement_mm.clone()).collect();
        let mut terms = Vec::with_capacity(bench.data.len() * TERMS);
        for track in tracks {
            operator.reset();
            for &x in &track.displacement_mm {
                operator.move_to(x);
                terms.extend(operator.terms());
            }
        }
        let mut surrogate = Surrogate {
            expansions: Vec::new(),
            held: vec![None; parameters.len()],
            parameters,
            terms: Arc::new(DMatrix::from_vec(TERMS, bench.data.len(), terms)),
            recorded_mm: Arc::new(recorded_mm),
            scale,
        };
        let start = &bench.setup.start;
        surrogate.expand(bench, start)?;
        let first = &mut surrogate.expansions[0];
        surrogate.held = unseen(bench.data, &first.slopes, parameters);
        for (p, _) in surrogate.held.iter().enumerate().filter(|(_, h)| h.is_some()) {
            first.slopes.column_mut(p).fill(0.0);
        }
        Some(surrogate)
    }

    /// Takes the model's answer at some values in. How far off the surrogate was there: root mean square, in units of the noise.
    pub(super) fn expand(&mut self, bench: &FitContext<'_>, values: &[f64]) -> Option<f64> {
        let values = &values[..self.parameters.len()];
        let mut points = vec![values.to_vec()];
        for (i, p) in self.parameters.iter().enumerate() {
            if self.held[i].is_none() {
                let step = STEP * believed(p);
                let mut moved = values.to_vec();
                moved[i] += if moved[i] + step <= p.bounds[1] {
                    step
                } else {
                    -step
                };
                points.push(moved);
            }
        }
        let mut paths = paths(bench, &points, 1).into_iter();
        let force_n = paths.next()??;
        let mut slopes = DMatrix::zeros(force_n.len(), values.len());
        let free = (0..values.len()).filter(|&i| self.held[i].is_none());
        for ((i, moved_n), point) in free.zip(paths).zip(&points[1..]) {
            // Where the model cannot go, it says nothing of the way there.
            if let Some(moved_n) = moved_n {
                slopes.set_column(i, &((moved_n - &force_n) / (point[i] - values[i])));
            }
        }
        let weight = &bench.data.weight;
        let off = if self.expansions.is_empty() {
            f64::INFINITY
        } else {
            let (said_n, _) = self.blend(values);
            let squares = (0..weight.len()).map(|i| ((said_n[i] - force_n[i]) * weight[i]).powi(2));
            let counted = weight.iter().filter(|w| **w > 0.0).count().max(1);
            (squares.sum::<f64>() / counted as f64).sqrt()
        };
        let mut normal = &*self.terms * self.terms.transpose();
        for i in 0..TERMS {
            normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-6) + 1e-9;
        }
        let strengths = normal.cholesky()?.solve(&(&*self.terms * &force_n));
        self.expansions.push(Expansion {
            values: values.to_vec(),
            force_n,
            slopes,
            strengths,
        });
        Some(off)
    }

    /// Force at every point as recorded, and strengths of `H`, at some values.
    fn blend(&self, values: &[f64]) -> (DVector<f64>, DVector<f64>) {
        let moves: Vec<DVector<f64>> = self
            .expansions
            .iter()
            .map(|e| DVector::from_iterator(values.len(), values.iter().zip(&e.values).map(|(v, o)| v - o)))
            .collect();
        let near: Vec<f64> = moves
            .iter()
            .map(|m| {
                let free = (0..m.len()).filter(|&i| self.held[i].is_none());
                let square = free
                    .map(|i| (m[i] / believed(&self.parameters[i])).powi(2))
                    .sum::<f64>();
                1.0 / (square + 1e-12)
            })
            .collect();
        let all: f64 = near.iter().sum();
        let mut force_n = DVector::zeros(self.terms.ncols());
        let mut strengths = DVector::zeros(TERMS);
        for ((e, m), near) in self.expansions.iter().zip(&moves).zip(near) {
            let share = near / all;
            if share < 1e-9 {
                continue;
            }
            force_n.axpy(share, &e.force_n, 1.0);
            force_n.gemv(share, &e.slopes, m, 1.0);
            strengths.axpy(share, &e.strengths, 1.0);
        }
        (force_n, strengths)
    }

    /// Steps along the recordings, in their order, told of every point.
    pub(super) fn plant(&self, values: &[f64]) -> Box<dyn Plant> {
        let (force_n, strengths) = self.blend(values);
        Box::new(Traced::new(
            (Arc::new(force_n), Arc::new(strengths)),
            (Arc::clone(&self.recorded_mm), Arc::clone(&self.terms)),
            self.scale,
        ))
    }

    /// What is held, and why.
    pub(super) fn remarks(&self) -> Vec<String> {
        let values = &self.expansions[0].values;
        self.parameters
            .iter()
            .zip(&self.held)
            .zip(values)
            .filter_map(|((p, why), value)| {
                why.map(|why| format!("{} is not identified and held at {value}: {why}", p.name))
            })
            .collect()
    }

    /// True for a parameter of the model that is held.
    pub(super) fn holds(&self, parameter: usize) -> bool {
        self.held.get(parameter).is_some_and(Option::is_some)
    }
}

/// Root mean square that a surrogate may be off where a fit of the baseline has gone, in units of the noise and as a share of
/// what that fit leaves; and where a search has gone: what it chose is refitted on the model anyway.
const CLOSE: f64 = 0.1;
const CLOSE_SHARE: f64 = 0.05;
const NEAR: f64 = 0.5;
/// Most expansions for the baseline, and most searches.
const BASELINE_ROUNDS: usize = 8;
const SEARCHES: usize = 2;
/// Most choices that are confirmed.
const CHOICES: usize = 4;
/// Rivals of a finding that are confirmed.
const RIVALS: usize = 4;
/// Parts of a step that show what the step leaves out.
const FINER: u32 = 8;

/// Puts a surrogate in the model's place and expands it where the fit of the baseline goes, until it says there what the model does.
pub(super) fn install(setup: &mut Setup, data: &Data, means: &Means) -> Option<()> {
    setup.surrogate = Some(Surrogate::new(&means.bench(setup, data))?);
    for _ in 0..BASELINE_ROUNDS {
        let there = means.bench(setup, data).baseline()?;
        let counted = data.count(Split::Fit).max(1) as f64;
        let off = expand(setup, data, means, &there)?;
        if off < CLOSE.max(CLOSE_SHARE * (there.fit / counted).sqrt()) {
            break;
        }
    }
    Some(())
}

/// Takes in what the model says where a fit has gone; how far off the surrogate was.
fn expand(setup: &mut Setup, data: &Data, means: &Means, there: &Node) -> Option<f64> {
    let mut surrogate = setup.surrogate.take()?;
    let off = surrogate.expand(&means.bench(setup, data), &there.values);
    setup.surrogate = Some(surrogate);
    off
}

/// Searches again where the surrogate was too far off at what was chosen, then chooses on the model itself. The baseline, as it
/// is and as searched from, is refitted on the model too.
pub(super) fn confirm(
    setup: &mut Setup,
    data: &Data,
    means: &Means,
    (plain, base): (&mut Node, &Node),
    mut search: Search,
) -> Search {
    for round in 1..=SEARCHES {
        let there = search.nodes[search.chosen].clone();
        let off = expand(setup, data, means, &there);
        if round == SEARCHES || off.is_none_or(|off| off < NEAR) {
            break;
        }
        let bench = means.bench(setup, data);
        let settled = bench.settled(base).map_or_else(|| base.clone(), |(node, _)| node);
        search = super::select::search(&bench, settled, &[], &mut |_| {});
    }
    let bench = means.bench(setup, data);
    refit(&bench, std::slice::from_mut(plain), &[0]);
    choose_on_model(&bench, &mut search);
    search
}

/// Refits the chosen set and all that is less by some of its effects on the model itself, and chooses again.
fn choose_on_model(bench: &FitContext<'_>, search: &mut Search) {
    let extras = bench.setup.extras.len();
    let mut done: Vec<usize> = Vec::new();
    for _ in 0..CHOICES {
        let mut open = vec![search.chosen];
        let mut fresh: Vec<usize> = Vec::new();
        while let Some(i) = open.pop() {
            if done.contains(&i) || fresh.contains(&i) {
                continue;
            }
            fresh.push(i);
            for leave in extras..search.nodes[i].attached.len() {
                open.push(without(bench, &mut search.nodes, i, leave));
            }
        }
        refit(bench, &mut search.nodes, &fresh);
        done.extend(fresh);
        search.worth = Worth::of(bench.data, &search.nodes[search.chosen].residuals);
        search.chosen = choose(bench, &mut search.nodes, search.worth);
        if done.contains(&search.chosen) {
            break;
        }
    }
}

/// Refits the best few of the sets that have one effect more than `base`, but for the chosen one.
pub(super) fn refit_rivals(bench: &FitContext<'_>, search: &mut Search, base: &Key) {
    if bench.setup.surrogate.is_none() {
        return;
    }
    let extras = bench.setup.extras.len();
    let mut rivals: Vec<usize> = (0..search.nodes.len())
        .filter(|&i| {
            let key = search.nodes[i].key(extras);
            i != search.chosen && key.len() == base.len() + 1 && base.iter().all(|c| key.contains(c))
        })
        .collect();
    rivals.sort_by(|&a, &b| search.nodes[a].cost().total_cmp(&search.nodes[b].cost()));
    rivals.truncate(RIVALS);
    refit(bench, &mut search.nodes, &rivals);
}

/// Refits some nodes on the model itself, with the surrogate's slopes.
fn refit(bench: &FitContext<'_>, nodes: &mut [Node], which: &[usize]) {
    let fitted = bench.side_by_side(which, |&i| {
        let node = &nodes[i];
        let tangent = Tangent::new(&bench.structure(node.attached.clone()), &node.values)?;
        polish(
            &bench.structure(node.attached.clone()).exact(),
            &tangent,
            node.values.clone(),
        )
    });
    for (&i, fitted) in which.iter().zip(fitted) {
        if let Some(node) = fitted {
            nodes[i] = node;
        }
    }
}

/// Width of what a person would believe of a parameter.
fn believed(p: &Parameter) -> f64 {
    p.belief[1] - p.belief[0]
}

/// The model's own force along all recordings, at each of some points, every step taken in `parts`.
fn paths(bench: &FitContext<'_>, points: &[Vec<f64>], parts: u32) -> Vec<Option<DVector<f64>>> {
    let tracks = &bench.data.tracks;
    let tasks: Vec<(&Vec<f64>, &Track)> = points
        .iter()
        .flat_map(|p| tracks.iter().map(move |t| (p, t)))
        .collect();
    let pieces = bench.side_by_side(&tasks, |(values, track)| {
        let mut plant = bench.setup.model.plant(values, &bench.setup.structure).ok()?;
        let mut from_mm = 0.0;
        let path: Vec<f64> = (0..track.len())
            .map(|i| {
                let by_mm = (track.displacement_mm[i] - from_mm) / f64::from(parts);
                let mut force_n = 0.0;
                for k in 1..=parts {
                    force_n = plant.step(from_mm + f64::from(k) * by_mm, track.dt_s(i) / f64::from(parts));
                }
                from_mm = track.displacement_mm[i];
                force_n
            })
            .collect();
        path.iter().all(|f| f.is_finite()).then_some(path)
    });
    pieces
        .chunks(tracks.len())
        .map(|of_tracks| {
            let whole: Option<Vec<&Vec<f64>>> = of_tracks.iter().map(Option::as_ref).collect();
            whole.map(|paths| DVector::from_iterator(bench.data.len(), paths.into_iter().flatten().copied()))
        })
        .collect()
}

/// How far the model's force is off at each point though its parameters were right, N: its steps are no finer than the
/// recordings, and where it turned is no better known than the displacement's noise lets it.
pub(super) fn coarseness_n(bench: &FitContext<'_>, values: &[f64]) -> Option<Vec<f64>> {
    let points = [values[..bench.setup.model.parameters.len()].to_vec()];
    let coarse_n = paths(bench, &points, 1).pop()??;
    let fine_n = paths(bench, &points, FINER).pop()??;
    let mut off_n = Vec::with_capacity(fine_n.len());
    for track in &bench.data.tracks {
        let from = off_n.len();
        for i in 0..track.len() {
            // The neighbours' as well: a difference that changes its sign is no better there.
            let near = i.saturating_sub(1)..(i + 2).min(track.len());
            let step_n = near
                .clone()
                .map(|k| (fine_n[from + k] - coarse_n[from + k]).abs());
            let steepest = near.clone().skip(1).map(|k| {
                let dx = track.displacement_mm[k] - track.displacement_mm[k - 1];
                let df = fine_n[from + k] - fine_n[from + k - 1];
                df.abs() / dx.abs().max(track.noise_mm).max(1e-9)
            });
            let place_n = steepest.fold(0.0, f64::max) * track.noise_mm;
            off_n.push(step_n.fold(0.0, f64::max).hypot(place_n));
        }
    }
    Some(off_n)
}

/// Parameters that a fit to these points could not tell from the others (greedy: the most telling one first).
fn unseen(data: &Data, slopes: &DMatrix<f64>, parameters: &[Parameter]) -> Vec<Option<&'static str>> {
    let mut left = slopes.clone();
    for (mut column, p) in left.column_iter_mut().zip(parameters) {
        for (i, value) in column.iter_mut().enumerate() {
            let fitted = data.part[i] == Split::Fit;
            *value *= if fitted { data.weight[i] * believed(p) } else { 0.0 };
        }
    }
    let alone: Vec<f64> = left.column_iter().map(|c| c.norm()).collect();
    let mut verdict: Vec<Option<&'static str>> = alone
        .iter()
        .map(|&n| {
            Some(if n < UNSEEN {
                "these recordings say nothing of it"
            } else {
                "these recordings do not tell it from the model's other parameters"
            })
        })
        .collect();
    loop {
        let telling = (0..parameters.len())
            .filter(|&i| verdict[i].is_some())
            .map(|i| (i, left.column(i).norm()))
            .filter(|&(i, norm)| norm > UNSEEN.max(IMITATED * alone[i]))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((next, norm)) = telling else {
            return verdict;
        };
        verdict[next] = None;
        let along = left.column(next) / norm;
        for mut column in left.column_iter_mut() {
            let share = column.dot(&along);
            column.axpy(-share, &along, 1.0);
        }
    }
}
