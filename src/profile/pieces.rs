//! Resolves a profile into pieces: levels absolute, repeats written out, durations in whole ticks. A profile that would need a
//! step is refused here. `player` plays the pieces.

use std::sync::Arc;

use super::correction::CycleTarget;
use super::{CycleSegment, Level, Profile, ProfileError, Segment, Wave};
use crate::units::Mode;

/// Largest number of segments with all repeats written out.
const MAX_SEGMENTS: usize = 10_000;
/// Longest duration of a profile in hours.
const MAX_DURATION_H: u32 = 1000;
/// Levels closer than this, in N or mm, are the same. It is far below a count of either channel.
const SAME_LEVEL: f64 = 1e-9;
/// A profile that begins at a level of its own starts from a rig that is this close to it: mm in displacement control, N in
/// force control. A rig at rest stands there: noise, zero drift, and what an unload leaves (20 N, which is 0.25 mm of an
/// 80 N/mm spring). Half of it would refuse a soft spring after a run; twice as much is a motion that the profile should name.
const LEAD_IN_MM: f64 = 1.0;
const LEAD_IN_N: f64 = 50.0;
/// Duration of the lead-in over the whole of that distance in s. A shorter lead-in takes less, at the same mean speed.
const LEAD_IN_S: f64 = 2.0;
/// Shortest duration of a lead-in in s.
const LEAD_IN_LEAST_S: f64 = 0.1;

/// Cycles about a mean: taper, counted cycles, taper.
#[derive(Debug, Clone, Copy)]
pub(super) struct CyclicMotion {
    pub(super) wave: Wave,
    pub(super) target: CycleTarget,
    pub(super) taper: u64,
    pub(super) counted: u64,
    /// Number of the first counted cycle in the profile, from 1.
    pub(super) first_cycle: u32,
    pub(super) frequency_hz: f64,
}

impl CyclicMotion {
    /// Number of all cycles, tapers included.
    pub(super) fn cycles(&self) -> u64 {
        self.counted + 2 * self.taper
    }
}

/// How a piece goes from its first level to its last.
#[derive(Debug, Clone)]
pub(super) enum PieceMotion {
    Line,
    /// S-curve with speed zero at both ends.
    Approach,
    Cycles(CyclicMotion),
    Table {
        time_s: Arc<[f64]>,
        level: Arc<[f64]>,
        /// Added to every level.
        base: f64,
    },
}

/// One segment with its levels and ticks resolved.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub(super) segment: u32,
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) ticks: u64,
    pub(super) motion: PieceMotion,
}

/// All segments in order, repeats written out, and the number of counted cycles.
pub(super) fn resolve(
    profile: &Profile,
    start_level: f64,
    sample_rate_hz: f64,
) -> Result<(Vec<Piece>, u32), ProfileError> {
    let mut pieces = Vec::new();
    let mut level = start_level;
    let mut total_cycles = 0;
    let blocks = profile.blocks.iter().filter(|b| !b.segments.is_empty());
    let segments = blocks.flat_map(|b| (0..b.repeat).flat_map(|_| &b.segments));
    for (number, segment) in (1..).zip(segments) {
        if number as usize > MAX_SEGMENTS {
            return Err(ProfileError::TooManySegments {
                name: profile.name.clone(),
                limit: MAX_SEGMENTS,
            });
        }
        if number == 1
            && let Some(lead_in) = lead_in(segment, profile.mode, start_level, sample_rate_hz)
        {
            level = lead_in.to;
            pieces.push(lead_in);
        }
        let build = PieceBuilder {
            name: &profile.name,
            segment: number,
            level,
            sample_rate_hz,
        };
        let piece = build.piece(segment, &mut total_cycles)?;
        level = piece.to;
        pieces.push(piece);
    }
    if pieces.is_empty() {
        return Err(ProfileError::Empty {
            name: profile.name.clone(),
        });
    }
    within_longest(&profile.name, &pieces, sample_rate_hz)?;
    Ok((pieces, total_cycles))
}

/// The way from `start_level` to the level at which the first segment begins; `None` if there is none or it is too far, which
/// the segment then refuses.
fn lead_in(segment: &Segment, mode: Mode, start_level: f64, sample_rate_hz: f64) -> Option<Piece> {
    let begins = match segment {
        Segment::Cycles(CycleSegment {
            mean: Level::Absolute(mean),
            ..
        }) => *mean,
        Segment::Table {
            level,
            relative: false,
            ..
        } => *level.first()?,
        _ => return None,
    };
    let longest = match mode {
        Mode::Displacement => LEAD_IN_MM,
        Mode::Force => LEAD_IN_N,
    };
    let distance = (begins - start_level).abs();
    let duration_s = (LEAD_IN_S * distance / longest).max(LEAD_IN_LEAST_S);
    (distance > SAME_LEVEL && distance <= longest).then(|| Piece {
        segment: 1,
        from: start_level,
        to: begins,
        ticks: (duration_s * sample_rate_hz).round().max(1.0) as u64,
        motion: PieceMotion::Approach,
    })
}

impl Piece {
    pub(super) fn target(&self) -> Option<CycleTarget> {
        match &self.motion {
            PieceMotion::Cycles(c) => Some(c.target),
            _ => None,
        }
    }
}

/// Refuses a profile that lasts longer than [`MAX_DURATION_H`].
fn within_longest(name: &str, pieces: &[Piece], sample_rate_hz: f64) -> Result<(), ProfileError> {
    let ticks: f64 = pieces.iter().map(|p| p.ticks as f64).sum();
    if ticks <= f64::from(MAX_DURATION_H) * 3600.0 * sample_rate_hz {
        return Ok(());
    }
    Err(ProfileError::TooLong {
        name: name.to_owned(),
        limit_h: MAX_DURATION_H,
    })
}

/// Resolves one segment. `segment` is its number from 1, `level` the level before it.
struct PieceBuilder<'a> {
    name: &'a str,
    segment: u32,
    level: f64,
    sample_rate_hz: f64,
}

impl PieceBuilder<'_> {
    fn piece(&self, segment: &Segment, total_cycles: &mut u32) -> Result<Piece, ProfileError> {
        let (to, ticks, motion) = match segment {
            Segment::Ramp { to, duration_s } => (
                self.resolve(*to, "to")?,
                self.ticks(*duration_s, "duration_s")?,
                PieceMotion::Line,
            ),
            Segment::Hold { duration_s } => (
                self.level,
                self.ticks(*duration_s, "duration_s")?,
                PieceMotion::Line,
            ),
            Segment::Cycles(cycles) => self.cyclic(cycles, total_cycles)?,
            Segment::Table {
                time_s,
                level,
                relative,
            } => self.table(time_s, level, *relative)?,
        };
        Ok(Piece {
            segment: self.segment,
            from: self.level,
            to,
            ticks,
            motion,
        })
    }

    fn cyclic(
        &self,
        cycles: &CycleSegment,
        total_cycles: &mut u32,
    ) -> Result<(f64, u64, PieceMotion), ProfileError> {
        let &CycleSegment {
            wave,
            amplitude,
            frequency_hz,
            cycles: counted,
            taper_cycles: taper,
            correct: corrected,
            ..
        } = cycles;
        let mean = self.resolve(cycles.mean, "mean")?;
        self.begins_at(mean)?;
        self.positive(amplitude, "amplitude")?;
        self.positive(frequency_hz, "frequency_hz")?;
        if counted == 0 {
            return Err(self.refuse("cycles", 0.0, "is not allowed: enter at least one cycle"));
        }
        if taper == 0 && (wave == Wave::Sine || corrected) {
            let reason = "would begin or end with a step in speed or mean: enter at least one cycle of taper";
            return Err(self.refuse("taper_cycles", 0.0, reason));
        }
        let first_cycle = *total_cycles + 1;
        *total_cycles = total_cycles.checked_add(counted).ok_or_else(|| {
            let reason = "is more than the cycle counter can hold: enter fewer";
            self.refuse("cycles", f64::from(counted), reason)
        })?;
        let motion = CyclicMotion {
            wave,
            target: CycleTarget {
                mean,
                amplitude,
                corrected,
            },
            taper: u64::from(taper),
            counted: u64::from(counted),
            first_cycle,
            frequency_hz,
        };
        let ticks = self.ticks(motion.cycles() as f64 / frequency_hz, "frequency_hz")?;
        if ticks < 4 * motion.cycles() {
            let reason = "leaves fewer than four samples for each cycle: lower it";
            return Err(self.refuse("frequency_hz", frequency_hz, reason));
        }
        Ok((mean, ticks, PieceMotion::Cycles(motion)))
    }

    fn table(
        &self,
        time_s: &[f64],
        level: &[f64],
        relative: bool,
    ) -> Result<(f64, u64, PieceMotion), ProfileError> {
        let base = if relative { self.level } else { 0.0 };
        let points = time_s.len();
        let (Some(&first), Some(&last), Some(&end_s), 2..) =
            (level.first(), level.last(), time_s.last(), points)
        else {
            let reason = "points are too few: enter at least two times and levels";
            return Err(self.refuse("time_s", points as f64, reason));
        };
        if level.len() != points {
            let reason = "points do not match the levels: enter as many levels as times";
            return Err(self.refuse("time_s", points as f64, reason));
        }
        if time_s[0] != 0.0 {
            return Err(self.refuse("time_s", time_s[0], "is the first time: the first time must be 0"));
        }
        if let Some(w) = time_s
            .windows(2)
            .find(|w| w[0].partial_cmp(&w[1]) != Some(std::cmp::Ordering::Less))
        {
            return Err(self.refuse(
                "time_s",
                w[1],
                "does not rise: sort the points by time and remove repeated times",
            ));
        }
        if let Some(&bad) = level.iter().chain(time_s).find(|v| !v.is_finite()) {
            return Err(self.refuse("level", bad, "is not finite: enter a finite number"));
        }
        self.begins_at(base + first)?;
        let motion = PieceMotion::Table {
            time_s: time_s.into(),
            level: level.into(),
            base,
        };
        Ok((base + last, self.ticks(end_s, "time_s")?, motion))
    }

    fn resolve(&self, level: Level, key: &'static str) -> Result<f64, ProfileError> {
        let value = match level {
            Level::Absolute(v) => v,
            Level::Relative(v) => self.level + v,
        };
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.refuse(key, value, "is not finite: enter a finite number"))
        }
    }

    fn ticks(&self, duration_s: f64, key: &'static str) -> Result<u64, ProfileError> {
        self.positive(duration_s, key)?;
        let ticks = (duration_s * self.sample_rate_hz).round();
        if ticks < 1.0 {
            return Err(self.refuse(key, duration_s, "is shorter than one sample: lengthen it"));
        }
        // `within_longest` checks the sum of all pieces.
        Ok(ticks.min(1e15) as u64)
    }

    fn positive(&self, value: f64, key: &'static str) -> Result<(), ProfileError> {
        if value.is_finite() && value > 0.0 {
            Ok(())
        } else {
            Err(self.refuse(key, value, "is not above 0: enter a positive number"))
        }
    }

    fn begins_at(&self, begins: f64) -> Result<(), ProfileError> {
        if (begins - self.level).abs() <= SAME_LEVEL {
            return Ok(());
        }
        Err(ProfileError::Step {
            name: self.name.to_owned(),
            segment: self.segment,
            begins,
            level: self.level,
        })
    }

    fn refuse(&self, key: &'static str, value: f64, reason: &'static str) -> ProfileError {
        ProfileError::Value {
            name: self.name.to_owned(),
            segment: self.segment,
            key,
            value,
            reason,
        }
    }
}
