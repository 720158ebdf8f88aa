//! Reads the TOML form of a profile, strictly: every refusal has line and column. `keys` knows the keys of each kind.
//!
//! ```toml
//! name = "static-ramp"
//! description = "0 to 2 kN and back."
//! control = "force"              # or "displacement"; keys end in the unit of it: _n or _mm
//! [[block]]
//! repeat = 1
//! [[block.segment]]
//! kind = "ramp"                  # ramp, hold, sine, triangle, table
//! to_n = 2000.0                  # absolute; by_n is relative to the level before
//! duration_s = 60.0
//! ```

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::keys::{Keys, RawSegment};
use super::{Block, Profile, ProfileError, Segment, pieces};
use crate::units::Mode;

/// Larger files are not profiles.
pub(crate) const MAX_FILE_BYTES: usize = 1 << 20;
/// Rate at which a file is checked for durations below a sample.
const CHECK_RATE_HZ: f64 = 1000.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawProfile {
    name: Spanned<String>,
    #[serde(default)]
    description: String,
    control: Mode,
    #[serde(default)]
    block: Vec<RawBlock>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBlock {
    #[serde(default = "once")]
    repeat: Spanned<u32>,
    #[serde(default)]
    segment: Vec<Spanned<RawSegment>>,
}

fn once() -> Spanned<u32> {
    Spanned::new(0..0, 1)
}

/// Line and column, both from 1, of a byte in `text`.
pub(crate) fn line_column(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text
        .char_indices()
        .take_while(|(i, _)| *i < byte)
        .map(|(_, c)| c)
        .collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

impl Profile {
    /// Reads and checks a profile file's text; `name_for_messages` is the file's name.
    pub(crate) fn from_toml(text: &str, name_for_messages: &str) -> Result<Profile, ProfileError> {
        let reader = Reader {
            text,
            name: name_for_messages,
        };
        if text.len() > MAX_FILE_BYTES {
            return Err(reader.refuse(
                0..0,
                format!("{} bytes are more than a profile's {MAX_FILE_BYTES}", text.len()),
            ));
        }
        let raw: RawProfile = toml::from_str(text)
            .map_err(|e| reader.refuse(e.span().unwrap_or(0..0), e.message().replace('\n', "; ")))?;
        reader.profile(raw)
    }
}

pub(super) struct Reader<'a> {
    text: &'a str,
    name: &'a str,
}

impl Reader<'_> {
    pub(super) fn refuse(&self, span: Range<usize>, reason: impl Into<String>) -> ProfileError {
        let (line, column) = line_column(self.text, span.start);
        ProfileError::File {
            name: self.name.to_owned(),
            line,
            column,
            reason: reason.into(),
        }
    }

    fn profile(&self, raw: RawProfile) -> Result<Profile, ProfileError> {
        let sound = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
        if raw.name.get_ref().is_empty()
            || raw.name.get_ref().len() > 64
            || !raw.name.get_ref().chars().all(sound)
        {
            let reason =
                "name may hold 1 to 64 letters, digits, dashes, dots and underscores: rename the profile";
            return Err(self.refuse(raw.name.span(), reason));
        }
        let mut blocks = Vec::new();
        let mut spans = Vec::new();
        for block in raw.block {
            if *block.repeat.get_ref() == 0 {
                return Err(self.refuse(block.repeat.span(), "repeat = 0 plays nothing: give 1 or more"));
            }
            spans.push(block.segment.iter().map(Spanned::span).collect::<Vec<_>>());
            let segments = block.segment.into_iter().map(|s| self.segment(s, raw.control));
            blocks.push(Block {
                repeat: block.repeat.into_inner(),
                segments: segments.collect::<Result<_, _>>()?,
            });
        }
        let (name, description) = (raw.name.into_inner(), raw.description);
        let profile = Profile {
            name,
            description,
            mode: raw.control,
            blocks,
        };
        match pieces::resolve(&profile, 0.0, CHECK_RATE_HZ) {
            Ok(_) => Ok(profile),
            Err(e) => Err(self.located(&profile, &spans, e)),
        }
    }

    /// An error of an expanded segment, at the place where that segment is written.
    fn located(&self, profile: &Profile, spans: &[Vec<Range<usize>>], error: ProfileError) -> ProfileError {
        let (ProfileError::Value { segment, .. } | ProfileError::Step { segment, .. }) = &error else {
            return self.refuse(0..0, error.to_string());
        };
        let mut before = *segment as usize - 1;
        for (block, spans) in profile.blocks.iter().zip(spans).filter(|(_, s)| !s.is_empty()) {
            let here = block.repeat as usize * spans.len();
            if before < here {
                return self.refuse(spans[before % spans.len()].clone(), error.to_string());
            }
            before -= here;
        }
        error
    }

    fn segment(&self, raw: Spanned<RawSegment>, mode: Mode) -> Result<Segment, ProfileError> {
        let span = raw.span();
        let mut raw = raw.into_inner();
        let Some(kind) = raw.kind.take() else {
            return Err(self.refuse(
                span,
                "segment has no kind: write kind = \"ramp\", hold, sine, triangle or table",
            ));
        };
        let mut keys = Keys {
            reader: self,
            raw: &mut raw,
            mode,
            kind: kind.get_ref(),
            span: span.clone(),
        };
        let segment = match kind.get_ref().as_str() {
            "ramp" => Segment::Ramp {
                to: keys.level("to")?,
                duration_s: keys.duration()?,
            },
            "hold" => Segment::Hold {
                duration_s: keys.duration()?,
            },
            "sine" => {
                let (mean, amplitude, frequency_hz, cycles, taper_cycles, correct) = keys.cyclic(2)?;
                Segment::Sine {
                    mean,
                    amplitude,
                    frequency_hz,
                    cycles,
                    taper_cycles,
                    correct,
                }
            }
            "triangle" => {
                let (mean, amplitude, frequency_hz, cycles, taper_cycles, correct) = keys.cyclic(1)?;
                Segment::Triangle {
                    mean,
                    amplitude,
                    frequency_hz,
                    cycles,
                    taper_cycles,
                    correct,
                }
            }
            "table" => keys.table()?,
            other => {
                let reason =
                    format!("\"{other}\" is no kind of segment: use ramp, hold, sine, triangle or table");
                return Err(self.refuse(kind.span(), reason));
            }
        };
        match raw.left_over() {
            None => Ok(segment),
            Some((key, at)) => {
                let (kind, unit) = (kind.get_ref(), mode.unit_suffix());
                let reason = format!(
                    "{key} does not belong to a {kind} here (control is in {unit}), or says the same twice: remove it"
                );
                Err(self.refuse(at, reason))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL_KINDS: &str = r#"
        name = "all-kinds"
        description = "One of each, \"quoted\"."
        control = "displacement"
        [[block]]
        repeat = 2
        [[block.segment]]
        kind = "ramp"
        to_mm = 10.0
        duration_s = 2
        [[block.segment]]
        kind = "hold"
        duration_s = 0.5
        [[block.segment]]
        kind = "sine"
        mean_by_mm = 0.0
        amplitude_mm = 3.0
        frequency_hz = 2.5
        cycles = 4
        [[block.segment]]
        kind = "triangle"
        mean_mm = 10.0
        amplitude_mm = 1e-3
        frequency_hz = 1.0
        cycles = 2
        taper_cycles = 0
        correct = false
        [[block.segment]]
        kind = "table"
        time_s = [0.0, 1.0, 1.5]
        level_by_mm = [0.0, -3.0, -10.0]
    "#;

    #[test]
    fn what_is_written_reads_back_the_same() {
        let profile = Profile::from_toml(ALL_KINDS, "all.toml").unwrap();
        assert_eq!(profile.blocks[0].segments.len(), 5);
        let again = Profile::from_toml(&profile.to_toml(), "again.toml").unwrap();
        assert_eq!(again, profile);
    }

    #[test]
    fn a_refusal_points_at_the_line_and_says_what_to_do() {
        let text = ALL_KINDS.replace("duration_s = 0.5", "duration_s = 0");
        let error = Profile::from_toml(&text, "bad.toml").unwrap_err();
        assert!(
            matches!(
                error,
                ProfileError::File {
                    line: 13,
                    column: 22,
                    ..
                }
            ),
            "{error}"
        );
        assert!(error.to_string().contains("bad.toml"), "{error}");
        let text = ALL_KINDS.replace("mean_mm = 10.0", "mean_mm = 12.0");
        let error = Profile::from_toml(&text, "bad.toml").unwrap_err();
        assert!(error.to_string().contains("add a ramp to 12"), "{error}");
        assert!(matches!(error, ProfileError::File { line: 20, .. }), "{error}");
    }
}
