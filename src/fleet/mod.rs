//! Pooled diagnosis: what the estimates of many runs say together about specimens, families, batches, benches, operators and age.
//!
//! A table of [`estimate`] rows goes quantity by quantity through [`quantity_data`] (who belongs to whom), [`design`] (the columns),
//! [`mixed_model`] (the fit), [`outliers`] (the fit that outliers do not spoil), [`levels`] and [`quantity`] (values and questions).
//! What is compared within a family goes through [`within_benches`] first, with the scatter of [`run_scatter`];
//! [`bench_form`] measures how far families disagree about a bench.
//! Specimens whose family has a drawing are judged by it in [`against_drawing`].
//! Then [`questions`] corrects all p values together, [`bench_cause`] explains the benches, and [`sentences`] and [`cannot_tell`] say
//! it in words. `docs/fleet.md` has the equations.

mod against_drawing;
mod bench_cause;
mod bench_form;
mod cannot_tell;
mod design;
pub(crate) mod diagnosed;
pub(crate) mod drawing;
pub(crate) mod estimate;
pub(crate) mod findings;
mod levels;
pub(crate) mod members;
mod mixed_model;
mod outliers;
pub(crate) mod predict;
mod quantity;
mod quantity_data;
mod questions;
mod run_scatter;
mod sentences;
#[cfg(test)]
mod tests;
mod within_benches;
mod wording;

use std::collections::{BTreeMap, BTreeSet};

use drawing::{DrawingError, Drawings};
use estimate::EstimateRow;
use findings::{DrawingCounts, FleetFindings, PooledValue, QuantityFindings, QuestionKind};
use outliers::{QuantityFits, RobustFit};
use quantity_data::QuantityData;
use questions::FAMILY_WISE_ERROR;

use crate::diagnose::{FORCE_AT_ZERO, PARTS_OF_FORCE_AT_ZERO};

/// What pooling is told beside the table.
#[derive(Debug, Clone, Default)]
pub(crate) struct FleetOptions {
    /// The bench that counts as right; without one, each bench is compared with the mean of the others.
    pub reference_bench: Option<String>,
    /// Leaves differences between operators in the scatter from run to run.
    pub ignore_operators: bool,
    /// What the drawings of the families allow.
    pub drawings: Option<Drawings>,
}

/// Why a table cannot be pooled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FleetError {
    /// The table has no rows.
    #[error("the table has no rows: add one row for each quantity of each run")]
    Empty,
    /// Rows that must agree do not.
    #[error("{of} has {what} {}: correct one of them", .said.join(" and "))]
    Contradiction {
        /// Specimen or quantity, with its name.
        of: String,
        /// What should agree, such as "the unit".
        what: &'static str,
        /// The two values, each with its run.
        said: [String; 2],
    },
    /// The reference bench is not in the table.
    #[error("the reference bench {name} is not in the table, which has {known}: name one of them")]
    UnknownBench {
        /// The bench that was asked for.
        name: String,
        /// The benches of the table.
        known: String,
    },
    /// The drawings do not fit the table.
    #[error(transparent)]
    Drawing(#[from] DrawingError),
}

/// Pools a table. The order of its rows does not matter.
pub(crate) fn pool(rows: &[EstimateRow], options: &FleetOptions) -> Result<FleetFindings, FleetError> {
    check(rows, options)?;
    let reference = options.reference_bench.as_deref();
    let mut rows_of: BTreeMap<&str, Vec<&EstimateRow>> = BTreeMap::new();
    for row in rows {
        rows_of.entry(&row.quantity).or_default().push(row);
    }
    let mut data: Vec<QuantityData> = rows_of.into_values().map(QuantityData::of).collect();
    let operators = !options.ignore_operators;
    let compared = within_benches::comparisons(&data, operators);
    // A table with too few rows for a bench effect of each family has one for all.
    let fit_within =
        |data| RobustFit::within_benches(data, operators).or_else(|| RobustFit::of(data, operators));
    let within: Vec<Option<RobustFit>> = compared.iter().map(fit_within).collect();
    let share = bench_form::bench_form_share(&within.iter().flatten().collect::<Vec<_>>());
    for (data, compared) in data.iter_mut().zip(&compared) {
        data.known_variance.clone_from(&compared.known_variance);
        data.bench_form_share = share;
    }
    let mut fits = Vec::new();
    let mut too_few: Vec<&str> = Vec::new();
    for (data, within) in data.iter().zip(within) {
        match RobustFit::of(data, operators).zip(within) {
            Some((lab, within)) => fits.push(QuantityFits { lab, within }),
            None => too_few.push(&data.rows[0].quantity),
        }
    }
    let (quantities, questions) = answered(&fits, options);
    let drawings = options.drawings.as_ref();
    let mut cannot_tell = cannot_tell::cannot_tell(&fits, &too_few);
    cannot_tell.extend(
        drawings
            .into_iter()
            .flat_map(|d| not_judged(rows, d, &quantities)),
    );
    let count = |name: fn(&EstimateRow) -> &str| {
        let names: BTreeSet<&str> = rows.iter().map(name).filter(|n| !n.is_empty()).collect();
        names.len()
    };
    Ok(FleetFindings {
        rows: rows.len(),
        specimens: count(|row| &row.specimen),
        families: count(|row| &row.family),
        benches: count(|row| &row.bench),
        operators: count(|row| &row.operator),
        questions,
        family_wise_error: FAMILY_WISE_ERROR,
        findings: sentences::sentences(&quantities, reference),
        against_drawings: drawings.map(|_| DrawingCounts::of(&quantities)),
        worth_a_look: sentences::worth_a_look(&quantities),
        bench_causes: bench_cause::bench_causes(&fits, &quantities, reference),
        cannot_tell,
        quantities,
    })
}

/// All values of all quantities, with the answers to the questions about them and the number of questions.
fn answered(fits: &[QuantityFits], options: &FleetOptions) -> (Vec<QuantityFindings>, usize) {
    let reference = options.reference_bench.as_deref();
    let mut quantities: Vec<QuantityFindings> = fits
        .iter()
        .map(|fit| quantity::quantity_findings(fit, reference))
        .collect();
    leave_unasked(&mut quantities);
    if let Some(drawings) = &options.drawings {
        for (fit, quantity) in fits.iter().zip(&mut quantities) {
            quantity.against_drawing = against_drawing::judged(&fit.lab, drawings, reference);
        }
    }
    let questions = questions::answer(quantities.iter_mut().flat_map(asked).collect());
    against_drawing::conclude(&mut quantities);
    mark_worth_a_look(&mut quantities);
    (quantities, questions)
}

/// What the drawings limit and the table cannot judge.
fn not_judged(rows: &[EstimateRow], drawings: &Drawings, quantities: &[QuantityFindings]) -> Vec<String> {
    let specimens: BTreeSet<(&str, &str)> = rows
        .iter()
        .map(|row| (row.family.as_str(), row.specimen.as_str()))
        .collect();
    let specimens: Vec<(&str, &str)> = specimens.into_iter().collect();
    let names: BTreeSet<&str> = rows.iter().map(|row| row.quantity.as_str()).collect();
    let of_quantity = |name: &str| {
        let judged = quantities.iter().find(|q| q.quantity == name);
        let judged = judged.map_or(&[][..], |q| &q.against_drawing);
        against_drawing::not_judged(name, drawings, &specimens, judged)
    };
    let quantities = names.into_iter().filter_map(of_quantity);
    drawings
        .families_without_runs(rows)
        .into_iter()
        .chain(quantities)
        .collect()
}

/// True for one of the two parameters whose sum is another quantity of the table.
fn is_part_of_sum<'q>(quantity: &str, mut all: impl Iterator<Item = &'q str>) -> bool {
    PARTS_OF_FORCE_AT_ZERO.contains(&quantity) && all.any(|other| other == FORCE_AT_ZERO)
}

/// Asks nothing about the two parts of a sum that is in the table, too: one run can hardly tell preload from zero of the force.
fn leave_unasked(quantities: &mut [QuantityFindings]) {
    let names: Vec<String> = quantities.iter().map(|q| q.quantity.clone()).collect();
    let parts = quantities
        .iter_mut()
        .filter(|q| is_part_of_sum(&q.quantity, names.iter().map(String::as_str)));
    parts.flat_map(asked).for_each(|(_, value)| value.p = None);
}

/// Marks the specimens that are no findings, not by their drawing either, but would be if specimens followed the normal law.
fn mark_worth_a_look(quantities: &mut [QuantityFindings]) {
    let mut questions: BTreeMap<QuestionKind, usize> = BTreeMap::new();
    for quantity in &*quantities {
        let asked = quantity.specimen_deviations.iter();
        let asked = asked.filter(|s| s.deviation.p.is_some()).count();
        *questions
            .entry(QuestionKind::about_specimens(quantity.role))
            .or_default() += asked;
    }
    for quantity in quantities {
        let of_kind = questions[&QuestionKind::about_specimens(quantity.role)];
        let out = |name: &str| {
            let mut judged = quantity.against_drawing.iter();
            judged.any(|j| j.specimen == name && j.value.found)
        };
        for specimen in &mut quantity.specimen_deviations {
            specimen.worth_a_look =
                specimen.is_worth_a_look(of_kind, FAMILY_WISE_ERROR) && !out(&specimen.specimen);
        }
    }
}

/// The values of a quantity that answer questions.
fn asked(quantity: &mut QuantityFindings) -> Vec<(QuestionKind, &mut PooledValue)> {
    let about_specimens = QuestionKind::about_specimens(quantity.role);
    let benches = quantity
        .benches
        .iter_mut()
        .map(|b| (QuestionKind::Bench, &mut b.effect));
    let operators = quantity.operators.iter_mut();
    let operators = operators.map(|o| (QuestionKind::Operator, &mut o.effect));
    let groups = quantity.groups.iter_mut().flat_map(|group| {
        let levels = std::iter::once(&mut group.level).chain(&mut group.on_least_sure_bench);
        let levels = levels.map(|value| (QuestionKind::Group, value));
        let batches = group.from_other_batches.iter_mut();
        levels.chain(batches.map(|value| (QuestionKind::Batch, value)))
    });
    let slopes = quantity
        .slopes
        .iter_mut()
        .map(|s| (QuestionKind::Age, &mut s.slope));
    let specimens = quantity.specimen_deviations.iter_mut();
    let specimens = specimens.map(|s| (about_specimens, &mut s.deviation));
    let drawings = quantity.against_drawing.iter_mut();
    let drawings = drawings.map(|j| (QuestionKind::Drawing, &mut j.value));
    benches
        .chain(operators)
        .chain(groups)
        .chain(slopes)
        .chain(specimens)
        .chain(drawings)
        .collect()
}

fn check(rows: &[EstimateRow], options: &FleetOptions) -> Result<(), FleetError> {
    if rows.is_empty() {
        return Err(FleetError::Empty);
    }
    agree(
        rows,
        "specimen",
        |r| &r.specimen,
        "the family",
        |r| r.family.clone(),
    )?;
    agree(
        rows,
        "specimen",
        |r| &r.specimen,
        "the batch",
        |r| format!("\"{}\"", r.batch),
    )?;
    agree(rows, "quantity", |r| &r.quantity, "the unit", |r| r.unit.clone())?;
    agree(
        rows,
        "quantity",
        |r| &r.quantity,
        "the scale",
        |r| r.scale.word().to_owned(),
    )?;
    options
        .drawings
        .as_ref()
        .map_or(Ok(()), |drawings| drawings.check(rows))?;
    let benches: BTreeSet<&str> = rows.iter().map(|row| row.bench.as_str()).collect();
    match options
        .reference_bench
        .as_deref()
        .filter(|name| !benches.contains(name))
    {
        Some(name) => Err(FleetError::UnknownBench {
            name: name.to_owned(),
            known: benches.into_iter().collect::<Vec<_>>().join(", "),
        }),
        None => Ok(()),
    }
}

/// Checks that all rows of one specimen or quantity have one value.
fn agree(
    rows: &[EstimateRow],
    noun: &str,
    name: fn(&EstimateRow) -> &str,
    what: &'static str,
    value: fn(&EstimateRow) -> String,
) -> Result<(), FleetError> {
    let mut first: BTreeMap<&str, &EstimateRow> = BTreeMap::new();
    for row in rows {
        let earlier = *first.entry(name(row)).or_insert(row);
        if value(earlier) != value(row) {
            return Err(FleetError::Contradiction {
                of: format!("{noun} {}", name(row)),
                what,
                said: [earlier, row].map(|row| format!("{} in run {}", value(row), row.run_id)),
            });
        }
    }
    Ok(())
}
