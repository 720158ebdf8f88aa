//! The library for other Rust programs: a few functions over the rooms below. `src/lib.rs` re-exports them with the types.

use std::path::Path;

use crate::cli::{CliError, virtual_bench};
use crate::config::Bench;
use crate::model::{self, BuildError, Model};
use crate::profile::Profile;
use crate::recording::Recording;
use crate::recording::csv::{self, CsvError};

/// Why a run on the mock rig gave no recording. The text says what is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct RecordError(#[from] Box<CliError>);

/// Runs a profile on the bench's mock rig in virtual time and returns what was recorded: from the first to the last sample
/// of the profile, without the unloading after it. The same bench gives the same bits.
pub fn record(bench: &Bench, profile: &Profile) -> Result<Recording, RecordError> {
    let memory = virtual_bench::record_in_memory(bench, profile).map_err(Box::new)?;
    Ok(memory.recording(&profile.name))
}

/// Reads a recording from a CSV file with at least the columns `time_s`, `displacement_mm` and `force_n`.
pub fn read_csv(path: &Path) -> Result<Recording, CsvError> {
    csv::read_file(path)
}

/// The model of this name: `equivalent`, `five-link`, `finite-segment` or `leaf-pack`.
pub fn find_model(name: &str) -> Result<&'static Model, BuildError> {
    model::find(name)
}
