//! Findings from tests that are known by peak force and loop energy, and one set of leaf-pack parameters for all of them.
//! The `laws` find the physics; the fit of the leaf pack is in `identify::leaf_pack_rows`.

use super::laws::{Strokes, constant, load, power_law, rate, viscous};
use super::table::{Fitted, TableRow, TargetsTable, belief, mounts};
use super::{AggregateDiagnosis, AggregateErrors, Compared, fitted_values, not_testable, worst};
use crate::diagnose::diagnosis::{ImprovedModel, Value, Verdict};
use crate::identify::IdentifyError;
use crate::identify::leaf_pack_rows::{
    ALLOWED, AmplitudeReading, MOUNTS, MountTest, RowFit, RowFitOptions, TESTS, TestFigures,
    fit_within_ranges, mount_index, mount_name,
};
use crate::identify::targets::Aggregate;
use crate::model::leaf_pack::{self, Mounting};

/// An adequate model misses no test by more than these relative errors of peak force and loop energy.
const ADEQUATE: [f64; 2] = ALLOWED;
/// Tests with more scatter about a power law of force and rate are inconsistent.
const MOST_SCATTER: f64 = 0.1;
/// An optimum was fitted to a test if it meets both figures within this relative error.
const MATCHED: f64 = 0.01;

pub(super) fn diagnose(
    table: &TargetsTable,
    threads: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<AggregateDiagnosis, IdentifyError> {
    let mut out = without_findings(table);
    if errors(&table.rows, |r| r.model).iter().all(within) {
        out.verdict = Verdict::Adequate;
        out.summary = format!(
            "The model meets every test within {:.0} % of peak force and {:.0} % of loop energy. Two figures per test cannot show more.",
            100.0 * ADEQUATE[0],
            100.0 * ADEQUATE[1]
        );
        return Ok(out);
    }
    impossible(table, &mut out);
    if !find(&table.rows, &mut out) {
        return Ok(out);
    }
    if let Some(measured) = standard_tests(&table.rows) {
        let options = RowFitOptions {
            reading: AmplitudeReading::Whole,
            trough_mm: None,
            threads,
        };
        let fits = fit_within_ranges(&measured, &options, progress)?;
        if let Some(both) = fits.last() {
            add_fit(both, &mut out);
        }
    }
    conclude(&mut out);
    Ok(out)
}

/// Findings by the laws. False where the tests follow no law; the summary then says why.
fn find(rows: &[TableRow], out: &mut AggregateDiagnosis) -> bool {
    let (measured, model) = (
        power_law(rows, |r| Some(r.measured)),
        power_law(rows, |r| r.model),
    );
    let Some(measured) = measured else {
        out.summary = "Model and tests differ, but the tests are too few to show how the loss depends on load and rate: add tests \
                       at other strokes and rates."
            .to_owned();
        return false;
    };
    if measured.scatter > MOST_SCATTER {
        out.summary = format!(
            "The tests are inconsistent: their loop energies scatter by {:.0} % about any law of peak force and rate. Check that each \
             loop energy is in the row of its own peak force.",
            100.0 * measured.scatter
        );
        out.alarms.push(out.summary.clone());
        return false;
    }
    let rate = rate(rows, &measured, model.as_ref(), out);
    let flat = viscous(rows, &measured, out) || rate;
    if flat {
        let strokes: Vec<_> = mounts(rows).into_iter().map(|m| Strokes::new(rows, m)).collect();
        load(&strokes, out);
        constant(&strokes, out);
    }
    out.not_testable = not_testable(&out.effects, &out.excluded, why);
    true
}

fn without_findings(table: &TargetsTable) -> AggregateDiagnosis {
    let pair = |a: Aggregate| [a.peak_force_n, a.loop_energy_j];
    let optimum = |row: &TableRow| {
        let fitted = table.fitted.iter().find(|f| fitted_to(f, row));
        fitted.map(|f| pair(f.reach))
    };
    let rows = table
        .rows
        .iter()
        .map(|r| Compared {
            name: format!("{}, {}", r.mount, r.name),
            measured: pair(r.measured),
            model: r.model.map(pair),
            optimum: optimum(r),
            ours: None,
        })
        .collect();
    let mut out = AggregateDiagnosis::new(
        ["peak force in N", "loop energy in J"],
        ["model", "its reported optimum", "leaf pack fitted"],
        rows,
        why,
        &table.remarks,
    );
    out.fit.baseline = worst_errors(&errors(&table.rows, |r| r.model));
    out
}

/// The errors of the worst test, from pairs of relative errors.
fn worst_errors(errors: &[[f64; 2]]) -> AggregateErrors {
    AggregateErrors {
        peak_force_error: worst(errors.iter().map(|e| e[0])),
        loop_energy_error: worst(errors.iter().map(|e| e[1])),
        ..AggregateErrors::default()
    }
}

/// True where an optimum was fitted to a test: same mounting, both figures met.
fn fitted_to(fitted: &Fitted, row: &TableRow) -> bool {
    let near = |a: f64, b: f64| (a / b - 1.0).abs() < MATCHED;
    fitted.mount == row.mount
        && near(fitted.reach.peak_force_n, row.measured.peak_force_n)
        && near(fitted.reach.loop_energy_j, row.measured.loop_energy_j)
}

/// Relative errors of peak force and loop energy, for the tests that have the figures.
fn errors(rows: &[TableRow], of: impl Fn(&TableRow) -> Option<Aggregate>) -> Vec<[f64; 2]> {
    rows.iter()
        .filter_map(|r| Some(of(r)?.errors(&r.measured)))
        .collect()
}

fn within(errors: &[f64; 2]) -> bool {
    errors.iter().zip(ADEQUATE).all(|(e, most)| e.abs() <= most)
}

/// Alarms for reported optima that meet their figures with values outside belief.
fn impossible(table: &TargetsTable, out: &mut AggregateDiagnosis) {
    let hit = |f: &&Fitted| table.rows.iter().any(|r| fitted_to(f, r));
    for fitted in table.fitted.iter().filter(hit) {
        for &(name, value) in &fitted.parameters {
            let Some([low, high]) = belief(name) else { continue };
            if (low..=high).contains(&value) {
                continue;
            }
            // A value outside by more than the width of the range is impossible for steel leaves; a nearer one is doubtful.
            let width = high - low;
            if value > high + width || value < low - width {
                let count = fitted.parameters.len();
                let proof = if count < 2 { "little" } else { "nothing" };
                out.alarms.push(format!(
                    "The reported fit has an impossible parameter: {name} = {value} ({}), where {low} to {high} is possible. It fits \
                     {count} parameters to 2 figures, so that the good match proves {proof}.",
                    fitted.mount
                ));
            } else {
                out.alarms.push(format!(
                    "{name} = {value} ({}) is outside its plausible range {low} to {high}.",
                    fitted.mount
                ));
            }
            out.alarm_figures.push(Value {
                name: format!("{name}, {}", fitted.mount),
                value,
                unit: String::new(),
                ci95: None,
            });
        }
    }
    let friction = |f: &Fitted| f.parameters.iter().find(|p| p.0 == "interleaf_mu").map(|p| p.1);
    let hits: Vec<f64> = table.fitted.iter().filter(hit).filter_map(friction).collect();
    let (low, high) = hits.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
        (l.min(*v), h.max(*v))
    });
    if low < 0.0 && high > 0.0 {
        out.alarms.push(format!(
            "The reported fits give the same leaves a friction coefficient of {low} on one mounting and {high} on the other."
        ));
    }
}

fn why(code: &str) -> &'static str {
    match code {
        "rate_independent_friction" | "viscous_damping" => {
            "the tests do not determine the loss at several rates well enough, or the model agrees with it"
        }
        "load_dependent_friction" | "coulomb_friction" => {
            "the tests do not determine the loss over stroke and load well enough, or the model agrees with it"
        }
        "run_in" | "relaxation" | "sensor_drift" | "warming" => {
            "one loop energy per test does not show a change over time"
        }
        "channel_delay" => {
            "a delay adds to the loop energy as viscous damping does; two figures per test do not show the delay itself"
        }
        "inertia" => {
            "the peak forces of one stroke at two rates differ by less than the scatter of the tests"
        }
        _ => "it changes the shape of the loop, which peak force and loop energy do not show",
    }
}

/// Figures of the standard tests, where the table has exactly those, on both mountings.
fn standard_tests(rows: &[TableRow]) -> Option<TestFigures> {
    let find = |mount: &str, test: &MountTest| {
        let same = |r: &&TableRow| {
            r.mount == mount
                && r.stroke_mm == test.amplitude_mm
                && (r.frequency_hz / test.frequency_hz - 1.0).abs() < 1e-6
        };
        rows.iter().find(same).map(|r| r.measured)
    };
    let mut figures = TestFigures::default();
    for (pair, test) in figures.iter_mut().zip(&TESTS) {
        for mounting in MOUNTS {
            pair[mount_index(mounting)] = find(mount_name(mounting), test)?;
        }
    }
    (rows.len() == MOUNTS.len() * TESTS.len()).then_some(figures)
}

/// Adds the fitted leaf pack to the diagnosis.
fn add_fit(fit: &RowFit, out: &mut AggregateDiagnosis) {
    for row in &fit.rows {
        let name = format!("{}, {}", mount_name(row.mounting), row.name);
        if let Some(place) = out.rows.iter_mut().find(|r| r.name == name) {
            place.ours = Some([row.ours.peak_force_n, row.ours.loop_energy_j]);
        }
    }
    let errors: Vec<[f64; 2]> = fit.rows.iter().map(|r| r.errors()).collect();
    out.fit.improved = worst_errors(&errors);
    out.parameters = fitted_values(&fit.fit, |i| fit.fit.free[i]);
    out.improved = fit
        .case
        .mounts
        .iter()
        .filter_map(|&m| Some((mount_name(m).to_owned(), model_of(fit, m)?)))
        .collect();
    let at = fit.at_bounds();
    if !at.is_empty() {
        out.alarms.push(format!(
            "The fitted leaf pack has parameters at the end of their range: {}.",
            at.join(", ")
        ));
    }
    for miss in fit.misses() {
        out.alarms.push(format!("The fitted leaf pack misses {miss}."));
    }
}

/// The pack of a mounting as a model; `None` where the structure is no TOML table.
fn model_of(fit: &RowFit, mounting: Mounting) -> Option<ImprovedModel> {
    let (structure, values) = fit.pack(mounting);
    let names = leaf_pack::MODEL.parameters.iter().map(|p| p.name.to_owned());
    Some(ImprovedModel {
        model: leaf_pack::MODEL.name.to_owned(),
        parameters: names.zip(values.to_array()).collect(),
        structure: toml::Table::try_from(&structure).ok()?,
        effects: Vec::new(),
        law: None,
        force_zero_n: 0.0,
    })
}

fn conclude(out: &mut AggregateDiagnosis) {
    let codes: Vec<String> = out.effects.iter().map(|f| f.code.replace('_', " ")).collect();
    let impossible = match out.alarm_figures.is_empty() {
        true => "",
        false => "The reported fit has an impossible parameter. ",
    };
    if codes.is_empty() {
        out.summary = format!(
            "{impossible}Model and tests differ, but the tests do not show which physics is missing."
        );
        return;
    }
    out.verdict = Verdict::MissingPhysics;
    let excluded = match out.excluded.is_empty() {
        true => String::new(),
        false => " Viscous damping does not explain the difference.".to_owned(),
    };
    out.summary = format!("{impossible}The model lacks {}.{excluded}", codes.join(", "));
}
