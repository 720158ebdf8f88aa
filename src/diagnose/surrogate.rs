//! Replaces a slow model during the search: its force along the recordings, how that changes with its parameters, and an operator
//! for displacements beside the recorded ones. A leaf pack takes 0.1 s for all recordings, and a search runs it thousands of times.
//!
//! ```text
//! F(x, p) = sum w_e (F_e + S_e (p - p_e)) + H(x) - H(recorded x),      w_e as 1 / |p - p_e|^2, of sum 1
//! ```
//! At every point of the recordings `F_e` and `S_e` are the model's own force and slopes with the parameters of expansion e. Between
//! expansions they are blended (Shepard 1968), so force and slopes are exact at each. Where effects leave the displacement as
//! recorded, `H` cancels and only the curvature in the parameters is neglected; each expansion makes that error smaller. `H` is for
//! effects that shift the displacement: a polynomial and elastic-plastic elements (Prandtl and Ishlinskii), with strengths
//! quadratic in the displacement, fitted to `F_e`. The final result is fitted and compared on the model itself.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::backward_elimination::{choose, without};
use super::baseline::Setup;
use super::condition::Track;
use super::context::{FitContext, Key, LikelihoodScale, Node, RunSettings};
use super::data::Data;
use super::fit::refine;
use super::score::Tangent;
use super::search::SearchResult;
use super::splits::Split;
use super::surrogate_plant::{HysteresisOperator, Scale, SurrogatePlant, TERMS};
use crate::model::{Parameter, Plant};

/// Step of a difference quotient as a share of a parameter's plausible range: far above the tolerance of the model's solver.
const STEP: f64 = 0.01;
/// A parameter is fixed if a move over its plausible range, with the others refitted, changes the force by less than
/// `LEAST_EFFECT` (root of the sum of squares in units of the noise) or by less than `LEAST_OWN_SHARE` of its effect alone.
const LEAST_EFFECT: f64 = 10.0;
const LEAST_OWN_SHARE: f64 = 0.01;
/// An expansion with a smaller share of the blend is left out.
const LEAST_BLEND: f64 = 1e-9;
/// RMS error, in units of the noise, at which the surrogate of the baseline is accurate enough, or a share of what the fit leaves.
const BASELINE_ERROR: f64 = 0.1;
const BASELINE_ERROR_SHARE: f64 = 0.05;
/// The same for the chosen set: larger, because that is refitted on the model itself.
const CHOSEN_ERROR: f64 = 0.5;
/// Largest number of expansions for the baseline, and of searches.
const BASELINE_ROUNDS: usize = 8;
const SEARCHES: usize = 2;
/// Largest number of choices that are confirmed on the model itself, and of rivals per finding.
const CHOICES: usize = 4;
const RIVALS: usize = 4;
/// Number of parts of a step in the reference for the discretisation error.
const FINER: u32 = 8;

/// Forces and slopes of the model at some parameters.
#[derive(Clone)]
struct Expansion {
    values: Vec<f64>,
    force_n: DVector<f64>,
    /// One column per parameter, N per unit; zero where it is fixed.
    slopes: DMatrix<f64>,
    /// Coefficients of the terms of `H`.
    strengths: DVector<f64>,
}

/// The surrogate of a slow model.
#[derive(Clone)]
pub(super) struct Surrogate {
    expansions: Vec<Expansion>,
    /// For each parameter why it is not identifiable and fixed; `None` where it is fitted.
    fixed: Vec<Option<&'static str>>,
    parameters: &'static [Parameter],
    /// Terms of `H`, one column per recorded point.
    terms: Arc<DMatrix<f64>>,
    /// Recorded displacement, mm.
    recorded_mm: Arc<Vec<f64>>,
    scale: Scale,
}

impl Surrogate {
    /// From one expansion at the start values; `None` if the model has no finite force there.
    pub(super) fn new(context: &FitContext<'_>) -> Option<Surrogate> {
        let parameters = context.setup.model.parameters;
        let scale = Scale::of(context.span.displacement_mm);
        let mut operator = HysteresisOperator::new(scale);
        let tracks = &context.data.tracks;
        let recorded_mm: Vec<f64> = tracks.iter().flat_map(|t| t.displacement_mm.clone()).collect();
        let mut terms = Vec::with_capacity(context.data.len() * TERMS);
        for track in tracks {
            operator.reset();
            for &x in &track.displacement_mm {
                operator.move_to(x);
                terms.extend(operator.terms());
            }
        }
        let mut surrogate = Surrogate {
            expansions: Vec::new(),
            fixed: vec![None; parameters.len()],
            parameters,
            terms: Arc::new(DMatrix::from_vec(TERMS, context.data.len(), terms)),
            recorded_mm: Arc::new(recorded_mm),
            scale,
        };
        let start = &context.setup.start;
        surrogate.expand(context, start)?;
        let first = &mut surrogate.expansions[0];
        surrogate.fixed = unidentifiable(context.data, &first.slopes, parameters);
        for (p, _) in surrogate.fixed.iter().enumerate().filter(|(_, h)| h.is_some()) {
            first.slopes.column_mut(p).fill(0.0);
        }
        Some(surrogate)
    }

    /// Adds an expansion at some values. Returns the RMS error that the surrogate had there, in units of the noise.
    fn expand(&mut self, context: &FitContext<'_>, values: &[f64]) -> Option<f64> {
        let values = &values[..self.parameters.len()];
        let mut points = vec![values.to_vec()];
        for (i, p) in self.parameters.iter().enumerate() {
            if self.fixed[i].is_none() {
                let step = STEP * belief_width(p);
                let mut moved = values.to_vec();
                moved[i] += if moved[i] + step <= p.bounds[1] {
                    step
                } else {
                    -step
                };
                points.push(moved);
            }
        }
        let mut paths = paths(context, &points, 1).into_iter();
        let force_n = paths.next()??;
        let mut slopes = DMatrix::zeros(force_n.len(), values.len());
        let free = (0..values.len()).filter(|&i| self.fixed[i].is_none());
        for ((i, moved_n), point) in free.zip(paths).zip(&points[1..]) {
            // No slope where the model has no finite force.
            if let Some(moved_n) = moved_n {
                slopes.set_column(i, &((moved_n - &force_n) / (point[i] - values[i])));
            }
        }
        let weight = &context.data.weight;
        let error = if self.expansions.is_empty() {
            f64::INFINITY
        } else {
            let (blended_n, _) = self.blend(values);
            let squares = (0..weight.len()).map(|i| ((blended_n[i] - force_n[i]) * weight[i]).powi(2));
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
        Some(error)
    }

    /// Force at every recorded point, and strengths of `H`, for some values.
    fn blend(&self, values: &[f64]) -> (DVector<f64>, DVector<f64>) {
        let moves: Vec<DVector<f64>> = self
            .expansions
            .iter()
            .map(|e| DVector::from_iterator(values.len(), values.iter().zip(&e.values).map(|(v, o)| v - o)))
            .collect();
        let near: Vec<f64> = moves
            .iter()
            .map(|m| {
                let free = (0..m.len()).filter(|&i| self.fixed[i].is_none());
                let square = free
                    .map(|i| (m[i] / belief_width(&self.parameters[i])).powi(2))
                    .sum::<f64>();
                1.0 / (square + 1e-12)
            })
            .collect();
        let all: f64 = near.iter().sum();
        let mut force_n = DVector::zeros(self.terms.ncols());
        let mut strengths = DVector::zeros(TERMS);
        for ((e, m), near) in self.expansions.iter().zip(&moves).zip(near) {
            let share = near / all;
            if share < LEAST_BLEND {
                continue;
            }
            force_n.axpy(share, &e.force_n, 1.0);
            force_n.gemv(share, &e.slopes, m, 1.0);
            strengths.axpy(share, &e.strengths, 1.0);
        }
        (force_n, strengths)
    }

    /// A plant that is stepped along the recordings in their order, with `told` called before every step.
    pub(super) fn plant(&self, values: &[f64]) -> Box<dyn Plant> {
        let (force_n, strengths) = self.blend(values);
        Box::new(SurrogatePlant::new(
            (Arc::new(force_n), Arc::new(strengths)),
            (Arc::clone(&self.recorded_mm), Arc::clone(&self.terms)),
            self.scale,
        ))
    }

    /// Which parameters are fixed, and why.
    pub(super) fn remarks(&self) -> Vec<String> {
        let values = &self.expansions[0].values;
        self.parameters
            .iter()
            .zip(&self.fixed)
            .zip(values)
            .filter_map(|((p, why), value)| {
                why.map(|why| format!("{} is not identifiable and held at {value}: {why}", p.name))
            })
            .collect()
    }

    /// True for a parameter of the model that is fixed.
    pub(super) fn is_fixed(&self, parameter: usize) -> bool {
        self.fixed.get(parameter).is_some_and(Option::is_some)
    }
}

/// Adds a surrogate to the setup, with expansions where the fit of the baseline ends, until it is accurate there.
pub(super) fn fit_surrogate(setup: &mut Setup, data: &Data, run: &RunSettings) -> Option<()> {
    setup.surrogate = Some(Surrogate::new(&run.context(setup, data))?);
    for _ in 0..BASELINE_ROUNDS {
        let fitted = run.context(setup, data).baseline()?;
        let counted = data.count(Split::Fit).max(1) as f64;
        let error = expand(setup, data, run, &fitted)?;
        if error < BASELINE_ERROR.max(BASELINE_ERROR_SHARE * (fitted.fit / counted).sqrt()) {
            break;
        }
    }
    Some(())
}

/// Adds an expansion at the values of a node; returns the error that the surrogate had there.
fn expand(setup: &mut Setup, data: &Data, run: &RunSettings, node: &Node) -> Option<f64> {
    let mut surrogate = setup.surrogate.take()?;
    let error = surrogate.expand(&run.context(setup, data), &node.values);
    setup.surrogate = Some(surrogate);
    error
}

/// Repeats the search if the surrogate was not accurate at the chosen set, then chooses on the model itself. The baseline with its
/// own friction law (`refitted`) is refitted on the model too; `base` is the start of the search.
pub(super) fn confirm(
    setup: &mut Setup,
    data: &Data,
    run: &RunSettings,
    (refitted, base): (&mut Node, &Node),
    mut search: SearchResult,
) -> SearchResult {
    for round in 1..=SEARCHES {
        let chosen = search.nodes[search.chosen].clone();
        let error = expand(setup, data, run, &chosen);
        if round == SEARCHES || error.is_none_or(|error| error < CHOSEN_ERROR) {
            break;
        }
        let context = run.context(setup, data);
        let converged = context
            .converged(base)
            .map_or_else(|| base.clone(), |(node, _)| node);
        search = super::search::search(&context, converged, &[], &mut |_, _| {});
    }
    let context = run.context(setup, data);
    refit(&context, std::slice::from_mut(refitted), &[0]);
    choose_on_model(&context, &mut search);
    search
}

/// Refits the chosen set and all its subsets on the model itself, and chooses again.
fn choose_on_model(context: &FitContext<'_>, search: &mut SearchResult) {
    let extras = context.setup.extras.len();
    let mut done: Vec<usize> = Vec::new();
    for _ in 0..CHOICES {
        let mut open = vec![search.chosen];
        let mut fresh: Vec<usize> = Vec::new();
        while let Some(i) = open.pop() {
            if done.contains(&i) || fresh.contains(&i) {
                continue;
            }
            fresh.push(i);
            for place in extras..search.nodes[i].attached.len() {
                open.push(without(context, &mut search.nodes, i, place));
            }
        }
        refit(context, &mut search.nodes, &fresh);
        done.extend(fresh);
        search.likelihood = LikelihoodScale::of(context.data, &search.nodes[search.chosen].residuals);
        search.chosen = choose(context, &mut search.nodes, search.likelihood);
        if done.contains(&search.chosen) {
            break;
        }
    }
}

/// Refits the best sets with one effect more than `base` on the model itself, except the chosen one.
pub(super) fn refit_rivals(context: &FitContext<'_>, search: &mut SearchResult, base: &Key) {
    if context.setup.surrogate.is_none() {
        return;
    }
    let extras = context.setup.extras.len();
    let mut rivals: Vec<usize> = (0..search.nodes.len())
        .filter(|&i| {
            let key = search.nodes[i].key(extras);
            i != search.chosen && key.len() == base.len() + 1 && base.iter().all(|c| key.contains(c))
        })
        .collect();
    rivals.sort_by(|&a, &b| search.nodes[a].cost().total_cmp(&search.nodes[b].cost()));
    rivals.truncate(RIVALS);
    refit(context, &mut search.nodes, &rivals);
}

/// Refits some nodes on the model itself, with the slopes of the surrogate.
fn refit(context: &FitContext<'_>, nodes: &mut [Node], which: &[usize]) {
    let fitted = context.parallel_map(which, |&i| {
        let node = &nodes[i];
        let tangent = Tangent::new(&context.structure(node.attached.clone()), &node.values)?;
        refine(
            &context.structure(node.attached.clone()).exact(),
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

/// Width of the plausible range of a parameter.
fn belief_width(p: &Parameter) -> f64 {
    p.belief[1] - p.belief[0]
}

/// Force of the model itself along all recordings, for each set of values in `points`, with every step divided into `parts`.
fn paths(context: &FitContext<'_>, points: &[Vec<f64>], parts: u32) -> Vec<Option<DVector<f64>>> {
    let tracks = &context.data.tracks;
    let tasks: Vec<(&Vec<f64>, &Track)> = points
        .iter()
        .flat_map(|p| tracks.iter().map(move |t| (p, t)))
        .collect();
    let paths = context.parallel_map(&tasks, |(values, track)| {
        let mut plant = context.setup.model.plant(values, &context.setup.structure).ok()?;
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
    paths
        .chunks(tracks.len())
        .map(|of_tracks| {
            let whole: Option<Vec<&Vec<f64>>> = of_tracks.iter().map(Option::as_ref).collect();
            whole.map(|path| DVector::from_iterator(context.data.len(), path.into_iter().flatten().copied()))
        })
        .collect()
}

/// Error of the model's force at each point with exact parameters, N: its steps are as coarse as the recordings, and the reversals
/// have the noise of the displacement.
pub(super) fn discretisation_error_n(context: &FitContext<'_>, values: &[f64]) -> Option<Vec<f64>> {
    let points = [values[..context.setup.model.parameters.len()].to_vec()];
    let coarse_n = paths(context, &points, 1).pop()??;
    let fine_n = paths(context, &points, FINER).pop()??;
    let mut off_n = Vec::with_capacity(fine_n.len());
    for track in &context.data.tracks {
        let from = off_n.len();
        for i in 0..track.len() {
            // The largest of the neighbours too: an error that changes its sign is not smaller there.
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

/// For each parameter why it is not identifiable from the fitted points. Greedy: the parameter with the largest own effect is taken
/// first and projected out of the others.
fn unidentifiable(data: &Data, slopes: &DMatrix<f64>, parameters: &[Parameter]) -> Vec<Option<&'static str>> {
    let mut left = slopes.clone();
    for (mut column, p) in left.column_iter_mut().zip(parameters) {
        for (i, value) in column.iter_mut().enumerate() {
            let fitted = data.split[i] == Split::Fit;
            *value *= if fitted {
                data.weight[i] * belief_width(p)
            } else {
                0.0
            };
        }
    }
    let alone: Vec<f64> = left.column_iter().map(|c| c.norm()).collect();
    let mut reasons: Vec<Option<&'static str>> = alone
        .iter()
        .map(|&n| {
            Some(if n < LEAST_EFFECT {
                "these recordings do not excite it"
            } else {
                "in these recordings other parameters of the model have the same effect"
            })
        })
        .collect();
    loop {
        let largest = (0..parameters.len())
            .filter(|&i| reasons[i].is_some())
            .map(|i| (i, left.column(i).norm()))
            .filter(|&(i, norm)| norm > LEAST_EFFECT.max(LEAST_OWN_SHARE * alone[i]))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((next, norm)) = largest else {
            return reasons;
        };
        reasons[next] = None;
        let along = left.column(next) / norm;
        for mut column in left.column_iter_mut() {
            let share = column.dot(&along);
            column.axpy(-share, &along, 1.0);
        }
    }
}
