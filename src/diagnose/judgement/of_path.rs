//! Effects of the path, as they were judged before everything that follows from the path was in doubt.

use crate::diagnose::diagnosis::*;
use crate::effect::Axis;

/// Axes that follow from the path of the displacement.
const OF_PATH: [Axis; 3] = [Axis::DisplacementMm, Axis::ForceN, Axis::DistanceFromReversalMm];

/// Effects that follow from the path of the displacement, as a search found them in which the path was not in doubt.
#[derive(Clone, Default)]
pub(in crate::diagnose) struct FoundOfPath {
    pub effects: Vec<Finding>,
    pub alternatives: Vec<Alternative>,
    pub location: Vec<Location>,
}

impl FoundOfPath {
    /// What a diagnosis names; nothing where it explains nothing.
    pub(super) fn of(before: &Diagnosis) -> FoundOfPath {
        if before.verdict == Verdict::Unexplained {
            return FoundOfPath::default();
        }
        let follows = |code: &str| crate::effect::find(code).is_ok_and(|e| e.follows_path);
        let named = |code: &str| follows(code) && before.effects.iter().any(|e| e.code == code);
        FoundOfPath {
            effects: before
                .effects
                .iter()
                .filter(|e| follows(&e.code))
                .cloned()
                .collect(),
            alternatives: before
                .alternatives
                .iter()
                .filter(|a| named(&a.instead_of))
                .cloned()
                .collect(),
            location: before
                .location
                .iter()
                .filter(|l| OF_PATH.contains(&l.axis))
                .cloned()
                .collect(),
        }
    }

    pub(super) fn clear_if(&mut self, unexplained: bool) {
        if unexplained {
            *self = FoundOfPath::default();
        }
    }

    pub(super) fn names(&self, code: &str) -> bool {
        self.effects.iter().any(|e| e.code == code)
    }
}

/// Locations, where those on an axis of the path were found before: in this search that axis is in doubt.
pub(super) fn with_path(of_path: Vec<Location>, found: Vec<Location>) -> Vec<Location> {
    let axes: Vec<Axis> = of_path.iter().map(|l| l.axis).collect();
    let beside = found.into_iter().filter(|l| !axes.contains(&l.axis));
    of_path.into_iter().chain(beside).collect()
}
