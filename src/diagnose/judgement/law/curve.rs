//! Reads a law off the residuals: hat functions over one axis, fitted together with the baseline's own parameters in first order,
//! smoothed by second differences. Axis, branch and smoothness are chosen by the selecting cycles.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, FitContext, LikelihoodScale, ModelStructure, Node, Setup, Tangent};
use crate::diagnose::search::coordinate;
use crate::effect::Axis;
use crate::effect::law::ForceLaw;

/// Number of places of a table: a ripple of eight periods still has three for each.
const PLACES: usize = 25;
/// Weights of the second differences that are tried, in units of a place's power.
const SMOOTHNESS: [f64; 4] = [1e-4, 1e-2, 1.0, 100.0];
/// Small ridge that holds the places without points, in the same unit.
const RIDGE: f64 = 1e-6;
/// Axes of a law. Not the measured force: it contains the residual.
const AXES: [Axis; 5] = [
    Axis::DisplacementMm,
    Axis::VelocityMmS,
    Axis::DistanceFromReversalMm,
    Axis::TimeS,
    Axis::Cycle,
];

/// A law as it was read, with the standard deviation of each value.
pub(super) struct LawCurve {
    pub law: ForceLaw,
    pub band: Vec<f64>,
    /// Fall of the sum of squares on selecting cycles.
    gain: f64,
}

/// Axis, branch and scale of a law, with its places.
struct LawFrame {
    axis: Axis,
    opposes_motion: bool,
    per_load: bool,
    at: Vec<f64>,
}

/// Residuals and sensitivities of a set at every point, held-out ones included.
struct Linearised<'a> {
    data: &'a Data,
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
    /// Product of the sensitivities with themselves, and with the residuals, over fitted points and priors.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    scale: LikelihoodScale,
}

impl LawCurve {
    /// The law over one axis that explains most of what a set leaves on selecting cycles.
    pub(super) fn best(context: &FitContext<'_>, node: &Node) -> Option<LawCurve> {
        let linearised = Linearised::new(context, context.setup, node)?;
        let frames = AXES.iter().flat_map(|&axis| {
            [(false, false), (true, false), (false, true), (true, true)]
                .map(|(opposes_motion, per_load)| (axis, opposes_motion, per_load))
        });
        let frames: Vec<LawFrame> = frames
            .filter_map(|(axis, opposes_motion, per_load)| {
                Some(LawFrame {
                    axis,
                    opposes_motion,
                    per_load,
                    at: places(context.data, axis)?,
                })
            })
            .collect();
        let curves = context.parallel_map(&frames, |frame| linearised.curve(frame, None));
        let best = curves
            .into_iter()
            .flatten()
            .max_by(|a, b| a.gain.total_cmp(&b.gain))?;
        (best.gain > 0.0).then_some(best)
    }

    /// The same law with its values corrected by what it leaves at a set that was refitted with it.
    pub(super) fn refitted(&self, context: &FitContext<'_>, setup: &Setup, node: &Node) -> Option<LawCurve> {
        let frame = LawFrame {
            axis: self.law.axis,
            opposes_motion: self.law.opposes_motion,
            per_load: self.law.per_load,
            at: self.law.at.clone(),
        };
        Linearised::new(context, setup, node)?.curve(&frame, Some(&self.law))
    }
}

/// Places of a table along an axis: closer together near zero for travel since a reversal and for speed, where most happens.
fn places(data: &Data, axis: Axis) -> Option<Vec<f64>> {
    let (mut low, mut high, mut first) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    for track in &data.tracks {
        for i in 0..track.len() {
            if data.weight[first + i] > 0.0 {
                let place = coordinate(track, i, axis);
                (low, high) = (low.min(place), high.max(place));
            }
        }
        first += track.len();
    }
    let power = match axis {
        Axis::DistanceFromReversalMm => 2.5,
        Axis::VelocityMmS => 2.0,
        _ => 1.0,
    };
    let place = |k: usize| low + (high - low) * (k as f64 / (PLACES - 1) as f64).powf(power);
    (high > low).then(|| (0..PLACES).map(place).collect())
}

impl<'a> Linearised<'a> {
    fn new(context: &FitContext<'a>, setup: &Setup, node: &Node) -> Option<Linearised<'a>> {
        let data = context.data;
        let every = data.all_fitted();
        let structure = ModelStructure::new(setup, &every, node.attached.clone());
        let residuals = structure.fitted(&node.values)?;
        let jacobian = Tangent::new(&structure, &node.values)?.jacobian;
        let mut fitted = jacobian.clone();
        for i in (0..data.len()).filter(|&i| data.split[i] != Split::Fit) {
            fitted.row_mut(i).fill(0.0);
        }
        Some(Linearised {
            data,
            normal: fitted.tr_mul(&jacobian),
            right: fitted.tr_mul(&residuals),
            scale: LikelihoodScale::of(data, &node.residuals),
            residuals,
            jacobian,
        })
    }

    /// The law in a frame, at the smoothness that the selecting cycles choose. It is added to `known`, if there is one.
    fn curve(&self, frame: &LawFrame, known: Option<&ForceLaw>) -> Option<LawCurve> {
        let entries = self.entries(frame);
        let own = self.jacobian.ncols();
        let size = own + PLACES;
        let mut normal = DMatrix::zeros(size, size);
        let mut right = DVector::zeros(size);
        normal.view_mut((0, 0), (own, own)).copy_from(&self.normal);
        right.rows_mut(0, own).copy_from(&self.right);
        for (i, entry) in entries.iter().enumerate() {
            if self.data.split[i] != Split::Fit {
                continue;
            }
            for &(place, value) in entry {
                right[own + place] += value * self.residuals[i];
                for j in 0..own {
                    let product = value * self.jacobian[(i, j)];
                    normal[(j, own + place)] += product;
                    normal[(own + place, j)] += product;
                }
                for &(other, theirs) in entry {
                    normal[(own + place, own + other)] += value * theirs;
                }
            }
        }
        let power = (own..size).map(|k| normal[(k, k)]).sum::<f64>() / PLACES as f64;
        let curves = SMOOTHNESS.iter().filter_map(|smoothness| {
            let mut smooth = normal.clone();
            add_penalty(&mut smooth, own, smoothness * power, power);
            let factor = smooth.cholesky()?;
            let solved = factor.solve(&right);
            let variance = factor.inverse();
            let noise = self.scale.variance * self.scale.correlation_time;
            let force = |k: usize| solved[own + k] + known.map_or(0.0, |law| law.force[k]);
            Some(LawCurve {
                gain: self.gain(&entries, &solved),
                band: (0..PLACES)
                    .map(|k| (noise * variance[(own + k, own + k)]).max(0.0).sqrt())
                    .collect(),
                law: ForceLaw {
                    axis: frame.axis,
                    opposes_motion: frame.opposes_motion,
                    per_load: frame.per_load,
                    at: frame.at.clone(),
                    force: (0..PLACES).map(force).collect(),
                },
            })
        });
        curves.max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// Places and weighted values of the hat functions at every point.
    fn entries(&self, frame: &LawFrame) -> Vec<[(usize, f64); 2]> {
        let mut entries = Vec::with_capacity(self.data.len());
        for track in &self.data.tracks {
            for i in 0..track.len() {
                let weight = self.data.weight[entries.len()];
                let sign = if frame.opposes_motion {
                    track.direction[i]
                } else {
                    1.0
                };
                let scale = if frame.per_load { track.force_n[i] } else { 1.0 };
                let place = coordinate(track, i, frame.axis);
                let above = frame.at.partition_point(|at| *at <= place).clamp(1, PLACES - 1);
                let (low, high) = (frame.at[above - 1], frame.at[above]);
                let share = ((place - low) / (high - low)).clamp(0.0, 1.0);
                let value = weight * sign * scale;
                entries.push([(above - 1, value * (1.0 - share)), (above, value * share)]);
            }
        }
        entries
    }

    /// Fall of the sum of squares on selecting points.
    fn gain(&self, entries: &[[(usize, f64); 2]], solved: &DVector<f64>) -> f64 {
        let own = self.jacobian.ncols();
        let selecting = (0..self.data.len()).filter(|&i| self.data.split[i] == Split::Select);
        selecting
            .map(|i| {
                let mut predicted: f64 = (0..own).map(|j| self.jacobian[(i, j)] * solved[j]).sum();
                predicted += entries[i]
                    .iter()
                    .map(|&(place, value)| value * solved[own + place])
                    .sum::<f64>();
                let residual = self.residuals[i];
                residual * residual - (residual - predicted).powi(2)
            })
            .sum()
    }
}

/// Adds the penalty on second differences, and the ridge, to the part of the normal matrix from `own` on.
fn add_penalty(normal: &mut DMatrix<f64>, own: usize, smoothness: f64, power: f64) {
    let size = normal.nrows();
    for j in 0..own {
        normal[(j, j)] = normal[(j, j)] * (1.0 + 1e-9) + 1e-9;
    }
    for k in own..size {
        normal[(k, k)] += RIDGE * power + f64::MIN_POSITIVE;
    }
    for k in own + 1..size - 1 {
        let difference = [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)];
        for (a, x) in difference {
            for (b, y) in difference {
                normal[(a, b)] += smoothness * x * y;
            }
        }
    }
}
