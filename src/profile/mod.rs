//! Profiles: what the rig is asked to do over time. A profile is blocks in order, a block is segments that repeat.

use crate::units::Mode;

/// A test as a technician writes it. The TOML form is in `file`.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Name: letters, digits, dashes.
    pub name: String,
    /// One sentence.
    pub description: String,
    /// What the rig controls, for the whole profile.
    pub mode: Mode,
    /// Blocks in order.
    pub blocks: Vec<Block>,
}

/// Segments that repeat.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// How often.
    pub repeat: u32,
    /// Segments in order.
    pub segments: Vec<Segment>,
}

/// An end level, in the unit of the profile's mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Level {
    /// From the datum (tared zero).
    Absolute(f64),
    /// From the level that the segment before ended at.
    Relative(f64),
}

/// One piece of motion.
#[derive(Debug, Clone, PartialEq)]
pub enum Segment {
    /// Straight to `to` in `duration_s`.
    Ramp {
        /// Where to.
        to: Level,
        /// How long.
        duration_s: f64,
    },
    /// Stay.
    Hold {
        /// How long.
        duration_s: f64,
    },
    /// Sine about `mean`: `taper_cycles` that grow, `cycles` counted ones at full amplitude, `taper_cycles` that shrink.
    Sine {
        /// Mean level; the sine starts and ends there.
        mean: Level,
        /// Half of peak minus valley.
        amplitude: f64,
        /// Frequency.
        frequency_hz: f64,
        /// Counted, full-amplitude cycles.
        cycles: u32,
        /// Cycles of taper on either side, never counted.
        taper_cycles: u32,
        /// Correct amplitude and mean cycle by cycle.
        correct: bool,
    },
    /// Triangle about `mean`; as `Sine`, with straight half cycles.
    Triangle {
        /// Mean level.
        mean: Level,
        /// Half of peak minus valley.
        amplitude: f64,
        /// Frequency.
        frequency_hz: f64,
        /// Counted cycles.
        cycles: u32,
        /// Cycles of taper on either side.
        taper_cycles: u32,
        /// Correct amplitude and mean cycle by cycle.
        correct: bool,
    },
    /// Points of time (s from the segment's start, rising from 0) and level, joined by straight lines.
    Table {
        /// Times in s.
        time_s: Vec<f64>,
        /// Levels; all absolute or all relative to the segment's start.
        level: Vec<f64>,
        /// True: levels count from where the segment starts.
        relative: bool,
    },
}
