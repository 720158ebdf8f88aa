//! The report of a diagnosis: one page with the verdict on top, then loops before and after, residuals with the located
//! regions marked, candidates, parameters, and what the recordings cannot show. `diagnose` decides what it says.

use maud::{Markup, html};

use super::diagnosis_plots::{at_a_glance, law_plot, loops, maps};
use super::figures::{figure, interval, percent, signed_percent, spaced, unbroken};
use super::html::document;
use crate::diagnose::Verdict;
use crate::diagnose::diagnosis::{CandidateRow, Diagnosis, Errors, Value};

/// Rows of the table of candidates. The others are in `diagnosis.json` only.
const CANDIDATES: usize = 12;
/// The smallest noise floor that an error is divided by.
const SMALLEST_FLOOR: f64 = 1e-12;

pub(super) const STYLE: &str = include_str!("diagnosis.css");

/// A file that the diagnosis read.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InputFile {
    /// Path or run id.
    pub name: String,
    /// Hex SHA-256 of the file; `None` for a run that is still being written.
    pub sha256: Option<String>,
    /// Specimen that the run file or the data package names.
    pub specimen: Option<String>,
}

/// What the report says about the input of the diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Context<'a> {
    /// Specimen of the bench, for recordings that name none.
    pub bench_specimen: &'a str,
    /// Name of the baseline's model.
    pub baseline: &'a str,
    /// Number of recordings that were diagnosed.
    pub recordings: usize,
    /// The files that were read.
    pub inputs: &'a [InputFile],
    /// Version of leafbench.
    pub version: &'a str,
    /// Day and time of the diagnosis, UTC.
    pub date: &'a str,
}

impl Context<'_> {
    /// The specimens that the recordings name, or that of the bench.
    fn specimen(&self) -> String {
        let mut named: Vec<&str> = self.inputs.iter().filter_map(|i| i.specimen.as_deref()).collect();
        named.sort_unstable();
        named.dedup();
        match named.is_empty() {
            true => self.bench_specimen.to_owned(),
            false => named.join(", "),
        }
    }
}

/// The report as HTML text.
pub(crate) fn page(diagnosis: &Diagnosis, context: &Context<'_>) -> String {
    let d = diagnosis;
    let body = html! {
        div class={ "verdict " (verdict_word(d.verdict)) } {
            h1 { (unbroken(&d.summary)) }
            p.quiet {
                "Specimen " (context.specimen()) ", baseline model " (context.baseline) ", "
                (counted(context.recordings, "recording")) ". Diagnosed on " (context.date) " (UTC) by leafbench "
                (context.version) "."
            }
        }
        (notes(d))
        (strip(d))
        (yardsticks(d))
        (proof(d))
        (at_a_glance(d))
        (findings(d))
        (law(d))
        (alternatives(d))
        (locations(d))
        (errors(d))
        (loops(d))
        (maps(d))
        (candidates(d))
        (parameters(d))
        (alarms(d))
        (not_testable(d))
        (next_test(d))
        (inputs(context.inputs))
        p.quiet {
            "Every plot is also in the folder figures: as SVG, and its numbers as CSV of the same name. A line is broken where \
             points are missing or masked."
        }
    };
    document(&format!("Diagnosis of {}", context.specimen()), STYLE, &body)
}

/// The verdict as in `diagnosis.json`. The style has a class of the same name.
pub(super) fn verdict_word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Adequate => "adequate",
        Verdict::MissingPhysics => "missing_physics",
        Verdict::Unexplained => "unexplained",
    }
}

/// The files that were read, with their hashes.
fn inputs(inputs: &[InputFile]) -> Markup {
    html! {
        @if !inputs.is_empty() {
            h2 { "Inputs" }
            table {
                tr { th { "File" } th { "Specimen" } th { "SHA-256" } }
                @for i in inputs {
                    tr {
                        td { (file_name(&i.name)) }
                        td { (i.specimen.as_deref().unwrap_or("not named")) }
                        td.hash { (i.sha256.as_deref().unwrap_or("none: the file is still being written")) }
                    }
                }
            }
        }
    }
}

/// The last part of a path: the hash tells files of one name apart.
fn file_name(path: &str) -> &str {
    std::path::Path::new(path)
        .file_name()
        .and_then(|name| name.to_str())
        .unwrap_or(path)
}

fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// What is imperfect about the recordings: it is read before anything that follows from them.
fn notes(d: &Diagnosis) -> Markup {
    html! {
        @if !d.notes.is_empty() {
            h2 { "First: the recordings" }
            table {
                tr { th { "Recording" } th { "What" } th.n { "Size" } th { "Done" } th {} }
                @for n in &d.notes {
                    tr {
                        td { (n.recording) }
                        td.word { (n.kind.word()) }
                        td.n { (figure(n.size.value)) " " (n.size.unit) }
                        td.word { (n.done.word()) }
                        td { (n.text) }
                    }
                }
            }
        }
    }
}

/// The figures that the verdict is based on: baseline, then improved model.
fn strip(d: &Diagnosis) -> Markup {
    let (before, after) = (&d.fit.baseline, &d.fit.improved);
    let floor = d.fit.noise_floor_nrmse.max(SMALLEST_FLOOR);
    let change = |figure: fn(f64) -> String, pick: fn(&Errors) -> f64| {
        let (from, to) = (figure(pick(before)), figure(pick(after)));
        format!("{} \u{2192} {to}", from.trim_end_matches(" %"))
    };
    let cells = [
        ("Held-out error", change(|e| percent(e, 3), |e| e.nrmse_heldout)),
        (
            "Held-out error / noise floor",
            format!(
                "{:.1} \u{2192} {:.2}",
                before.nrmse_heldout / floor,
                after.nrmse_heldout / floor
            ),
        ),
        ("Noise floor", percent(d.fit.noise_floor_nrmse, 3)),
        ("Peak force error", change(signed_percent, |e| e.peak_force_error)),
        (
            "Loop energy error",
            change(signed_percent, |e| e.loop_energy_error),
        ),
    ];
    html! {
        dl.strip {
            @for (name, value) in cells {
                div { dt { (name) } dd { (value) } }
            }
        }
    }
}

/// The errors of simple models on the points of the held-out error, and what it means if one of them is better.
fn yardsticks(d: &Diagnosis) -> Markup {
    let error = |name: &str, nrmse: f64| format!("{name} {}", percent(nrmse, 3));
    let mut errors = vec![
        error("baseline", d.fit.baseline.nrmse_heldout),
        error("improved model", d.fit.improved.nrmse_heldout),
    ];
    errors.extend(d.yardsticks.iter().map(|y| error(&y.name, y.nrmse_leftout)));
    html! {
        @if !d.yardsticks.is_empty() {
            p { "Held-out error beside models that know nothing of springs: " (unbroken(&errors.join("; "))) "." }
        }
        @if let Some(warning) = d.yardstick_warning() {
            p { b { (unbroken(&warning)) } }
        }
    }
}

/// What the written model does when it is simulated, and its errors on recordings that nothing was fitted to.
fn proof(d: &Diagnosis) -> Markup {
    html! {
        @if let Some(proof) = &d.proof {
            p { (unbroken(&proof.words)) ". Left out: " (proof.left_out) "." }
        }
        @if let Some(first) = d.left_out.first() {
            table {
                tr {
                    th { "Recording left out" }
                    th.n { "baseline" }
                    th.n { "improved model" }
                    @for y in &first.yardsticks { th.n { (y.name) } }
                }
                @for row in &d.left_out {
                    tr {
                        td { (row.recording) }
                        td.n { (error_or_none(row.baseline)) }
                        td.n { (error_or_none(row.improved)) }
                        @for y in &row.yardsticks { td.n { (percent(y.nrmse_leftout, 2)) } }
                    }
                }
            }
        }
    }
}

fn error_or_none(error: Option<f64>) -> String {
    error.map_or("none".to_owned(), |e| percent(e, 2))
}

fn findings(d: &Diagnosis) -> Markup {
    html! {
        @if !d.effects.is_empty() {
            h2 { "Missing physics" }
            table {
                tr { th { "Physics" } th {} th.n { "Confidence" } }
                @for e in &d.effects {
                    tr { td { (spaced(&e.code)) } td { (e.statement) } td.n { (percent(e.confidence, 0)) } }
                }
            }
        }
    }
}

/// The law that was read off the recordings, with its table as a curve.
fn law(d: &Diagnosis) -> Markup {
    html! {
        @if let Some(law) = &d.law {
            h2 { "Law read off the recordings" }
            div.pair.block {
                div {
                    p { (unbroken(&law.statement)) }
                    @if let Some(power) = law.exponent {
                        p {
                            "The power is " (format!("{:.2}", power.value)) ", 95 % interval "
                            (format!("{:.2} to {:.2}", power.ci95[0], power.ci95[1])) "."
                        }
                    }
                    p {
                        "It takes away " (percent(law.explained_share, 0)) " of the difference above the noise on cycles that were \
                         not fitted. The improved model has the table, not the equation."
                    }
                }
                div { (law_plot(law)) }
            }
        }
    }
}

fn alternatives(d: &Diagnosis) -> Markup {
    html! {
        @if !d.alternatives.is_empty() {
            h3 { "Look-alikes" }
            table {
                tr {
                    th { "Physics" }
                    th { "Instead of" }
                    th { "Why these recordings do not separate them" }
                    th { "Test that separates them" }
                }
                @for a in &d.alternatives {
                    tr { td { (spaced(&a.code)) } td { (spaced(&a.instead_of)) } td { (a.why) } td { (a.test) } }
                }
            }
        }
    }
}

fn locations(d: &Diagnosis) -> Markup {
    html! {
        @if !d.location.is_empty() {
            h2 { "Where the model and the recordings differ" }
            ul {
                @for l in &d.location { li { (l.words) } }
            }
        }
    }
}

fn errors(d: &Diagnosis) -> Markup {
    let floor = d.fit.noise_floor_nrmse;
    html! {
        h2 { "How well the models fit" }
        p {
            "Error: RMS of measured minus model, divided by the range of the measured force. Held out: whole cycles or \
             recordings that no parameter was fitted to. Noise floor: " (percent(floor, 3)) "."
        }
        table {
            tr {
                th {}
                th.n { "fitted" }
                th.n { "held out" }
                th.n { "held out / noise floor" }
                th.n { "peak force error" }
                th.n { "loop energy error" }
            }
            @for rung in &d.fit.ladder {
                tr {
                    td { (spaced(&rung.what)) }
                    td.n { (percent(rung.errors.nrmse_train, 3)) }
                    td.n { (percent(rung.errors.nrmse_heldout, 3)) }
                    td.n { (format!("{:.2}", rung.errors.nrmse_heldout / floor.max(SMALLEST_FLOOR))) }
                    td.n { (signed_percent(rung.errors.peak_force_error)) }
                    td.n { (signed_percent(rung.errors.loop_energy_error)) }
                }
            }
        }
    }
}

fn candidates(d: &Diagnosis) -> Markup {
    let more = d.candidates.len() - shown(&d.candidates).count();
    html! {
        @if !d.candidates.is_empty() {
            h2 { "Candidates compared" }
            p {
                "Gain: increase of the log-likelihood (effective samples) over the refitted baseline. Held out: the same on \
                 cycles that no parameter was fitted to."
            }
            table {
                tr { th { "Added to the baseline" } th.n { "gain" } th.n { "held out" } th {} }
                @for c in shown(&d.candidates) {
                    tr class=[c.chosen.then_some("chosen")] {
                        td { (codes(c)) }
                        td.n { (format!("{:.0}", c.gain)) }
                        td.n { (format!("{:.0}", c.gain_heldout)) }
                        td { @if c.chosen { "chosen" } }
                    }
                }
            }
            @if more > 0 {
                p.quiet { (more) " more are in diagnosis.json." }
            }
        }
    }
}

fn codes(row: &CandidateRow) -> String {
    if row.codes.is_empty() {
        return "nothing".to_owned();
    }
    let codes: Vec<String> = row.codes.iter().map(|c| spaced(c)).collect();
    codes.join(", ")
}

/// The first rows, and the chosen one if it comes later.
fn shown(rows: &[CandidateRow]) -> impl Iterator<Item = &CandidateRow> {
    rows.iter()
        .enumerate()
        .filter(|(i, c)| *i < CANDIDATES || c.chosen)
        .map(|(_, c)| c)
}

fn parameters(d: &Diagnosis) -> Markup {
    html! {
        h2 { "Parameters" }
        table {
            tr { th { "Of" } th { "Parameter" } th.n { "Value" } th { "Unit" } th { "95 % interval" } }
            @for value in &d.baseline_parameters { (parameter("baseline", value)) }
            @for e in &d.effects {
                @for value in &e.parameters { (parameter(&spaced(&e.code), value)) }
            }
        }
    }
}

fn parameter(of: &str, v: &Value) -> Markup {
    html! {
        tr { td { (of) } td { (v.name) } td.n { (figure(v.value)) } td { (v.unit) } td { (interval(v)) } }
    }
}

fn alarms(d: &Diagnosis) -> Markup {
    html! {
        @if !d.alarms.is_empty() {
            h2 { "Please check" }
            ul {
                @for alarm in &d.alarms { li { (alarm) } }
            }
        }
    }
}

fn not_testable(d: &Diagnosis) -> Markup {
    html! {
        @if !d.not_testable.is_empty() {
            h2 { "What these recordings cannot show" }
            table {
                tr { th { "Physics" } th.n { "Visible share" } th { "Why" } }
                @for n in &d.not_testable {
                    tr { td { (spaced(&n.code)) } td.n { (percent(n.surviving, 1)) } td { (n.why) } }
                }
            }
        }
    }
}

fn next_test(d: &Diagnosis) -> Markup {
    html! {
        @if let Some(next) = &d.next_test {
            div.block {
                h2 { "Next test" }
                p {
                    (next.why.trim_end_matches('.')) ". "
                    @if let Some(sigma) = next.separation_sigma {
                        "Expected difference: " (format!("{sigma:.0}")) " standard deviations of the noise in "
                    } @else {
                        "Duration: "
                    }
                    (format!("{:.0}", next.duration_s)) " s."
                }
                pre { (next.profile_toml) }
            }
        }
        @if let Some(why) = &d.no_next_test {
            h2 { "Next test" }
            p { "None: " (why) "." }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::{Baseline, DiagnoseOptions, diagnose};
    use crate::model::equivalent;
    use crate::recording::Recording;
    use crate::truth::Case;

    /// Takes a tenth of the samples away, in the middle.
    fn lose_a_tenth(recording: &mut Recording) {
        let (from, to) = (recording.len() * 9 / 20, recording.len() * 11 / 20);
        for column in [
            &mut recording.time_s,
            &mut recording.displacement_mm,
            &mut recording.force_n,
        ] {
            column.drain(from..to);
        }
        (recording.command, recording.command_mode) = (None, None);
        (recording.cycle, recording.flags) = (None, None);
    }

    #[test]
    fn the_page_is_complete_escapes_text_and_loads_nothing_from_elsewhere() {
        let case = Case::single("progressive_stiffness", 1, 10.0).expect("visible");
        let options = DiagnoseOptions {
            points: 400,
            threads: 1,
            ..DiagnoseOptions::default()
        };
        let mut recordings = case.recordings[..2].to_vec();
        lose_a_tenth(&mut recordings[0]);
        let d = diagnose(
            &recordings,
            &Baseline::of(&equivalent::MODEL),
            &options,
            &mut |_, _| {},
        )
        .expect("sound data");
        assert!(!d.curves[0].breaks.is_empty(), "the line is broken at the gap");
        let inputs = [InputFile {
            name: "x".to_owned(),
            sha256: Some("0123abcd".to_owned()),
            specimen: Some("a <b>".to_owned()),
        }];
        let context = Context {
            bench_specimen: "another",
            baseline: "equivalent",
            recordings: 1,
            inputs: &inputs,
            version: "9.8.7",
            date: "2026-11-24 10:00",
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
            "2026-11-24 10:00 (UTC) by leafbench 9.8.7",
            "0123abcd",
        ] {
            assert!(page.contains(wanted), "{wanted}");
        }
        assert!(page.matches("<svg").count() >= 2 * d.curves.len());
        // The namespace of the plots looks like an address but is never loaded.
        let outside = page.replace("http://www.w3.org/2000/svg", "");
        for asks in [
            "http", "<script", "src=", "href=", "@import", "url(", "fetch(", "<link", "<iframe", "NaN",
        ] {
            assert!(!outside.contains(asks), "{asks}");
        }
    }
}
