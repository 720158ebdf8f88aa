//! How far two axes go together over recorded points. Where one follows from the other, a difference that lies along one lies along
//! the other as well, and laws of the two look alike: with one sine at one frequency the speed follows from place and branch.

use super::binning::{AXES, coordinate};
use crate::diagnose::fitting::Data;
use crate::effect::Axis;

/// Number of bins of the axis that another one is predicted from. Near its ends the speed of a sine changes much over little travel:
/// with 48 bins a sine has 0.98, with 12 it has 0.89.
const BINS: usize = 48;
/// Two axes go together if one explains this share of the other's variance. In one sine the speed has 0.98 to 1 with the place; a
/// second size of loop or frequency leaves less.
const TOGETHER: f64 = 0.9;

/// A point with its coordinates on [`AXES`].
#[derive(Debug, Clone, Copy)]
pub(in crate::diagnose) struct AxisPoint {
    pub at: [f64; AXES.len()],
    /// 1 loading, -1 unloading.
    pub direction: f64,
    /// Share of its recording: all recordings count the same.
    pub share: f64,
}

/// Recorded points that count.
pub(in crate::diagnose) fn recorded_points(data: &Data) -> Vec<AxisPoint> {
    let mut points = Vec::new();
    let mut from = 0;
    for track in &data.tracks {
        let counted: Vec<usize> = (0..track.len()).filter(|i| data.weight[from + i] > 0.0).collect();
        points.extend(counted.iter().map(|&i| AxisPoint {
            at: AXES.map(|axis| coordinate(track, i, axis)),
            direction: track.direction[i],
            share: 1.0 / counted.len() as f64,
        }));
        from += track.len();
    }
    points
}

/// True if two axes go together over some points.
pub(in crate::diagnose) fn go_together(points: &[AxisPoint], axes: [Axis; 2]) -> bool {
    confounding(points, axes) >= TOGETHER
}

/// Largest share of the variance of one of two axes that the other one explains, 0 to 1.
pub(in crate::diagnose) fn confounding(points: &[AxisPoint], [one, other]: [Axis; 2]) -> f64 {
    explained(points, one, other).max(explained(points, other, one))
}

/// Share of the variance of an axis between bins of another axis and of the branch (correlation ratio, Pearson 1905); 1 where the
/// axis does not vary.
fn explained(points: &[AxisPoint], of: Axis, by: Axis) -> f64 {
    // Every axis is a function of the time, also where a law in time and one along that axis differ: only the cycle counts in it.
    if by == Axis::TimeS && of != Axis::Cycle {
        return 0.0;
    }
    let index = |axis: Axis| AXES.iter().position(|a| *a == axis);
    let (Some(of), Some(by)) = (index(of), index(by)) else {
        return 0.0;
    };
    let ends = points.iter().map(|p| p.at[by]);
    let [low, high] = ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| {
        [l.min(v), h.max(v)]
    });
    let bin = |p: &AxisPoint| {
        let share = (p.at[by] - low) / (high - low).max(f64::MIN_POSITIVE);
        let bin = ((share * BINS as f64) as usize).min(BINS - 1);
        if p.direction > 0.0 { bin } else { BINS + bin }
    };
    let (mut sums, mut all) = ([[0.0; 2]; 2 * BINS], [0.0; 3]);
    for p in points {
        let into = &mut sums[bin(p)];
        into[0] += p.share;
        into[1] += p.share * p.at[of];
        all[0] += p.share;
        all[1] += p.share * p.at[of];
        all[2] += p.share * p.at[of] * p.at[of];
    }
    let mean_square = all[1] * all[1] / all[0].max(f64::MIN_POSITIVE);
    let whole = all[2] - mean_square;
    if whole <= 1e-9 * all[2] {
        return 1.0;
    }
    let filled = sums.iter().filter(|[share, _]| *share > 0.0);
    let between: f64 = filled.map(|[share, sum]| sum * sum / share).sum();
    ((between - mean_square) / whole).clamp(0.0, 1.0)
}

/// Name of an axis in a sentence.
pub(in crate::diagnose) fn axis_in_words(axis: Axis) -> &'static str {
    match axis {
        Axis::DistanceFromReversalMm => "travel since the reversal",
        Axis::DisplacementMm => "displacement",
        Axis::ForceN => "force",
        Axis::VelocityMmS => "speed",
        Axis::AccelerationMmS2 => "acceleration",
        Axis::Cycle => "cycle",
        Axis::TimeS => "time",
        Axis::FrequencyHz => "frequency",
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Points of sines of these amplitudes in mm and frequencies in Hz.
    fn sines(waves: &[[f64; 2]]) -> Vec<AxisPoint> {
        let wave = |&[mm, hz]: &[f64; 2]| {
            (0..1000).map(move |i| {
                let time_s = f64::from(i) * 5.0 / 1000.0 / hz;
                let phase = TAU * hz * time_s;
                let since_mm = mm * (1.0 - (phase + TAU / 4.0).rem_euclid(TAU / 2.0).cos());
                AxisPoint {
                    at: AXES.map(|axis| match axis {
                        Axis::DistanceFromReversalMm => since_mm,
                        Axis::DisplacementMm => mm * phase.sin(),
                        Axis::VelocityMmS => (mm * TAU * hz * phase.cos()).abs(),
                        Axis::Cycle => (hz * time_s).floor(),
                        Axis::TimeS => time_s,
                        _ => 0.0,
                    }),
                    direction: phase.cos().signum(),
                    share: 1e-3,
                }
            })
        };
        waves.iter().flat_map(wave).collect()
    }

    #[test]
    fn one_sine_ties_the_axes_and_others_separate_them() {
        let speed = [Axis::VelocityMmS, Axis::DisplacementMm];
        let time = [Axis::TimeS, Axis::Cycle];
        let one = sines(&[[10.0, 1.0]]);
        assert!(go_together(&one, speed) && go_together(&one, time));
        assert!(!go_together(&one, [Axis::TimeS, Axis::DisplacementMm]));
        let two_rates = sines(&[[10.0, 1.0], [10.0, 0.25]]);
        assert!(
            !go_together(&two_rates, speed),
            "{}",
            confounding(&two_rates, speed)
        );
        assert!(
            !go_together(&two_rates, time),
            "{}",
            confounding(&two_rates, time)
        );
        let two_sizes = sines(&[[10.0, 1.0], [4.0, 1.0]]);
        assert!(
            !go_together(&two_sizes, speed),
            "{}",
            confounding(&two_sizes, speed)
        );
    }
}
