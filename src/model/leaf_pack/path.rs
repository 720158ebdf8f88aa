//! Static paths: a loading and unloading in few steps, for identification.

use super::LeafPack;
use crate::model::Plant;

/// One point of a static path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathPoint {
    /// Displacement of the pusher, mm.
    pub displacement_mm: f64,
    /// Force of the pusher, N.
    pub force_n: f64,
}

/// First increment after a turning point, mm. There the contacts change from stick to slip one after the other.
const FIRST_MM: f64 = 0.05;
/// Ratio of one increment to the one before.
const GROWTH: f64 = 1.35;

/// A path through the turning points: fine after each of them, then up to `longest_mm` per step.
pub(crate) fn graded_path(turning_points_mm: &[f64], longest_mm: f64) -> Vec<f64> {
    let mut path = Vec::new();
    path.extend(turning_points_mm.first());
    for pair in turning_points_mm.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let span = (to - from).abs();
        let mut ladder = Vec::new();
        let (mut at, mut increment) = (0.0, FIRST_MM.min(longest_mm));
        while at < span {
            at += increment;
            ladder.push(at);
            increment = (increment * GROWTH).min(longest_mm);
        }
        // Scaled so that the last step ends at the turning point.
        let scale = if at > 0.0 { (to - from) / at } else { 0.0 };
        path.extend(ladder.into_iter().map(|d| from + d * scale));
    }
    path
}

impl LeafPack {
    /// Steps through the displacements at constant speed, `duration_s` in all, and returns the force at each.
    pub(crate) fn static_path(&mut self, displacements_mm: &[f64], duration_s: f64) -> Vec<PathPoint> {
        let way: f64 = displacements_mm.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
        displacements_mm
            .iter()
            .map(|&displacement_mm| {
                let share = (displacement_mm - self.displacement_mm()).abs() / way.max(1e-12);
                let dt_s = (share * duration_s).max(1e-6);
                PathPoint {
                    displacement_mm,
                    force_n: self.step(displacement_mm, dt_s),
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_graded_path_has_its_turning_points() {
        let path = graded_path(&[0.0, 26.0, 0.0], 1.0);
        assert_eq!(path.first(), Some(&0.0));
        assert!(path.iter().any(|d| (d - 26.0).abs() < 1e-12));
        assert!(path.last().expect("points").abs() < 1e-12);
        assert!(path.windows(2).all(|w| (w[1] - w[0]).abs() <= 1.0 + 1e-12));
        assert!(path.len() < 90);
    }
}
