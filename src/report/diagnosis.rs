//! The report of a diagnosis: one page with the verdict on top, loops before and after, residual maps with the located
//! region marked, candidates, parameters, and what could not be tested. What it says is decided in `diagnose`.

use std::fmt::Write;

use super::diagnosis_plots::{at_a_glance, loops, maps};
use super::html::escape;
use crate::diagnose::Verdict;
use crate::diagnose::diagnosis::{CandidateRow, Diagnosis, Errors, Value};

/// Rows of the table of candidates.
const CANDIDATES: usize = 12;

pub(super) const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1180px; margin: 0 auto; padding: 24px; background: #fff; color: #16191c; }
h1 { font-size: 26px; line-height: 1.3; margin: 0 0 8px; }
h2 { font-size: 20px; margin: 26px 0 4px; }
h3 { font-size: 16px; margin: 18px 0 2px; }
p { margin: 0 0 10px; }
.verdict { border-left: 8px solid; padding: 2px 0 2px 16px; margin: 0 0 18px; }
.adequate { border-color: rgb(22,138,84); }
.missing_physics { border-color: rgb(222,117,26); }
.unexplained { border-color: rgb(160,60,160); }
dl.strip { display: flex; flex-wrap: wrap; gap: 6px 34px; margin: 0 0 10px; }
dl.strip dt { font-size: 14px; opacity: .75; }
dl.strip dd { margin: 0; font-size: 18px; font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 12px; }
svg { width: 100%; height: auto; display: block; }
table { border-collapse: collapse; width: 100%; margin: 6px 0 14px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 5px 14px 5px 0; border-bottom: 1px solid rgba(118,128,136,.35); vertical-align: top; }
th { font-weight: 600; opacity: .75; }
td.n, th.n { text-align: right; }
tr.chosen td { font-weight: 600; }
.quiet { opacity: .75; }
.legend i { display: inline-block; width: 24px; height: 4px; border-radius: 2px; margin: 0 6px 4px 0; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.legend span { margin-right: 20px; }
pre { font-size: 14px; line-height: 1.4; padding: 12px; border: 1px solid rgba(118,128,136,.4); overflow-x: auto; }
@media (prefers-color-scheme: dark) { body { background: #14171a; color: #eef1f2; } }
@media screen and (max-width: 760px) { .pair { grid-template-columns: 1fr; } }
@page { size: A4; margin: 14mm; }
@media print { :root { color-scheme: light; } body { background: #fff; color: #000; max-width: none; padding: 0; font-size: 12px; } h1 { font-size: 20px; } .block, .pair > div, tr, pre { break-inside: avoid; } thead, th { break-after: avoid; } h2, h3 { break-after: avoid; } }
";

/// What the report tells beside the diagnosis itself.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Context<'a> {
    /// The specimen's name.
    pub specimen: &'a str,
    /// The baseline's model.
    pub baseline: &'a str,
    /// Recordings, by name.
    pub recordings: Vec<String>,
}

/// The page.
pub(crate) fn page(diagnosis: &Diagnosis, context: &Context<'_>) -> String {
    let mut page = String::new();
    // Writing into a string cannot fail.
    let _ = write_page(&mut page, diagnosis, context);
    page
}

fn write_page(page: &mut String, d: &Diagnosis, context: &Context<'_>) -> std::fmt::Result {
    let word = verdict_word(d.verdict);
    write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>Diagnosis of {0}</title>\n<style>{STYLE}</style></head>\n<body>\n\
         <div class=\"verdict {word}\"><h1>{1}</h1>\n<p class=\"quiet\">Specimen {0}, baseline model {2}, {3}.</p></div>\n",
        escape(context.specimen),
        escape(&d.summary).replace(" %", "&nbsp;%"),
        escape(context.baseline),
        counted(context.recordings.len(), "recording"),
    )?;
    strip(page, d)?;
    at_a_glance(page, d)?;
    findings(page, d)?;
    places(page, d)?;
    errors(page, d)?;
    loops(page, d)?;
    maps(page, d)?;
    candidates(page, d)?;
    parameters(page, d)?;
    open_ends(page, d)?;
    next_test(page, d)?;
    writeln!(page, "</body>\n</html>")
}

/// As in `diagnosis.json`; a class of the style too.
pub(super) fn verdict_word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Adequate => "adequate",
        Verdict::MissingPhysics => "missing_physics",
        Verdict::Unexplained => "unexplained",
    }
}

fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// The figures that a verdict stands on, before and after.
fn strip(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    let (before, after, floor) = (
        &d.fit.baseline,
        &d.fit.improved,
        d.fit.noise_floor_nrmse.max(1e-12),
    );
    let cells = [
        (
            "Error, held out",
            format!(
                "{:.3} \u{2192} {:.3} %",
                100.0 * before.nrmse_heldout,
                100.0 * after.nrmse_heldout
            ),
        ),
        (
            "In noise floors",
            format!(
                "{:.1} \u{2192} {:.2}",
                before.nrmse_heldout / floor,
                after.nrmse_heldout / floor
            ),
        ),
        ("Noise floor", format!("{:.3} %", 100.0 * d.fit.noise_floor_nrmse)),
        (
            "Peak force",
            format!(
                "{:+.2} \u{2192} {:+.2} %",
                100.0 * before.peak_force_error,
                100.0 * after.peak_force_error
            ),
        ),
        (
            "Loop energy",
            format!(
                "{:+.2} \u{2192} {:+.2} %",
                100.0 * before.loop_energy_error,
                100.0 * after.loop_energy_error
            ),
        ),
    ];
    write!(page, "<dl class=\"strip\">")?;
    for (name, value) in cells {
        write!(page, "<div><dt>{name}</dt><dd>{value}</dd></div>")?;
    }
    writeln!(page, "</dl>")
}

fn findings(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    if !d.effects.is_empty() {
        writeln!(
            page,
            "<h2>What is missing</h2>\n<table><tr><th>Physics</th><th></th><th class=\"n\">Confidence</th></tr>"
        )?;
        for e in &d.effects {
            writeln!(
                page,
                "<tr><td>{}</td><td>{}</td><td class=\"n\">{:.0} %</td></tr>",
                spaced(&e.code),
                escape(&e.statement),
                100.0 * e.confidence
            )?;
        }
        writeln!(page, "</table>")?;
    }
    if d.alternatives.is_empty() {
        return Ok(());
    }
    writeln!(
        page,
        "<h3>What it could be instead</h3>\n<table><tr><th>Physics</th><th>Instead of</th><th>Why it is not told apart</th><th>What would tell</th></tr>"
    )?;
    for a in &d.alternatives {
        writeln!(
            page,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            spaced(&a.code),
            spaced(&a.instead_of),
            escape(&a.why),
            escape(&a.test)
        )?;
    }
    writeln!(page, "</table>")
}

fn places(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    if d.location.is_empty() {
        return Ok(());
    }
    writeln!(page, "<h2>Where the model and the recordings differ</h2>\n<ul>")?;
    for l in &d.location {
        writeln!(page, "<li>{}</li>", escape(&l.words))?;
    }
    writeln!(page, "</ul>")
}

fn errors(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    writeln!(
        page,
        "<h2>How well it fits</h2>\n<p>Error: RMS of measured minus model over the range of the measured force. Held out: whole cycles or \
         recordings that no parameter was fitted on. Noise floor: {:.3} %.</p>\n\
         <table><tr><th></th><th class=\"n\">fitted</th><th class=\"n\">held out</th><th class=\"n\">in noise floors</th><th class=\"n\">peak force</th><th class=\"n\">loop energy</th></tr>",
        100.0 * d.fit.noise_floor_nrmse
    )?;
    for rung in &d.fit.ladder {
        error_row(page, &spaced(&rung.what), &rung.errors, d.fit.noise_floor_nrmse)?;
    }
    writeln!(page, "</table>")
}

fn error_row(page: &mut String, what: &str, e: &Errors, floor: f64) -> std::fmt::Result {
    writeln!(
        page,
        "<tr><td>{what}</td><td class=\"n\">{:.3} %</td><td class=\"n\">{:.3} %</td><td class=\"n\">{:.2}</td><td class=\"n\">{:+.2} %</td><td class=\"n\">{:+.2} %</td></tr>",
        100.0 * e.nrmse_train,
        100.0 * e.nrmse_heldout,
        e.nrmse_heldout / floor.max(1e-12),
        100.0 * e.peak_force_error,
        100.0 * e.loop_energy_error
    )
}

fn candidates(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    if d.candidates.is_empty() {
        return Ok(());
    }
    writeln!(
        page,
        "<h2>Explanations compared</h2>\n<p>Gain over the refitted baseline in log-likelihood of effective samples; held out: on cycles that no \
         parameter was fitted on.</p>\n<table><tr><th>Added to the baseline</th><th class=\"n\">gain</th><th class=\"n\">held out</th><th></th></tr>"
    )?;
    for c in shown(&d.candidates) {
        let codes: Vec<String> = c.codes.iter().map(|c| spaced(c)).collect();
        let codes = if codes.is_empty() {
            "nothing".to_owned()
        } else {
            codes.join(", ")
        };
        let (class, word) = if c.chosen {
            (" class=\"chosen\"", "chosen")
        } else {
            ("", "")
        };
        writeln!(
            page,
            "<tr{class}><td>{codes}</td><td class=\"n\">{:.0}</td><td class=\"n\">{:.0}</td><td>{word}</td></tr>",
            c.gain, c.gain_heldout
        )?;
    }
    writeln!(page, "</table>")?;
    let left = d.candidates.len() - shown(&d.candidates).count();
    if left > 0 {
        writeln!(page, "<p class=\"quiet\">{left} more are in diagnosis.json.</p>")?;
    }
    Ok(())
}

/// The best, and the chosen one wherever it stands.
fn shown(rows: &[CandidateRow]) -> impl Iterator<Item = &CandidateRow> {
    rows.iter()
        .enumerate()
        .filter(|(i, c)| *i < CANDIDATES || c.chosen)
        .map(|(_, c)| c)
}

fn parameters(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    writeln!(
        page,
        "<h2>Parameters</h2>\n<table><tr><th>Of</th><th>Parameter</th><th class=\"n\">Value</th><th>Unit</th><th>95 % interval</th></tr>"
    )?;
    for value in &d.baseline_parameters {
        value_row(page, "baseline", value)?;
    }
    for e in &d.effects {
        for value in &e.parameters {
            value_row(page, &spaced(&e.code), value)?;
        }
    }
    writeln!(page, "</table>")
}

fn value_row(page: &mut String, of: &str, v: &Value) -> std::fmt::Result {
    let interval = v
        .ci95
        .map_or("not given by these data".to_owned(), |[low, high]| {
            format!("{} to {}", figure(low), figure(high))
        });
    writeln!(
        page,
        "<tr><td>{of}</td><td>{}</td><td class=\"n\">{}</td><td>{}</td><td>{interval}</td></tr>",
        escape(&v.name),
        figure(v.value),
        escape(&v.unit)
    )
}

/// The last part of a path.
pub(super) fn file_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// Four figures that a person reads.
pub(super) fn figure(v: f64) -> String {
    let size = v.abs();
    let digits = match size {
        _ if size == 0.0 || size >= 1000.0 => 0,
        _ => (3 - size.log10().floor() as i32).clamp(0, 8) as usize,
    };
    format!("{v:.digits$}")
}

fn open_ends(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    if !d.alarms.is_empty() {
        writeln!(page, "<h2>To be looked at</h2>\n<ul>")?;
        for alarm in &d.alarms {
            writeln!(page, "<li>{}</li>", escape(alarm))?;
        }
        writeln!(page, "</ul>")?;
    }
    if d.not_testable.is_empty() {
        return Ok(());
    }
    writeln!(
        page,
        "<h2>What these recordings cannot show</h2>\n<table><tr><th>Physics</th><th class=\"n\">Visible share</th><th>Why</th></tr>"
    )?;
    for n in &d.not_testable {
        writeln!(
            page,
            "<tr><td>{}</td><td class=\"n\">{:.1} %</td><td>{}</td></tr>",
            spaced(&n.code),
            100.0 * n.surviving,
            escape(&n.why)
        )?;
    }
    writeln!(page, "</table>")
}

fn next_test(page: &mut String, d: &Diagnosis) -> std::fmt::Result {
    let Some(next) = &d.next_test else { return Ok(()) };
    writeln!(
        page,
        "<div class=\"block\"><h2>Next test</h2>\n<p>{}. Expected difference {:.0} standard deviations of the noise in {:.0} s.</p>\n<pre>{}</pre></div>",
        escape(next.why.trim_end_matches('.')),
        next.separation_sigma,
        next.duration_s,
        escape(&next.profile_toml)
    )
}

pub(super) fn spaced(code: &str) -> String {
    escape(&code.replace('_', " "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::{Baseline, DiagnoseOptions, diagnose};
    use crate::model::equivalent;
    use crate::truth::Case;

    #[test]
    fn the_page_holds_everything_itself() {
        let case = Case::single("progressive_stiffness", 1, 10.0).expect("visible");
        let options = DiagnoseOptions {
            points: 400,
            threads: 1,
            limits: None,
        };
        let d = diagnose(
            &case.recordings[..2],
            &Baseline::of(&equivalent::MODEL),
            &options,
            &mut |_, _| {},
        )
        .expect("sound data");
        let context = Context {
            specimen: "a <b>",
            baseline: "equivalent",
            recordings: vec!["x".to_owned()],
        };
        let page = page(&d, &context);
        for wanted in [
            "<h1>",
            "a &lt;b&gt;",
            "Loops",
            "Residuals",
            "Parameters",
            "rate_n_per_mm",
            "1 recording.",
        ] {
            assert!(page.contains(wanted), "{wanted}");
        }
        assert!(page.matches("<svg").count() >= 2 * d.curves.len());
        // Namespaces of the plots are names, not addresses; nothing else may point out of the page.
        let outside = page.replace("http://www.w3.org/2000/svg", "");
        for asks in [
            "http", "<script", "src=", "href=", "@import", "url(", "fetch(", "<link", "<iframe", "NaN",
        ] {
            assert!(!outside.contains(asks), "{asks}");
        }
    }

    #[test]
    fn figures_as_people_write_them() {
        assert_eq!(figure(81.23456), "81.23");
        assert_eq!(figure(0.0123456), "0.01235");
        assert_eq!(figure(12345.6), "12346");
        assert_eq!(figure(0.0), "0");
    }
}
