//! A run on the mock rig in one call, for other Rust programs.

use crate::cli::{CliError, virtual_bench};
use crate::config::Bench;
use crate::profile::Profile;
use crate::recording::Recording;

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
