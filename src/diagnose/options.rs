//! What may be set for a diagnosis.

use crate::cancel::CancelFlag;
use crate::profile::ProfileLimits;

/// Points of all recordings together, and the fewest of one: many recordings are thinned further, so that the time of a diagnosis
/// does not grow with their number.
const MOST_POINTS: usize = 24_000;
const LEAST_POINTS: usize = 600;

/// Options of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnoseOptions {
    /// Number of points that a recording is thinned to; fewer where there are more than eight recordings.
    pub points: usize,
    /// Number of worker threads; 0 for one per core. The result does not depend on it.
    pub threads: usize,
    /// Ends the diagnosis early, with an error.
    pub cancel: CancelFlag,
    /// Limits of the bench for the next test. `None`: the test is no faster than the recordings.
    pub(crate) limits: Option<ProfileLimits>,
}

impl DiagnoseOptions {
    /// The same with the limits of a bench for the next test.
    pub(crate) fn within(self, limits: ProfileLimits) -> DiagnoseOptions {
        DiagnoseOptions {
            limits: Some(limits),
            ..self
        }
    }

    /// Number of points that each of so many recordings is thinned to.
    pub(super) fn points_of_each(&self, recordings: usize) -> usize {
        self.points
            .min((MOST_POINTS / recordings.max(1)).max(LEAST_POINTS))
    }
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        DiagnoseOptions {
            points: 3000,
            threads: 0,
            cancel: CancelFlag::default(),
            limits: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_recordings_are_thinned_further_but_not_to_nothing() {
        let points = |recordings| DiagnoseOptions::default().points_of_each(recordings);
        assert_eq!([1, 8, 16, 40, 1000].map(points), [3000, 3000, 1500, 600, 600]);
    }
}
