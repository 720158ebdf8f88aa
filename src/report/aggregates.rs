//! The report of a diagnosis from a table of peak forces and loop energies (no recordings): verdict, findings with their
//! figures, measured and model row by row, and what such a table cannot show.

use maud::{Markup, html};

use super::diagnosis::{STYLE, verdict_word};
use super::diagnosis_plots::{line, plot};
use super::figures::{figure, interval, percent, spaced, unbroken};
use super::html::{document, legend};
use super::svg::Ink;
use crate::diagnose::aggregates::{AggregateDiagnosis, Compared};
use crate::diagnose::diagnosis::{Finding, Value};

/// The report as HTML text.
pub(crate) fn page(diagnosis: &AggregateDiagnosis) -> String {
    let d = diagnosis;
    let body = html! {
        div class={ "verdict " (verdict_word(d.verdict)) } {
            h1 { (unbroken(&d.summary)) }
            p.quiet { "From " (d.rows.len()) " rows of " (d.columns[0]) " and " (d.columns[1]) "; no recordings." }
        }
        (at_a_glance(d))
        (alarms(&d.alarms))
        (findings("Missing physics", &d.effects))
        (findings("Physics that is not missing", &d.excluded))
        @for a in &d.alternatives {
            p { (spaced(&a.code)) " instead of " (spaced(&a.instead_of)) ": " (a.why) "; " (a.test) "." }
        }
        (rows(d))
        @if !d.parameters.is_empty() {
            h2 { "One set of parameters for all rows" }
            (values(&d.parameters))
        }
        (not_testable(d))
        @for remark in &d.remarks {
            p.quiet { (remark) }
        }
    };
    document("Diagnosis from a table", STYLE, &body)
}

/// The findings in one sentence each, beside the plot.
fn at_a_glance(d: &AggregateDiagnosis) -> Markup {
    let entries = [
        ("measured", Ink::Measured),
        (&d.models[0], Ink::Twin),
        (&d.models[2], Ink::Improved),
    ];
    html! {
        div.pair.block {
            div {
                ul {
                    @for f in d.effects.iter().chain(&d.excluded) { li { (f.statement) } }
                }
            }
            div { (rows_plot(d)) (legend(&entries, "")) }
        }
    }
}

fn alarms(alarms: &[String]) -> Markup {
    html! {
        @if !alarms.is_empty() {
            h2 { "Please check first" }
            ul {
                @for alarm in alarms { li { (alarm) } }
            }
        }
    }
}

fn findings(heading: &str, findings: &[Finding]) -> Markup {
    html! {
        @if !findings.is_empty() {
            h2 { (heading) }
            @for f in findings {
                div.block {
                    h3 { (spaced(&f.code)) ", confidence " (percent(f.confidence, 1)) }
                    (values(&f.parameters))
                }
            }
        }
    }
}

fn values(values: &[Value]) -> Markup {
    html! {
        table {
            tr { th { "Figure" } th.n { "Value" } th { "Unit" } th { "95 % interval" } }
            @for v in values {
                tr { td { (v.name) } td.n { (figure(v.value)) } td { (v.unit) } td { (interval(v)) } }
            }
        }
    }
}

fn rows(d: &AggregateDiagnosis) -> Markup {
    let pair = |p: Option<[f64; 2]>| {
        p.map_or("\u{2013}".to_owned(), |[a, b]| {
            format!("{}, {}", figure(a), figure(b))
        })
    };
    html! {
        h2 { "Row by row" }
        p { "Each cell: " (d.columns[0]) ", " (d.columns[1]) "." }
        table {
            tr {
                th {} th.n { "measured" }
                @for model in &d.models { th.n { (model) } }
            }
            @for row in &d.rows {
                tr {
                    td { (row.name) }
                    @for value in [Some(row.measured), row.model, row.optimum, row.ours] { td.n { (pair(value)) } }
                }
            }
        }
    }
}

fn not_testable(d: &AggregateDiagnosis) -> Markup {
    html! {
        h2 { "What this table cannot show" }
        table {
            tr { th { "Physics" } th { "Why" } }
            @for n in &d.not_testable {
                tr { td { (spaced(&n.code)) } td { (n.why) } }
            }
        }
    }
}

/// One value pair of a row.
type Pick = fn(&Compared) -> Option<[f64; 2]>;

/// The rows as points. The points of one loop are connected in their order. Tests are connected for each mounting, in the
/// order of their peak force.
fn rows_plot(d: &AggregateDiagnosis) -> Markup {
    let tests = d.columns[0].starts_with("peak force");
    let group = |r: &Compared| {
        if tests {
            r.name.split(", ").next().unwrap_or("").to_owned()
        } else {
            String::new()
        }
    };
    let mut groups: Vec<String> = d.rows.iter().map(group).collect();
    groups.dedup();
    let picks: [(Ink, Pick); 3] = [
        (Ink::Measured, |r| Some(r.measured)),
        (Ink::Twin, |r| r.model),
        (Ink::Improved, |r| r.ours),
    ];
    let mut curves = Vec::new();
    for (ink, pick) in picks {
        for name in &groups {
            let rows = d.rows.iter().filter(|r| group(r) == *name);
            let mut points: Vec<(f64, f64)> = rows.filter_map(|r| pick(r).map(|[x, y]| (x, y))).collect();
            if tests {
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
            curves.push(line(points, ink));
        }
    }
    plot(&d.columns[0], &d.columns[1], &curves, &[])
}
