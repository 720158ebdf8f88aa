//! Bins of all points along the axes of `docs/formats.md`.

use crate::diagnose::conditioning::Track;
use crate::diagnose::fitting::Data;
use crate::effect::Axis;

/// Axes along which residuals are binned.
pub(in crate::diagnose) const AXES: [Axis; 6] = [
    Axis::DistanceFromReversalMm,
    Axis::DisplacementMm,
    Axis::ForceN,
    Axis::VelocityMmS,
    Axis::Cycle,
    Axis::TimeS,
];

/// Coordinate of a point on an axis; accelerations are not binned.
pub(in crate::diagnose) fn coordinate(track: &Track, i: usize, axis: Axis) -> f64 {
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
pub(in crate::diagnose) struct BinnedAxis {
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
pub(in crate::diagnose) fn binned(data: &Data, axis: Axis, bins: usize) -> Option<BinnedAxis> {
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
