//! Stores the hash of a new calibration in a rig that is off.

use super::probe::Probe;
use crate::protocol::message::object;

impl Probe {
    /// Writes the calibration hash and reads it back; returns the hash that the rig had. The error says what the rig answered.
    pub(crate) fn store_calibration_hash(&mut self, hash: u32) -> Result<u32, String> {
        let before = self.read(object::CALIBRATION_HASH)?;
        self.try_write(object::CALIBRATION_HASH, hash)?.map_err(|abort| {
            format!("the rig refuses the hash ({abort:?}): it must be off, with the pump off")
        })?;
        match self.read(object::CALIBRATION_HASH)? {
            stored if stored == hash => Ok(before),
            stored => Err(format!(
                "the rig has {stored:#010x} after {hash:#010x} was written: check its memory"
            )),
        }
    }
}
