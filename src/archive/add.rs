//! Puts runs into an archive: first their samples, then their rows, then the manifest. Only the last step makes them a part of the
//! archive, so a command that is killed at any instant leaves nothing half, and the next one goes on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::lock::WriterLock;
use super::manifest::{Manifest, ManifestEntry};
use super::partition::{self, CYCLES, Partition, RUNS, SAMPLES, hash};
use super::runs::ArchiveRow;
use super::{ArchiveError, ArchiveStore, cycles, runs, samples};
use crate::recording::cycles::CycleSummary;
use crate::recording::export;
use crate::recording::run_file::RunFile;

/// Runs between two commits: what a kill loses is a few seconds of work.
const RUNS_OF_A_COMMIT: usize = 256;

/// How runs are put into an archive.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct AddOptions {
    /// Take the archive from another writer.
    pub take_over: bool,
}

/// What a command put into an archive.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub(crate) struct Added {
    /// Runs that are new in the archive.
    pub added: usize,
    /// Runs that were there already.
    pub present: usize,
    /// Samples of the new runs.
    pub samples: u64,
    /// Bytes of the new objects.
    pub bytes: u64,
    /// Objects that an interrupted command had left, now removed.
    pub leftovers_removed: usize,
    /// Runs that are still under way: archive them after their end.
    pub open: Vec<String>,
    /// Runs that are not whole, each with the reason. They are not archived.
    pub refused: Vec<String>,
}

/// A run that was read and whose samples are in the store.
struct StoredRun {
    partition: Partition,
    row: ArchiveRow,
    cycles: Vec<CycleSummary>,
    samples: ManifestEntry,
}

/// What became of one run file.
enum Fate {
    Prepared(Box<StoredRun>),
    Open(String),
    Refused(String),
}

/// Puts the run files into the archive. `progress` is called with the number of files that are done.
pub(crate) fn add(
    store: &ArchiveStore,
    files: &[PathBuf],
    options: AddOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Added, ArchiveError> {
    let lock = WriterLock::take(store, options.take_over)?;
    let found = Manifest::read(store)?;
    let mut manifest = found.clone().unwrap_or_default();
    let mut added = Added {
        leftovers_removed: remove_leftovers(store, &manifest)?,
        ..Added::default()
    };
    if found.is_none() {
        manifest.write(store)?;
    }
    let new = new_files(files, &manifest, &mut added);
    progress(files.len() - new.len());
    for batch in new.chunks(RUNS_OF_A_COMMIT) {
        let done = added.present + added.refused.len() + added.added + added.open.len();
        let counter = std::sync::atomic::AtomicUsize::new(done);
        let fates: Result<Vec<Fate>, ArchiveError> = batch
            .par_iter()
            .map(|path| {
                let fate = prepare(store, path)?;
                progress(1 + counter.fetch_add(1, std::sync::atomic::Ordering::Relaxed));
                Ok(fate)
            })
            .collect();
        let prepared = sort_fates(fates?, &mut added);
        commit(store, &lock, &mut manifest, &prepared, &mut added)?;
    }
    Ok(added)
}

/// Removes what an interrupted command has left: files that are not whole, and objects of the tables that the manifest does not know.
fn remove_leftovers(store: &ArchiveStore, manifest: &Manifest) -> Result<usize, ArchiveError> {
    let interrupted = store.interrupted_files()?;
    for path in &interrupted {
        std::fs::remove_file(path).map_err(|source| ArchiveError::Read {
            path: path.clone(),
            source,
        })?;
    }
    let mut leftovers = manifest.unknown(store.list()?.into_iter().map(|object| object.path));
    // A run that is half there must not be seen in the table of runs.
    leftovers.sort_by_key(|path| !path.starts_with(RUNS));
    for path in &leftovers {
        store.delete(path)?;
    }
    Ok(interrupted.len() + leftovers.len())
}

/// The files of runs that the archive does not have, in the order of specimens and months, so that a commit has few partitions.
fn new_files(files: &[PathBuf], manifest: &Manifest, added: &mut Added) -> Vec<PathBuf> {
    let present = manifest.runs_of(SAMPLES);
    let mut new: Vec<(Option<Partition>, PathBuf)> = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for path in files {
        match RunFile::open(path) {
            Ok(run) => {
                let header = run.header();
                if !seen.insert(header.run_id.clone()) {
                    let twice = format!("{}: another file has the same run id", path.display());
                    added.refused.push(twice);
                } else if present.contains(header.run_id.as_str()) {
                    added.present += 1;
                } else {
                    new.push((Some(Partition::of(header)), path.clone()));
                }
            }
            // Read again later, where it is refused with its reason.
            Err(_) => new.push((None, path.clone())),
        }
    }
    new.sort_unstable();
    new.into_iter().map(|(_, path)| path).collect()
}

/// Reads a run in full and stores its samples.
fn prepare(store: &ArchiveStore, path: &Path) -> Result<Fate, ArchiveError> {
    let refused = |reason: &dyn std::fmt::Display| Fate::Refused(format!("{}: {reason}", path.display()));
    let run = match RunFile::open(path) {
        Ok(run) => run,
        Err(error) => return Ok(refused(&error)),
    };
    let Some(outcome) = run.outcome() else {
        return Ok(Fate::Open(run.header().run_id.clone()));
    };
    let survey = run.survey();
    if !survey.damage.is_empty() {
        return Ok(refused(&survey.damage.join("; ")));
    }
    let read = |source| ArchiveError::Read {
        path: path.to_owned(),
        source,
    };
    let Some(sha256) = export::run_file_sha256(&run).map_err(read)? else {
        return Ok(Fate::Open(run.header().run_id.clone()));
    };
    let bytes = path.metadata().map_err(read)?.len();
    let row = ArchiveRow::of(&run, outcome, &survey, sha256, bytes);
    let cycles = export::cycle_summaries(&run);
    let partition = Partition::of(run.header());
    let run_id = run.header().run_id.clone();
    let file = match samples::file(&run, &survey) {
        Err(error @ ArchiveError::OutOfRange { .. }) => return Ok(refused(&error)),
        file => file?,
    };
    let samples = store_table(store, partition.file(SAMPLES, &run_id), file, vec![run_id])?;
    Ok(Fate::Prepared(Box::new(StoredRun {
        partition,
        row,
        cycles,
        samples,
    })))
}

fn sort_fates(fates: Vec<Fate>, added: &mut Added) -> Vec<StoredRun> {
    let mut prepared = Vec::new();
    for fate in fates {
        match fate {
            Fate::Prepared(run) => prepared.push(*run),
            Fate::Open(run_id) => added.open.push(run_id),
            Fate::Refused(reason) => added.refused.push(reason),
        }
    }
    prepared
}

/// Writes the rows of the prepared runs, and then the manifest.
fn commit(
    store: &ArchiveStore,
    lock: &WriterLock,
    manifest: &mut Manifest,
    prepared: &[StoredRun],
    added: &mut Added,
) -> Result<(), ArchiveError> {
    let mut partitions: BTreeMap<&Partition, Vec<&StoredRun>> = BTreeMap::new();
    for run in prepared {
        partitions.entry(&run.partition).or_default().push(run);
    }
    let partitions: Vec<_> = partitions.into_iter().collect();
    let tables: Result<Vec<[ManifestEntry; 2]>, ArchiveError> = partitions
        .par_iter()
        .map(|(partition, runs)| store_rows(store, partition, runs))
        .collect();
    let samples = prepared.iter().map(|run| run.samples.clone());
    let entries: Vec<ManifestEntry> = tables?.into_iter().flatten().chain(samples).collect();
    lock.check()?;
    added.bytes += entries.iter().map(|entry| entry.bytes).sum::<u64>();
    manifest.extend(entries);
    manifest.write(store)?;
    added.added += prepared.len();
    added.samples += prepared.iter().map(|run| run.samples.rows).sum::<u64>();
    Ok(())
}

/// Stores the rows of runs of one partition: the cycles first, because a run is looked up in the table of runs.
fn store_rows(
    store: &ArchiveStore,
    partition: &Partition,
    prepared: &[&StoredRun],
) -> Result<[ManifestEntry; 2], ArchiveError> {
    let mut prepared = prepared.to_vec();
    prepared.sort_unstable_by(|a, b| a.row.header.run_id.cmp(&b.row.header.run_id));
    let ids: Vec<String> = prepared.iter().map(|run| run.row.header.run_id.clone()).collect();
    let name = format!("part-{}", &hash(ids.join("\n").as_bytes())[..16]);
    let of_cycles = prepared
        .iter()
        .map(|run| (run.row.header.run_id.as_str(), run.cycles.as_slice()));
    let cycles = store_table(
        store,
        partition.file(CYCLES, &name),
        cycles::file(of_cycles)?,
        ids.clone(),
    )?;
    let rows = runs::file(prepared.iter().map(|run| &run.row))?;
    let runs = store_table(store, partition.file(RUNS, &name), rows, ids)?;
    Ok([cycles, runs])
}

fn store_table(
    store: &ArchiveStore,
    path: String,
    (content, rows): (Vec<u8>, u64),
    runs: Vec<String>,
) -> Result<ManifestEntry, ArchiveError> {
    let entry = ManifestEntry {
        bytes: content.len() as u64,
        sha256: partition::hash(&content),
        rows,
        runs,
        path,
    };
    store.put(&entry.path, content)?;
    Ok(entry)
}
