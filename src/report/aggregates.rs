//! The report of a diagnosis from aggregates: verdict, findings with their figures, row by row, what two numbers hide.

use std::fmt::Write;

use super::diagnosis::{STYLE, figure, spaced, verdict_word};
use super::html::escape;
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::diagnose::aggregates::{AggregateDiagnosis, Compared};
use crate::diagnose::diagnosis::{Finding, Value};

/// The page.
pub(crate) fn page(diagnosis: &AggregateDiagnosis) -> String {
    let mut page = String::new();
    // Writing into a string cannot fail.
    let _ = write_page(&mut page, diagnosis);
    page
}

fn write_page(page: &mut String, d: &AggregateDiagnosis) -> std::fmt::Result {
    write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>Diagnosis from a table</title>\n<style>{STYLE}</style></head>\n<body>\n\
         <div class=\"verdict {}\"><h1>{}</h1>\n<p class=\"quiet\">From {} rows of {} and {}; no recordings.</p></div>\n",
        verdict_word(d.verdict),
        escape(&d.summary).replace(" %", "&nbsp;%"),
        d.rows.len(),
        escape(&d.columns[0]),
        escape(&d.columns[1])
    )?;
    at_a_glance(page, d)?;
    if !d.alarms.is_empty() {
        writeln!(page, "<h2>To be looked at first</h2>\n<ul>")?;
        for alarm in &d.alarms {
            writeln!(page, "<li>{}</li>", escape(alarm))?;
        }
        writeln!(page, "</ul>")?;
    }
    for (heading, findings) in [
        ("What is missing", &d.effects),
        ("What is not missing", &d.excluded),
    ] {
        if !findings.is_empty() {
            writeln!(page, "<h2>{heading}</h2>")?;
            findings.iter().try_for_each(|f| finding(page, f))?;
        }
    }
    for a in &d.alternatives {
        writeln!(
            page,
            "<p>{} instead of {}: {}; {}.</p>",
            spaced(&a.code),
            spaced(&a.instead_of),
            escape(&a.why),
            escape(&a.test)
        )?;
    }
    rows(page, d)?;
    if !d.parameters.is_empty() {
        writeln!(page, "<h2>One set of parameters for all rows</h2>")?;
        values(page, &d.parameters)?;
    }
    writeln!(
        page,
        "<h2>Not testable with these figures</h2>\n<table><tr><th>Physics</th><th>Why</th></tr>"
    )?;
    for n in &d.not_testable {
        writeln!(
            page,
            "<tr><td>{}</td><td>{}</td></tr>",
            spaced(&n.code),
            escape(&n.why)
        )?;
    }
    writeln!(page, "</table>")?;
    for remark in &d.remarks {
        writeln!(page, "<p class=\"quiet\">{}</p>", escape(remark))?;
    }
    writeln!(page, "</body>\n</html>")
}

fn finding(page: &mut String, f: &Finding) -> std::fmt::Result {
    writeln!(
        page,
        "<div class=\"block\"><h3>{}, {:.1} % sure</h3>",
        spaced(&f.code),
        100.0 * f.confidence
    )?;
    values(page, &f.parameters)?;
    writeln!(page, "</div>")
}

fn values(page: &mut String, values: &[Value]) -> std::fmt::Result {
    writeln!(
        page,
        "<table><tr><th>Figure</th><th class=\"n\">Value</th><th>Unit</th><th>95 % interval</th></tr>"
    )?;
    for v in values {
        let interval = v.ci95.map_or("not given by these data".to_owned(), |[a, b]| {
            format!("{} to {}", figure(a), figure(b))
        });
        writeln!(
            page,
            "<tr><td>{}</td><td class=\"n\">{}</td><td>{}</td><td>{interval}</td></tr>",
            escape(&v.name),
            figure(v.value),
            escape(&v.unit)
        )?;
    }
    writeln!(page, "</table>")
}

/// What was found in a sentence each, beside the plot.
fn at_a_glance(page: &mut String, d: &AggregateDiagnosis) -> std::fmt::Result {
    writeln!(page, "<div class=\"pair block\"><div><ul>")?;
    for f in d.effects.iter().chain(&d.excluded) {
        writeln!(page, "<li>{}</li>", escape(&f.statement))?;
    }
    let entries = [
        ("measured", Ink::Measured),
        (&d.models[0], Ink::Twin),
        (&d.models[2], Ink::Improved),
    ];
    writeln!(page, "</ul></div><div>{}<p class=\"legend\">", plot(d))?;
    for (name, ink) in entries {
        write!(
            page,
            "<span><i style=\"background:{}\"></i>{}</span>",
            ink.css(),
            escape(name)
        )?;
    }
    writeln!(page, "</p></div></div>")
}

fn rows(page: &mut String, d: &AggregateDiagnosis) -> std::fmt::Result {
    writeln!(
        page,
        "<h2>Row by row</h2>\n<p>Each pair: {}, {}.</p>\n<table><tr><th></th><th class=\"n\">measured</th><th class=\"n\">{}</th>\
         <th class=\"n\">{}</th><th class=\"n\">{}</th></tr>",
        escape(&d.columns[0]),
        escape(&d.columns[1]),
        escape(&d.models[0]),
        escape(&d.models[1]),
        escape(&d.models[2])
    )?;
    let pair = |p: Option<[f64; 2]>| {
        p.map_or("\u{2013}".to_owned(), |[a, b]| {
            format!("{}, {}", figure(a), figure(b))
        })
    };
    for row in &d.rows {
        writeln!(
            page,
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            escape(&row.name),
            pair(Some(row.measured)),
            pair(row.model),
            pair(row.optimum),
            pair(row.ours)
        )?;
    }
    writeln!(page, "</table>")
}

/// Points of one loop in their order; tests by mounting, in the order of their peak force.
fn plot(d: &AggregateDiagnosis) -> String {
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
    let mut curves = Vec::new();
    type Pick = fn(&Compared) -> Option<[f64; 2]>;
    let picks: [(Ink, Pick); 3] = [
        (Ink::Measured, |r| Some(r.measured)),
        (Ink::Twin, |r| r.model),
        (Ink::Improved, |r| r.ours),
    ];
    for (ink, pick) in picks {
        for name in &groups {
            let rows = d.rows.iter().filter(|r| group(r) == *name);
            let mut points: Vec<(f64, f64)> = rows.filter_map(|r| pick(r).map(|[x, y]| (x, y))).collect();
            if tests {
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
            curves.push(PlotCurve {
                name: String::new(),
                points,
                ink,
            });
        }
    }
    Plot {
        title: "",
        legend: false,
        x_label: &d.columns[0],
        y_label: &d.columns[1],
        curves: &curves,
        bands: &[],
        size: HALF,
    }
    .render()
}
