//! The index on the disk: `runs.index` in the data folder, so that a program that has just started need not open every run
//! file. It is never the truth. Each line stands for itself: a checksum, then what was read from one state of one file. A line
//! that is torn or of another state of the file counts as missing, and the run file is read again. So a crash, a second
//! program and a deleted index all do no harm.

use std::collections::HashMap;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::identity::FileIdentity;
use crate::recording::atomic_file;
use crate::recording::run_file::RunListing;
use crate::regular_file;

/// Name of the file in the data folder.
const FILE: &str = "runs.index";
/// First line. Raise the number when the meaning of a line changes.
const HEAD: &str = "leafbench run index 1";
/// A larger file is not read, bytes: a million runs.
const MOST_BYTES: u64 = 1 << 30;
/// The file is written anew if it has this many lines more than twice the number of runs.
const SPARE_LINES: usize = 1000;

static CRC32: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// What was read from one state of a run file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct KeptRun {
    /// Name of the file in the data folder.
    pub file: String,
    pub identity: FileIdentity,
    /// The file was read in full.
    pub checked: bool,
    pub listing: RunListing,
}

/// The file of the index.
#[derive(Debug)]
pub(super) struct KeptIndex {
    path: PathBuf,
    lines: usize,
    /// The file is not there, or has lines that cannot be read.
    unsound: bool,
}

impl KeptIndex {
    /// The index of `folder`, and what it says by the name of the run file.
    pub(super) fn read(folder: &Path) -> (KeptIndex, HashMap<String, KeptRun>) {
        let path = folder.join(FILE);
        // Any error means that the run files are read instead.
        let text = regular_file::read(&path, MOST_BYTES).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let mut lines = text.lines();
        let mut index = KeptIndex {
            path,
            lines: 0,
            unsound: lines.next() != Some(HEAD),
        };
        let mut runs = HashMap::new();
        if !index.unsound {
            for line in lines {
                index.lines += 1;
                match run_of(line) {
                    Some(run) => drop(runs.insert(run.file.clone(), run)),
                    None => index.unsound = true,
                }
            }
        }
        (index, runs)
    }

    /// Adds what was read since. If it cannot be written, the next program reads the run files.
    pub(super) fn add(&mut self, runs: &[KeptRun]) {
        if runs.is_empty() || self.unsound {
            return;
        }
        let text: String = runs.iter().filter_map(line_of).collect();
        let file = OpenOptions::new().append(true).mode(0o600).open(&self.path);
        match file.and_then(|mut file| file.write_all(text.as_bytes())) {
            Ok(()) => self.lines += runs.len(),
            Err(_) => self.unsound = true,
        }
    }

    /// The file has to be written anew: it is missing, damaged or mostly out of date.
    pub(super) fn is_worn(&self, runs: usize) -> bool {
        self.unsound || self.lines > 2 * runs + SPARE_LINES
    }

    /// Writes the file anew.
    pub(super) fn rewrite(&mut self, runs: &[KeptRun]) {
        let write = || -> io::Result<()> {
            atomic_file::write(&self.path, |file| {
                writeln!(file, "{HEAD}")?;
                runs.iter()
                    .filter_map(line_of)
                    .try_for_each(|line| file.write_all(line.as_bytes()))
            })
        };
        match write() {
            Ok(()) => (self.lines, self.unsound) = (runs.len(), false),
            Err(error) => tracing::debug!("{} is not written: {error}", self.path.display()),
        }
    }
}

fn line_of(run: &KeptRun) -> Option<String> {
    let json = serde_json::to_string(run).ok()?;
    Some(format!("{:08x} {json}\n", CRC32.checksum(json.as_bytes())))
}

fn run_of(line: &str) -> Option<KeptRun> {
    let (crc, json) = line.split_once(' ')?;
    let crc = u32::from_str_radix(crc, 16).ok()?;
    (CRC32.checksum(json.as_bytes()) == crc)
        .then(|| serde_json::from_str(json).ok())
        .flatten()
}
