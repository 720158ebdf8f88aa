//! SAMPLE: TPDO1, 0x180 + N, rig to host, every tick.

use super::{COUNTS_INVALID, COUNTS_MAX, DecodeError};
use crate::protocol::bits::{Bits, Field, TICK, seal};
use crate::protocol::frame::Frame;
use crate::protocol::protection::FrameKind;

/// Both channels at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SampleMessage {
    /// Alternating counter, 0 to 14.
    pub counter: u8,
    /// Low 16 bits of the rig's tick at the sample.
    pub tick: u16,
    /// Load cell, 18 bit signed; `COUNTS_INVALID` = no valid reading.
    pub force_counts: i32,
    /// LVDT, 18 bit signed; `COUNTS_INVALID` = no valid reading.
    pub displacement_counts: i32,
}

const FORCE: Field = Field::new("force", 12, 18);
const DISPLACEMENT: Field = Field::new("displacement", 30, 18);

impl SampleMessage {
    /// Counts beyond 18 bits are limited to the nearest value that fits.
    pub(super) fn encode(&self, node: u8) -> Frame {
        let bits = FORCE.put_signed(self.force_counts.clamp(COUNTS_INVALID, COUNTS_MAX))
            | DISPLACEMENT.put_signed(self.displacement_counts.clamp(COUNTS_INVALID, COUNTS_MAX))
            | TICK.put(self.tick);
        seal(FrameKind::Sample, node, self.counter, bits)
    }

    pub(super) fn decode(frame: &Frame, node: u8) -> Result<Self, DecodeError> {
        let bits = Bits::unseal(frame, FrameKind::Sample, node)?;
        Ok(SampleMessage {
            counter: bits.counter()?,
            tick: bits.u16(&TICK),
            force_counts: bits.signed(&FORCE),
            displacement_counts: bits.signed(&DISPLACEMENT),
        })
    }
}
