//! Runs a slow model to make its surrogate: force and slopes along the recordings at some parameters, and the error of its coarse
//! steps.

use nalgebra::{DMatrix, DVector};

use super::baseline::Setup;
use super::context::{FitContext, RunSettings};
use super::data::Data;
use super::node::Node;
use super::surrogate::{Surrogate, belief_width};
use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::model::Parameter;

/// Step of a difference quotient as a share of a parameter's plausible range: far above the tolerance of the model's solver.
const STEP: f64 = 0.01;
/// A parameter is fixed if a move over its plausible range, with the others refitted, changes the force by less than
/// `LEAST_EFFECT` (root of the sum of squares in units of the noise) or by less than `LEAST_OWN_SHARE` of its effect alone.
const LEAST_EFFECT: f64 = 10.0;
const LEAST_OWN_SHARE: f64 = 0.01;
/// RMS error, in units of the noise, at which the surrogate of the baseline is accurate enough, or a share of what the fit leaves.
const BASELINE_ERROR: f64 = 0.1;
const BASELINE_ERROR_SHARE: f64 = 0.05;
/// Largest number of expansions for the baseline.
const BASELINE_ROUNDS: usize = 8;
/// Number of parts of a step in the reference for the discretisation error.
const FINER: u32 = 8;

/// Adds a surrogate to the setup, with expansions where the fit of the baseline ends, until it is accurate there.
pub(super) fn fit_surrogate(setup: &mut Setup, data: &Data, run: &RunSettings) -> Option<()> {
    setup.surrogate = Some(expanded(&run.context(setup, data))?);
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
pub(in crate::diagnose) fn expand(
    setup: &mut Setup,
    data: &Data,
    run: &RunSettings,
    node: &Node,
) -> Option<f64> {
    let mut surrogate = setup.surrogate.take()?;
    let error = expand_at(&run.context(setup, data), &mut surrogate, &node.values);
    setup.surrogate = Some(surrogate);
    error
}

/// A surrogate from one expansion at the start values; `None` if the model has no finite force there.
fn expanded(context: &FitContext<'_>) -> Option<Surrogate> {
    let parameters = context.setup.model.parameters;
    let mut surrogate = Surrogate::new(parameters, &context.data.tracks, context.span.displacement_mm);
    expand_at(context, &mut surrogate, &context.setup.start)?;
    surrogate.fix(|slopes| unidentifiable(context.data, slopes, parameters));
    Some(surrogate)
}

/// Adds an expansion at some values. Returns the RMS error that the surrogate had there, in units of the noise.
fn expand_at(context: &FitContext<'_>, surrogate: &mut Surrogate, values: &[f64]) -> Option<f64> {
    let parameters = context.setup.model.parameters;
    let values = &values[..parameters.len()];
    let mut points = vec![values.to_vec()];
    for (i, p) in parameters.iter().enumerate() {
        if !surrogate.is_fixed(i) {
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
    let free = (0..values.len()).filter(|&i| !surrogate.is_fixed(i));
    for ((i, moved_n), point) in free.zip(paths).zip(&points[1..]) {
        // No slope where the model has no finite force.
        if let Some(moved_n) = moved_n {
            slopes.set_column(i, &((moved_n - &force_n) / (point[i] - values[i])));
        }
    }
    surrogate.add(values, force_n, slopes, &context.data.weight)
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
