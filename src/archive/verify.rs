//! Compares an archive with its manifest, byte by byte, and with the run files it was made from.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use rayon::prelude::*;

use super::manifest::{Manifest, ManifestEntry};
use super::partition::{RUN_TABLES, RUNS, SAMPLES, hash};
use super::{ArchiveError, ArchiveStore};
use crate::recording::run_file::RunFile;

/// What an archive holds, and what is wrong with it.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub(crate) struct Verified {
    pub runs: usize,
    pub samples: u64,
    pub objects: usize,
    pub bytes: u64,
    /// What is wrong, one sentence each; empty if the archive is whole.
    pub problems: Vec<String>,
    /// Objects of an interrupted command. They are no damage: the next `leafbench archive` removes them.
    pub leftovers: Vec<String>,
    /// Closed runs of the given files that the archive does not have.
    pub missing_runs: Vec<String>,
}

impl Verified {
    /// True if nothing is wrong, left over or missing.
    pub(crate) fn is_clean(&self) -> bool {
        self.problems.is_empty() && self.leftovers.is_empty() && self.missing_runs.is_empty()
    }
}

/// Reads every object of the archive. `files` are run files that it should have.
pub(crate) fn verify(
    store: &ArchiveStore,
    files: &[PathBuf],
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Verified, ArchiveError> {
    let manifest = Manifest::read(store)?.ok_or_else(|| ArchiveError::NoArchive {
        place: store.name().to_owned(),
    })?;
    let objects: BTreeMap<String, u64> = store.list()?.into_iter().map(|o| (o.path, o.bytes)).collect();
    let entries: Vec<&ManifestEntry> = manifest.entries().collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let checked: Result<Vec<Option<String>>, ArchiveError> = entries
        .par_iter()
        .map(|entry| {
            let problem = match objects.get(&entry.path) {
                None => Some(format!("{} is missing", entry.path)),
                Some(_) => problem_of(store, entry)?,
            };
            let so_far = 1 + done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            progress(so_far as f64 / entries.len() as f64);
            Ok(problem)
        })
        .collect();
    let mut problems: Vec<String> = checked?.into_iter().flatten().collect();
    problems.extend(incomplete_runs(&manifest));
    let mut leftovers = manifest.unknown(objects.into_keys());
    let interrupted = store.interrupted_files()?;
    leftovers.extend(interrupted.iter().map(|path| path.display().to_string()));
    Ok(Verified {
        runs: manifest.runs_of(RUNS).len(),
        samples: manifest.of_table(SAMPLES).map(|entry| entry.rows).sum(),
        objects: entries.len(),
        bytes: entries.iter().map(|entry| entry.bytes).sum(),
        problems,
        leftovers,
        missing_runs: missing_runs(&manifest, files),
    })
}

/// What is wrong with one object.
fn problem_of(store: &ArchiveStore, entry: &ManifestEntry) -> Result<Option<String>, ArchiveError> {
    let Some(content) = store.get(&entry.path)? else {
        return Ok(Some(format!("{} is missing", entry.path)));
    };
    if content.len() as u64 != entry.bytes {
        let (is, was) = (content.len(), entry.bytes);
        return Ok(Some(format!("{} has {is} bytes and had {was}", entry.path)));
    }
    let same = hash(&content) == entry.sha256;
    Ok((!same).then(|| format!("{} is not what was written: its hash is another", entry.path)))
}

/// Runs that are in some tables only.
fn incomplete_runs(manifest: &Manifest) -> Vec<String> {
    let tables = RUN_TABLES.map(|table| (table, manifest.runs_of(table)));
    let all: BTreeSet<&str> = tables.iter().flat_map(|(_, runs)| runs).copied().collect();
    let lacking = all.iter().flat_map(|run| {
        let without = tables.iter().filter(move |(_, runs)| !runs.contains(run));
        without.map(move |(table, _)| format!("run {run} is missing in the table {table}"))
    });
    let mut problems: Vec<String> = lacking.collect();
    // Each run is in one file of each table.
    for table in RUN_TABLES {
        let mut seen = BTreeSet::new();
        for run in manifest.of_table(table).flat_map(|entry| &entry.runs) {
            if !seen.insert(run) {
                problems.push(format!("run {run} is twice in the table {table}"));
            }
        }
    }
    problems
}

/// Closed runs of these files that the archive does not have, or has from another file.
fn missing_runs(manifest: &Manifest, files: &[PathBuf]) -> Vec<String> {
    let present = manifest.runs_of(RUNS);
    let closed = files.iter().filter_map(|path| {
        let run = RunFile::open(path).ok()?;
        run.outcome()?;
        Some(run.header().run_id.clone())
    });
    closed
        .filter(|run_id| !present.contains(run_id.as_str()))
        .collect()
}
