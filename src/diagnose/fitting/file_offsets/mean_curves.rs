//! The curve of the spring as each recording shows it without a model: the mean of both branches of its loops.
//!
//! Whatever friction a spring has, it acts against either direction, so that the mean of both branches is the spring. Recordings of one
//! specimen must show the same curve wherever they overlap. A zero of the force shifts the curve of its recording along the force, a zero
//! of the displacement along the displacement.

use nalgebra::{DMatrix, DVector};

use super::offsets::OffsetKind;
use crate::diagnose::conditioning::{Track, median, range};
use crate::diagnose::fitting::data::Data;

/// Number of places along the displacement at which the curves are compared, and fewest points of a branch at one.
const PLACES: usize = 40;
const LEAST_POINTS: usize = 3;
/// Fewest places that two recordings share.
const LEAST_SHARED: usize = 6;
/// Share of a stroke after which friction has reversed.
const REVERSED: f64 = 0.3;
/// From this spread of the displacements at a place on (standard deviation, in steps), a slope is fitted to its points.
const SPREAD: f64 = 0.1;

/// The mean curves of all recordings.
pub(super) struct MeanCurves {
    /// Force in N of each recording at each place; `None` where one of its branches is missing.
    of_each: Vec<Vec<Option<f64>>>,
    /// Distance of two places in mm.
    step_mm: f64,
}

impl MeanCurves {
    /// The curves of a force in N at the points of the data.
    pub(super) fn of(data: &Data, force_n: &[f64]) -> MeanCurves {
        let of_all: Vec<[f64; 2]> = data.tracks.iter().map(ends_mm).collect();
        let low_mm = of_all.iter().map(|e| e[0]).fold(f64::INFINITY, f64::min);
        let high_mm = of_all.iter().map(|e| e[1]).fold(f64::NEG_INFINITY, f64::max);
        let step_mm = (high_mm - low_mm) / PLACES as f64;
        let mut from = 0;
        let curve = |track: &Track| {
            let mut points = vec![[Vec::new(), Vec::new()]; PLACES];
            let [lowest_mm, highest_mm] = ends_mm(track);
            for i in 0..track.len() {
                // The first stroke has no turning point before it.
                let [from_mm, to_mm] = track.motion[i].reach_mm;
                let stroke_mm = to_mm.min(highest_mm) - from_mm.max(lowest_mm);
                let reversed = track.since_reversal_mm[i] > REVERSED * stroke_mm;
                if data.weight[from + i] > 0.0 && reversed {
                    let steps = (track.displacement_mm[i] - low_mm) / step_mm;
                    let place = (steps as usize).min(PLACES - 1);
                    let beside = steps - (place as f64 + 0.5);
                    points[place][usize::from(track.direction[i] > 0.0)].push([beside, force_n[from + i]]);
                }
            }
            from += track.len();
            let rate = step_mm * range(&track.force_n) / range(&track.displacement_mm);
            points
                .iter()
                .map(|[down, up]| Some(0.5 * (level(down, rate)? + level(up, rate)?)))
                .collect()
        };
        MeanCurves {
            of_each: data.tracks.iter().map(curve).collect(),
            step_mm,
        }
    }

    /// Mean force in N at a place over the recordings that reach it, and their number; `None` for fewer than two.
    fn common(&self, place: usize) -> Option<(f64, f64)> {
        let shown: Vec<f64> = self.of_each.iter().filter_map(|curve| curve[place]).collect();
        let count = shown.len() as f64;
        (shown.len() > 1).then(|| (shown.iter().sum::<f64>() / count, count))
    }

    /// RMS in N by which the curves differ from their mean where they overlap; `None` if they overlap at too few places.
    pub(super) fn disagreement_n(&self) -> Option<f64> {
        let shared: Vec<(usize, f64)> = (0..PLACES)
            .filter_map(|place| Some((place, self.common(place)?.0)))
            .collect();
        let apart: Vec<f64> = shared
            .iter()
            .flat_map(|&(place, common_n)| {
                let shown = self.of_each.iter().filter_map(move |curve| curve[place]);
                shown.map(move |n| (n - common_n).powi(2))
            })
            .collect();
        (shared.len() >= LEAST_SHARED).then(|| (apart.iter().sum::<f64>() / apart.len() as f64).sqrt())
    }

    /// Slope in N/mm of the mean of the curves at each place, taken from the nearest place with neighbours on both sides.
    fn slopes(&self) -> Vec<f64> {
        let common: Vec<Option<f64>> = (0..PLACES).map(|k| Some(self.common(k)?.0)).collect();
        let own: Vec<(usize, f64)> = (1..PLACES - 1)
            .filter_map(|k| Some((k, (common[k + 1]? - common[k - 1]?) / (2.0 * self.step_mm))))
            .collect();
        let nearest = |k: usize| own.iter().min_by_key(|(at, _)| at.abs_diff(k));
        (0..PLACES).map(|k| nearest(k).map_or(0.0, |s| s.1)).collect()
    }

    /// What each recording reads too much on a channel, in N or mm, by least squares to first order. The zeros are relative to their
    /// median: a zero that all recordings share is not seen.
    pub(super) fn zeros(&self, kind: OffsetKind) -> Option<Vec<f64>> {
        let slopes = self.slopes();
        let files = self.of_each.len();
        let mut normal = DMatrix::zeros(files, files);
        let mut right = DVector::zeros(files);
        for (place, slope) in slopes.iter().enumerate() {
            let Some((common_n, count)) = self.common(place) else {
                continue;
            };
            let by_n = if kind == OffsetKind::Force { 1.0 } else { -slope };
            let shown: Vec<(usize, f64)> = (0..files)
                .filter_map(|file| Some((file, self.of_each[file][place]? - common_n)))
                .collect();
            for &(a, apart_n) in &shown {
                right[a] += by_n * apart_n;
                normal[(a, a)] += by_n * by_n;
                for &(b, _) in &shown {
                    normal[(a, b)] -= by_n * by_n / count;
                }
            }
        }
        // Without the ridge the matrix is singular: a zero that all recordings share is not seen, nor that of one that overlaps with none.
        let ridge = 1e-6 * normal.diagonal().amax();
        for file in 0..files {
            normal[(file, file)] += ridge;
        }
        let zeros = normal.cholesky()?.solve(&right);
        let middle = median(zeros.iter().copied().collect());
        Some(zeros.iter().map(|zero| zero - middle).collect())
    }
}

/// Smallest and largest displacement in mm.
fn ends_mm(track: &Track) -> [f64; 2] {
    let x = track.displacement_mm.iter();
    x.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
        [low.min(*x), high.max(*x)]
    })
}

/// Force in N in the middle of a place, from its points: distance from the middle in steps, force in N. `rate` in N per step is the mean
/// slope of the recording, for points that lie too close together to show one.
fn level(points: &[[f64; 2]], rate: f64) -> Option<f64> {
    if points.len() < LEAST_POINTS {
        return None;
    }
    let count = points.len() as f64;
    let [x, n] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
    let power: f64 = points.iter().map(|p| (p[0] - x).powi(2)).sum();
    let along: f64 = points.iter().map(|p| (p[0] - x) * (p[1] - n)).sum();
    let slope = if power > count * SPREAD * SPREAD {
        along / power
    } else {
        rate
    };
    Some(n - slope * x)
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::offsets::OffsetKind::{Displacement, Force};
    use super::*;
    use crate::diagnose::fitting::sampled;

    /// Three recordings of a spring of 60 + 2 x N/mm with friction of 10 % of the force, each with a zero of the displacement in mm and of
    /// the force in N.
    pub(in super::super) fn three(zeros: [[f64; 2]; 3]) -> Data {
        let (one, _) = sampled(0.005, 20.0, |_, _| 0.0);
        let mut data = one.clone();
        (data.tracks, data.force_n) = (Vec::new(), Vec::new());
        data.weight = one.weight.repeat(3);
        for [zero_mm, zero_n] in zeros {
            let mut track = one.tracks[0].clone();
            for i in 0..track.len() {
                let x = track.displacement_mm[i];
                let spring_n = 60.0 * x + x * x;
                track.force_n[i] = spring_n * (1.0 + 0.1 * track.direction[i]) + zero_n;
                track.displacement_mm[i] += zero_mm;
                for reach_mm in &mut track.motion[i].reach_mm {
                    *reach_mm += zero_mm;
                }
            }
            data.force_n.extend(&track.force_n);
            data.tracks.push(track);
        }
        data
    }

    #[test]
    fn curves_of_one_spring_agree_whatever_its_friction() {
        let data = three([[0.0; 2]; 3]);
        let apart_n = MeanCurves::of(&data, &data.force_n).disagreement_n().unwrap();
        assert!(apart_n < 1e-9, "{apart_n}");
    }

    #[test]
    fn a_zero_of_the_force_is_seen_exactly() {
        let data = three([[0.0, 0.0], [0.0, 25.0], [0.0, -8.0]]);
        let zeros = MeanCurves::of(&data, &data.force_n).zeros(Force).unwrap();
        for (found, truth) in zeros.iter().zip([0.0, 25.0, -8.0]) {
            assert!((found - truth).abs() < 0.01, "{zeros:?}");
        }
    }

    #[test]
    fn a_zero_of_the_displacement_is_seen_to_first_order() {
        let data = three([[0.0, 0.0], [0.3, 0.0], [-0.1, 0.0]]);
        let zeros = MeanCurves::of(&data, &data.force_n).zeros(Displacement).unwrap();
        for (found, truth) in zeros.iter().zip([0.0, 0.3, -0.1]) {
            assert!((found - truth).abs() <= 0.1 * truth.abs(), "{zeros:?}");
        }
    }

    #[test]
    fn recordings_that_hardly_overlap_say_nothing() {
        let data = three([[0.0, 0.0], [30.0, 0.0], [60.0, 0.0]]);
        assert_eq!(MeanCurves::of(&data, &data.force_n).disagreement_n(), None);
    }
}
