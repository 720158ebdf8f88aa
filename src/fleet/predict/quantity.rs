//! One quantity of the next run: its predictive mean, standard deviation and degrees of freedom on the pooled scale.
//!
//! The form error that all runs of a family share is in the estimate of its level and in the next run alike, so it is no uncertainty of
//! the prediction. It counts on a bench where no run of the family was made: there it may be another one.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::next_run::{FEWEST_RUNS, NextRun};
use crate::fleet::design::DesignTerm;
use crate::fleet::estimate::{EstimateRow, EstimateScale};
use crate::fleet::mixed_model::Contrast;
use crate::fleet::outliers::RobustFit;
use crate::fleet::quantity_data::QuantityData;
use crate::identify::confidence::{student_975, student_quantile, student_within};

/// Fewest runs and specimens of a family from which its scatter is estimated without the other families. Fewer give intervals of few
/// degrees of freedom, which are wider than those with the scatter that all families share.
const OWN_SCATTER: [usize; 2] = [15, 6];
/// Fewest runs of a family on a bench from which the typical standard error there is taken.
const TYPICAL_RUNS: usize = 5;

/// Degrees of freedom that the standard errors count for when they are compared with the scatter of the runs.
const BELIEF_IN_ERRORS: f64 = 5.0;

/// A predicted quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PredictedQuantity {
    pub quantity: String,
    pub unit: String,
    pub scale: EstimateScale,
    /// Median of the prediction and its 95 % interval, in the unit.
    pub predicted: f64,
    pub low95: f64,
    pub high95: f64,
    /// Mean and standard deviation on the pooled scale (logarithms, if the scale is relative), and degrees of freedom of Student's t.
    pub pooled_mean: f64,
    pub pooled_deviation: f64,
    pub degrees: f64,
    /// Earlier runs of the specimen and of its family that it rests on.
    pub runs_of_specimen: usize,
    pub runs_of_family: usize,
    /// What the table does not know, in words.
    pub remarks: Vec<String>,
}

/// How the runs of a quantity scattered about what the fit says of them, in their own standard deviations: one value for each run.
pub(crate) type RunDeviations = BTreeMap<String, f64>;

impl PredictedQuantity {
    /// A value of the pooled scale in the unit.
    pub(crate) fn in_unit(&self, pooled: f64) -> f64 {
        match self.scale {
            EstimateScale::Relative => pooled.exp(),
            EstimateScale::Absolute => pooled,
        }
    }

    /// Ends of the central interval that holds `share` of the prediction, in the unit.
    pub(crate) fn interval(&self, share: f64) -> [f64; 2] {
        let half = self.pooled_deviation * student_quantile(self.degrees, 0.5 + 0.5 * share);
        [-half, half].map(|d| self.in_unit(self.pooled_mean + d))
    }

    /// Share of the prediction within the smallest central interval that holds an estimate, 0 to 1.
    pub(crate) fn level_of(&self, estimate: f64) -> f64 {
        let pooled = match self.scale {
            EstimateScale::Relative => estimate.ln(),
            EstimateScale::Absolute => estimate,
        };
        student_within(
            self.degrees,
            ((pooled - self.pooled_mean) / self.pooled_deviation).abs(),
        )
    }
}

/// A quantity with the fit that predicts it.
pub(crate) struct QuantityPredictor<'d, 'r> {
    robust: RobustFit<'d, 'r>,
}

/// True if the runs of its family alone predict a run: if they are enough, and some were on its bench.
pub(crate) fn has_own_scatter(rows: &[&EstimateRow], next: &NextRun) -> bool {
    let own = || rows.iter().filter(|row| row.family == next.family);
    let specimens: BTreeSet<&str> = own().map(|row| row.specimen.as_str()).collect();
    let knows_bench = own().any(|row| row.bench == next.bench);
    own().count() >= OWN_SCATTER[0] && specimens.len() >= OWN_SCATTER[1] && knows_bench
}

/// The rows of one quantity that predict a run: those of its family alone, or all.
pub(crate) fn predicting_rows<'r>(rows: &[&'r EstimateRow], next: &NextRun) -> Vec<&'r EstimateRow> {
    let own_only = has_own_scatter(rows, next);
    let all = rows.iter().copied();
    all.filter(|row| !own_only || row.family == next.family).collect()
}

/// Predicts every quantity of a table that has enough runs, with how the runs of the family deviated. Sorted by name.
pub(crate) fn predict_quantities(
    rows: &[EstimateRow],
    next: &NextRun,
) -> Vec<(PredictedQuantity, RunDeviations)> {
    let mut of_quantity: BTreeMap<&str, Vec<&EstimateRow>> = BTreeMap::new();
    for row in rows {
        of_quantity.entry(&row.quantity).or_default().push(row);
    }
    let predicted = of_quantity.into_values().filter_map(|rows| {
        let mut data = QuantityData::of(predicting_rows(&rows, next));
        let predictor = QuantityPredictor::of(&mut data)?;
        Some((predictor.next(next)?, predictor.deviations(&next.family)))
    });
    predicted.collect()
}

impl<'d, 'r> QuantityPredictor<'d, 'r> {
    /// Fits the rows of one quantity; `None` if they are too few. Differences between operators are scatter from run to run here: who
    /// will run the test need not be known. Where runs scatter less than their standard errors say, these are made smaller.
    pub(in crate::fleet) fn of(data: &'d mut QuantityData<'r>) -> Option<QuantityPredictor<'d, 'r>> {
        let share = overstated(&RobustFit::of(data, false)?);
        data.known_variance
            .iter_mut()
            .for_each(|variance| *variance *= share);
        let robust = RobustFit::of(data, false)?;
        Some(QuantityPredictor { robust })
    }

    /// The quantity in the next run; `None` if its family has too few runs.
    pub(crate) fn next(&self, next: &NextRun) -> Option<PredictedQuantity> {
        let data = self.robust.design.of;
        let of_family: Vec<usize> = (0..data.rows.len())
            .filter(|i| data.rows[*i].family == next.family)
            .collect();
        if of_family.len() < FEWEST_RUNS {
            return None;
        }
        let specimen = data
            .specimens
            .iter()
            .position(|s| s.name == next.specimen && s.family == next.family);
        let mut place = NextPlace::new(&self.robust, specimen, next)?;
        let on_bench = |i: &usize| data.rows[*i].bench == next.bench;
        let there: Vec<usize> = of_family.iter().copied().filter(on_bench).collect();
        let typical = if there.len() >= TYPICAL_RUNS {
            &there
        } else {
            &of_family
        };
        place.more_variance += mean(typical.iter().map(|i| data.known_variance[*i]));
        let form = data.form_variance_of(&of_family);
        if there.is_empty() && form > 0.0 {
            place.more_variance += form;
            place.remarks.push(format!(
                "no run of family {} was on bench {}: the error of the model may be different there, so the interval is wider",
                next.family, next.bench
            ));
        }
        let entries = self.robust.design.entries(&place.effects);
        let contrast =
            (self.robust.fit).next_row(&self.robust.design.data, specimen, &entries, place.more_variance);
        let runs_of_specimen = specimen.map_or(0, |s| data.specimens[s].rows.len());
        let sound =
            contrast.estimate.is_finite() && contrast.std_error.is_finite() && contrast.std_error > 0.0;
        sound.then(|| self.predicted(&contrast, [runs_of_specimen, of_family.len()], place.remarks))
    }

    fn predicted(&self, contrast: &Contrast, runs: [usize; 2], remarks: Vec<String>) -> PredictedQuantity {
        let row = self.robust.design.of.rows[0];
        let mut predicted = PredictedQuantity {
            quantity: row.quantity.clone(),
            unit: row.unit.clone(),
            scale: row.scale,
            predicted: 0.0,
            low95: 0.0,
            high95: 0.0,
            pooled_mean: contrast.estimate,
            pooled_deviation: contrast.std_error,
            degrees: contrast.degrees,
            runs_of_specimen: runs[0],
            runs_of_family: runs[1],
            remarks,
        };
        let half = student_975(contrast.degrees) * contrast.std_error;
        [predicted.low95, predicted.predicted, predicted.high95] =
            [-half, 0.0, half].map(|d| predicted.in_unit(contrast.estimate + d));
        predicted
    }

    /// Deviations of the runs of a family from what the fit says of their specimen.
    pub(crate) fn deviations(&self, family: &str) -> RunDeviations {
        let (data, fit) = (&self.robust.design.data, &self.robust.fit);
        let rows = self
            .robust
            .design
            .of
            .rows
            .iter()
            .zip(residuals(&self.robust))
            .enumerate();
        let of_family = rows.filter(|(_, (row, _))| row.family == family);
        let deviation = |(i, (row, residual)): (usize, (&&EstimateRow, f64))| {
            let expected = (fit.variances.y + data.known_variance[i]).sqrt();
            (row.run_id.clone(), residual / expected)
        };
        of_family.map(deviation).collect()
    }
}

/// What each row differs by from its specimen at its place.
fn residuals(robust: &RobustFit) -> Vec<f64> {
    let (data, fit) = (&robust.design.data, &robust.fit);
    let mut residuals = vec![0.0; data.y.len()];
    for (number, rows) in data.blocks.iter().enumerate() {
        let own = fit.specimen(data, number).predicted.estimate;
        for i in rows.clone() {
            let expected: f64 = data.rows[i].iter().map(|&(c, x)| x * fit.effects[c]).sum();
            residuals[i] = data.y[i] - expected - own;
        }
    }
    residuals
}

/// Variance of the runs divided by the squares of their standard errors, at most 1. It is below 1 only where the fit finds no scatter
/// beyond the standard errors, and it is drawn towards 1 where the runs are few.
fn overstated(robust: &RobustFit) -> f64 {
    let (data, fit) = (&robust.design.data, &robust.fit);
    if fit.variances.y > 0.0 {
        return 1.0;
    }
    let squares = residuals(robust).into_iter().zip(&data.known_variance);
    let squares: f64 = squares
        .map(|(residual, variance)| residual * residual / variance)
        .sum();
    let degrees = data.y.len().saturating_sub(data.width + data.blocks.len()) as f64;
    ((squares + BELIEF_IN_ERRORS) / (degrees + BELIEF_IN_ERRORS)).min(1.0)
}

/// Where the next run stands in the design.
struct NextPlace {
    effects: Vec<(DesignTerm, f64)>,
    /// Variance of what the table does not know.
    more_variance: f64,
    remarks: Vec<String>,
}

impl NextPlace {
    /// `None` if the family is not among the rows.
    fn new(robust: &RobustFit, specimen: Option<usize>, next: &NextRun) -> Option<NextPlace> {
        let (design, data) = (&robust.design, robust.design.of);
        let bench = data.benches.names.iter().position(|name| *name == next.bench);
        let group = specimen
            .map(|s| data.specimens[s].group)
            .or_else(|| group_of(data, &next.family, bench.map(|b| data.part_of_bench[b])))?;
        let part = data.groups[group].part;
        let age = [next.age_cycles / 1000.0, data.years_at(next.started_utc)];
        let mut place = NextPlace {
            effects: vec![
                (DesignTerm::Group(group), 1.0),
                (DesignTerm::Cycles(None), age[0] - design.mean_age[0]),
                (DesignTerm::Years, age[1] - design.mean_age[1]),
            ],
            more_variance: 0.0,
            remarks: Vec::new(),
        };
        let benches = data.benches_of_part(part).into_iter().map(DesignTerm::Bench);
        let bench = bench
            .filter(|b| data.part_of_bench[*b] == part)
            .map(DesignTerm::Bench);
        place.level(robust, bench, benches.collect(), &format!("bench {}", next.bench));
        let batches = &data.groups[group].batches;
        let batch = batches.iter().position(|batch| *batch == next.batch);
        let batch = batch.map(|b| DesignTerm::Batch(group, b));
        let all = (0..batches.len()).map(|b| DesignTerm::Batch(group, b)).collect();
        place.level(robust, batch, all, &format!("batch \"{}\"", next.batch));
        place
            .effects
            .extend(specimen.into_iter().flat_map(|s| design.effects_of_specimen(s)));
        Some(place)
    }

    /// Adds the effect of a level. One that the table does not know is one of those that it knows: 0 on average, with their variance.
    fn level(&mut self, robust: &RobustFit, level: Option<DesignTerm>, all: Vec<DesignTerm>, what: &str) {
        if let Some(term) = level {
            self.effects.push((term, 1.0));
            return;
        }
        let effects = all
            .iter()
            .filter_map(|term| robust.design.contrast(&robust.fit, &[(*term, 1.0)]));
        let squares: Vec<f64> = effects.map(|effect| effect.estimate.powi(2)).collect();
        if squares.len() > 1 {
            self.more_variance += squares.iter().sum::<f64>() / (squares.len() - 1) as f64;
        }
        self.remarks.push(match squares.len() {
            0 | 1 => format!(
                "the table cannot compare {what} with others: the interval does not allow for its difference from them"
            ),
            n => format!(
                "the table cannot compare {what} with others: the interval allows for differences as large as those of the {n} known ones"
            ),
        });
    }
}

/// The group of a family, in the connected part of the bench if it has one there.
fn group_of(data: &QuantityData, family: &str, part: Option<usize>) -> Option<usize> {
    let of_family = |in_part: bool| {
        let mut groups = data.groups.iter();
        groups.position(|g| g.family == family && (!in_part || Some(g.part) == part))
    };
    of_family(true).or_else(|| of_family(false))
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), v| (count + 1.0, sum + v));
    if count > 0.0 { sum / count } else { 0.0 }
}
