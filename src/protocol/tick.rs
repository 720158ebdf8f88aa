//! The rig's tick: one sample, one command slot and one turn of the servo loop. Every length of a tick in the program
//! derives from [`SAMPLE_RATE_HZ`].

use crate::units::NS_PER_S;

/// Ticks per second: samples, command slots and turns of the servo loop.
pub(crate) const SAMPLE_RATE_HZ: u32 = 1000;
/// The same as a float, for rates per tick.
pub(crate) const TICKS_PER_S: f64 = SAMPLE_RATE_HZ as f64;
/// Length of a tick in s.
pub(crate) const TICK_S: f64 = 1.0 / TICKS_PER_S;
/// Length of a tick in ns.
pub(crate) const TICK_NS: u64 = NS_PER_S / SAMPLE_RATE_HZ as u64;

/// Whole ticks in `ms` milliseconds.
pub(crate) const fn ticks_in_ms(ms: u64) -> u64 {
    ms * SAMPLE_RATE_HZ as u64 / 1000
}

/// Whole milliseconds in `ticks` ticks.
pub(crate) const fn ms_in_ticks(ticks: u64) -> u64 {
    ticks * 1000 / SAMPLE_RATE_HZ as u64
}
