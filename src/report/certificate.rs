//! The certificate of a run: one page A4 with what was tested, by what, with which result, and the hashes that tie it to the run
//! file. Long lists are cut with their number, so that the page stays one: `leafbench result` has all of them.

use std::io;

use maud::{Markup, PreEscaped, html};
use sha2::{Digest, Sha256};

use super::figures::figure;
use super::html::{document, legend};
use super::svg::{HALF, Ink, Plot, PlotCurve};
use crate::acceptance::{
    LimitResult, LimitVerdict, LoopTrace, RunResult, RunVerdict, ValueSummary, digits, traces,
};
use crate::recording::export::run_file_sha256;
use crate::recording::run_file::RunFile;
use crate::recording::{ChannelScale, Ending, Event, EventKind, FirmwareIdentity, Header, SensorIdentity};

/// Rows of the table of limits; the broken ones come first.
const MOST_LIMITS: usize = 8;
/// Lines of the notes.
const MOST_NOTES: usize = 5;
/// With more limits or notes than these the print is smaller, so that all of it is on the sheet.
const FEW_LIMITS: usize = 4;
const FEW_NOTES: usize = 2;
/// Text values of the calibration of one sensor.
const MOST_FACTS: usize = 9;
/// Longest text of a person or a name, characters.
const LONGEST_NAME: usize = 60;
/// Longest text of a calibration: a SHA-256 in hex.
const LONGEST_FACT: usize = 64;
/// Longest note, characters.
const LONGEST_NOTE: usize = 96;

/// The certificate of a run file as HTML text. Fails only if the run file cannot be read for its hash.
pub(crate) fn page(run: &RunFile) -> io::Result<String> {
    let (result, header) = (RunResult::of(run), run.header());
    let hash = run_file_sha256(run)?;
    let notes = notes(&result, header, &run.events());
    let dense = result.limits.len() > FEW_LIMITS || notes.len() > FEW_NOTES;
    let body = html! {
        div.dense[dense] {
            header {
                h1 { "Test certificate" small { "Run " (header.run_id) } }
                div class={ "verdict " (verdict_class(result.verdict)) } { (result.verdict.words()) }
            }
            p { b { (shortened(&sentence(&result.why), 2 * LONGEST_NOTE)) } }
            (facts(&result, header))
            (limits(&result.limits))
            (values(&result))
            div.pair {
                (loops(&traces(run, &result)))
                div { (calibrations(header)) }
            }
            (notes_list(&notes))
            (hashes(header, hash.as_deref()))
            footer {
                span { "leafbench " (header.program_version) ", firmware " (firmware(&header.firmware)) }
                span { "Signed: ______________________________" }
            }
        }
    };
    let title = format!("Certificate of run {}", header.run_id);
    Ok(document(&title, include_str!("certificate.css"), &body))
}

/// The class of the style for a verdict: its word in JSON.
fn verdict_class(verdict: RunVerdict) -> &'static str {
    match verdict {
        RunVerdict::Pass => "pass",
        RunVerdict::Fail => "fail",
        RunVerdict::NotJudged => "not_judged",
        RunVerdict::NoLimits => "no_limits",
    }
}

/// The text with a capital letter and a full stop.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| {
        first.to_uppercase().chain(letters).collect::<String>() + if text.ends_with('.') { "" } else { "." }
    })
}

/// The text, cut with an ellipsis if it is too long.
fn shortened(text: &str, most: usize) -> String {
    match text.chars().count() > most {
        true => text.chars().take(most - 1).chain(['\u{2026}']).collect(),
        false => text.to_owned(),
    }
}

fn facts(result: &RunResult, header: &Header) -> Markup {
    let ended = match result.ending {
        None => "has no end yet".to_owned(),
        Some(Ending::Completed) if result.problem.is_empty() => "completed".to_owned(),
        Some(Ending::Completed) => format!("completed; {}", result.problem),
        Some(Ending::Stopped) => format!("stopped: {}", result.cause),
        Some(Ending::Aborted) => format!("aborted: {}", result.cause),
    };
    let cycles = match (result.cycles_planned, result.first_cycle) {
        (0, _) => "none counted".to_owned(),
        (planned, 1) => format!("{} of {planned} complete", result.loops().len()),
        (planned, first) => format!(
            "{} complete, from cycle {first} of {planned}; resumes run {}",
            result.loops().len(),
            header.resumes_run
        ),
    };
    let bench = bench_table(header);
    let bench_name = bench.get("name").and_then(toml::Value::as_str).unwrap_or("");
    let rows = [
        ("Specimen", header.specimen.clone()),
        ("Started", format!("{} (UTC)", header.started_utc)),
        ("Operator", header.operator.clone()),
        ("Ended", ended),
        ("Profile", header.profile_name.clone()),
        ("Cycles", cycles),
        ("Bench", bench_name.to_owned()),
        (
            "Samples",
            format!(
                "{}; {} lost, {} late, {} flagged",
                result.samples, result.lost, result.late, result.flagged
            ),
        ),
    ];
    html! {
        dl {
            @for (name, value) in rows {
                dt { (name) }
                dd { (if value.is_empty() { "\u{2013}".to_owned() } else { shortened(&value, LONGEST_NAME) }) }
            }
        }
    }
}

/// The limits: broken ones first, then those that could not be judged.
fn limits(limits: &[LimitResult]) -> Markup {
    let order = |l: &&LimitResult| match l.verdict {
        LimitVerdict::Fail => 0,
        LimitVerdict::NotJudged => 1,
        LimitVerdict::Pass => 2,
    };
    let mut sorted: Vec<&LimitResult> = limits.iter().collect();
    sorted.sort_by_key(order);
    let shown = sorted.len().min(MOST_LIMITS);
    let more = &sorted[shown..];
    let of = |verdict: LimitVerdict| more.iter().filter(|l| l.verdict == verdict).count();
    html! {
        @if !limits.is_empty() {
            h2 { "Limits" }
            table {
                tr { th { "Limit" } th { "Cycles" } th.n { "Measured" } th.n { "In cycle" } th { "Verdict" } }
                @for l in &sorted[..shown] { (limit_row(l)) }
            }
            @if !more.is_empty() {
                p {
                    (more.len()) " more limits: " (of(LimitVerdict::Fail)) " broken, " (of(LimitVerdict::NotJudged))
                    " not judged, " (of(LimitVerdict::Pass)) " kept."
                }
            }
        }
    }
}

fn limit_row(l: &LimitResult) -> Markup {
    let cycles = match l.cycles {
        None => "whole run".to_owned(),
        Some([first, last]) => format!("{first} to {last}"),
    };
    let plain = LimitResult {
        cycles: None,
        at_cycle: None,
        ..l.clone()
    };
    html! {
        tr {
            td { (plain.words()) }
            td { (cycles) }
            td.n { (plain.measured_words()) }
            td.n { @if let Some(cycle) = l.at_cycle { (cycle) } }
            td.v { (l.verdict.words()) }
        }
    }
}

fn values(result: &RunResult) -> Markup {
    let counted = result.cycles_planned > 0;
    let (loops, many) = (result.loops().len(), result.loops().len() > 1);
    let trend = |v: &ValueSummary| {
        v.trend.map_or("\u{2013}".to_owned(), |t| {
            format!("{} {}", figure(t), v.trend_unit)
        })
    };
    html! {
        @if !result.values.is_empty() {
            h2 {
                @if counted { "Measured in " (loops) " complete counted cycle" @if many { "s" } }
                @else { "Measured over the whole motion" }
            }
            table {
                tr {
                    th { "Value" } th { "Unit" }
                    @if counted { th.n { "first" } th.n { "last" } th.n { "smallest" } th.n { "largest" } th.n { "mean" } th.n { "trend" } }
                    @else { th.n { "value" } }
                }
                @for v in &result.values {
                    tr {
                        td { (v.what) } td { (v.unit) }
                        @if counted {
                            @for value in [v.first, v.last, v.min, v.max, v.mean] { td.n { (digits(value)) } }
                            td.n { (trend(v)) }
                        } @else {
                            td.n { (digits(v.mean)) }
                        }
                    }
                }
            }
        }
    }
}

/// The first and the last loop, measured and twin.
fn loops(traces: &[LoopTrace]) -> Markup {
    let curve = |points: &[(f64, f64)], ink| PlotCurve {
        name: String::new(),
        points: points.to_vec(),
        ink,
    };
    let last = traces.len().saturating_sub(1);
    let mut curves: Vec<PlotCurve> = Vec::new();
    let mut entries: Vec<(&str, Ink)> = Vec::new();
    for (i, trace) in traces.iter().enumerate() {
        let ink = if i == last { Ink::Measured } else { Ink::Earlier };
        curves.push(curve(&trace.measured, ink));
        entries.push((&trace.name, ink));
    }
    if let Some(trace) = traces.last().filter(|t| t.twin.iter().any(|p| p.1.is_finite())) {
        curves.push(curve(&trace.twin, Ink::Twin));
        entries.push(("twin", Ink::Twin));
    }
    let plot = Plot {
        title: "",
        legend: false,
        x_label: "displacement in mm",
        y_label: "force in N",
        curves: &curves,
        bands: &[],
        levels: &[],
        size: HALF,
    };
    html! {
        div {
            @if curves.is_empty() {
                p { "No complete loop was recorded." }
            } @else {
                (PreEscaped(plot.render()))
                (legend(&entries, ""))
            }
        }
    }
}

/// The bench file of the run; empty if it cannot be read.
fn bench_table(header: &Header) -> toml::Table {
    header.bench_toml.parse().unwrap_or_default()
}

/// Identity and calibration of both sensors.
fn calibrations(header: &Header) -> Markup {
    let bench = bench_table(header);
    let sensors = [
        (
            "Load cell",
            "force_channel",
            header.force_channel,
            &header.force_sensor,
            "N",
        ),
        (
            "LVDT",
            "displacement_channel",
            header.displacement_channel,
            &header.displacement_sensor,
            "mm",
        ),
    ];
    html! {
        @for (sensor, table, scale, identity, unit) in sensors {
            h2 { (sensor) }
            p.facts {
                @for (name, value) in sensor_facts(identity, bench.get(table), unit).into_iter().take(MOST_FACTS) {
                    (name) " " b { (shortened(&value, LONGEST_FACT)) } "; "
                }
                (scaling(scale, unit))
            }
        }
        p.facts { "Calibration hash of the firmware " b { (format!("{:#010x}", header.firmware.calibration_hash)) } }
    }
}

/// What is known of a sensor: first what its calibration file says, then what else the bench file has.
fn sensor_facts(
    identity: &SensorIdentity,
    channel: Option<&toml::Value>,
    unit: &str,
) -> Vec<(String, String)> {
    let uncertainty = identity
        .expanded_uncertainty
        .map_or(String::new(), |value| format!("{} {unit} (k = 2)", digits(value)));
    let named = [
        ("sensor", &identity.sensor),
        ("serial", &identity.serial),
        ("certificate", &identity.certificate),
        ("calibrated", &identity.calibrated),
        ("due", &identity.due),
        ("class", &identity.class),
        ("laboratory", &identity.laboratory),
        ("uncertainty", &uncertainty),
    ];
    let mut facts: Vec<(String, String)> = named
        .into_iter()
        .filter(|(_, value)| !value.is_empty())
        .map(|(name, value)| (name.to_owned(), value.clone()))
        .collect();
    for (name, value) in texts(channel) {
        if !facts.iter().any(|(_, known)| *known == value) {
            facts.push((name, value));
        }
    }
    facts
}

/// Every text of a channel's table and of the tables in it, by name: certificate, dates, serial number, what else is there.
fn texts(channel: Option<&toml::Value>) -> Vec<(String, String)> {
    let Some(table) = channel.and_then(toml::Value::as_table) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::String(text) => found.push((key.replace('_', " "), text.clone())),
            toml::Value::Datetime(date) => found.push((key.replace('_', " "), date.to_string())),
            toml::Value::Table(_) => found.extend(texts(Some(value))),
            _ => {}
        }
    }
    found
}

fn scaling(scale: ChannelScale, unit: &str) -> String {
    format!(
        "{} {unit} per count, offset {} {unit}, tare {} {unit}",
        digits(scale.scale_per_count),
        digits(scale.offset),
        digits(scale.tare)
    )
}

/// What a reader must know beside the numbers: overrides, what tripped, what is missing.
fn notes(result: &RunResult, header: &Header, events: &[Event]) -> Vec<String> {
    let mut notes = header.remarks.clone();
    // A person who answers for something comes first.
    notes.sort_by_key(|remark| !remark.starts_with("override"));
    if !result.problem.is_empty() {
        notes.push(result.problem.clone());
    }
    if !header.continues.is_empty() {
        notes.push(format!("this file continues run {}", header.continues));
    }
    let told = |kinds: &'static [EventKind]| {
        let chosen = events.iter().filter(move |e| kinds.contains(&e.kind));
        chosen.map(|e| format!("{:.3} s: {}", e.time_s, e.text))
    };
    notes.extend(told(&[EventKind::Limit, EventKind::Link]));
    notes.extend(told(&[
        EventKind::Gap,
        EventKind::Host,
        EventKind::ModelMismatch,
        EventKind::Operator,
    ]));
    notes
}

fn notes_list(notes: &[String]) -> Markup {
    let more = notes.len().saturating_sub(MOST_NOTES);
    html! {
        @if !notes.is_empty() {
            h2 { "Notes" }
            ul {
                @for note in notes.iter().take(MOST_NOTES) { li { (shortened(&sentence(note), LONGEST_NOTE)) } }
                @if more > 0 { li { (more) " more in the events of the run file." } }
            }
        }
    }
}

fn hashes(header: &Header, run_file: Option<&str>) -> Markup {
    let hash = |text: &str| -> String {
        let bytes = Sha256::digest(text.as_bytes());
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    };
    html! {
        h2 { "SHA-256" }
        dl.one {
            dt { "run file" }
            dd.hash { (run_file.unwrap_or("none: the run file is still being written")) }
            dt { "bench" } dd.hash { (header.bench_sha256) }
            dt { "profile" } dd.hash { (hash(&header.profile_toml)) }
        }
    }
}

fn firmware(f: &FirmwareIdentity) -> String {
    let version = |v: u32| format!("{}.{}", v >> 16, v & 0xffff);
    format!(
        "{} (serial {}, protocol {})",
        version(f.revision),
        f.serial,
        version(f.protocol)
    )
}
