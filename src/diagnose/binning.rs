//! Bins along the axes of `docs/formats.md`: mean residuals per bin, and the share of the residual in a place.

use super::condition::Track;
use super::data::Data;
use super::diagnosis::Map;
use crate::effect::{Axis, Branch, Place};

/// Axes along which residuals are binned.
pub(super) const AXES: [Axis; 6] = [
    Axis::DistanceFromReversalMm,
    Axis::DisplacementMm,
    Axis::ForceN,
    Axis::VelocityMmS,
    Axis::Cycle,
    Axis::TimeS,
];
/// Number of bins of a map and of the scan for a location.
pub(super) const BINS: usize = 24;

/// Coordinate of a point on an axis; accelerations are not binned.
pub(super) fn coordinate(track: &Track, i: usize, axis: Axis) -> f64 {
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

/// One axis: edges of its bins, and for every point its direction and its bin (`None` where it has no weight).
pub(super) struct BinnedAxis {
    pub axis: Axis,
    pub edges: Vec<f64>,
    pub bin: Vec<Option<usize>>,
    pub direction: Vec<f64>,
}

impl BinnedAxis {
    pub(super) fn len(&self) -> usize {
        self.edges.len() - 1
    }
}

/// Bins all points along an axis; `None` where the data do not extend along it.
pub(super) fn binned(data: &Data, axis: Axis, bins: usize) -> Option<BinnedAxis> {
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
    // Bins of travel since a reversal and of speed are narrower near zero, where most happens.
    let exponent = match axis {
        Axis::DistanceFromReversalMm => 2.5,
        Axis::VelocityMmS => 2.0,
        _ => 1.0,
    };
    let edges: Vec<f64> = (0..=bins)
        .map(|k| low + (high - low) * (k as f64 / bins as f64).powf(exponent))
        .collect();
    let bin = (0..values.len())
        .map(|i| {
            counted(i).then(|| {
                let share = ((values[i] - low) / (high - low))
                    .clamp(0.0, 1.0)
                    .powf(1.0 / exponent);
                ((share * bins as f64) as usize).min(bins - 1)
            })
        })
        .collect();
    Some(BinnedAxis {
        axis,
        edges,
        bin,
        direction,
    })
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

/// Share of the residual's sum of squares above the noise that lies in a place.
pub(super) fn share_in(data: &Data, residuals: &[f64], place: &Place) -> f64 {
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

    use super::super::condition::condition;
    use super::super::splits::assign_splits;
    use super::*;
    use crate::recording::Recording;

    /// Ten cycles between 1 and 11 mm, and residuals of unit noise plus `extra` of (displacement, direction).
    pub(in crate::diagnose) fn case(extra: impl Fn(f64, f64) -> f64) -> (Data, Vec<f64>) {
        sampled(0.005, 10.0, extra)
    }

    /// The same motion for `duration_s`, sampled every `dt_s`.
    pub(in crate::diagnose) fn sampled(
        dt_s: f64,
        duration_s: f64,
        extra: impl Fn(f64, f64) -> f64,
    ) -> (Data, Vec<f64>) {
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
        assign_splits(&mut tracks);
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
}
