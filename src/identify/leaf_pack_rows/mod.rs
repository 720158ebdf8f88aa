//! One leaf pack for a set of tests that are known by peak force and loop energy: a slow ramp and four sines, with shackle
//! and without.
//!
//! - `walk` one pass through all tests of a mounting · `parameters` what is fitted, with ranges · `fit` the fits
//!
//! A table may leave open whether "amplitude" is half of the stroke or the whole of it, where the troughs of the sines are,
//! and how far the slow ramp travels. [`AmplitudeReading`] is an option, the trough a parameter (or fixed), and the ramp
//! goes to the measured peak force.

mod fit;
mod parameters;
mod walk;

pub(crate) use fit::{ALLOWED, FreedRange, RowFit, RowFitCase, fit_cases, fit_within_ranges, within_ranges};
pub(crate) use parameters::PARAMETERS;
pub(crate) use walk::walk;

use super::targets::{Aggregate, SLOW_RAMP_S};
use crate::model::leaf_pack::Mounting;

/// One test of a mounting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MountTest {
    /// Name for tables and messages.
    pub name: &'static str,
    /// Amplitude of the sine in mm; `None` for the slow ramp to a force and back.
    pub amplitude_mm: Option<f64>,
    /// Cycles per second; one over the time up and down for the slow ramp.
    pub frequency_hz: f64,
}

/// The tests of a mounting, the slow ramp first.
pub(crate) const TESTS: [MountTest; 5] = [
    MountTest {
        name: "static",
        amplitude_mm: None,
        frequency_hz: 1.0 / SLOW_RAMP_S,
    },
    sine("6 mm, 1 Hz", 6.0, 1.0),
    sine("10 mm, 1 Hz", 10.0, 1.0),
    sine("15 mm, 1 Hz", 15.0, 1.0),
    sine("6 mm, 2.5 Hz", 6.0, 2.5),
];

const fn sine(name: &'static str, amplitude_mm: f64, frequency_hz: f64) -> MountTest {
    MountTest {
        name,
        amplitude_mm: Some(amplitude_mm),
        frequency_hz,
    }
}

/// Amplitudes that one pass walks, rising. The laws do not depend on the rate: the 2.5 Hz sine is the 6 mm one.
pub(crate) const AMPLITUDES_MM: [f64; 3] = [6.0, 10.0, 15.0];
/// Index into [`AMPLITUDES_MM`] for each test; the entry of the slow ramp is not used.
pub(crate) const SINE_OF_TEST: [usize; 5] = [0, 0, 1, 2, 0];

/// Figures of all tests: `[test][mounting]`, in the order of [`TESTS`] and [`MOUNTS`].
pub(crate) type TestFigures = [[Aggregate; 2]; 5];

/// The two mountings.
pub(crate) const MOUNTS: [Mounting; 2] = [Mounting::Shackle, Mounting::Rail];

/// Place of a mounting in [`MOUNTS`].
pub(crate) fn mount_index(mounting: Mounting) -> usize {
    match mounting {
        Mounting::Shackle => 0,
        Mounting::Rail => 1,
    }
}

/// Name of a mounting in tables and messages.
pub(crate) fn mount_name(mounting: Mounting) -> &'static str {
    match mounting {
        Mounting::Shackle => "shackle",
        Mounting::Rail => "no shackle",
    }
}

/// Meaning of "amplitude" in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AmplitudeReading {
    /// Half of the stroke.
    Half,
    /// The whole stroke, peak to peak.
    Whole,
}

impl AmplitudeReading {
    /// Stroke of a printed amplitude, mm.
    pub(crate) fn stroke_mm(self, amplitude_mm: f64) -> f64 {
        match self {
            AmplitudeReading::Half => 2.0 * amplitude_mm,
            AmplitudeReading::Whole => amplitude_mm,
        }
    }

    /// The reading as an equation in words.
    pub(crate) fn name(self) -> &'static str {
        match self {
            AmplitudeReading::Half => "amplitude = half the stroke",
            AmplitudeReading::Whole => "amplitude = the whole stroke",
        }
    }
}

/// Options of the fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RowFitOptions {
    /// Meaning of "amplitude".
    pub reading: AmplitudeReading,
    /// Lowest displacement of the sines in mm, the same for both mountings; fitted where `None`.
    pub trough_mm: Option<f64>,
    /// Cores to use; 0 for all.
    pub threads: usize,
}
