//! Resolves a profile into pieces: levels absolute, repeats expanded, durations in whole ticks. What could not be played
//! without a step is refused here; playing is `player`'s.

use std::sync::Arc;

use super::player::CycleTarget;
use super::{Level, Profile, ProfileError, Segment};

/// Most segments that a profile may expand to.
pub(crate) const MAX_SEGMENTS: usize = 10_000;
/// Longest profile in hours.
pub(crate) const MAX_DURATION_H: u32 = 1000;
/// Levels closer than this are the same: far below a count of either channel.
const SAME_LEVEL: f64 = 1e-9;
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Wave {
    Sine,
    Triangle,
}

/// Cycles about a mean: taper, counted, taper.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cyclic {
    pub(super) wave: Wave,
    pub(super) target: CycleTarget,
    pub(super) taper: u64,
    pub(super) counted: u64,
    /// Number of the first counted cycle, from 1 through the profile.
    pub(super) first_cycle: u32,
    pub(super) frequency_hz: f64,
}

impl Cyclic {
    pub(super) fn cycles(&self) -> u64 {
        self.counted + 2 * self.taper
    }
}

#[derive(Debug, Clone)]
pub(super) enum PieceMotion {
    Line,
    /// S-curve: at rest at both ends.
    Approach,
    Cycles(Cyclic),
    Table {
        time_s: Arc<[f64]>,
        level: Arc<[f64]>,
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

/// Every segment in order, and how many cycles they count.
pub(super) fn resolve(
    profile: &Profile,
    start_level: f64,
    sample_rate_hz: f64,
) -> Result<(Vec<Piece>, u32), ProfileError> {
    let mut pieces = Vec::new();
    let mut level = start_level;
    let mut total_cycles = 0;
    let blocks = profile.blocks.iter().filter(|b| !b.segments.is_empty());
    for segment in blocks.flat_map(|b| (0..b.repeat).flat_map(|_| &b.segments)) {
        if pieces.len() == MAX_SEGMENTS {
            return Err(ProfileError::TooManySegments {
                name: profile.name.clone(),
                limit: MAX_SEGMENTS,
            });
        }
        let build = PieceBuilder {
            name: &profile.name,
            segment: pieces.len() as u32 + 1,
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

impl Piece {
    pub(super) fn target(&self) -> Option<CycleTarget> {
        match &self.motion {
            PieceMotion::Cycles(c) => Some(c.target),
            _ => None,
        }
    }
}

/// Refuses what lasts longer than any test.
pub(super) fn within_longest(name: &str, pieces: &[Piece], sample_rate_hz: f64) -> Result<(), ProfileError> {
    let ticks: f64 = pieces.iter().map(|p| p.ticks as f64).sum();
    if ticks <= f64::from(MAX_DURATION_H) * 3600.0 * sample_rate_hz {
        return Ok(());
    }
    Err(ProfileError::TooLong {
        name: name.to_owned(),
        limit_h: MAX_DURATION_H,
    })
}

/// Resolves one segment of the expanded profile.
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
            &Segment::Sine {
                mean,
                amplitude,
                frequency_hz,
                cycles,
                taper_cycles,
                correct,
            } => {
                let shape = [amplitude, frequency_hz];
                self.cyclic(
                    Wave::Sine,
                    mean,
                    shape,
                    [cycles, taper_cycles],
                    correct,
                    total_cycles,
                )?
            }
            &Segment::Triangle {
                mean,
                amplitude,
                frequency_hz,
                cycles,
                taper_cycles,
                correct,
            } => {
                let shape = [amplitude, frequency_hz];
                self.cyclic(
                    Wave::Triangle,
                    mean,
                    shape,
                    [cycles, taper_cycles],
                    correct,
                    total_cycles,
                )?
            }
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
        wave: Wave,
        mean: Level,
        [amplitude, frequency_hz]: [f64; 2],
        [cycles, taper]: [u32; 2],
        corrected: bool,
        total_cycles: &mut u32,
    ) -> Result<(f64, u64, PieceMotion), ProfileError> {
        let mean = self.resolve(mean, "mean")?;
        self.begins_at(mean)?;
        self.positive(amplitude, "amplitude")?;
        self.positive(frequency_hz, "frequency_hz")?;
        if cycles == 0 {
            return Err(self.refuse("cycles", 0.0, "counts nothing: ask for at least one cycle"));
        }
        if taper == 0 && (wave == Wave::Sine || corrected) {
            let reason = "would begin or end with a step in speed or mean: give at least one cycle of taper";
            return Err(self.refuse("taper_cycles", 0.0, reason));
        }
        let first_cycle = *total_cycles + 1;
        *total_cycles = total_cycles.checked_add(cycles).ok_or_else(|| {
            self.refuse(
                "cycles",
                f64::from(cycles),
                "is more than can be counted: ask for fewer",
            )
        })?;
        let motion = Cyclic {
            wave,
            target: CycleTarget {
                mean,
                amplitude,
                corrected,
            },
            taper: u64::from(taper),
            counted: u64::from(cycles),
            first_cycle,
            frequency_hz,
        };
        let ticks = self.ticks(motion.cycles() as f64 / frequency_hz, "frequency_hz")?;
        if ticks < 4 * motion.cycles() {
            return Err(self.refuse(
                "frequency_hz",
                frequency_hz,
                "leaves fewer than four samples a cycle: lower it",
            ));
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
        let (Some(&first), Some(&last), Some(&end_s)) = (level.first(), level.last(), time_s.last()) else {
            return Err(self.refuse("time_s", 0.0, "points are too few: give at least two"));
        };
        if time_s.len() != level.len() || time_s.len() < 2 {
            let reason = "points: give as many levels as times, and at least two";
            return Err(self.refuse("time_s", time_s.len() as f64, reason));
        }
        if time_s[0] != 0.0 {
            return Err(self.refuse("time_s", time_s[0], "is the first time: begin at 0"));
        }
        if let Some(w) = time_s
            .windows(2)
            .find(|w| w[0].partial_cmp(&w[1]) != Some(std::cmp::Ordering::Less))
        {
            return Err(self.refuse(
                "time_s",
                w[1],
                "does not rise: sort the points by time, one level a time",
            ));
        }
        if let Some(&bad) = level.iter().chain(time_s).find(|v| !v.is_finite()) {
            return Err(self.refuse("level", bad, "is not a number: enter a finite one"));
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
            Err(self.refuse(key, value, "is not a number: enter a finite level"))
        }
    }

    fn ticks(&self, duration_s: f64, key: &'static str) -> Result<u64, ProfileError> {
        self.positive(duration_s, key)?;
        let ticks = (duration_s * self.sample_rate_hz).round();
        if ticks < 1.0 {
            return Err(self.refuse(key, duration_s, "is shorter than one sample: lengthen it"));
        }
        // The cap on the sum is checked once all pieces are known.
        Ok(ticks.min(1e15) as u64)
    }

    fn positive(&self, value: f64, key: &'static str) -> Result<(), ProfileError> {
        if value.is_finite() && value > 0.0 {
            Ok(())
        } else {
            Err(self.refuse(key, value, "is not a positive number: enter one above 0"))
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
