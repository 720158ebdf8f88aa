//! The readings of a calibration. A reading is the sensor's own: counts times the nominal value of a count, without any correction.

use serde::{Deserialize, Serialize};

/// What is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum CalibratedChannel {
    /// The load cell, in N.
    Force,
    /// The LVDT, in mm.
    Displacement,
}

impl CalibratedChannel {
    /// Ending of its keys: `n` or `mm`.
    pub(crate) fn suffix(self) -> &'static str {
        match self {
            CalibratedChannel::Force => "n",
            CalibratedChannel::Displacement => "mm",
        }
    }

    /// Its unit: `N` or `mm`.
    pub(crate) fn unit(self) -> &'static str {
        match self {
            CalibratedChannel::Force => "N",
            CalibratedChannel::Displacement => "mm",
        }
    }

    /// Name of its table in a bench file.
    pub(crate) fn table(self) -> &'static str {
        match self {
            CalibratedChannel::Force => "force_channel",
            CalibratedChannel::Displacement => "displacement_channel",
        }
    }
}

/// One level of the reference in one series, N or mm. The level near 0 is the zero before (up) and after (down) the series.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CalibrationPoint {
    /// Number of the series, from 1.
    #[serde(default = "CalibrationPoint::first_series")]
    pub series: u32,
    /// Value of the reference instrument on the way up.
    #[serde(rename = "reference_n", alias = "reference_mm")]
    pub reference: f64,
    /// Reading on the way up.
    #[serde(rename = "up_n", alias = "up_mm")]
    pub up: f64,
    /// Reading on the way down; at the highest level there is none.
    #[serde(
        default,
        rename = "down_n",
        alias = "down_mm",
        skip_serializing_if = "Option::is_none"
    )]
    pub down: Option<f64>,
    /// Value of the reference on the way down, where it is not that of the way up.
    #[serde(
        default,
        rename = "down_reference_n",
        alias = "down_reference_mm",
        skip_serializing_if = "Option::is_none"
    )]
    pub down_reference: Option<f64>,
}

impl CalibrationPoint {
    /// Share of the greatest value below which a reference is the zero: no class is defined there.
    const ZERO_SHARE: f64 = 0.02;

    fn first_series() -> u32 {
        1
    }

    /// True for the zero before and after a series: a reference hardly ever shows exactly 0.
    pub(crate) fn is_zero(&self, greatest: f64) -> bool {
        self.reference.abs() <= Self::ZERO_SHARE * greatest
    }

    /// Value of the reference on the way down.
    pub(crate) fn reference_down(&self) -> f64 {
        self.down_reference.unwrap_or(self.reference)
    }

    /// Reading and reference of each way.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = (f64, f64)> + use<> {
        let down = self.down.map(|down| (down, self.reference_down()));
        std::iter::once((self.up, self.reference)).chain(down)
    }
}
