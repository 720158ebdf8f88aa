//! One SQLite file for each run: `writer` fills it during the run, `reader` opens it afterwards, whole or damaged.
//! `recording::export` writes CSV and data package from it.
//!
//! The tables are described in docs/formats.md; `layout` has them. Every row has a checksum, and the row of `totals` counts
//! them. During a live run there is a write-ahead log (`-wal`) beside the file. A clean end merges it into the file.
//!
//! Written by `writer`, through `waiting` (memory) and `part` (a file) with `sync`. Read by `reader`, through `samples` and
//! `survey`. `version_1` reads older files.

mod block;
mod layout;
mod listing;
mod part;
mod reader;
mod samples;
mod status;
mod survey;
mod sync;
mod version_1;
mod waiting;
mod writer;

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod disk_tests;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use layout::FORMAT_VERSION;

pub(crate) use listing::{RunListing, check, is_open, listing};
pub(crate) use reader::RunFile;
pub(crate) use samples::{Gap, GapCause};
pub(crate) use status::RunFileStatus;
pub(crate) use survey::{CycleSpan, Survey};
pub(crate) use writer::RunFileWriter;

/// Extension of a run file, without the dot.
pub(crate) const EXTENSION: &str = "leafrun";

/// Upper bound of the disk space of one sample in bytes: record, b-tree, and write-ahead log before it is merged.
const BYTES_PER_SAMPLE_AT_MOST: f64 = 128.0;
/// Upper bound of the disk space of a run without samples in bytes: tables, and the longest write-ahead log.
const BYTES_OF_A_RUN_AT_MOST: f64 = 160e6;

/// Removes a run file that nobody needs, with its log and its reserve.
pub(crate) fn remove(path: &Path) {
    for ending in ["", "-wal", "-shm"] {
        // A file that stays behind is closed as aborted at the next start of the daemon.
        let _ = std::fs::remove_file(format!("{}{ending}", path.display()));
    }
    part::free_reserve(path);
}

/// Why a run file could not be written or read. `path` is the run file, unless the variant says otherwise.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RunFileError {
    #[error("{path} exists already and a run file is never overwritten: use a new run id")]
    Exists { path: PathBuf },
    /// SQLite or the disk failed.
    #[error("{doing} {path} failed: check the free space and the permissions of the disk")]
    Database {
        path: PathBuf,
        /// What was tried: "writing", "opening" ...
        doing: &'static str,
        source: rusqlite::Error,
    },
    /// The file system failed; `path` is the file or a folder.
    #[error("{doing} {path} failed: check the free space and the permissions of the disk")]
    Io {
        path: PathBuf,
        /// What was tried: "listing", "syncing the folder of" ...
        doing: &'static str,
        source: std::io::Error,
    },
    #[error("{path} is not a leafbench run file ({reason}): give the path of a .leafrun file")]
    NotARun { path: PathBuf, reason: String },
    #[error(
        "{path} has run file version {found} and this program reads version {FORMAT_VERSION}: use a newer leafbench"
    )]
    Version { path: PathBuf, found: i32 },
    /// Header or outcome do not match their checksum.
    #[error("{path}: the {part} is damaged ({reason}): restore the file from a copy")]
    Damaged {
        path: PathBuf,
        /// "header" or "outcome".
        part: &'static str,
        reason: String,
    },
    /// Files are named after the run id, so it may not lead out of a folder.
    #[error(
        "{path}: its run id has other characters than letters, digits, dashes, points and underscores: do not use this file"
    )]
    RunId { path: PathBuf },
    /// Only a run that was left open can be closed as aborted.
    #[error("{path} is already closed: leave it as it is")]
    Closed { path: PathBuf },
    /// Less is free than twice the size of the run.
    #[error(
        "{folder} has {free_mb:.0} MB free and this run needs {needed_mb:.0} MB (twice its size): delete or move old \
         runs, or record elsewhere"
    )]
    NoSpace {
        /// Folder of the run files.
        folder: PathBuf,
        /// Free space for this user in MB.
        free_mb: f64,
        /// Twice the size of the run in MB.
        needed_mb: f64,
    },
}

impl RunFileError {
    fn database(path: &Path, doing: &'static str, source: rusqlite::Error) -> Self {
        RunFileError::Database {
            path: path.to_owned(),
            doing,
            source,
        }
    }
}

/// An error with all its causes in one line.
fn chain(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", chain(cause)),
        None => error.to_string(),
    }
}

/// Free space on the disk of `folder`, for a user who is not root.
pub(crate) fn free_bytes(folder: &Path) -> Result<u64, RunFileError> {
    let space = nix::sys::statvfs::statvfs(folder).map_err(|errno| RunFileError::Io {
        path: folder.to_owned(),
        doing: "reading the free space of",
        source: errno.into(),
    })?;
    Ok(space.blocks_available().saturating_mul(space.fragment_size()))
}

/// Check before a run: refuses if `folder` has less free space than twice the size of the run.
pub(crate) fn check_space(folder: &Path, duration_s: f64, sample_rate_hz: f64) -> Result<(), RunFileError> {
    let free_mb = free_bytes(folder)? as f64 / 1e6;
    let samples = duration_s * sample_rate_hz;
    let needed_mb = 2.0 * (samples * BYTES_PER_SAMPLE_AT_MOST + BYTES_OF_A_RUN_AT_MOST) / 1e6;
    if free_mb < needed_mb {
        return Err(RunFileError::NoSpace {
            folder: folder.to_owned(),
            free_mb,
            needed_mb,
        });
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod test_support {
    use crate::recording::{
        ChannelScale, Ending, FirmwareIdentity, Flags, Header, Outcome, Sample, SensorIdentity,
    };
    use crate::units::Command;

    /// A header with calibration values that are not round numbers.
    pub(crate) fn header() -> Header {
        Header {
            run_id: "20261121-103000-a1b2".into(),
            started_utc: "2026-11-21T10:30:00Z".into(),
            specimen: "leaf spring, \"no. 7\"".into(),
            operator: "=1+1".into(),
            profile_name: "sine-6mm-1hz".into(),
            profile_toml: "name = \"sine-6mm-1hz\"\n".into(),
            bench_toml: "name = \"mock\"\n".into(),
            bench_sha256: "00".repeat(32),
            firmware: FirmwareIdentity {
                serial: 12,
                ..FirmwareIdentity::default()
            },
            program_version: "0.1.0".into(),
            sample_rate_hz: 1000.0,
            force_channel: ChannelScale {
                scale_per_count: 0.1,
                offset: 1.25,
                tare: 12.3437,
                curve: [0.0; 2],
            },
            displacement_channel: ChannelScale {
                scale_per_count: 0.0005,
                offset: 0.0,
                tare: 0.012_34,
                curve: [0.0; 2],
            },
            force_sensor: SensorIdentity::default(),
            displacement_sensor: SensorIdentity::default(),
            twin: "equivalent".into(),
            first_cycle: 1,
            resumes_run: String::new(),
            cycles_planned: 50,
            duration_planned_s: 60.0,
            remarks: vec!["no real-time rights".into()],
            continues: String::new(),
        }
    }

    /// A sample of a 6 mm 1 Hz sine (1000 ticks per cycle) that starts at tick 0.
    pub(crate) fn sample(tick: u64) -> Sample {
        let header = header();
        let phase_rad = std::f64::consts::TAU * (tick % 1000) as f64 / 1000.0;
        let displacement_counts = (12_000.0 * phase_rad.sin()).round() as i32;
        let force_counts = (3_000.0 * (phase_rad - 0.2).sin()).round() as i32;
        Sample {
            tick,
            time_s: tick as f64 / 1000.0,
            force_n: header.force_channel.value(force_counts),
            displacement_mm: header.displacement_channel.value(displacement_counts),
            force_counts,
            displacement_counts,
            command: Some(Command::Displacement(6.0 * phase_rad.sin())),
            cycle: (tick / 1000) as u32 + 1,
            segment: (tick / 500) as u32 + 1,
            twin_force_n: (!tick.is_multiple_of(3)).then_some(300.0 * (phase_rad - 0.25).sin()),
            flags: Flags::default(),
        }
    }

    /// Gives a closed file another header, as if another run had been recorded in it.
    pub(crate) fn replace_header(path: &std::path::Path, header: &Header) {
        let database = rusqlite::Connection::open(path).expect("a run file");
        database
            .execute_batch("PRAGMA synchronous = OFF")
            .expect("a setting");
        super::layout::write_header(&database, header).expect("written");
    }

    /// Makes the first block of samples another one than its checksum says.
    pub(crate) fn damage_samples(path: &std::path::Path) {
        let database = rusqlite::Connection::open(path).expect("a run file");
        let sql = "UPDATE blocks SET crc32 = crc32 + 1 WHERE seq = (SELECT min(seq) FROM blocks)";
        database.execute_batch(sql).expect("changed");
    }

    /// A completed run of `samples` samples.
    pub(crate) fn outcome(samples: u64) -> Outcome {
        Outcome {
            ending: Ending::Completed,
            cause: String::new(),
            samples,
            lost: 0,
            late: 0,
            cycles_completed: (samples / 1000) as u32,
            unsaved: None,
            punctuality: None,
        }
    }
}
