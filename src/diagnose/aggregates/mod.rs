//! Recordings of which only aggregates are known: peak force and loop energy of each test, or a few points of one loop.
//!
//! - `table` what the files hold · `rows` findings from tests by the `laws` · `points` findings from one loop · `regression` lines and intervals
//!
//! Two numbers a test hide the loop's shape. What the rows can say is how the loss goes with rate, load and stroke, each as an
//! exponent or a slope with its interval; everything that lives in the shape is answered "not testable".

mod laws;
mod points;
mod regression;
mod rows;
mod table;

use serde::Serialize;

pub(crate) use table::{TableError, TableReader, TableRow, TargetsTable};

use super::diagnosis::{
    Alternative, Finding, ImprovedModel, Location, NextTest, NotTestable, Value, Verdict,
};
use crate::effect::EFFECTS;
use crate::identify::IdentifyError;
use crate::papers::first::Two;

/// Errors of whole curves and on data that no parameter was fitted on are left out; the others are of the worst row.
type Errors = super::diagnosis::Errors<Option<f64>>;
type FitErrors = super::diagnosis::FitErrors<Option<f64>>;

/// One line of the table of rows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Compared {
    /// Mounting and test.
    pub name: String,
    /// Columns' units: N and J for tests, mm and N for points.
    pub measured: [f64; 2],
    /// The baseline's.
    pub model: Option<[f64; 2]>,
    /// The reported optimum's.
    pub optimum: Option<[f64; 2]>,
    /// The believable set's.
    pub ours: Option<[f64; 2]>,
}

/// All of it: the fields of contracts.md and what stands beside them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct AggregateDiagnosis {
    /// In one word.
    pub verdict: Verdict,
    /// In one sentence.
    pub summary: String,
    /// What is missing; the parameters are evidence: figures computed from the rows.
    pub effects: Vec<Finding>,
    /// What it could be instead.
    pub alternatives: Vec<Alternative>,
    /// Where; empty for tests known by two numbers.
    pub location: Vec<Location>,
    /// How good.
    pub fit: FitErrors,
    /// None: without a curve no profile can be weighed.
    pub next_test: Option<NextTest>,
    /// Physics that the rows say is not what is missing.
    pub excluded: Vec<Finding>,
    /// Impossible parameters and rows that contradict one another: findings in themselves.
    pub alarms: Vec<String>,
    /// The figures of the alarms, with intervals.
    pub alarm_figures: Vec<Value>,
    /// What aggregates cannot show.
    pub not_testable: Vec<NotTestable>,
    /// Headings of the pairs in `rows`.
    pub columns: [String; 2],
    /// What `model`, `optimum` and `ours` of a row are.
    pub models: [String; 3],
    /// Row by row.
    pub rows: Vec<Compared>,
    /// The believable set, identified on all rows together.
    pub parameters: Vec<Value>,
    /// The believable set as a model for twin, simulator and mock rig: mounting and model.
    pub improved: Vec<(String, ImprovedModel)>,
    /// What was left out of the files.
    pub remarks: Vec<String>,
}

/// Why there is no diagnosis of a table.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AggregateError {
    /// A file cannot be read.
    #[error(transparent)]
    TargetsTable(#[from] TableError),
    /// Nothing in it.
    #[error("no file holds a test or a point: {0}")]
    Empty(String),
    /// Tests that nothing stands beside.
    #[error(
        "{name}: no model stands beside the tests: add rows with source \"simulation\", or the columns motion, stroke_mm, \
         frequency_hz, valley_mm and duration_s, so that the baseline can run them"
    )]
    NoModel {
        /// First test without.
        name: String,
    },
    /// The fit.
    #[error(transparent)]
    Fit(#[from] IdentifyError),
}

/// Runs the baseline over tests of which all the motion is told: one pair a row.
pub(crate) type Simulate<'a> = dyn FnMut(&[TableRow]) -> Result<Vec<Two>, IdentifyError> + 'a;

/// Diagnoses a table. `simulate` is asked where the table has no model of its own.
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
        let remark = "the loop's points were left out: give them in a call of their own";
        table.remarks.push(remark.to_owned());
    }
    if table.rows.iter().any(|r| r.model.is_none()) {
        if let Some(row) = table.rows.iter().find(|r| r.motion.is_none()) {
            let name = format!("{}, {}", row.mount, row.name);
            return Err(AggregateError::NoModel { name });
        }
        let given = simulate(&table.rows)?;
        for (row, two) in table.rows.iter_mut().zip(given) {
            row.model = Some(two);
        }
    }
    Ok(rows::diagnose(&table, threads, progress)?)
}

/// Codes that no finding is about, and why: `why` knows those that a table of this kind can show.
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

/// Of several relative errors the one largest in size.
fn worst(errors: impl Iterator<Item = f64>) -> Option<f64> {
    errors
        .filter(|e| e.is_finite())
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))
}
