//! Stores the calibration hash of a bench file in its rig.

use std::time::{Duration, Instant};

use super::super::{CliError, Done, Output};
use crate::config::Bench;
use crate::conformance::{Probe, ProbeClock, Reach};
use crate::link::{self, Side};

/// Pause between two looks at the link.
const LOOK: Duration = Duration::from_millis(1);
/// CalibrationSession number of this program, which it never opens.
const SESSION: u8 = 202;

/// The result as JSON.
#[derive(serde::Serialize)]
struct StoredHash {
    link: String,
    hash: String,
    hash_before: String,
}

/// Writes the hash and reads it back. Nothing moves; a rig whose pump is on refuses.
pub(super) fn store(bench: &Bench, address: Option<&str>, output: &Output) -> Result<Done, CliError> {
    let address = address.unwrap_or(&bench.link.address);
    if link::is_in_process(address) {
        return Err(CliError::Input(
            "the mock rig in memory takes the hash of its bench by itself: name a rig with --link".to_owned(),
        ));
    }
    let node = bench.link.node;
    let link = link::open(address, Side::Host { rig_node: node })?;
    let began = Instant::now();
    let wait = Box::new(move || {
        std::thread::sleep(LOOK);
        u64::try_from(began.elapsed().as_millis()).unwrap_or(u64::MAX)
    });
    let mut probe = Probe::new(link, ProbeClock::Real(wait), node, SESSION);
    match probe.reach() {
        Reach::Free => {}
        Reach::Nothing => {
            return Err(CliError::Input(format!(
                "no rig answers at {address} as node {node}: check power, cable, bit rate and node"
            )));
        }
        Reach::Owned(session) => {
            return Err(CliError::Input(format!(
                "session {session} owns the rig at {address}: stop that daemon first"
            )));
        }
    }
    let hash = bench.calibration_hash();
    let before = probe.store_calibration_hash(hash).map_err(CliError::Input)?;
    let stored = StoredHash {
        link: address.to_owned(),
        hash: format!("{hash:#010x}"),
        hash_before: format!("{before:#010x}"),
    };
    output.result(&stored, || {
        format!(
            "the rig at {} has the calibration hash {} now (before: {})",
            stored.link, stored.hash, stored.hash_before
        )
    })?;
    Ok(Done::Success)
}
