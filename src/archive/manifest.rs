//! The manifest: every object that belongs to the archive, with its hash. It is written last and whole, so a run is in the archive
//! from one instant to the next. What is not in it is the rest of an interrupted command, and the next command removes it.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::partition::{TABLES, hash};
use super::{ArchiveError, ArchiveStore, SCHEMA_VERSION};

/// The manifest, one JSON object a line.
pub(super) const MANIFEST: &str = "_archive/manifest.jsonl";

/// The first line of a manifest.
#[derive(Debug, Serialize, Deserialize)]
struct ManifestHead {
    schema: u32,
}

/// One object of the archive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ManifestEntry {
    pub path: String,
    pub bytes: u64,
    pub sha256: String,
    pub rows: u64,
    /// Ids of the runs whose rows are in it.
    pub runs: Vec<String>,
}

/// Last line: what the lines before it are.
#[derive(Debug, Serialize, Deserialize)]
struct ManifestEnd {
    entries: usize,
    sha256: String,
}

/// All objects of an archive, by path.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Manifest {
    entries: BTreeMap<String, ManifestEntry>,
}

impl Manifest {
    /// Reads the manifest; `None` if the place has none.
    pub(super) fn read(store: &ArchiveStore) -> Result<Option<Manifest>, ArchiveError> {
        let Some(bytes) = store.get(MANIFEST)? else {
            return Ok(None);
        };
        let damaged = |reason: &str| ArchiveError::Manifest {
            place: store.name().to_owned(),
            reason: reason.to_owned(),
        };
        let text = std::str::from_utf8(&bytes).map_err(|_| damaged("it is no text"))?;
        let body_end = text.trim_end_matches('\n').rfind('\n').map_or(0, |at| at + 1);
        let (body, end) = text.split_at(body_end);
        let end: ManifestEnd = serde_json::from_str(end).map_err(|_| damaged("its last line is missing"))?;
        // The end line as it was written, so that a flipped byte in it shows too.
        let written = text == format!("{body}{}", end_line(&end));
        if !written || end.sha256 != hash(body.as_bytes()) {
            return Err(damaged("its hash is another"));
        }
        let mut lines = body.lines();
        let head = lines
            .next()
            .and_then(|line| serde_json::from_str::<ManifestHead>(line).ok());
        let head = head.ok_or_else(|| damaged("its first line cannot be read"))?;
        if head.schema > SCHEMA_VERSION {
            return Err(ArchiveError::Schema {
                place: store.name().to_owned(),
                found: head.schema,
            });
        }
        let entries = lines.map(serde_json::from_str::<ManifestEntry>);
        let entries: Result<Vec<_>, _> = entries.collect();
        let entries = entries.map_err(|_| damaged("a line cannot be read"))?;
        if entries.len() != end.entries {
            return Err(damaged("its number of lines is another"));
        }
        let entries = entries.into_iter().map(|entry| (entry.path.clone(), entry));
        Ok(Some(Manifest {
            entries: entries.collect(),
        }))
    }

    /// Writes the manifest: from here on its objects are in the archive.
    pub(super) fn write(&self, store: &ArchiveStore) -> Result<(), ArchiveError> {
        let head = ManifestHead {
            schema: SCHEMA_VERSION,
        };
        let mut text = serde_json::to_string(&head).unwrap_or_default() + "\n";
        for entry in self.entries.values() {
            text += &serde_json::to_string(entry).unwrap_or_default();
            text.push('\n');
        }
        let end = ManifestEnd {
            entries: self.entries.len(),
            sha256: hash(text.as_bytes()),
        };
        text += &end_line(&end);
        store.put(MANIFEST, text.into_bytes())
    }

    /// Adds objects, or replaces those of the same path.
    pub(super) fn extend(&mut self, entries: impl IntoIterator<Item = ManifestEntry>) {
        let entries = entries.into_iter().map(|entry| (entry.path.clone(), entry));
        self.entries.extend(entries);
    }

    /// All objects, by path.
    pub(super) fn entries(&self) -> impl Iterator<Item = &ManifestEntry> {
        self.entries.values()
    }

    /// Those paths that lie in a table and that it does not have.
    pub(super) fn unknown(&self, paths: impl Iterator<Item = String>) -> Vec<String> {
        let of_a_table = |path: &str| {
            path.split_once('/')
                .is_some_and(|(table, _)| TABLES.contains(&table))
        };
        paths.filter(|path| of_a_table(path) && !self.has(path)).collect()
    }

    /// The objects of a table, by path.
    pub(super) fn of_table<'a>(&'a self, table: &'a str) -> impl Iterator<Item = &'a ManifestEntry> {
        self.entries()
            .filter(move |e| e.path.split('/').next() == Some(table))
    }

    /// True if it has an object of this path.
    pub(super) fn has(&self, path: &str) -> bool {
        self.entries.contains_key(path)
    }

    /// Runs that have rows in a table.
    pub(super) fn runs_of<'a>(&'a self, table: &'a str) -> BTreeSet<&'a str> {
        let of_table = self.of_table(table);
        of_table.flat_map(|e| e.runs.iter().map(String::as_str)).collect()
    }
}

fn end_line(end: &ManifestEnd) -> String {
    serde_json::to_string(end).unwrap_or_default() + "\n"
}
