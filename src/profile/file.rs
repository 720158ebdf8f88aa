//! The TOML form of a profile: read strictly, written so that it reads back the same. Every refusal has line and column.
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

use std::fmt::Write;
use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::{Block, Level, Profile, ProfileError, Segment, pieces};
use crate::units::Mode;

/// Larger files are not profiles.
pub const MAX_FILE_BYTES: usize = 1 << 20;
/// Frequencies that a leaf-spring bench is asked for.
const FREQUENCY_HZ: [f64; 2] = [0.001, 50.0];
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

/// All keys of all kinds; `Reader::segment` takes those of the kind and refuses the rest.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawSegment {
    kind: Option<Spanned<String>>,
    to_n: Option<Spanned<f64>>,
    to_mm: Option<Spanned<f64>>,
    by_n: Option<Spanned<f64>>,
    by_mm: Option<Spanned<f64>>,
    duration_s: Option<Spanned<f64>>,
    mean_n: Option<Spanned<f64>>,
    mean_mm: Option<Spanned<f64>>,
    mean_by_n: Option<Spanned<f64>>,
    mean_by_mm: Option<Spanned<f64>>,
    amplitude_n: Option<Spanned<f64>>,
    amplitude_mm: Option<Spanned<f64>>,
    frequency_hz: Option<Spanned<f64>>,
    cycles: Option<Spanned<u32>>,
    taper_cycles: Option<Spanned<u32>>,
    correct: Option<Spanned<bool>>,
    time_s: Option<Spanned<Vec<f64>>>,
    level_n: Option<Spanned<Vec<f64>>>,
    level_mm: Option<Spanned<Vec<f64>>>,
    level_by_n: Option<Spanned<Vec<f64>>>,
    level_by_mm: Option<Spanned<Vec<f64>>>,
}

/// Line and column, both from 1, of a byte in `text`.
pub fn line_column(text: &str, byte: usize) -> (usize, usize) {
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
    pub fn from_toml(text: &str, name_for_messages: &str) -> Result<Profile, ProfileError> {
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

    /// The file's text: `from_toml` of it gives this profile again.
    pub fn to_toml(&self) -> String {
        let unit = self.mode.unit_suffix();
        let quoted = |s: &str| toml::Value::String(s.to_owned()).to_string();
        let control = match self.mode {
            Mode::Displacement => "displacement",
            Mode::Force => "force",
        };
        let (name, description) = (quoted(&self.name), quoted(&self.description));
        let mut out = format!("name = {name}\ndescription = {description}\ncontrol = \"{control}\"\n");
        for block in &self.blocks {
            out += &format!("\n[[block]]\nrepeat = {}\n", block.repeat);
            for segment in &block.segments {
                out += "\n[[block.segment]]\n";
                write_segment(&mut out, segment, unit);
            }
        }
        out
    }
}

fn write_segment(out: &mut String, segment: &Segment, unit: &str) {
    let level = |key: &str, level: Level| match level {
        Level::Absolute(v) => format!("{key}_{unit} = {v:?}\n"),
        Level::Relative(v) if key == "to" => format!("by_{unit} = {v:?}\n"),
        Level::Relative(v) => format!("{key}_by_{unit} = {v:?}\n"),
    };
    // Writing into a String cannot fail.
    let _ = match segment {
        Segment::Ramp { to, duration_s } => {
            write!(
                out,
                "kind = \"ramp\"\n{}duration_s = {duration_s:?}\n",
                level("to", *to)
            )
        }
        Segment::Hold { duration_s } => write!(out, "kind = \"hold\"\nduration_s = {duration_s:?}\n"),
        Segment::Sine {
            mean,
            amplitude,
            frequency_hz,
            cycles,
            taper_cycles,
            correct,
        }
        | Segment::Triangle {
            mean,
            amplitude,
            frequency_hz,
            cycles,
            taper_cycles,
            correct,
        } => write!(
            out,
            "kind = \"{}\"\n{}amplitude_{unit} = {amplitude:?}\nfrequency_hz = {frequency_hz:?}\ncycles = {cycles}\n\
             taper_cycles = {taper_cycles}\ncorrect = {correct}\n",
            if matches!(segment, Segment::Sine { .. }) {
                "sine"
            } else {
                "triangle"
            },
            level("mean", *mean),
        ),
        Segment::Table {
            time_s,
            level,
            relative,
        } => write!(
            out,
            "kind = \"table\"\ntime_s = {time_s:?}\nlevel{}_{unit} = {level:?}\n",
            if *relative { "_by" } else { "" },
        ),
    };
}

struct Reader<'a> {
    text: &'a str,
    name: &'a str,
}

impl Reader<'_> {
    fn refuse(&self, span: Range<usize>, reason: impl Into<String>) -> ProfileError {
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

impl RawSegment {
    /// A key that nobody took.
    fn left_over(&self) -> Option<(&'static str, Range<usize>)> {
        fn at<T>(key: &'static str, value: &Option<Spanned<T>>) -> Option<(&'static str, Range<usize>)> {
            value.as_ref().map(|v| (key, v.span()))
        }
        at("to_n", &self.to_n)
            .or(at("to_mm", &self.to_mm))
            .or(at("by_n", &self.by_n))
            .or(at("by_mm", &self.by_mm))
            .or(at("duration_s", &self.duration_s))
            .or(at("mean_n", &self.mean_n))
            .or(at("mean_mm", &self.mean_mm))
            .or(at("mean_by_n", &self.mean_by_n))
            .or(at("mean_by_mm", &self.mean_by_mm))
            .or(at("amplitude_n", &self.amplitude_n))
            .or(at("amplitude_mm", &self.amplitude_mm))
            .or(at("frequency_hz", &self.frequency_hz))
            .or(at("cycles", &self.cycles))
            .or(at("taper_cycles", &self.taper_cycles))
            .or(at("correct", &self.correct))
            .or(at("time_s", &self.time_s))
            .or(at("level_n", &self.level_n))
            .or(at("level_mm", &self.level_mm))
            .or(at("level_by_n", &self.level_by_n))
            .or(at("level_by_mm", &self.level_by_mm))
    }
}

/// Takes keys out of one segment.
struct Keys<'a> {
    reader: &'a Reader<'a>,
    raw: &'a mut RawSegment,
    mode: Mode,
    kind: &'a str,
    span: Range<usize>,
}

impl Keys<'_> {
    fn missing(&self, key: &str) -> ProfileError {
        self.reader
            .refuse(self.span.clone(), format!("{} needs {key}: add it", self.kind))
    }

    fn finite(&self, value: Spanned<f64>, key: &str) -> Result<f64, ProfileError> {
        if value.get_ref().is_finite() {
            return Ok(value.into_inner());
        }
        let reason = format!("{key} = {} is not a number: enter a finite one", value.get_ref());
        Err(self.reader.refuse(value.span(), reason))
    }

    fn positive(&self, value: Spanned<f64>, key: &str) -> Result<f64, ProfileError> {
        let span = value.span();
        match self.finite(value, key)? {
            v if v > 0.0 => Ok(v),
            v => Err(self.reader.refuse(
                span,
                format!("{key} = {v} must be above 0: enter a positive number"),
            )),
        }
    }

    /// `to_`/`by_` or `mean_`/`mean_by_` in the unit of the mode.
    fn level(&mut self, key: &str) -> Result<Level, ProfileError> {
        let raw = &mut *self.raw;
        let (absolute, relative) = match (key, self.mode) {
            ("to", Mode::Force) => (&mut raw.to_n, &mut raw.by_n),
            ("to", Mode::Displacement) => (&mut raw.to_mm, &mut raw.by_mm),
            (_, Mode::Force) => (&mut raw.mean_n, &mut raw.mean_by_n),
            (_, Mode::Displacement) => (&mut raw.mean_mm, &mut raw.mean_by_mm),
        };
        // An absolute level leaves a relative one behind, which is then refused as left over.
        let found = match absolute.take() {
            Some(v) => Some((v, Level::Absolute as fn(f64) -> Level)),
            None => relative.take().map(|v| (v, Level::Relative as fn(f64) -> Level)),
        };
        let unit = self.mode.unit_suffix();
        let (value, level) = found.ok_or_else(|| self.missing(&format!("{key}_{unit}")))?;
        Ok(level(self.finite(value, key)?))
    }

    fn duration(&mut self) -> Result<f64, ProfileError> {
        let value = self
            .raw
            .duration_s
            .take()
            .ok_or_else(|| self.missing("duration_s"))?;
        self.positive(value, "duration_s")
    }

    fn cyclic(&mut self, default_taper: u32) -> Result<(Level, f64, f64, u32, u32, bool), ProfileError> {
        let mean = self.level("mean")?;
        let amplitude = match self.mode {
            Mode::Force => self.raw.amplitude_n.take(),
            Mode::Displacement => self.raw.amplitude_mm.take(),
        };
        let key = format!("amplitude_{}", self.mode.unit_suffix());
        let amplitude = amplitude.ok_or_else(|| self.missing(&key))?;
        let amplitude = self.positive(amplitude, &key)?;
        let frequency = self
            .raw
            .frequency_hz
            .take()
            .ok_or_else(|| self.missing("frequency_hz"))?;
        let at = frequency.span();
        let frequency_hz = self.positive(frequency, "frequency_hz")?;
        let [low, high] = FREQUENCY_HZ;
        if !(low..=high).contains(&frequency_hz) {
            let reason =
                format!("frequency_hz = {frequency_hz} is outside {low} to {high}: enter one within");
            return Err(self.reader.refuse(at, reason));
        }
        let cycles = self.raw.cycles.take().ok_or_else(|| self.missing("cycles"))?;
        if *cycles.get_ref() == 0 {
            return Err(self
                .reader
                .refuse(cycles.span(), "cycles = 0 counts nothing: give 1 or more"));
        }
        let taper_cycles = self
            .raw
            .taper_cycles
            .take()
            .map_or(default_taper, Spanned::into_inner);
        let correct = self.raw.correct.take().is_none_or(Spanned::into_inner);
        Ok((
            mean,
            amplitude,
            frequency_hz,
            cycles.into_inner(),
            taper_cycles,
            correct,
        ))
    }

    fn table(&mut self) -> Result<Segment, ProfileError> {
        let time_s = self
            .raw
            .time_s
            .take()
            .ok_or_else(|| self.missing("time_s"))?
            .into_inner();
        let raw = &mut *self.raw;
        let (absolute, relative) = match self.mode {
            Mode::Force => (&mut raw.level_n, &mut raw.level_by_n),
            Mode::Displacement => (&mut raw.level_mm, &mut raw.level_by_mm),
        };
        let (level, relative) = match absolute.take() {
            Some(v) => (Some(v), false),
            None => (relative.take(), true),
        };
        let key = format!("level_{}", self.mode.unit_suffix());
        let level = level.ok_or_else(|| self.missing(&key))?.into_inner();
        Ok(Segment::Table {
            time_s,
            level,
            relative,
        })
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
