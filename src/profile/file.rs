//! Reads the TOML form of a profile strictly: every error has line and column. `keys` has the keys of each kind of segment.
//!
//! ```toml
//! name = "static-ramp"
//! description = "0 to 2 kN and back."
//! control = "force"              # or "displacement"; keys end in its unit: _n or _mm
//! [[block]]
//! repeat = 1
//! [[block.segment]]
//! kind = "ramp"                  # ramp, hold, sine, triangle, table
//! to_n = 2000.0                  # absolute; by_n is relative to the end of the segment before
//! duration_s = 60.0
//! ```

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::accept::{self, RawAccept};
use super::keys::{Keys, RawSegment, misplaced};
use super::reader::Reader;
use super::{Block, Profile, ProfileError, Segment, Wave, pieces};
use crate::regular_file::WRITTEN_MAX_BYTES;
use crate::units::Mode;

/// Sample rate at which a file is checked for durations shorter than a sample.
const CHECK_RATE_HZ: f64 = 1000.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawProfile {
    pub(super) name: Spanned<String>,
    #[serde(default)]
    pub(super) description: Option<Spanned<String>>,
    pub(super) control: Spanned<Mode>,
    #[serde(default)]
    pub(super) block: Vec<Spanned<RawBlock>>,
    #[serde(default)]
    accept: Vec<Spanned<RawAccept>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawBlock {
    #[serde(default = "once")]
    pub(super) repeat: Spanned<u32>,
    #[serde(default)]
    pub(super) segment: Vec<Spanned<RawSegment>>,
}

fn once() -> Spanned<u32> {
    Spanned::new(0..0, 1)
}

impl Profile {
    /// Reads and checks the text of a profile file; `name_for_messages` is the name of the file.
    pub fn from_toml(text: &str, name_for_messages: &str) -> Result<Profile, ProfileError> {
        let reader = Reader {
            text,
            name: name_for_messages,
        };
        reader.profile(reader.raw()?)
    }
}

/// The text of a profile file with another name and description, and more text at its end. All else stays as it is written. The result is
/// read once, so that an addition which does not fit is an error here.
pub(crate) fn rewritten(
    text: &str,
    name: &str,
    description: &str,
    more: &str,
) -> Result<String, ProfileError> {
    let raw = Reader { text, name }.raw()?;
    let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let mut new = text.to_owned();
    let name_span = raw.name.span();
    match raw.description.map(|d| d.span()) {
        Some(span) if span.start > name_span.start => {
            new.replace_range(span, &quoted(description));
            new.replace_range(name_span, &quoted(name));
        }
        Some(span) => {
            new.replace_range(name_span, &quoted(name));
            new.replace_range(span, &quoted(description));
        }
        None => {
            let both = format!("{}\ndescription = {}", quoted(name), quoted(description));
            new.replace_range(name_span, &both);
        }
    }
    let new = format!("{}\n{more}", new.trim_end());
    Profile::from_toml(&new, name).map(|_| new)
}

impl Reader<'_> {
    /// The keys and values of the text, which are not judged yet.
    pub(super) fn raw(&self) -> Result<RawProfile, ProfileError> {
        let text = self.text;
        if text.len() as u64 > WRITTEN_MAX_BYTES {
            return Err(self.refuse(
                0..0,
                format!(
                    "the file has {} bytes: a profile may have at most {WRITTEN_MAX_BYTES}",
                    text.len()
                ),
            ));
        }
        toml::from_str(text)
            .map_err(|e| self.refuse(e.span().unwrap_or(0..0), e.message().replace('\n', "; ")))
    }

    fn profile(&self, raw: RawProfile) -> Result<Profile, ProfileError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
        if raw.name.get_ref().is_empty()
            || raw.name.get_ref().len() > 64
            || !raw.name.get_ref().chars().all(allowed)
        {
            let reason = "the name of the profile is not allowed: use 1 to 64 letters, digits, dashes, points and underscores";
            return Err(self.refuse(raw.name.span(), reason));
        }
        let mode = raw.control.into_inner();
        let mut blocks = Vec::new();
        let mut spans = Vec::new();
        for block in raw.block.into_iter().map(Spanned::into_inner) {
            if *block.repeat.get_ref() == 0 {
                return Err(self.refuse(block.repeat.span(), "repeat = 0: enter 1 or more"));
            }
            spans.push(block.segment.iter().map(Spanned::span).collect::<Vec<_>>());
            let segments = block.segment.into_iter().map(|s| self.segment(s, mode));
            blocks.push(Block {
                repeat: block.repeat.into_inner(),
                segments: segments.collect::<Result<_, _>>()?,
            });
        }
        let accept = accept::read(self, raw.accept, &blocks)?;
        let profile = Profile {
            name: raw.name.into_inner(),
            description: raw.description.map(Spanned::into_inner).unwrap_or_default(),
            mode,
            blocks,
            accept,
        };
        match pieces::resolve(&profile, 0.0, CHECK_RATE_HZ) {
            Ok(_) => Ok(profile),
            Err(e) => Err(self.located(&profile, &spans, e)),
        }
    }

    /// Gives an error of a segment the line on which that segment is written.
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
            let reason =
                "the segment has no kind: add kind = \"ramp\", \"hold\", \"sine\", \"triangle\" or \"table\"";
            return Err(self.refuse(span, reason));
        };
        let mut keys = Keys {
            reader: self,
            raw: &mut raw,
            mode,
            kind: kind.get_ref(),
            span,
        };
        let segment = match kind.get_ref().as_str() {
            "ramp" => Segment::Ramp {
                to: keys.level("to")?,
                duration_s: keys.duration()?,
            },
            "hold" => Segment::Hold {
                duration_s: keys.duration()?,
            },
            "sine" => keys.cycles(Wave::Sine)?,
            "triangle" => keys.cycles(Wave::Triangle)?,
            "table" => keys.table()?,
            other => {
                let reason = format!(
                    "\"{other}\" is not a kind of segment: use \"ramp\", \"hold\", \"sine\", \"triangle\" or \"table\""
                );
                return Err(self.refuse(kind.span(), reason));
            }
        };
        match raw.left_over() {
            None => Ok(segment),
            Some((key, span)) => Err(self.refuse(span, misplaced(key, kind.get_ref(), mode))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CycleSegment, Level};
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
    fn every_kind_of_segment_is_read() {
        let profile = Profile::from_toml(ALL_KINDS, "all.toml").unwrap();
        assert_eq!(profile.description, "One of each, \"quoted\".");
        let sine = CycleSegment {
            wave: Wave::Sine,
            mean: Level::Relative(0.0),
            amplitude: 3.0,
            frequency_hz: 2.5,
            cycles: 4,
            taper_cycles: 2,
            correct: true,
        };
        let triangle = CycleSegment {
            wave: Wave::Triangle,
            mean: Level::Absolute(10.0),
            amplitude: 1e-3,
            frequency_hz: 1.0,
            cycles: 2,
            taper_cycles: 0,
            correct: false,
        };
        let segments = vec![
            Segment::Ramp {
                to: Level::Absolute(10.0),
                duration_s: 2.0,
            },
            Segment::Hold { duration_s: 0.5 },
            Segment::Cycles(sine),
            Segment::Cycles(triangle),
            Segment::Table {
                time_s: vec![0.0, 1.0, 1.5],
                level: vec![0.0, -3.0, -10.0],
                relative: true,
            },
        ];
        assert_eq!(profile.blocks, [Block { repeat: 2, segments }]);
    }

    #[test]
    fn an_error_points_at_the_line_and_says_what_to_do() {
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

    #[test]
    fn a_rewritten_profile_keeps_all_but_name_and_description() {
        let more = "[[accept]]\nlost_max_samples = 0\n";
        let with_both = rewritten(ALL_KINDS, "new", "Said \"so\".", more).expect("sound");
        let [old, new] = [ALL_KINDS, &with_both].map(|text| Profile::from_toml(text, "p").expect("sound"));
        assert_eq!(
            (new.name.as_str(), new.description.as_str()),
            ("new", "Said \"so\".")
        );
        assert_eq!((new.blocks, new.accept.len()), (old.blocks, 1));
        let without: String = ALL_KINDS
            .lines()
            .filter(|l| !l.contains("description"))
            .map(|l| format!("{l}\n"))
            .collect();
        let described = rewritten(&without, "new", "Said.", "").expect("sound");
        assert_eq!(
            Profile::from_toml(&described, "p").expect("sound").description,
            "Said."
        );
        assert!(rewritten(ALL_KINDS, "new", "Said.", "[[accept]]\nnothing = 1\n").is_err());
    }
}
