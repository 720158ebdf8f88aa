//! Findings from tests that are known by peak force and loop energy: what may be said, and the believable set beside it.
//! The laws that say it are in `laws`.

use super::laws::{Strokes, constant, load, power_law, rate, viscous};
use super::table::{Fitted, TableRow, TargetsTable, belief};
use super::{AggregateDiagnosis, Compared, Errors, FitErrors, not_testable, worst};
use crate::diagnose::diagnosis::{ImprovedModel, Value, Verdict};
use crate::identify::IdentifyError;
use crate::model::leaf_pack::{self, Mounting};
use crate::papers::first::{
    self, AmplitudeReading, Choice, MOUNTS, PhysicsFit, Printed, ROWS, Two, believable, column, mount_name,
};

/// What a model may miss of a row (peak force, loop energy) and still be adequate.
const ADEQUATE: [f64; 2] = first::ALLOWED;
/// Rows that scatter more about a power law of force and rate contradict one another.
const MOST_SCATTER: f64 = 0.1;
/// An optimum "matches" its targets within this share.
const MATCHED: f64 = 0.01;

pub(super) fn diagnose(
    table: &TargetsTable,
    threads: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<AggregateDiagnosis, IdentifyError> {
    let mut out = blank(table);
    if errors(&table.rows, |r| r.model).iter().all(within) {
        out.verdict = Verdict::Adequate;
        out.summary = format!(
            "The model gives every row within {:.0} % of peak force and {:.0} % of loop energy; two numbers a row can ask no more.",
            100.0 * ADEQUATE[0],
            100.0 * ADEQUATE[1]
        );
        return Ok(out);
    }
    impossible(table, &mut out);
    let rows = &table.rows;
    let (measured, model) = (
        power_law(rows, |r| Some(r.measured)),
        power_law(rows, |r| r.model),
    );
    let Some(measured) = measured else {
        out.summary =
            "Model and rows differ, but there are too few rows to say how the loss goes with load and rate."
                .to_owned();
        return Ok(out);
    };
    if measured.scatter > MOST_SCATTER {
        out.summary = format!(
            "The rows contradict one another: their loop energies scatter by {:.0} % about any law of peak force and rate. Check \
             that each energy stands beside its own force.",
            100.0 * measured.scatter
        );
        out.alarms.push(out.summary.clone());
        return Ok(out);
    }
    let rate = rate(rows, &measured, model.as_ref(), &mut out);
    let flat = viscous(rows, &measured, &mut out) || rate;
    let strokes = mounts(rows)
        .into_iter()
        .map(|m| Strokes::new(rows, m))
        .collect::<Vec<_>>();
    if flat {
        load(&strokes, &mut out);
        constant(&strokes, &mut out);
    }
    out.not_testable = not_testable(&out.effects, &out.excluded, why);
    if let Some(printed) = like_the_paper(rows) {
        let choice = Choice {
            readings: vec![AmplitudeReading::Whole],
            threads,
            ..Choice::default()
        };
        let fits = believable(&printed, AmplitudeReading::Whole, &choice, &mut |_, share| {
            progress(share);
            true
        })?;
        if let Some(both) = fits.last() {
            ours(both, &mut out);
        }
    }
    conclude(&mut out);
    Ok(out)
}

fn blank(table: &TargetsTable) -> AggregateDiagnosis {
    let pair = |t: Two| [t.peak_n, t.loop_j];
    let of = |rows: &[[f64; 2]]| Errors {
        peak_force_error: worst(rows.iter().map(|e| e[0])),
        loop_energy_error: worst(rows.iter().map(|e| e[1])),
        ..Errors::default()
    };
    let optimum = |row: &TableRow| table.fitted.iter().find(|f| meant(f, row)).map(|f| pair(f.reach));
    AggregateDiagnosis {
        verdict: Verdict::Unexplained,
        summary: String::new(),
        effects: Vec::new(),
        alternatives: Vec::new(),
        location: Vec::new(),
        fit: FitErrors {
            baseline: of(&errors(&table.rows, |r| r.model)),
            ..FitErrors::default()
        },
        next_test: None,
        excluded: Vec::new(),
        alarms: Vec::new(),
        alarm_figures: Vec::new(),
        not_testable: not_testable(&[], &[], why),
        columns: ["peak force in N".to_owned(), "loop energy in J".to_owned()],
        models: ["model", "its reported optimum", "believable set"].map(str::to_owned),
        rows: table
            .rows
            .iter()
            .map(|r| Compared {
                name: format!("{}, {}", r.mount, r.name),
                measured: pair(r.measured),
                model: r.model.map(pair),
                optimum: optimum(r),
                ours: None,
            })
            .collect(),
        parameters: Vec::new(),
        improved: Vec::new(),
        remarks: table.remarks.clone(),
    }
}

/// An optimum is of a mounting's row if it was fitted to it: it hits both numbers.
fn meant(fitted: &Fitted, row: &TableRow) -> bool {
    let near = |a: f64, b: f64| (a / b - 1.0).abs() < MATCHED;
    fitted.mount == row.mount
        && near(fitted.reach.peak_n, row.measured.peak_n)
        && near(fitted.reach.loop_j, row.measured.loop_j)
}

fn errors(rows: &[TableRow], of: impl Fn(&TableRow) -> Option<Two>) -> Vec<[f64; 2]> {
    let error = |r: &TableRow| {
        let m = of(r)?;
        Some([
            m.peak_n / r.measured.peak_n - 1.0,
            m.loop_j / r.measured.loop_j - 1.0,
        ])
    };
    rows.iter().filter_map(error).collect()
}

fn within(errors: &[f64; 2]) -> bool {
    errors.iter().zip(ADEQUATE).all(|(e, most)| e.abs() <= most)
}

pub(super) fn mounts(rows: &[TableRow]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        if !names.contains(&row.mount.as_str()) {
            names.push(&row.mount);
        }
    }
    names
}

/// A reported optimum that hits its two numbers with a value that nothing can have.
fn impossible(table: &TargetsTable, out: &mut AggregateDiagnosis) {
    let hit = |f: &&Fitted| table.rows.iter().any(|r| meant(f, r));
    for fitted in table.fitted.iter().filter(hit) {
        for &(name, value) in &fitted.parameters {
            let Some([low, high]) = belief(name) else { continue };
            if (low..=high).contains(&value) {
                continue;
            }
            // Just outside is doubtful; further out than the belief is wide is no property of steel leaves.
            let width = high - low;
            if value > high + width || value < low - width {
                let count = fitted.parameters.len();
                let spare = if count < 2 { "few are" } else { "none is" };
                out.alarms.push(format!(
                    "The fit is bought with an impossible parameter: {name} = {value} with {}, where {low} to {high} can be. It meets 2 \
                     numbers with {count} parameters, {spare} left to contradict it: that it meets them proves nothing.",
                    fitted.mount
                ));
            } else {
                out.alarms.push(format!(
                    "{name} = {value} with {} is beyond what is believed, {low} to {high}.",
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
            "The same leaves would have a friction coefficient of {low} on one mounting and {high} on the other."
        ));
    }
}

fn why(code: &str) -> &'static str {
    match code {
        "rate_independent_friction" | "viscous_damping" => {
            "the rows do not tell the loss at several rates well enough, or the model has it right"
        }
        "load_dependent_friction" | "coulomb_friction" => {
            "the rows do not tell the loss over stroke and load well enough, or the model has it right"
        }
        "run_in" | "relaxation" | "sensor_drift" => "one number a test has no time in it",
        "channel_delay" => {
            "a delay adds to the loop energy as viscous loss does; two numbers a test cannot date the channels"
        }
        "inertia" => "peak force at two rates and one stroke differs by less than the rows scatter",
        _ => "it lives in the shape of the loop; peak force and loop energy hide that",
    }
}

/// The rows as Tables 2 and 3 of the first paper have them, in their order, if these are such rows.
fn like_the_paper(rows: &[TableRow]) -> Option<[Printed; 5]> {
    let find = |mount: &str, printed: &Printed| {
        let same = |r: &&TableRow| {
            r.mount == mount
                && r.stroke_mm == printed.amplitude_mm
                && (r.frequency_hz / printed.frequency_hz - 1.0).abs() < 1e-6
        };
        rows.iter().find(same)
    };
    let mut out = ROWS;
    for printed in &mut out {
        for mounting in MOUNTS {
            let row = find(mount_name(mounting), printed)?;
            printed.measured[column(mounting)] = row.measured;
            printed.simulated[column(mounting)] = row.model?;
        }
    }
    (rows.len() == 10).then_some(out)
}

fn ours(fit: &PhysicsFit, out: &mut AggregateDiagnosis) {
    for row in &fit.rows {
        let name = format!("{}, {}", mount_name(row.mounting), row.name);
        if let Some(place) = out.rows.iter_mut().find(|r| r.name == name) {
            place.ours = Some([row.ours.peak_n, row.ours.loop_j]);
        }
    }
    out.fit.improved = Errors {
        peak_force_error: worst(fit.rows.iter().map(|r| r.errors()[0])),
        loop_energy_error: worst(fit.rows.iter().map(|r| r.errors()[1])),
        ..Errors::default()
    };
    let free = fit.fit.free.iter();
    let values = fit
        .fit
        .parameters
        .iter()
        .zip(&fit.fit.values)
        .zip(&fit.fit.ci95)
        .zip(free);
    out.parameters = values
        .filter(|(_, free)| **free)
        .map(|(((p, value), ci95), _)| Value {
            name: p.name.to_owned(),
            value: *value,
            unit: p.unit.to_owned(),
            ci95: *ci95,
        })
        .collect();
    out.improved = fit
        .case
        .mounts
        .iter()
        .filter_map(|&m| Some((mount_name(m).to_owned(), model_of(fit, m)?)))
        .collect();
    let at = fit.at_bounds();
    if !at.is_empty() {
        out.alarms.push(format!(
            "The believable set stands at the end of what is believed in: {}.",
            at.join(", ")
        ));
    }
    for miss in fit.misses() {
        out.alarms.push(format!("The believable set misses {miss}."));
    }
}

/// None where the structure cannot be written, which a structure that was just run can.
fn model_of(fit: &PhysicsFit, mounting: Mounting) -> Option<ImprovedModel> {
    let (structure, values) = fit.pack(mounting);
    let names = leaf_pack::MODEL.parameters.iter().map(|p| p.name.to_owned());
    Some(ImprovedModel {
        model: leaf_pack::MODEL.name.to_owned(),
        parameters: names.zip(values.to_array()).collect(),
        structure: toml::Table::try_from(&structure).ok()?,
        effects: Vec::new(),
        force_zero_n: 0.0,
    })
}

fn conclude(out: &mut AggregateDiagnosis) {
    let codes: Vec<String> = out.effects.iter().map(|f| f.code.replace('_', " ")).collect();
    let bought = match out.alarm_figures.is_empty() {
        true => "",
        false => "The reported fit is bought with an impossible parameter. ",
    };
    if codes.is_empty() {
        out.summary = format!("{bought}Model and rows differ, and the rows do not say by which physics.");
        return;
    }
    out.verdict = Verdict::MissingPhysics;
    let excluded = match out.excluded.is_empty() {
        true => String::new(),
        false => " Viscous damping is not what is missing.".to_owned(),
    };
    out.summary = format!("{bought}The model lacks {}.{excluded}", codes.join(", "));
}
