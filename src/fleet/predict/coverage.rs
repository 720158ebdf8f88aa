//! How often predictions were right: each run of a table against the prediction from the runs that began before it.
//!
//! A new fit for each run would take hours for a large table. So a fit serves all runs until the table has grown by 1 % or by one start;
//! a run is never predicted from itself or from a later one.

use std::collections::BTreeMap;

use serde::Serialize;

use super::next_run::NextRun;
use super::quantity::{PredictedQuantity, QuantityPredictor, has_own_scatter, predicting_rows};
use crate::fleet::estimate::EstimateRow;
use crate::fleet::quantity_data::QuantityData;
use crate::identify::confidence::wilson_interval;

/// Growth of the table after which a new fit is made.
const NEW_FIT_AT: f64 = 1.01;
/// Levels at which the share inside is counted.
pub(crate) const LEVELS: [f64; 2] = [0.5, 0.95];

/// One estimate beside what was predicted of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PredictedRun {
    pub run_id: String,
    pub specimen: String,
    pub family: String,
    pub bench: String,
    pub estimate: f64,
    /// Share of the prediction within the smallest central interval that holds the estimate: at most 0.95 if it is inside 95 %.
    pub level: f64,
    pub predicted: PredictedQuantity,
}

/// Share of the estimates inside the intervals of one level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct ShareInside {
    pub level: f64,
    pub inside: usize,
    pub of: usize,
    /// 95 % interval of the share if runs are independent; `None` without runs.
    pub ci95: Option<[f64; 2]>,
}

/// Coverage of one quantity, or of all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct QuantityCoverage {
    /// Empty for all quantities together.
    pub quantity: String,
    /// One for each of [`LEVELS`], in their order.
    pub shares: Vec<ShareInside>,
    /// At 95 %, of specimens with and without an earlier run.
    pub seen95: ShareInside,
    pub unseen95: ShareInside,
}

/// Coverage of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct FleetCoverage {
    pub all: QuantityCoverage,
    /// Sorted by name.
    pub quantities: Vec<QuantityCoverage>,
    /// Estimates that could not be predicted, because too few runs were before them.
    pub not_predicted: usize,
    #[serde(skip)]
    pub runs: Vec<PredictedRun>,
}

/// Predicts each run of a table from the runs before it.
pub(crate) fn coverage(rows: &[EstimateRow]) -> FleetCoverage {
    let mut of_quantity: BTreeMap<&str, Vec<&EstimateRow>> = BTreeMap::new();
    for row in rows {
        of_quantity.entry(&row.quantity).or_default().push(row);
    }
    let runs: Vec<PredictedRun> = of_quantity.into_values().flat_map(predicted_runs).collect();
    let mut quantities: Vec<&str> = runs.iter().map(|run| run.predicted.quantity.as_str()).collect();
    quantities.dedup();
    let of =
        |name: &str| QuantityCoverage::of(name, runs.iter().filter(|run| run.predicted.quantity == name));
    FleetCoverage {
        all: QuantityCoverage::of("", runs.iter()),
        quantities: quantities.into_iter().map(of).collect(),
        not_predicted: rows.len() - runs.len(),
        runs,
    }
}

impl ShareInside {
    /// Counts levels of estimates that are at most `level`.
    pub(crate) fn of(level: f64, found: impl Iterator<Item = f64>) -> ShareInside {
        let found: Vec<f64> = found.collect();
        let inside = found.iter().filter(|l| **l <= level).count();
        ShareInside {
            level,
            inside,
            of: found.len(),
            ci95: wilson_interval(inside, found.len()),
        }
    }

    /// The share with its interval in percent.
    pub(crate) fn words(&self) -> String {
        match self.ci95 {
            None => "no run".to_owned(),
            Some([low, high]) => format!(
                "{:.1} % ({:.1} to {:.1}) of {}",
                100.0 * self.inside as f64 / self.of as f64,
                100.0 * low,
                100.0 * high,
                self.of
            ),
        }
    }
}

impl QuantityCoverage {
    /// Name of the quantity, or `all`.
    pub(crate) fn name(&self) -> &str {
        match self.quantity.as_str() {
            "" => "all",
            quantity => quantity,
        }
    }

    fn of<'p>(quantity: &str, runs: impl Iterator<Item = &'p PredictedRun>) -> QuantityCoverage {
        let runs: Vec<&PredictedRun> = runs.collect();
        let at = |level: f64, seen: Option<bool>| {
            let some = runs
                .iter()
                .filter(|run| seen.is_none_or(|seen| seen == (run.predicted.runs_of_specimen > 0)));
            ShareInside::of(level, some.map(|run| run.level))
        };
        QuantityCoverage {
            quantity: quantity.to_owned(),
            shares: LEVELS.map(|level| at(level, None)).to_vec(),
            seen95: at(0.95, Some(true)),
            unseen95: at(0.95, Some(false)),
        }
    }
}

/// The predictions of one quantity, by start.
fn predicted_runs(mut rows: Vec<&EstimateRow>) -> Vec<PredictedRun> {
    rows.sort_by(|a, b| (a.started_utc, &a.run_id).cmp(&(b.started_utc, &b.run_id)));
    let mut predicted = Vec::new();
    let mut from = 0;
    while from < rows.len() {
        let earlier = &rows[..from];
        // All that begin together, and in a large table some more.
        let most = ((from as f64 * NEW_FIT_AT) as usize)
            .max(from + 1)
            .min(rows.len());
        let last = rows[most - 1].started_utc;
        let to = most
            + rows[most..]
                .iter()
                .take_while(|row| row.started_utc == last)
                .count();
        predicted.extend(predictions(earlier, &rows[from..to]));
        from = to;
    }
    predicted
}

/// Predictions of some runs from earlier ones. Runs that the same rows predict share a fit.
fn predictions(earlier: &[&EstimateRow], runs: &[&EstimateRow]) -> Vec<PredictedRun> {
    let mut sharing: BTreeMap<Option<&str>, Vec<(&EstimateRow, NextRun)>> = BTreeMap::new();
    for row in runs {
        let next = NextRun {
            specimen: row.specimen.clone(),
            family: row.family.clone(),
            batch: row.batch.clone(),
            bench: row.bench.clone(),
            started_utc: row.started_utc,
            age_cycles: row.age_cycles,
        };
        let own = has_own_scatter(earlier, &next).then_some(row.family.as_str());
        sharing.entry(own).or_default().push((row, next));
    }
    let mut predicted = Vec::new();
    for of_fit in sharing.into_values() {
        let mut data = QuantityData::of(predicting_rows(earlier, &of_fit[0].1));
        let Some(predictor) = QuantityPredictor::of(&mut data) else {
            continue;
        };
        let of_run = |(row, next): &(&EstimateRow, NextRun)| {
            let quantity = predictor.next(next)?;
            Some(PredictedRun {
                run_id: row.run_id.clone(),
                specimen: row.specimen.clone(),
                family: row.family.clone(),
                bench: row.bench.clone(),
                estimate: row.estimate,
                level: quantity.level_of(row.estimate),
                predicted: quantity,
            })
        };
        predicted.extend(of_fit.iter().filter_map(of_run));
    }
    predicted
}
