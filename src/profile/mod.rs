//! Profiles: what the rig is commanded to do over time. A profile is a list of blocks, a block is a list of segments that repeat.
//!
//! `file` and `keys` read the TOML form, `accept` the limits that a run is judged by, `outline` says where in the text each value stands,
//! `pieces` resolves levels and repeats, `player` gives one command per tick,
//! `correction` keeps amplitude and mean of a sine at their targets, `check` holds a profile against limits. Measuring the
//! rig and stopping it is left to `control`, the force of the spring to the models.

pub(crate) mod accept;
pub(crate) mod check;
pub(crate) mod correction;
pub(crate) mod file;
mod keys;
pub(crate) mod outline;
mod pieces;
pub(crate) mod player;
pub(crate) mod reader;
mod shape;

#[cfg(test)]
pub(crate) use check::violations;
pub(crate) use check::{Extreme, LimitWatch, ProfileLimits, Violation};
pub(crate) use correction::{Correction, CycleController, CycleMeasurement, CycleTarget};
pub(crate) use player::{Player, Slot};

use accept::AcceptLimit;

use crate::units::Mode;

/// Why a profile cannot be used. `name` is that of the profile; segments count from 1 with all repeats written out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProfileError {
    #[error("profile {name} has no segment: add a [[block]] with at least one [[block.segment]]")]
    Empty { name: String },
    #[error(
        "profile {name} expands to more than {limit} segments: repeat less, or put the cycles into one sine"
    )]
    TooManySegments { name: String, limit: usize },
    #[error("profile {name} lasts longer than {limit_h} h: shorten it or split it into runs")]
    TooLong { name: String, limit_h: u32 },
    /// The file cannot be read, or a segment in it cannot be played.
    #[error("profile {name}, line {line}, column {column}: {reason}")]
    File {
        /// Name of the file.
        name: String,
        /// Line of the file, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// What is wrong and what to do.
        reason: String,
    },
    /// A value with which no motion is possible.
    #[error("segment {segment} of profile {name}: {key} = {value} {reason}")]
    Value {
        name: String,
        segment: u32,
        /// Key of the file, without its unit.
        key: &'static str,
        value: f64,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// A sine, triangle or table that would begin with a step.
    #[error(
        "segment {segment} of profile {name} begins at {begins} but {} {level}: add a ramp to {begins} before it",
        if *segment == 1 { "the run starts at" } else { "the one before ends at" }
    )]
    Step {
        name: String,
        segment: u32,
        /// Level at which the segment begins.
        begins: f64,
        /// Level before the segment: end of the segment before, or measured level at the start of the run.
        level: f64,
    },
    /// A run is to resume at a cycle that the profile does not count.
    #[error("cycle {cycle} cannot be resumed: profile {name} counts cycles 1 to {total}, choose one of them")]
    NoSuchCycle { name: String, cycle: u32, total: u32 },
}

impl ProfileError {
    /// Line and column in the file, from 1, if the error is at one place.
    pub(crate) fn place(&self) -> Option<(usize, usize)> {
        match self {
            ProfileError::File { line, column, .. } => Some((*line, *column)),
            _ => None,
        }
    }
}

/// A test as it is written in a profile file. docs/profiles-and-benches.md lists its keys.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// 1 to 64 letters, digits, dashes, points and underscores.
    pub name: String,
    /// One sentence for the list of profiles.
    pub description: String,
    /// Controlled quantity, for the whole profile.
    pub(crate) mode: Mode,
    /// Blocks in the order in which they are played.
    pub(crate) blocks: Vec<Block>,
    /// Limits that a run is judged by after its end, in the order of the file.
    pub(crate) accept: Vec<AcceptLimit>,
}

/// Segments that are played several times.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Block {
    /// How many times the segments are played, at least 1.
    pub repeat: u32,
    /// Segments in the order in which they are played.
    pub segments: Vec<Segment>,
}

/// A level in the unit of the profile's mode, N or mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Level {
    /// Measured from the tared zero.
    Absolute(f64),
    /// Measured from the end of the segment before.
    Relative(f64),
}

/// One piece of motion. Levels and amplitudes are in the unit of the profile's mode.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Segment {
    /// A straight line to the level `to`.
    Ramp { to: Level, duration_s: f64 },
    /// The level stays where it is.
    Hold { duration_s: f64 },
    /// Sine or triangle about a mean level.
    Cycles(CycleSegment),
    /// Points joined by straight lines.
    Table {
        /// Times from the start of the segment in s, rising from 0.
        time_s: Vec<f64>,
        /// One level for each time.
        level: Vec<f64>,
        /// True: the levels count from the start of the segment. False: from the tared zero.
        relative: bool,
    },
}

/// Sine or triangle: `taper_cycles` that grow, `cycles` counted ones at full amplitude, `taper_cycles` that shrink.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CycleSegment {
    pub wave: Wave,
    /// Mean level, at which the segment also starts and ends.
    pub mean: Level,
    /// Half of peak minus valley.
    pub amplitude: f64,
    pub frequency_hz: f64,
    /// Number of counted cycles, at least 1.
    pub cycles: u32,
    /// Number of cycles with growing amplitude before the counted ones, and with shrinking amplitude after them.
    pub taper_cycles: u32,
    /// Amplitude and mean are corrected from cycle to cycle.
    pub correct: bool,
}

/// Form of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Wave {
    Sine,
    Triangle,
}
