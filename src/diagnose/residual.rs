//! Residuals in the axes of contracts.md: where on the loop they lie.
//!
//! The location is a scan: of all intervals of an axis the one whose box, projected on the baseline's own sensitivities,
//! scores highest.

use nalgebra::{DMatrix, DVector};

use super::condition::{Split, Track};
use super::diagnosis::{Location, Map};
use super::problem::Data;
use crate::effect::{Axis, Branch};

/// Axes that are looked along.
pub(super) const AXES: [Axis; 6] = [
    Axis::DistanceFromReversalMm,
    Axis::DisplacementMm,
    Axis::ForceN,
    Axis::VelocityMmS,
    Axis::Cycle,
    Axis::TimeS,
];
/// Bins of a map.
const BINS: usize = 24;

/// Coordinate of a point.
fn coordinate(track: &Track, i: usize, axis: Axis) -> f64 {
    match axis {
        Axis::DistanceFromReversalMm => track.since_reversal_mm[i],
        Axis::DisplacementMm => track.displacement_mm[i],
        Axis::ForceN => track.force_n[i],
        Axis::VelocityMmS => track.motion[i].velocity_mm_s.abs(),
        Axis::Cycle => f64::from(track.cycle[i]),
        Axis::TimeS => track.time_s[i],
        Axis::FrequencyHz => track.frequency_hz,
        Axis::AccelerationMmS2 => 0.0,
    }
}

/// One axis with its edges and the bin of every point; `None` where a point does not count.
pub(super) struct Binned {
    axis: Axis,
    edges: Vec<f64>,
    pub bin: Vec<Option<usize>>,
    pub direction: Vec<f64>,
}

impl Binned {
    /// Number of bins.
    pub(super) fn len(&self) -> usize {
        self.edges.len() - 1
    }
}

pub(super) fn binned(data: &Data, axis: Axis, bins: usize) -> Option<Binned> {
    let mut values = Vec::with_capacity(data.len());
    let mut direction = Vec::with_capacity(data.len());
    for track in &data.tracks {
        for i in 0..track.len() {
            values.push(coordinate(track, i, axis));
            direction.push(track.direction[i]);
        }
    }
    let counted = |i: usize| data.weight[i] > 0.0;
    let low = (0..values.len())
        .filter(|&i| counted(i))
        .map(|i| values[i])
        .fold(f64::INFINITY, f64::min);
    let high = (0..values.len())
        .filter(|&i| counted(i))
        .map(|i| values[i])
        .fold(f64::NEG_INFINITY, f64::max);
    if high <= low {
        return None;
    }
    // Travel since a reversal and speed count by ratios: what happens there happens near zero.
    let bend = match axis {
        Axis::DistanceFromReversalMm => 2.5,
        Axis::VelocityMmS => 2.0,
        _ => 1.0,
    };
    let edges: Vec<f64> = (0..=bins)
        .map(|k| low + (high - low) * (k as f64 / bins as f64).powf(bend))
        .collect();
    let bin = (0..values.len())
        .map(|i| {
            counted(i).then(|| {
                let share = ((values[i] - low) / (high - low))
                    .clamp(0.0, 1.0)
                    .powf(1.0 / bend);
                ((share * bins as f64) as usize).min(bins - 1)
            })
        })
        .collect();
    Some(Binned {
        axis,
        edges,
        bin,
        direction,
    })
}

/// A place holds this many times the energy that its share of the samples would.
const TELLING: f64 = 1.4;
/// No place holds more than this share of the samples on its branch.
const MOST: f64 = 0.7;
/// Mean residual over each axis, before and after.
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

/// The interval of every axis that explains most, best axis first. `jacobian` holds the baseline's weighted sensitivities.
pub(super) fn locate(data: &Data, residuals: &[f64], jacobian: &DMatrix<f64>) -> Vec<Location> {
    let p = jacobian.ncols();
    let mut normal = jacobian.tr_mul(jacobian);
    for i in 0..p {
        normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-9) + 1e-9;
    }
    let Some(normal) = normal.cholesky() else {
        return Vec::new();
    };
    let mut fitted = DVector::from_iterator(
        jacobian.nrows(),
        (0..jacobian.nrows()).map(|i| {
            if i < data.len() && data.part[i] == Split::Fit {
                residuals[i]
            } else {
                0.0
            }
        }),
    );
    fitted -= jacobian * normal.solve(&jacobian.tr_mul(&fitted));
    let above: f64 = (fitted.norm_squared() - data.count(Split::Fit) as f64).max(1e-9);
    // Not along the measured force: it holds the residual, so that any misfit lies at some force.
    let mut found: Vec<(f64, Location, bool)> = AXES
        .iter()
        .filter(|&&axis| axis != Axis::ForceN)
        .filter_map(|&axis| binned(data, axis, BINS))
        .flat_map(|b| {
            [Branch::Both, Branch::Loading, Branch::Unloading]
                .into_iter()
                .filter_map(|branch| scan(data, &b, branch, residuals, &fitted, jacobian, &normal, above))
                .collect::<Vec<_>>()
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut axes = Vec::new();
    found.retain(|(_, l, _)| {
        let new = !axes.contains(&l.axis);
        axes.push(l.axis);
        new
    });
    // Nearly everywhere is no place, unless there is no other.
    if found.iter().any(|(.., tells)| *tells) {
        found.retain(|(.., tells)| *tells);
    }
    found.into_iter().take(4).map(|(_, l, _)| l).collect()
}

#[allow(clippy::too_many_arguments)]
fn scan(
    data: &Data,
    b: &Binned,
    branch: Branch,
    residuals: &[f64],
    fitted: &DVector<f64>,
    jacobian: &DMatrix<f64>,
    normal: &nalgebra::Cholesky<f64, nalgebra::Dyn>,
    above: f64,
) -> Option<(f64, Location, bool)> {
    let p = jacobian.ncols();
    let mut best: Option<(f64, f64, usize, usize)> = None;
    let mut energy = [0.0; BINS];
    let mut samples = [0usize; BINS];
    // Even boxes see stiffness and offsets, odd ones friction.
    for odd in [false, true] {
        if odd && branch != Branch::Both {
            continue;
        }
        let mut score = [0.0; BINS];
        let mut power = [0.0; BINS];
        let mut shadow = vec![DVector::<f64>::zeros(p); BINS];
        for i in 0..data.len() {
            let Some(bin) = b.bin[i] else { continue };
            let on = match branch {
                Branch::Both => true,
                Branch::Loading => b.direction[i] > 0.0,
                Branch::Unloading => b.direction[i] < 0.0,
            };
            if !on || data.part[i] != Split::Fit {
                continue;
            }
            if !odd {
                energy[bin] += residuals[i] * residuals[i] - 1.0;
                samples[bin] += 1;
            }
            let w = data.weight[i] * if odd { b.direction[i] } else { 1.0 };
            score[bin] += w * fitted[i];
            power[bin] += w * w;
            for k in 0..p {
                shadow[bin][k] += w * jacobian[(i, k)];
            }
        }
        let on_branch = samples.iter().sum::<usize>() as f64;
        for from in 0..BINS {
            let (mut s, mut pw, mut c) = (0.0, 0.0, DVector::<f64>::zeros(p));
            let mut held = 0;
            for to in from..BINS {
                s += score[to];
                pw += power[to];
                c += &shadow[to];
                held += samples[to];
                if to - from + 1 > 3 * BINS / 4 || held as f64 > MOST * on_branch {
                    break;
                }
                let left = pw - c.dot(&normal.solve(&c));
                if left > 1e-3 * pw && pw > 0.0 {
                    let gain = s * s / left;
                    if best.is_none_or(|b| gain > b.0) {
                        best = Some((gain, gain / above, from, to));
                    }
                }
            }
        }
    }
    let (gain, explained, from, to) = best?;
    let inside: f64 = energy[from..=to].iter().sum();
    let everywhere: f64 = (0..data.len())
        .filter(|&i| data.part[i] == Split::Fit && data.weight[i] > 0.0)
        .map(|i| residuals[i] * residuals[i] - 1.0)
        .sum();
    let share = (inside / everywhere.max(1e-9)).clamp(0.0, 1.0);
    let location = Location {
        axis: b.axis,
        from: b.edges[from],
        to: b.edges[to + 1],
        direction: branch,
        share,
        words: words(b.axis, b.edges[from], b.edges[to + 1], branch, share),
    };
    // A box on one branch must beat the one on both: half the data explain less by themselves.
    let rank = if branch == Branch::Both {
        explained
    } else {
        0.8 * explained
    };
    let held = samples[from..=to].iter().sum::<usize>() as f64;
    let tells = share > TELLING * held / data.count(Split::Fit).max(1) as f64;
    (gain > 10.0).then_some((rank, location, tells))
}

/// A location in words.
pub(super) fn words(axis: Axis, from: f64, to: f64, branch: Branch, share: f64) -> String {
    let place = match axis {
        Axis::DistanceFromReversalMm if from < 0.02 * to => format!("within {to:.2} mm after a reversal"),
        Axis::DistanceFromReversalMm => format!("{from:.2} to {to:.2} mm after a reversal"),
        Axis::DisplacementMm => format!("between {from:.2} and {to:.2} mm"),
        Axis::ForceN => format!("between {from:.0} and {to:.0} N"),
        Axis::VelocityMmS => format!("at speeds of {from:.1} to {to:.1} mm/s"),
        Axis::AccelerationMmS2 => format!("at accelerations of {from:.0} to {to:.0} mm/s2"),
        Axis::Cycle => format!("in cycles {from:.0} to {to:.0}"),
        Axis::TimeS => format!("from {from:.1} to {to:.1} s"),
        Axis::FrequencyHz => format!("at {from:.2} to {to:.2} Hz"),
    };
    let branch = match branch {
        Branch::Loading => "on the loading branch",
        Branch::Unloading => "on the unloading branch",
        Branch::Both => "on both branches",
    };
    format!(
        "{:.0} % of the difference above the noise lies {place}, {branch}",
        100.0 * share
    )
}

/// Share of the residual's energy above the noise that falls in a place.
pub(super) fn share_in(data: &Data, residuals: &[f64], place: &crate::effect::Place) -> f64 {
    let (mut inside, mut all, mut k) = (0.0, 0.0, 0);
    for track in &data.tracks {
        for i in 0..track.len() {
            if data.weight[k] > 0.0 {
                let energy = residuals[k] * residuals[k] - 1.0;
                all += energy;
                let at = coordinate(track, i, place.axis);
                let on = match place.branch {
                    Branch::Both => true,
                    Branch::Loading => track.direction[i] > 0.0,
                    Branch::Unloading => track.direction[i] < 0.0,
                };
                if on && at >= place.from && at <= place.to {
                    inside += energy;
                }
            }
            k += 1;
        }
    }
    if all > 0.0 {
        (inside / all).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
pub(super) mod tests {
    use rand::{RngExt, SeedableRng};

    use super::super::condition::{condition, share_out};
    use super::*;
    use crate::recording::Recording;

    /// Ten cycles between 1 and 11 mm, and residuals of unit noise plus `extra` of (displacement, direction).
    pub fn case(extra: impl Fn(f64, f64) -> f64) -> (Data, Vec<f64>) {
        sampled(0.005, 10.0, extra)
    }

    /// The same for a time, a sample every `dt_s`.
    pub fn sampled(dt_s: f64, duration_s: f64, extra: impl Fn(f64, f64) -> f64) -> (Data, Vec<f64>) {
        let count = (duration_s / dt_s) as i32;
        let time_s: Vec<f64> = (0..count).map(|i| dt_s * f64::from(i)).collect();
        let displacement_mm: Vec<f64> = time_s
            .iter()
            .map(|t| 6.0 - 5.0 * (std::f64::consts::TAU * t).cos())
            .collect();
        let recording = Recording {
            force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
            time_s,
            displacement_mm,
            ..Recording::default()
        };
        let mut tracks = condition(&[recording], 3000).expect("conditioned");
        share_out(&mut tracks);
        let mut data = Data::new(tracks);
        data.weight
            .iter_mut()
            .filter(|w| **w > 0.0)
            .for_each(|w| *w = 1.0);
        let track = &data.tracks[0];
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let residuals = (0..data.len())
            .map(|i| {
                let noise = 3f64.sqrt() * (2.0 * random.random::<f64>() - 1.0);
                let at = extra(track.displacement_mm[i], track.direction[i]);
                if data.weight[i] > 0.0 { noise + at } else { 0.0 }
            })
            .collect();
        (data, residuals)
    }

    #[test]
    fn a_local_friction_is_located_to_a_bin() {
        let (data, residuals) = case(|x, d| if (4.0..6.0).contains(&x) { 3.0 * d } else { 0.0 });
        let jacobian = DMatrix::from_fn(data.len(), 2, |i, k| {
            if k == 0 {
                data.weight[i]
            } else {
                data.weight[i] * data.tracks[0].displacement_mm[i]
            }
        });
        let place = locate(&data, &residuals, &jacobian)
            .into_iter()
            .find(|l| l.axis == Axis::DisplacementMm)
            .expect("located");
        // Bins of 10/24 mm.
        assert!(
            (place.from - 4.0).abs() < 0.5 && (place.to - 6.0).abs() < 0.5,
            "{place:?}"
        );
        assert!(place.share > 0.7 && place.words.contains("mm"), "{place:?}");
    }
}
