//! What a reader must know about a run beside its samples, as names and texts, for formats that hold them in the same file.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::Selection;
use crate::recording::datapackage;
use crate::recording::run_file::{RunFile, Survey};

/// Name and text of each fact. `leafbench` is the object of this name in a data package, as JSON.
pub(super) fn facts(
    run: &RunFile,
    survey: &Survey,
    selection: Selection,
) -> io::Result<Vec<(&'static str, String)>> {
    let header = run.header();
    let details = datapackage::details(run, survey, &selection.to_string());
    let mut facts = vec![
        ("run_id", header.run_id.clone()),
        ("started_utc", header.started_utc.clone()),
        ("specimen", header.specimen.clone()),
        ("operator", header.operator.clone()),
        ("profile", header.profile_name.clone()),
        ("profile_toml", header.profile_toml.clone()),
        ("bench_toml", header.bench_toml.clone()),
        ("bench_sha256", header.bench_sha256.clone()),
        (
            "calibration_hash",
            format!("{:#010x}", header.firmware.calibration_hash),
        ),
        ("calibration", datapackage::calibration(header).to_string()),
        ("twin", header.twin.clone()),
        ("sample_rate_hz", header.sample_rate_hz.to_string()),
        ("selection", selection.to_string()),
        ("sign", datapackage::SIGN.to_owned()),
        ("program_version", header.program_version.clone()),
        ("leafbench", details.to_string()),
    ];
    facts.extend(run_file_sha256(run)?.map(|hash| ("run_file_sha256", hash)));
    Ok(facts)
}

/// SHA-256 of the run file in hex; `None` if a part of it is still in the write-ahead log or the run has no outcome yet.
pub(crate) fn run_file_sha256(run: &RunFile) -> io::Result<Option<String>> {
    let log = PathBuf::from(format!("{}-wal", run.path().display()));
    let log_bytes = log.metadata().map_or(0, |found| found.len());
    match run.outcome().is_some() && log_bytes == 0 {
        true => sha256_of(run.path()).map(Some),
        false => Ok(None),
    }
}

/// SHA-256 of a file in hex.
pub(crate) fn sha256_of(path: &Path) -> io::Result<String> {
    let mut hash = Sha256::new();
    io::copy(&mut File::open(path)?, &mut HashSink(&mut hash))?;
    Ok(super::hex(&hash.finalize()))
}

/// Passes what is written to a hash.
struct HashSink<'a>(&'a mut Sha256);

impl io::Write for HashSink<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
