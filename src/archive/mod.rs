//! The archive: the verified runs of a lab as one Parquet data set, on a disk or an object store. `docs/archive.md` describes it for
//! the programs that read it.
//!
//! `place` the name of an archive and its store · `lock` one writer at a time · `manifest` what is in it: the one point of commit ·
//! `samples`, `runs`, `cycles`, `diagnoses` the tables · `parquet_file` a table as bytes · `add` puts runs in · `read` gets them back · `verify` finds what changed

mod add;
mod cycles;
mod diagnoses;
mod lock;
mod manifest;
mod parquet_file;
mod partition;
mod place;
mod read;
mod runs;
mod samples;
mod verify;

#[cfg(test)]
mod tests;

use std::path::PathBuf;

use crate::recording::run_file::RunFileError;

pub(crate) use add::{AddOptions, Added, add};
pub(crate) use diagnoses::add_diagnoses;
pub use diagnoses::{DiagnosedRun, DiagnosisRow, Estimated};
pub(crate) use place::ArchiveStore;
pub(crate) use read::ArchiveReader;
pub use read::ArchivedRun;
pub(crate) use runs::bench_name;
pub(crate) use verify::{Verified, verify};

/// Version of the tables and of the manifest. A reader refuses a newer one.
pub(crate) const SCHEMA_VERSION: u32 = 1;

/// Why an archive could not be written or read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ArchiveError {
    #[error(
        "\"{place}\" is no place for an archive ({reason}): give a folder, or s3://BUCKET/PREFIX with its key in the environment"
    )]
    Place { place: String, reason: String },
    #[error(
        "{place}: {doing} {object} failed: check the connection, the rights and the free space, then give the same command again"
    )]
    Store {
        place: String,
        /// What was tried: "reading", "writing" ...
        doing: &'static str,
        object: String,
        source: Box<object_store::Error>,
    },
    #[error("{place} is not an archive: `leafbench archive {place}` makes one")]
    NoArchive { place: String },
    #[error(
        "{place} has schema {found} and this program reads up to {SCHEMA_VERSION}: use a newer leafbench"
    )]
    Schema { place: String, found: u32 },
    #[error(
        "{place}: the manifest is damaged ({reason}): restore {object} from a copy of the archive; without one, archive all runs \
         into a new place",
        object = manifest::MANIFEST
    )]
    Manifest { place: String, reason: String },
    #[error(
        "another command writes to {place} since {since} (process {pid} on {host}): wait until it ends; if you know that it has ended, \
         give --take-over"
    )]
    Locked {
        place: String,
        host: String,
        pid: u32,
        since: String,
    },
    #[error("{place} has no run {run_id}: add it with `leafbench archive`")]
    NoRun { place: String, run_id: String },
    #[error(
        "{place}: {object} is missing or not what was written: `leafbench verify {place}` names all such objects; restore them from a copy"
    )]
    Changed { place: String, object: String },
    /// Another command took the archive over while this one wrote.
    #[error("{place} was taken over by another command: nothing was committed by this one after that")]
    TakenOver { place: String },
    #[error(transparent)]
    RunFile(#[from] RunFileError),
    #[error("{path} cannot be read: check the path and the rights")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{run}: {column} is {value} in sample {sample}, which an archive cannot hold: correct the scale in the calibration of this bench"
    )]
    OutOfRange {
        run: String,
        column: &'static str,
        value: f64,
        sample: u64,
    },
    #[error("{what}: this is a defect of leafbench, please report it")]
    Parquet {
        what: &'static str,
        source: Box<parquet::errors::ParquetError>,
    },
}
