//! Chula thesis, chapter V: the measured loop of Table 5-1 against the thesis' envelope lines, its model as printed, and the
//! five-link spring fitted to it (`identify::loop_points`).
//!
//! The sixth unloading point is left out, its deflection is not printed. The first point carries 294 N at 0.03 mm: the
//! spring was under preload when the LVDT was zeroed. The thesis' model has no preload, so it is one more parameter: the
//! travel before the zero, `preload_mm`. Without it that point distorts the other parameters; both fits are shown.

use crate::identify::IdentifyError;
use crate::identify::loop_points::{FiveLinkComparison, LoopPoints, compare_five_link};

/// Table 5-1 in mm and N (kgf and cm printed), in the order of the test: six points up, five down.
pub(crate) const TABLE_5_1: [(f64, f64); 11] = [
    (0.034, 293.5228),
    (5.855, 622.4977),
    (13.098, 850.2503),
    (21.493, 1153.9191),
    (32.116, 1470.2424),
    (48.539, 1830.8525),
    (47.701, 1728.3338),
    (37.293, 1131.5354),
    (26.469, 707.1820),
    (19.905, 536.2482),
    (7.700, 210.7547),
];
/// Number of points on the loading branch.
const LOADING: usize = 6;

/// Runs Table 5-1 again.
pub(crate) fn rerun(threads: usize) -> Result<FiveLinkComparison, IdentifyError> {
    let points = LoopPoints {
        points: &TABLE_5_1,
        loading: LOADING,
    };
    compare_five_link(&points, threads)
}
