//! The keys of one segment as written: taken by kind and in the unit of the profile's mode; what is left over is refused.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::file::Reader;
use super::{Level, ProfileError, Segment};
use crate::units::Mode;

/// Frequencies that a leaf-spring bench is asked for.
const FREQUENCY_HZ: [f64; 2] = [0.001, 50.0];
/// All keys of all kinds; `Keys` takes those of the kind and refuses the rest.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawSegment {
    pub(super) kind: Option<Spanned<String>>,
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

impl RawSegment {
    /// A key that nobody took.
    pub(super) fn left_over(&self) -> Option<(&'static str, Range<usize>)> {
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
pub(super) struct Keys<'a> {
    pub(super) reader: &'a Reader<'a>,
    pub(super) raw: &'a mut RawSegment,
    pub(super) mode: Mode,
    pub(super) kind: &'a str,
    pub(super) span: Range<usize>,
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
    pub(super) fn level(&mut self, key: &str) -> Result<Level, ProfileError> {
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

    pub(super) fn duration(&mut self) -> Result<f64, ProfileError> {
        let value = self
            .raw
            .duration_s
            .take()
            .ok_or_else(|| self.missing("duration_s"))?;
        self.positive(value, "duration_s")
    }

    pub(super) fn cyclic(
        &mut self,
        default_taper: u32,
    ) -> Result<(Level, f64, f64, u32, u32, bool), ProfileError> {
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

    pub(super) fn table(&mut self) -> Result<Segment, ProfileError> {
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
