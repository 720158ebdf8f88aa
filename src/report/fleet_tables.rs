//! The tables behind the plots of the fleet report, as CSV. `docs/fleet.md` describes the columns.

use crate::fleet::estimate::EstimateScale;
use crate::fleet::findings::{
    DrawingJudgement, FleetFindings, GroupLevel, LevelEffect, PooledValue, QuantityFindings,
};

/// Columns that every table ends with.
const VALUE_COLUMNS: [&str; 8] = [
    "unit",
    "value",
    "low95",
    "high95",
    "degrees",
    "p",
    "adjusted_p",
    "found",
];

/// Name and text of each table.
pub(crate) fn tables(findings: &FleetFindings) -> Vec<(&'static str, String)> {
    vec![
        (BENCHES, levels(findings, "bench", |q| &q.benches)),
        (OPERATORS, levels(findings, "operator", |q| &q.operators)),
        (GROUPS, groups(findings)),
        (SLOPES, slopes(findings)),
        (SPECIMENS, specimens(findings)),
        (DRAWINGS, drawings(findings)),
    ]
}

/// Names of the tables.
pub(super) const BENCHES: &str = "benches.csv";
pub(super) const OPERATORS: &str = "operators.csv";
pub(super) const GROUPS: &str = "groups.csv";
pub(super) const SLOPES: &str = "slopes.csv";
pub(super) const SPECIMENS: &str = "specimens.csv";
/// Every specimen that was judged by its drawing.
pub(crate) const DRAWINGS: &str = "drawings.csv";

/// Unit of a difference: a fraction for a relative quantity.
fn difference_unit(quantity: &QuantityFindings) -> &str {
    match quantity.scale {
        EstimateScale::Relative => "1",
        EstimateScale::Absolute => &quantity.unit,
    }
}

fn value_cells(unit: &str, value: &PooledValue) -> Vec<String> {
    let optional = |p: Option<f64>| p.map_or(String::new(), |p| p.to_string());
    vec![
        unit.to_owned(),
        value.value.to_string(),
        value.low95.to_string(),
        value.high95.to_string(),
        value.degrees.to_string(),
        optional(value.p),
        optional(value.adjusted_p),
        value.found.to_string(),
    ]
}

fn table(columns: &[&str], rows: Vec<Vec<String>>) -> String {
    let header = columns.iter().chain(&VALUE_COLUMNS).map(|c| (*c).to_owned());
    let lines = std::iter::once(header.collect()).chain(rows);
    let line = |cells: Vec<String>| cells.iter().map(|c| cell(c)).collect::<Vec<_>>().join(",") + "\n";
    lines.map(line).collect()
}

/// A cell, quoted where a name needs it.
pub(super) fn cell(text: &str) -> String {
    match text.contains(['"', ',', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}

fn levels(findings: &FleetFindings, noun: &str, of: fn(&QuantityFindings) -> &[LevelEffect]) -> String {
    let rows = findings.quantities.iter().flat_map(|q| {
        of(q).iter().map(|level| {
            let own = [&q.quantity, &level.name, &level.against.join("; ")].map(Clone::clone);
            [own.to_vec(), value_cells(difference_unit(q), &level.effect)].concat()
        })
    });
    table(&["quantity", noun, "against"], rows.collect())
}

fn groups(findings: &FleetFindings) -> String {
    let mut rows = Vec::new();
    for q in &findings.quantities {
        for group in &q.groups {
            let mut add = |what: &str, unit: &str, value: &PooledValue| {
                rows.push([group_cells(q, group, what), value_cells(unit, value)].concat());
            };
            add("level", &q.unit, &group.level);
            if let Some(value) = &group.on_least_sure_bench {
                add("on_least_sure_bench", &q.unit, value);
            }
            if let Some(value) = &group.from_other_batches {
                add("from_other_batches", difference_unit(q), value);
            }
        }
    }
    let columns = [
        "quantity",
        "family",
        "batch",
        "benches",
        "specimens",
        "runs",
        "what",
    ];
    table(&columns, rows)
}

fn group_cells(quantity: &QuantityFindings, group: &GroupLevel, what: &str) -> Vec<String> {
    vec![
        quantity.quantity.clone(),
        group.family.clone(),
        group.batch.clone().unwrap_or_default(),
        group.benches.join("; "),
        group.specimens.to_string(),
        group.runs.to_string(),
        what.to_owned(),
    ]
}

fn slopes(findings: &FleetFindings) -> String {
    let rows = findings.quantities.iter().flat_map(|q| {
        q.slopes.iter().map(|slope| {
            let family = slope.family.clone().unwrap_or_default();
            let own = vec![q.quantity.clone(), family, slope.per.word().to_owned()];
            [own, value_cells(difference_unit(q), &slope.slope)].concat()
        })
    });
    table(&["quantity", "family", "per"], rows.collect())
}

fn specimens(findings: &FleetFindings) -> String {
    let rows = findings.quantities.iter().flat_map(|q| {
        q.specimen_deviations.iter().map(|s| {
            let own = vec![
                q.quantity.clone(),
                s.specimen.clone(),
                s.family.clone(),
                s.batch.clone(),
                s.benches.join("; "),
                s.runs.to_string(),
                s.deletion_t.to_string(),
            ];
            [own, value_cells(difference_unit(q), &s.deviation)].concat()
        })
    });
    let columns = [
        "quantity",
        "specimen",
        "family",
        "batch",
        "benches",
        "runs",
        "deletion_t",
    ];
    table(&columns, rows.collect())
}

fn drawings(findings: &FleetFindings) -> String {
    let rows = findings.quantities.iter().flat_map(|q| {
        let cells =
            |j: &DrawingJudgement| [drawing_cells(&q.quantity, j), value_cells(&q.unit, &j.value)].concat();
        q.against_drawing.iter().map(cells)
    });
    let columns = [
        "quantity",
        "specimen",
        "family",
        "batch",
        "benches",
        "runs",
        "nominal",
        "nominal_from",
        "at_least",
        "at_most",
        "verdict",
        "remark",
    ];
    table(&columns, rows.collect())
}

fn drawing_cells(quantity: &str, judgement: &DrawingJudgement) -> Vec<String> {
    let optional = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
    let from = match (judgement.nominal, judgement.nominal_is_family_mean) {
        (None, _) => "",
        (_, true) => "family mean",
        (_, false) => "drawing",
    };
    vec![
        quantity.to_owned(),
        judgement.specimen.clone(),
        judgement.family.clone(),
        judgement.batch.clone(),
        judgement.benches.join("; "),
        judgement.runs.to_string(),
        optional(judgement.nominal),
        from.to_owned(),
        optional(judgement.at_least),
        optional(judgement.at_most),
        judgement.verdict.words().to_owned(),
        judgement.remark.clone().unwrap_or_default(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fleet::tests::findings;

    #[test]
    fn every_table_is_read_as_it_was_meant() {
        let findings = findings();
        for (name, text) in tables(&findings) {
            let mut reader = csv::Reader::from_reader(text.as_bytes());
            let columns: Vec<String> = reader.headers().expect(name).iter().map(str::to_owned).collect();
            assert!(
                columns.ends_with(&VALUE_COLUMNS.map(str::to_owned)),
                "{name}: {columns:?}"
            );
            let rows: Vec<csv::StringRecord> = reader.records().map(|r| r.expect(name)).collect();
            if name == BENCHES {
                assert_eq!(
                    rows[0].iter().take(5).collect::<Vec<_>>(),
                    ["rate_n_per_mm", "B, \"2\"", "B1; B3", "1", "0.01"]
                );
            }
            assert_eq!(rows.is_empty(), name == OPERATORS, "{name}");
        }
    }
}
