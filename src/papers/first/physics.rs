//! The cases of Tables 2 and 3 with the friction of leaves, pins, rail and board.

use super::ROWS;
use crate::identify::IdentifyError;
use crate::identify::leaf_pack_rows::{
    AmplitudeReading, FreedRange, RowFit, RowFitCase, RowFitOptions, TestFigures, fit_cases, within_ranges,
};

/// The range that is freed where the ranges leave rows out: the one at whose end the fits of the reading are.
fn freed(reading: AmplitudeReading) -> FreedRange {
    match reading {
        AmplitudeReading::Whole => FreedRange {
            parameter: "rail_mu",
            words: "rail friction",
            bounds: [0.0, 2.0],
        },
        // Twice the stroke needs a softer pack, which no friction gives.
        AmplitudeReading::Half => FreedRange {
            parameter: "thickness_correction_mm",
            words: "thickness",
            bounds: [-1.5, 0.185],
        },
    }
}

/// All cases of a reading; `progress` as in [`super::rerun`].
pub(super) fn physics(
    options: &RowFitOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<RowFit>, IdentifyError> {
    let mut cases = within_ranges();
    let freed = cases.clone().into_iter().map(|case| RowFitCase {
        freed: Some(freed(options.reading)),
        ..case
    });
    cases.extend(freed);
    let measured: TestFigures = ROWS.map(|row| row.measured);
    fit_cases(cases, &measured, options, progress)
}
