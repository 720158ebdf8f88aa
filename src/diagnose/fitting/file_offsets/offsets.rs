//! Offsets of one recording, and their kinds.

/// Offsets of one recording.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(in crate::diagnose::fitting) struct FileOffsets {
    /// What the force channel reads at no force, N.
    pub force_n: f64,
    /// What the displacement channel reads too much, mm.
    pub displacement_mm: f64,
    /// Delay of the force behind the displacement, s.
    pub delay_s: f64,
}

/// One kind of offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OffsetKind {
    Force,
    Displacement,
    Delay,
}

use OffsetKind::{Delay, Displacement, Force};

impl FileOffsets {
    pub(super) fn add(&mut self, kind: OffsetKind, by: f64) {
        match kind {
            Force => self.force_n += by,
            Displacement => self.displacement_mm += by,
            Delay => self.delay_s += by,
        }
    }

    pub(super) fn of(&self, kind: OffsetKind) -> f64 {
        match kind {
            Force => self.force_n,
            Displacement => self.displacement_mm,
            Delay => self.delay_s,
        }
    }
}
