//! The row about the whole run: every frame that the rig sent.

use super::probe::Probe;
use super::row::CheckRow;

pub(super) const ROWS: &[CheckRow] = &[CheckRow {
    id: "frames-valid",
    section: "2",
    title: "every frame of the rig is as described, reserved bits and CRC-8 included",
    moves: false,
    check: frames_valid,
}];

fn frames_valid(probe: &mut Probe) -> Result<String, String> {
    match probe.undecodable.first() {
        None => Ok("in the whole run".to_owned()),
        Some(first) => Err(format!(
            "{} frames are not, the first: {first}",
            probe.undecodable.len()
        )),
    }
}
