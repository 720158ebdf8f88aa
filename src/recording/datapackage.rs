//! The `NAME.datapackage.json` beside a CSV: a Frictionless Data Package whose Table Schema has the units.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::run_file::{Gap, RunFile, Survey};
use super::{ChannelScale, Event, EventKind, Header, SensorIdentity, columns};

/// The CSV that the package describes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Resource {
    /// File name without folder.
    pub file_name: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// SHA-256 of the file in hex.
    pub sha256: String,
    /// Number of rows without the header row.
    pub rows: u64,
    /// Names of its columns in order.
    pub columns: Vec<&'static str>,
    /// What was exported: "whole run", "cycle 5" ...
    pub selection: String,
}

/// `NAME.datapackage.json` of `NAME.csv`.
pub(crate) fn path_of(csv: &Path) -> PathBuf {
    csv.with_extension("datapackage.json")
}

/// The package of an exported run.
pub(crate) fn build(run: &RunFile, survey: &Survey, resource: &Resource) -> Value {
    let header = run.header();
    let mut details = details(run, survey, &resource.selection);
    details["rows"] = resource.rows.into();
    of_table(
        &header.run_id,
        &format!("{} on {}", header.profile_name, header.specimen),
        &header.started_utc,
        resource,
        details,
    )
}

/// The package of a table: name, title, time of its origin, and what has no standard field.
pub(crate) fn of_table(
    name: &str,
    title: &str,
    created_utc: &str,
    resource: &Resource,
    details: Value,
) -> Value {
    let slug = slug(name);
    json!({
        "profile": "data-package",
        "name": slug,
        "title": title,
        "created": created_utc,
        "resources": [{
            "profile": "tabular-data-resource",
            "name": slug,
            "path": resource.file_name,
            "format": "csv",
            "mediatype": "text/csv",
            "encoding": "utf-8",
            "bytes": resource.bytes,
            "hash": format!("sha256:{}", resource.sha256),
            "dialect": {
                "delimiter": ",",
                "lineTerminator": "\r\n",
                "quoteChar": "\"",
                "doubleQuote": true,
                "header": true
            },
            "schema": {
                "fields": resource.columns.iter().map(|column| field(column)).collect::<Vec<_>>(),
                "missingValues": [""]
            }
        }],
        "leafbench": details
    })
}

/// The sign convention in words.
pub(crate) const SIGN: &str = "displacement and force are positive in the direction that loads the spring";

/// The scaling of both channels with its formula, and which sensors measured by which calibrations.
pub(crate) fn calibration(header: &Header) -> Value {
    let channels = [header.force_channel, header.displacement_channel];
    let curved = channels.iter().find(|channel| channel.curve != [0.0; 2]);
    json!({
        "formula": curved.unwrap_or(&header.force_channel).formula(),
        "force_n": channel(&header.force_channel, &header.force_sensor),
        "displacement_mm": channel(&header.displacement_channel, &header.displacement_sensor)
    })
}

/// Scaling and identity of one channel as one object. Empty texts are left out.
fn channel(scale: &ChannelScale, sensor: &SensorIdentity) -> Value {
    let mut channel = json!(scale);
    if let (Some(channel), Value::Object(sensor)) = (channel.as_object_mut(), json!(sensor)) {
        channel.extend(sensor.into_iter().filter(|(_, value)| value != ""));
    }
    channel
}

/// Facts for which a Data Package has no standard field. `selection` says which part of the run is exported.
pub(crate) fn details(run: &RunFile, survey: &Survey, selection: &str) -> Value {
    let (header, events) = (run.header(), run.events());
    let firmware = &header.firmware;
    json!({
        "run_id": header.run_id,
        "started_utc": header.started_utc,
        "specimen": header.specimen,
        "operator": header.operator,
        "program_version": header.program_version,
        "firmware": firmware,
        "bench": { "toml": header.bench_toml, "sha256": header.bench_sha256 },
        "profile": { "name": header.profile_name, "toml": header.profile_toml },
        "calibration": calibration(header),
        "twin": header.twin,
        "sample_rate_hz": header.sample_rate_hz,
        "first_cycle": header.first_cycle,
        "resumes_run": header.resumes_run,
        "continues": header.continues,
        "cycles_planned": header.cycles_planned,
        "remarks": header.remarks,
        "selection": selection,
        "samples": survey.samples,
        "lost": survey.lost,
        "late": survey.late,
        "damaged": survey.damaged,
        "unsaved": survey.unsaved,
        "damage": survey.damage,
        "flagged": survey.flagged,
        "gaps": survey.gaps.iter().map(|gap| gap_json(gap, survey, header)).collect::<Vec<_>>(),
        "events": events_json(&events),
        "outcome": run.outcome(),
        "sign": SIGN
    })
}

fn gap_json(gap: &Gap, survey: &Survey, header: &Header) -> Value {
    let first = survey.ticks.map_or(gap.from_tick, |(first, _)| first);
    let time_s = |tick: u64| tick.saturating_sub(first) as f64 / header.sample_rate_hz;
    json!({
        "cause": gap.cause,
        "from_tick": gap.from_tick,
        "to_tick": gap.to_tick,
        "samples": gap.ticks(),
        "from_s": time_s(gap.from_tick),
        "to_s": time_s(gap.to_tick)
    })
}

/// All events except the corrections: there is one per cycle, so only their number is written.
fn events_json(events: &[Event]) -> Value {
    let (corrections, others): (Vec<&Event>, Vec<&Event>) = events
        .iter()
        .partition(|event| event.kind == EventKind::Correction);
    json!({ "corrections": corrections.len(), "list": others })
}

/// A name that a Data Package allows: lower case letters, digits, `.`, `_`, `-`.
fn slug(text: &str) -> String {
    let lower = text.to_ascii_lowercase();
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || ".-_".contains(c);
    lower.chars().map(|c| if allowed(c) { c } else { '-' }).collect()
}

fn field(name: &str) -> Value {
    let column = columns::find(name);
    let (kind, unit, description) =
        column.map_or(("any", "", ""), |c| (c.kind.json_type(), c.unit, c.description));
    let mut field = json!({ "name": name, "type": kind, "unit": unit, "description": description });
    if super::csv::NEEDED.contains(&name) {
        field["constraints"] = json!({ "required": true });
    }
    field
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_only_the_characters_of_a_data_package() {
        assert_eq!(slug("Run 7/ä=A"), "run-7---a");
    }

    #[test]
    fn every_column_has_a_unit_and_a_description() {
        for column in ["time_s", "command_n", "twin_force_n", "flags", "cycles_averaged"] {
            let field = field(column);
            for key in ["unit", "description"] {
                assert!(
                    field[key].as_str().is_some_and(|text| !text.is_empty()),
                    "{field}"
                );
            }
        }
        assert_eq!(
            field("twin_force_n").get("constraints"),
            None,
            "empty cells are allowed"
        );
    }

    #[test]
    fn the_package_is_in_the_folder_of_the_csv() {
        assert_eq!(
            path_of(Path::new("out/run.csv")),
            Path::new("out/run.datapackage.json")
        );
    }
}
