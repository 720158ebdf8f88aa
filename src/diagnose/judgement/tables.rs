//! The tables of a diagnosis: errors on fitted and held-out cycles, candidates, parameters, curves and maps to plot.

use super::location::BINS;
use crate::diagnose::conditioning::Track;
use crate::diagnose::course::Split;
use crate::diagnose::diagnosis::*;
use crate::diagnose::fitting::{Data, FitContext, Node};
use crate::diagnose::search::{AXES, SearchResult, binned};
use crate::identify::confidence::Confidence;

/// Largest number of points of a curve in the report.
const CURVE_POINTS: usize = 600;
/// An effect cannot be tested if the baseline's parameters imitate all but this share of its signature.
pub(in crate::diagnose) const TESTABLE: f64 = 0.05;

/// Errors of baseline and improved model, and of the steps between them. `refitted` is the baseline with its own friction law,
/// `nominal` its residuals before the fit, `improved` the errors of the model that is written.
pub(super) fn errors(
    context: &FitContext<'_>,
    search: &SearchResult,
    refitted: &Node,
    improved: Errors,
    nominal: Option<Vec<f64>>,
) -> FitErrors {
    let extras = context.setup.extras.len();
    let data = context.data;
    let after = &search.nodes[search.chosen];
    let mut ladder = Vec::new();
    if let Some(residuals) = nominal {
        ladder.push(Rung {
            what: "nominal".to_owned(),
            errors: errors_of(data, &residuals),
        });
    }
    ladder.push(Rung {
        what: "baseline refitted".to_owned(),
        errors: errors_of_model(context, refitted),
    });
    if refitted.attached.len() < extras {
        ladder.push(Rung {
            what: "with a general friction law".to_owned(),
            errors: errors_of_model(context, &search.nodes[0]),
        });
    }
    for k in extras..after.attached.len() {
        let mut key: Vec<_> = after.attached[extras..=k].iter().map(|a| a.effect.code).collect();
        key.sort_unstable();
        let step = search
            .nodes
            .iter()
            .filter(|n| n.key(extras) == key)
            .min_by(|a, b| a.fit.total_cmp(&b.fit));
        if let Some(node) = step {
            ladder.push(Rung {
                what: format!("with {}", after.attached[k].effect.code),
                errors: errors_of_model(context, node),
            });
        }
    }
    let floor: Vec<f64> = data
        .weight
        .iter()
        .filter(|w| **w > 0.0)
        .map(|w| 1.0 / (w * w))
        .collect();
    FitErrors {
        baseline: errors_of_model(context, refitted),
        improved,
        noise_floor_nrmse: (floor.iter().sum::<f64>() / floor.len().max(1) as f64).sqrt()
            / data.force_range_n,
        ladder,
    }
}

/// Errors of what is written of a node. The small zero of each recording is not in a file, so it is not in these errors either.
pub(super) fn errors_of_model(context: &FitContext<'_>, node: &Node) -> Errors {
    let data = context.data;
    let mut model_n = vec![0.0; data.len()];
    let structure = context.structure(node.attached.clone()).exact();
    if structure.predict(&node.values, &mut model_n).is_err() {
        return errors_of(data, &node.residuals);
    }
    let compared = data.force_n.iter().zip(&model_n).zip(&data.weight);
    let residuals: Vec<f64> = compared.map(|((f, m), w)| (f - m) * w).collect();
    errors_of(data, &residuals)
}

/// Errors of a model with these weighted residuals.
pub(super) fn errors_of(data: &Data, residuals: &[f64]) -> Errors {
    let rms = |splits: &[Split]| {
        let squares: Vec<f64> = (0..data.len())
            .filter(|&i| data.weight[i] > 0.0 && splits.contains(&data.split[i]))
            .map(|i| (residuals[i] / data.weight[i]).powi(2))
            .collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt() / data.force_range_n
    };
    let (mut peak, mut energy, mut loops) = (0.0f64, 0.0, 0.0);
    let mut from = 0;
    for track in &data.tracks {
        let n = track.len();
        let model = |i: usize| {
            if data.weight[from + i] > 0.0 {
                data.force_n[from + i] - residuals[from + i] / data.weight[from + i]
            } else {
                data.force_n[from + i]
            }
        };
        let top = |f: &dyn Fn(usize) -> f64| (0..n).map(f).fold(f64::NEG_INFINITY, f64::max);
        let measured = top(&|i| data.force_n[from + i]);
        peak = peak.max(((top(&model) - measured) / measured.abs().max(1e-9)).abs());
        for i in 1..n {
            let dx = track.displacement_mm[i] - track.displacement_mm[i - 1];
            energy += 0.5 * (model(i) + model(i - 1)) * dx;
            loops += 0.5 * (data.force_n[from + i] + data.force_n[from + i - 1]) * dx;
        }
        from += n;
    }
    Errors {
        nrmse_train: rms(&[Split::Fit]),
        nrmse_heldout: rms(&[Split::Report]),
        peak_force_error: peak,
        loop_energy_error: if loops.abs() > 1e-9 {
            (energy - loops) / loops
        } else {
            0.0
        },
    }
}

/// Parameters of the model, and of the effects that belong to the baseline.
pub(super) fn baseline_parameters(
    context: &FitContext<'_>,
    node: &Node,
    confidence: &Confidence,
) -> Vec<Value> {
    let mut list = values_of(context.setup.model.parameters, 0, node, confidence);
    for (k, attached) in node.attached.iter().enumerate().filter(|(_, a)| a.own) {
        let from = context.offset(&node.attached, k);
        list.extend(values_of(&attached.parameters, from, node, confidence));
        // The general friction law adds to the model's own friction ratio. Only the sum can be compared with a measurement.
        let amplitudes = attached.effect.amplitudes.iter();
        let added: f64 = amplitudes.map(|&i| node.values[from + i]).sum();
        if let Some(i) = context.setup.model.friction_ratio {
            let sum = Value {
                name: format!("{}_in_all", list[i].name),
                value: list[i].value + added,
                unit: list[i].unit.clone(),
                ci95: None,
            };
            list.insert(i + 1, sum);
        }
    }
    list
}

/// The fitted sets with their gains, best first.
pub(super) fn candidates(context: &FitContext<'_>, search: &SearchResult) -> Vec<CandidateRow> {
    let extras = context.setup.extras.len();
    let base = &search.nodes[0];
    let mut rows: Vec<CandidateRow> = search
        .nodes
        .iter()
        .enumerate()
        .skip(1)
        .map(|(i, n)| CandidateRow {
            codes: n.attached[extras..]
                .iter()
                .map(|a| a.effect.code.to_owned())
                .collect(),
            gain: search.likelihood.gain(base.cost() - n.cost()),
            gain_heldout: search.likelihood.gain(base.select - n.select),
            chosen: i == search.chosen,
        })
        .collect();
    rows.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    rows
}

/// Candidates that these recordings cannot show.
pub(super) fn not_testable(context: &FitContext<'_>, baseline: &Node) -> Vec<NotTestable> {
    let lists = context
        .converged(baseline)
        .map_or_else(Vec::new, |(node, tangent)| context.scores(&node, &tangent));
    let mut rows = Vec::new();
    for (c, candidate) in context.setup.candidates.iter().enumerate() {
        let surviving = lists
            .iter()
            .flatten()
            .filter(|s| s.candidate == c)
            .map(|s| s.surviving)
            .fold(0.0, f64::max);
        if surviving < TESTABLE {
            rows.push(NotTestable {
                code: candidate.effect.code.to_owned(),
                surviving,
                why: "the recordings do not excite it, or the baseline's own parameters imitate it"
                    .to_owned(),
            });
        }
    }
    rows
}

/// Curves of all tracks for the report, from the weighted residuals of the baseline (`before`) and of the improved model (`after`).
pub(super) fn curves(data: &Data, [before, after]: [&[f64]; 2]) -> Vec<Curve> {
    let mut from = 0;
    data.tracks
        .iter()
        .map(|track| {
            let n = track.len();
            let model = |residuals: &[f64], i: usize| {
                let w = data.weight[from + i];
                if w > 0.0 {
                    data.force_n[from + i] - residuals[from + i] / w
                } else {
                    f64::NAN
                }
            };
            let every = n.div_ceil(CURVE_POINTS).max(1);
            let pick: Vec<usize> = (0..n)
                .filter(|&i| i % every == 0 && data.weight[from + i] > 0.0)
                .collect();
            let error = |residuals: &[f64]| {
                let squares: Vec<f64> = (0..n)
                    .filter(|&i| data.weight[from + i] > 0.0)
                    .map(|i| (residuals[from + i] / data.weight[from + i]).powi(2))
                    .collect();
                (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt() / data.force_range_n
            };
            let curve = Curve {
                name: track.name.clone(),
                time_s: pick.iter().map(|&i| track.time_s[i]).collect(),
                displacement_mm: pick.iter().map(|&i| track.displacement_mm[i]).collect(),
                measured_n: pick.iter().map(|&i| track.force_n[i]).collect(),
                baseline_n: pick.iter().map(|&i| model(before, i)).collect(),
                improved_n: pick.iter().map(|&i| model(after, i)).collect(),
                breaks: breaks(track, &data.weight[from..from + n], &pick),
                remarks: track.remarks.clone(),
                nrmse_baseline: error(before),
                nrmse_improved: error(after),
            };
            from += n;
            curve
        })
        .collect()
}

/// A step in time that is so many times longer than the longer one of its neighbours is a gap.
const GAP_STEPS: f64 = 5.0;

/// Indices into `pick` of the points before which a point is masked or the recording has a gap.
fn breaks(track: &Track, weight: &[f64], pick: &[usize]) -> Vec<usize> {
    let step_s = |i: usize| track.dt_s(i);
    let is_gap = |i: usize| {
        let before = if i > 1 { step_s(i - 1) } else { 0.0 };
        let after = if i + 1 < track.len() { step_s(i + 1) } else { 0.0 };
        let usual_s = before.max(after).max(track.width_s[i]).max(track.width_s[i - 1]);
        step_s(i) > GAP_STEPS * usual_s
    };
    let broken = |from: usize, to: usize| (from + 1..=to).any(|i| weight[i] == 0.0 || is_gap(i));
    let pairs = pick.windows(2).enumerate();
    pairs
        .filter(|(_, pair)| broken(pair[0], pair[1]))
        .map(|(i, _)| i + 1)
        .collect()
}

/// Values of a group of parameters, the first at index `from` of the node, with their intervals.
pub(super) fn values_of(
    parameters: &[crate::model::Parameter],
    from: usize,
    node: &Node,
    confidence: &Confidence,
) -> Vec<Value> {
    parameters
        .iter()
        .enumerate()
        .map(|(i, p)| Value {
            name: p.name.to_owned(),
            value: node.values[from + i],
            unit: p.unit.to_owned(),
            ci95: confidence.ci95[from + i],
        })
        .collect()
}

/// Mean residual in N over each axis: of the refitted baseline (`before`) and of the improved model (`after`).
pub(super) fn maps(data: &Data, before: &[f64], after: &[f64]) -> Vec<Map> {
    AXES.iter()
        .filter_map(|&axis| binned(data, axis, BINS))
        .map(|b| {
            let mean = |residuals: &[f64], sign: f64| -> Vec<Option<f64>> {
                let mut sums = vec![(0.0, 0.0); BINS];
                for (i, bin) in b.bin.iter().enumerate() {
                    if let (Some(bin), true) = (bin, b.direction[i] == sign) {
                        sums[*bin].0 += residuals[i] * data.weight[i];
                        sums[*bin].1 += data.weight[i] * data.weight[i];
                    }
                }
                sums.into_iter().map(|(s, w)| (w > 0.0).then(|| s / w)).collect()
            };
            Map {
                axis: b.axis,
                loading_n: mean(before, 1.0),
                unloading_n: mean(before, -1.0),
                improved_loading_n: mean(after, 1.0),
                improved_unloading_n: mean(after, -1.0),
                edges: b.edges,
            }
        })
        .collect()
}
