//! A run as an ASAM MDF 4.1 file: channels, facts of the run in the header, its files as attachments, its events as marks.

use std::io::{self, Seek, Write};

use super::table::Table;
use crate::recording::mdf::{Attachment, Mark, MdfHead, MdfWriter};
use crate::recording::{Event, EventKind};

/// Facts that are attached as files.
const ATTACHED: [&str; 3] = ["profile_toml", "bench_toml", "leafbench"];

/// Writes the table; the number of samples. `start_ns` is the start of the run: nanoseconds since 1970, UTC.
pub(super) fn write(
    sink: impl Write + Seek,
    table: &Table,
    facts: &[(&'static str, String)],
    start_ns: u64,
) -> io::Result<u64> {
    let header = table.run.header();
    let details = facts.iter().find(|(name, _)| *name == "leafbench");
    let details = details.map_or("", |(_, json)| json);
    let attachments = [
        Attachment {
            name: "profile.toml",
            mime_type: "application/toml",
            comment: "The profile file as it was used",
            bytes: header.profile_toml.as_bytes(),
        },
        Attachment {
            name: "bench.toml",
            mime_type: "application/toml",
            comment: "The bench file as it was used",
            bytes: header.bench_toml.as_bytes(),
        },
        Attachment {
            name: "leafbench.json",
            mime_type: "application/json",
            comment: "All facts of the run, as in a data package of leafbench",
            bytes: details.as_bytes(),
        },
    ];
    // The names that other programs show: author and subject.
    let mut properties = vec![
        ("author", header.operator.clone()),
        ("subject", header.specimen.clone()),
    ];
    let in_header = facts.iter().filter(|(name, _)| !ATTACHED.contains(name));
    properties.extend(in_header.cloned());
    let events = table.run.events();
    let mut writer = MdfWriter::begin(
        sink,
        &MdfHead {
            start_ns,
            title: &format!("{} on {}", header.profile_name, header.specimen),
            program_version: &header.program_version,
            properties: &properties,
            group: "samples",
            columns: &table.columns,
            attachments: &attachments,
            marks: &marks(&events),
        },
    )?;
    table.for_each(|row| writer.row(row))?;
    writer.finish()
}

/// All events except the corrections: there is one for each cycle.
fn marks(events: &[Event]) -> Vec<Mark<'_>> {
    let told = events.iter().filter(|event| event.kind != EventKind::Correction);
    told.map(|event| Mark {
        time_s: event.time_s,
        name: event.kind.word(),
        comment: &event.text,
    })
    .collect()
}
