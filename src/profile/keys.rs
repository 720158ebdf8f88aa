//! The keys of one segment: each kind takes its own keys in the unit of the profile's mode; every other key is refused.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::reader::Reader;
use super::{CycleSegment, Level, ProfileError, Segment, Wave};
use crate::units::Mode;

/// Allowed frequencies in Hz.
const FREQUENCY_HZ: [f64; 2] = [0.001, 50.0];

/// Declares the keys of all kinds of segment. `Keys` takes those of the kind; `left_over` finds one that was not taken.
macro_rules! segment_keys {
    ($($key:ident: $value:ty,)*) => {
        #[derive(Default, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub(super) struct RawSegment {
            pub(super) kind: Option<Spanned<String>>,
            $($key: Option<Spanned<$value>>,)*
        }

        impl RawSegment {
            /// The keys that are written, with the places of their values.
            pub(super) fn places(&self) -> Vec<(&'static str, Range<usize>)> {
                let kind = self.kind.as_ref().map(|value| ("kind", value.span()));
                let others = [$(self.$key.as_ref().map(|value| (stringify!($key), value.span())),)*];
                others.into_iter().chain([kind]).flatten().collect()
            }

            /// A key that the kind of the segment does not take, and its place.
            pub(super) fn left_over(&self) -> Option<(&'static str, Range<usize>)> {
                None$(.or_else(|| self.$key.as_ref().map(|value| (stringify!($key), value.span()))))*
            }
        }
    };
}

segment_keys! {
    to_n: f64,
    to_mm: f64,
    by_n: f64,
    by_mm: f64,
    duration_s: f64,
    mean_n: f64,
    mean_mm: f64,
    mean_by_n: f64,
    mean_by_mm: f64,
    amplitude_n: f64,
    amplitude_mm: f64,
    frequency_hz: f64,
    cycles: u32,
    taper_cycles: u32,
    correct: bool,
    time_s: Vec<f64>,
    level_n: Vec<f64>,
    level_mm: Vec<f64>,
    level_by_n: Vec<f64>,
    level_by_mm: Vec<f64>,
}

/// Why a key of another kind or unit, or a second level, is refused.
pub(super) fn misplaced(key: &str, kind: &str, mode: Mode) -> String {
    let unit = mode.unit_suffix();
    let other_unit = match mode {
        Mode::Force => "_mm",
        Mode::Displacement => "_n",
    };
    let second_level = match kind {
        "ramp" => key.starts_with("by_"),
        "sine" | "triangle" => key.starts_with("mean_by_"),
        _ => key.starts_with("level_by_"),
    };
    if key.ends_with(other_unit) {
        format!(
            "{key} has the wrong unit for this control mode: use keys that end in _{unit}, or change control"
        )
    } else if second_level {
        let absolute = match key.split_once("by_") {
            Some(("", unit)) => format!("to_{unit}"),
            Some((level, unit)) => format!("{level}{unit}"),
            None => key.to_owned(),
        };
        format!("{key} and {absolute} both give the level: keep one of them")
    } else {
        format!("{key} does not belong to a {kind}: remove it")
    }
}

/// Takes the keys of one segment out of its raw form.
pub(super) struct Keys<'a> {
    pub(super) reader: &'a Reader<'a>,
    pub(super) raw: &'a mut RawSegment,
    pub(super) mode: Mode,
    pub(super) kind: &'a str,
    pub(super) span: Range<usize>,
}

impl Keys<'_> {
    /// The value of a key that the kind needs.
    fn needed<T>(&self, value: Option<Spanned<T>>, key: &str) -> Result<Spanned<T>, ProfileError> {
        value.ok_or_else(|| {
            self.reader
                .refuse(self.span.clone(), format!("{} needs {key}: add it", self.kind))
        })
    }

    fn finite(&self, value: Spanned<f64>, key: &str) -> Result<f64, ProfileError> {
        if value.get_ref().is_finite() {
            return Ok(value.into_inner());
        }
        let reason = format!("{key} = {} is not finite: enter a finite number", value.get_ref());
        Err(self.reader.refuse(value.span(), reason))
    }

    fn positive(&self, value: Spanned<f64>, key: &str) -> Result<f64, ProfileError> {
        let span = value.span();
        match self.finite(value, key)? {
            v if v > 0.0 => Ok(v),
            v => {
                let reason = format!("{key} = {v} is not above 0: enter a positive number");
                Err(self.reader.refuse(span, reason))
            }
        }
    }

    /// `to_`/`by_` or `mean_`/`mean_by_` in the unit of the mode.
    pub(super) fn level(&mut self, key: &str) -> Result<Level, ProfileError> {
        let raw = &mut *self.raw;
        let (absolute, relative) = match (key, self.mode) {
            ("to", Mode::Force) => (&mut raw.to_n, &mut raw.by_n),
            ("to", Mode::Displacement) => (&mut raw.to_mm, &mut raw.by_mm),
            (_, Mode::Force) => (&mut raw.mean_n, &mut raw.mean_by_n),
            (_, Mode::Displacement) => (&mut raw.mean_mm, &mut raw.mean_by_mm),
        };
        // If both levels are written, the relative one stays in `raw` and is refused as left over.
        let found = match absolute.take() {
            Some(v) => Some((v, Level::Absolute as fn(f64) -> Level)),
            None => relative.take().map(|v| (v, Level::Relative as fn(f64) -> Level)),
        };
        let (value, level) = match found {
            Some((value, level)) => (Some(value), level),
            None => (None, Level::Absolute as fn(f64) -> Level),
        };
        let key = format!("{key}_{}", self.mode.unit_suffix());
        let value = self.needed(value, &key)?;
        Ok(level(self.finite(value, &key)?))
    }

    pub(super) fn duration(&mut self) -> Result<f64, ProfileError> {
        let value = self.raw.duration_s.take();
        let value = self.needed(value, "duration_s")?;
        self.positive(value, "duration_s")
    }

    pub(super) fn cycles(&mut self, wave: Wave) -> Result<Segment, ProfileError> {
        let mean = self.level("mean")?;
        let amplitude = self.amplitude()?;
        let frequency_hz = self.frequency()?;
        let cycles = self.raw.cycles.take();
        let cycles = self.needed(cycles, "cycles")?;
        if *cycles.get_ref() == 0 {
            let reason = "cycles = 0: enter 1 or more";
            return Err(self.reader.refuse(cycles.span(), reason));
        }
        let default_taper = match wave {
            Wave::Sine => 2,
            Wave::Triangle => 1,
        };
        Ok(Segment::Cycles(CycleSegment {
            wave,
            mean,
            amplitude,
            frequency_hz,
            cycles: cycles.into_inner(),
            taper_cycles: self
                .raw
                .taper_cycles
                .take()
                .map_or(default_taper, Spanned::into_inner),
            correct: self.raw.correct.take().is_none_or(Spanned::into_inner),
        }))
    }

    fn amplitude(&mut self) -> Result<f64, ProfileError> {
        let value = match self.mode {
            Mode::Force => self.raw.amplitude_n.take(),
            Mode::Displacement => self.raw.amplitude_mm.take(),
        };
        let key = format!("amplitude_{}", self.mode.unit_suffix());
        let value = self.needed(value, &key)?;
        self.positive(value, &key)
    }

    fn frequency(&mut self) -> Result<f64, ProfileError> {
        let value = self.raw.frequency_hz.take();
        let value = self.needed(value, "frequency_hz")?;
        let span = value.span();
        let frequency_hz = self.positive(value, "frequency_hz")?;
        let [low, high] = FREQUENCY_HZ;
        if (low..=high).contains(&frequency_hz) {
            return Ok(frequency_hz);
        }
        let reason =
            format!("frequency_hz = {frequency_hz} is outside {low} to {high}: enter a value in this range");
        Err(self.reader.refuse(span, reason))
    }

    pub(super) fn table(&mut self) -> Result<Segment, ProfileError> {
        let time_s = self.raw.time_s.take();
        let time_s = self.needed(time_s, "time_s")?.into_inner();
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
        Ok(Segment::Table {
            time_s,
            level: self.needed(level, &key)?.into_inner(),
            relative,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misplaced_key_is_refused_with_its_reason() {
        let said = |key, kind, mode| misplaced(key, kind, mode);
        let mm = Mode::Displacement;
        assert!(said("to_n", "ramp", mm).contains("use keys that end in _mm"));
        assert!(said("amplitude_mm", "sine", Mode::Force).contains("use keys that end in _n"));
        assert!(said("by_mm", "ramp", mm).starts_with("by_mm and to_mm both"));
        assert!(said("mean_by_mm", "triangle", mm).starts_with("mean_by_mm and mean_mm both"));
        assert!(said("level_by_n", "table", Mode::Force).starts_with("level_by_n and level_n both"));
        assert!(said("cycles", "ramp", mm).contains("does not belong to a ramp"));
        assert!(said("by_mm", "hold", mm).contains("does not belong to a hold"));
    }
}
