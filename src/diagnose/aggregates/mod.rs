//! Diagnosis of tests of which only aggregates are known: peak force and loop energy per test, or a few points of one loop.
//!
//! - `table` reads the files · `rows` findings from tests, by the `laws` · `points` findings from one loop · `regression`
//!   coefficients with intervals
//!
//! Two figures per test do not show the loop's shape. They show how the loss depends on rate, load and stroke, each as an
//! exponent or a slope with its interval; effects that are in the shape are reported as not testable.

mod laws;
mod points;
mod regression;
mod rows;
mod table;

use serde::Serialize;

pub(crate) use table::{TableError, TableReader, TableRow, TargetsTable};

use super::diagnosis::{
    Alternative, Errors, Finding, FitErrors, ImprovedModel, Location, NextTest, NotTestable, Value, Verdict,
};
use crate::effect::EFFECTS;
use crate::identify::targets::Aggregate;
use crate::identify::{Fit, IdentifyError};

/// Errors of one model. Those that need whole curves are `None`; the others are those of the worst test.
type AggregateErrors = Errors<Option<f64>>;
/// Errors before and after, in the same way.
type AggregateFitErrors = FitErrors<Option<f64>>;

/// One line of the table of tests or points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Compared {
    /// Mounting and test, or branch and displacement.
    pub name: String,
    /// Measured pair: N and J for tests, mm and N for points.
    pub measured: [f64; 2],
    /// Pair of the model.
    pub model: Option<[f64; 2]>,
    /// Pair of the reported optimum, or of the printed values.
    pub optimum: Option<[f64; 2]>,
    /// Pair of our fit.
    pub ours: Option<[f64; 2]>,
}

/// The diagnosis: the fields of `diagnosis.json` with `--targets` (docs/formats.md).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct AggregateDiagnosis {
    /// Verdict in one word.
    pub verdict: Verdict,
    /// Verdict in one or two sentences.
    pub summary: String,
    /// Missing physics; the parameters are figures computed from the tests.
    pub effects: Vec<Finding>,
    /// Other explanations of the findings.
    pub alternatives: Vec<Alternative>,
    /// Places on the loop where model and points differ; empty for tests.
    pub location: Vec<Location>,
    /// Errors of the model and of our fit.
    pub fit: AggregateFitErrors,
    /// Always `None`: profiles are compared by whole curves.
    pub next_test: Option<NextTest>,
    /// Physics that the tests show not to be missing.
    pub excluded: Vec<Finding>,
    /// Impossible parameters and inconsistent tests.
    pub alarms: Vec<String>,
    /// Figures of the alarms, with intervals.
    pub alarm_figures: Vec<Value>,
    /// Physics that aggregates cannot show.
    pub not_testable: Vec<NotTestable>,
    /// Headings of the pairs in `rows`.
    pub columns: [String; 2],
    /// Names of `model`, `optimum` and `ours` of a row.
    pub models: [String; 3],
    /// Test by test, or point by point.
    pub rows: Vec<Compared>,
    /// Parameters of our fit to all rows together; may be empty.
    pub parameters: Vec<Value>,
    /// Our fit as a model for twin, simulator and mock rig: mounting and model.
    pub improved: Vec<(String, ImprovedModel)>,
    /// What was left out of the files, and why.
    pub remarks: Vec<String>,
}

impl AggregateDiagnosis {
    /// A diagnosis without findings.
    fn new(
        columns: [&str; 2],
        models: [&str; 3],
        rows: Vec<Compared>,
        why: impl Fn(&str) -> &'static str,
        remarks: &[String],
    ) -> Self {
        AggregateDiagnosis {
            verdict: Verdict::Unexplained,
            summary: String::new(),
            effects: Vec::new(),
            alternatives: Vec::new(),
            location: Vec::new(),
            fit: AggregateFitErrors::default(),
            next_test: None,
            excluded: Vec::new(),
            alarms: Vec::new(),
            alarm_figures: Vec::new(),
            not_testable: not_testable(&[], &[], why),
            columns: columns.map(str::to_owned),
            models: models.map(str::to_owned),
            rows,
            parameters: Vec::new(),
            improved: Vec::new(),
            remarks: remarks.to_vec(),
        }
    }
}

/// Why there is no diagnosis of a table.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AggregateError {
    /// A file that cannot be read.
    #[error(transparent)]
    TargetsTable(#[from] TableError),
    /// Files without tests and points.
    #[error("no file has a test or a point: {0}")]
    Empty(String),
    /// Tests without figures of a model.
    #[error(
        "{name}: the test has no row of a model: add rows with source \"simulation\", or the columns motion, stroke_mm, \
         frequency_hz, valley_mm and duration_s, so that the baseline can run the tests"
    )]
    NoModel {
        /// Mounting and name of the first such test.
        name: String,
    },
    /// A fit that cannot start.
    #[error(transparent)]
    Fit(#[from] IdentifyError),
}

/// Runs the baseline over tests that have a motion: one pair per test.
pub(crate) type Simulate<'a> = dyn FnMut(&[TableRow]) -> Result<Vec<Aggregate>, IdentifyError> + 'a;

/// Diagnoses a table. `simulate` is called where a test has no row of a model.
pub(crate) fn diagnose_table(
    mut table: TargetsTable,
    simulate: &mut Simulate<'_>,
    threads: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<AggregateDiagnosis, AggregateError> {
    let any_points = table.points.loading.len() + table.points.unloading.len() > 0;
    if table.rows.is_empty() && !any_points {
        return Err(AggregateError::Empty(table.remarks.join("; ")));
    }
    if table.rows.is_empty() {
        return Ok(points::diagnose(&table, threads)?);
    }
    if any_points {
        let remark = "the points of the loop are left out: diagnose them without the tests";
        table.remarks.push(remark.to_owned());
    }
    if table.rows.iter().any(|r| r.model.is_none()) {
        if let Some(row) = table.rows.iter().find(|r| r.motion.is_none()) {
            let name = format!("{}, {}", row.mount, row.name);
            return Err(AggregateError::NoModel { name });
        }
        let given = simulate(&table.rows)?;
        for (row, figures) in table.rows.iter_mut().zip(given) {
            row.model = Some(figures);
        }
    }
    Ok(rows::diagnose(&table, threads, progress)?)
}

/// Codes without a finding; `why` gives the reason for each.
fn not_testable(
    found: &[Finding],
    excluded: &[Finding],
    why: impl Fn(&str) -> &'static str,
) -> Vec<NotTestable> {
    let said = |code: &str| found.iter().chain(excluded).any(|f| f.code == code);
    EFFECTS
        .iter()
        .filter(|e| !said(e.code))
        .map(|e| NotTestable {
            code: e.code.to_owned(),
            surviving: 0.0,
            why: why(e.code).to_owned(),
        })
        .collect()
}

/// The relative error with the largest size, with its sign.
fn worst(errors: impl Iterator<Item = f64>) -> Option<f64> {
    errors
        .filter(|e| e.is_finite())
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// The parameters of a fit whose index is `shown`, as values of `diagnosis.json`.
fn fitted_values(fit: &Fit, shown: impl Fn(usize) -> bool) -> Vec<Value> {
    (0..fit.parameters.len())
        .filter(|&i| shown(i))
        .map(|i| Value {
            name: fit.parameters[i].name.to_owned(),
            value: fit.values[i],
            unit: fit.parameters[i].unit.to_owned(),
            ci95: fit.ci95[i],
        })
        .collect()
}
