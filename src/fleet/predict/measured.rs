//! The loops of a profile that the family ran before: what was measured of them, pooled like any other quantity.
//!
//! Earlier runs of the same profile have the error of the model, of the tracking and of the instruments in them, so nothing of it has to
//! be assumed.

use super::band::{DrawnQuantity, Stream, draws};
use super::loops::{LoopValues, ProfileLoops};
use super::next_run::NextRun;
use super::quantity::QuantityPredictor;
use crate::fleet::estimate::{EstimateRow, EstimateScale};
use crate::fleet::members::PlacedRun;
use crate::fleet::quantity_data::QuantityData;
use crate::profile::Profile;

/// A run of the archive with what its loops measured.
#[derive(Debug, Clone)]
pub(crate) struct MeasuredRun {
    pub placed: PlacedRun,
    pub profile: Profile,
    pub loops: LoopValues,
}

/// Fewest runs of the profile by the family. Fewer say more about the mean than about the scatter.
const FEWEST_RUNS: usize = 8;
/// Standard error of a measured value as a share of it: values of a loop are known but for rounding.
const KNOWN: f64 = 1e-6;

/// Draws of the variables of a profile from the earlier runs of it, and their number; `None` if they are too few.
pub(crate) fn measured_draws(
    loops: &ProfileLoops,
    profile: &Profile,
    runs: &[MeasuredRun],
    next: &NextRun,
) -> Option<(Vec<Vec<f64>>, usize)> {
    let same = runs
        .iter()
        .filter(|run| run.placed.member.family == next.family && is_same_motion(&run.profile, profile));
    let runs: Vec<(&PlacedRun, Vec<f64>)> = same
        .filter_map(|run| Some((&run.placed, loops.measured(&run.loops)?)))
        .collect();
    if runs.len() < FEWEST_RUNS {
        return None;
    }
    let drawn: Option<Vec<DrawnQuantity>> = (0..loops.variables.len())
        .map(|j| {
            drawn(
                &runs
                    .iter()
                    .map(|(run, values)| row(run, values[j]))
                    .collect::<Vec<_>>(),
                next,
            )
        })
        .collect();
    Some((draws(&drawn?, Stream::Quantities), runs.len()))
}

/// True if two profiles move the specimen alike, whatever their names and limits are.
fn is_same_motion(a: &Profile, b: &Profile) -> bool {
    a.mode == b.mode && a.blocks == b.blocks
}

/// A value of a run as a row for pooling.
fn row(run: &PlacedRun, value: f64) -> EstimateRow {
    EstimateRow {
        run_id: run.run_id.clone(),
        specimen: run.member.specimen.clone(),
        family: run.member.family.clone(),
        batch: run.member.batch.clone(),
        bench: run.bench.clone(),
        operator: run.operator.clone(),
        started_utc: run.started_utc,
        age_cycles: run.age_cycles,
        quantity: String::new(),
        unit: String::new(),
        estimate: value,
        std_error: KNOWN * value.abs().max(KNOWN),
        form_error: 0.0,
        scale: EstimateScale::Absolute,
    }
}

fn drawn(rows: &[EstimateRow], next: &NextRun) -> Option<DrawnQuantity> {
    let mut data = QuantityData::of(rows.iter().collect());
    let predictor = QuantityPredictor::of(&mut data)?;
    let predicted = predictor.next(next)?;
    Some(DrawnQuantity {
        mean: predicted.pooled_mean,
        deviation: predicted.pooled_deviation,
        degrees: predicted.degrees,
        runs: predictor.deviations(&next.family),
    })
}
