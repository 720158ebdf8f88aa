//! What may be set for a diagnosis.

use crate::profile::ProfileLimits;

/// Options of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnoseOptions {
    /// Number of points that a recording is thinned to.
    pub points: usize,
    /// Number of worker threads; 0 for one per core. The result does not depend on it.
    pub threads: usize,
    /// Limits of the bench for the next test. `None`: the test is no faster than the recordings.
    pub(crate) limits: Option<ProfileLimits>,
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        DiagnoseOptions {
            points: 3000,
            threads: 0,
            limits: None,
        }
    }
}
