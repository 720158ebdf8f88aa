//! Profiles: what the rig is asked to do over time. A profile is blocks in order, a block is segments that repeat.
//!
//! `player` turns a profile into one command a tick, `stop` leaves it smoothly, `correction` keeps a sine's amplitude and
//! mean, `file` is the TOML form, `check` holds a profile against limits. Whether the rig obeys is `control`'s business; what the spring answers is a model's.

pub(crate) mod check;
pub(crate) mod correction;
pub(crate) mod file;
mod keys;
mod pieces;
pub(crate) mod player;
mod shape;
pub(crate) mod stop;
mod write;

#[cfg(test)]
pub(crate) use check::violations;
pub(crate) use check::{Extreme, LimitWatch, ProfileLimits, Violation};
pub(crate) use correction::{Correction, CycleController, CycleMeasurement};
pub(crate) use player::{CycleTarget, Player, Slot};

use crate::units::Mode;

/// Why a profile cannot be used. Segments are numbered from 1 through the expanded profile.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum ProfileError {
    /// Nothing to do.
    #[error("profile {name} has no segment: add a [[block]] with at least one [[block.segment]]")]
    Empty {
        /// The profile.
        name: String,
    },
    /// More segments than a session can hold.
    #[error(
        "profile {name} expands to more than {limit} segments: repeat less, or put the cycles into one sine"
    )]
    TooManySegments {
        /// The profile.
        name: String,
        /// How many are allowed.
        limit: usize,
    },
    /// Longer than the longest test.
    #[error("profile {name} lasts longer than {limit_h} h: shorten it or split it into runs")]
    TooLong {
        /// The profile.
        name: String,
        /// Hours allowed.
        limit_h: u32,
    },
    /// The file cannot be read, or a segment in it cannot be played.
    #[error("profile {name}, line {line}, column {column}: {reason}")]
    File {
        /// File name, for messages.
        name: String,
        /// From 1.
        line: usize,
        /// From 1, in characters.
        column: usize,
        /// What is wrong and what to do.
        reason: String,
    },
    /// A number that makes no motion.
    #[error("segment {segment} of profile {name}: {key} = {value} {reason}")]
    Value {
        /// The profile.
        name: String,
        /// Expanded segment.
        segment: u32,
        /// Key of the file.
        key: &'static str,
        /// As given.
        value: f64,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// A sine, triangle or table that would begin with a step.
    #[error(
        "segment {segment} of profile {name} begins at {begins} but the one before ends at {level}: add a ramp to {begins} before it"
    )]
    Step {
        /// The profile.
        name: String,
        /// Expanded segment.
        segment: u32,
        /// Level that the segment begins at.
        begins: f64,
        /// Level before it.
        level: f64,
    },
    /// Resume at a cycle that the profile does not count.
    #[error("cycle {cycle} cannot be resumed: profile {name} counts cycles 1 to {total}")]
    NoSuchCycle {
        /// The profile.
        name: String,
        /// As asked for.
        cycle: u32,
        /// Counted cycles.
        total: u32,
    },
}

/// A test as a technician writes it. The TOML form is in `file`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Profile {
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
pub(crate) struct Block {
    /// How often.
    pub repeat: u32,
    /// Segments in order.
    pub segments: Vec<Segment>,
}

/// An end level, in the unit of the profile's mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Level {
    /// From the datum (tared zero).
    Absolute(f64),
    /// From the level that the segment before ended at.
    Relative(f64),
}

/// One piece of motion.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Segment {
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
