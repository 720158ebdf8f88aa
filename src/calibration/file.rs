//! A calibration file: what stands in it, and its text. `config` reads and checks it.

use std::fmt::Write;

use serde::Deserialize;

use super::points::{CalibratedChannel, CalibrationPoint};

/// The calibration of one sensor. Dimensioned keys end in `_n` or `_mm`, after the channel.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CalibrationFile {
    /// What the sensor measures.
    pub channel: CalibratedChannel,
    /// Number of the calibration certificate.
    pub certificate: String,
    /// Who calibrated the sensor.
    pub laboratory: String,
    /// Maker and type of the sensor.
    #[serde(default)]
    pub sensor: String,
    /// Serial number of the sensor.
    pub serial: String,
    /// Reference instrument, with its own certificate.
    #[serde(default)]
    pub reference: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Last day of the calibration, `YYYY-MM-DD`.
    pub due: String,
    /// Class with its standard, `ISO 7500-1 class 1`.
    pub class: String,
    /// Expanded uncertainty (k = 2), N or mm.
    #[serde(rename = "expanded_uncertainty_n", alias = "expanded_uncertainty_mm")]
    pub expanded_uncertainty: f64,
    /// Nominal value of one count, N or mm.
    #[serde(rename = "n_per_count", alias = "mm_per_count")]
    pub per_count: f64,
    /// Rated capacity of the sensor, N or mm.
    #[serde(rename = "capacity_n", alias = "capacity_mm")]
    pub capacity: f64,
    /// Standard deviation of one sample at rest, N or mm.
    #[serde(rename = "noise_n", alias = "noise_mm")]
    pub noise: f64,
    /// Factors of the powers of the reading, from the constant on: two to four, N or mm.
    pub polynomial: Vec<f64>,
    /// What was read.
    #[serde(default, rename = "point")]
    pub points: Vec<CalibrationPoint>,
}

impl CalibrationFile {
    /// The dimensioned keys without their unit, for the check that they have the channel's.
    pub(crate) const DIMENSIONED: [&'static str; 4] =
        ["expanded_uncertainty", "per_count", "capacity", "noise"];

    /// The key with the unit of the channel: `noise_mm`, `n_per_count`.
    pub(crate) fn key(channel: CalibratedChannel, name: &str) -> String {
        match name {
            "per_count" => format!("{}_per_count", channel.suffix()),
            name => format!("{name}_{}", channel.suffix()),
        }
    }

    /// The text of the file, with comments. Reading it gives the same calibration again.
    pub(crate) fn to_toml(&self) -> String {
        let key = |name| CalibrationFile::key(self.channel, name);
        let text = |text: &str| toml::Value::from(text).to_string();
        let channel = match self.channel {
            CalibratedChannel::Force => "force",
            CalibratedChannel::Displacement => "displacement",
        };
        let unit = self.channel.unit();
        let mut file = format!(
            "# Calibration of a sensor. A bench file uses it by one line in [{}]: calibration = \"PATH OF THIS FILE\"\n\
             channel = \"{channel}\"\ncertificate = {}\nlaboratory = {}\nsensor = {}\nserial = {}\nreference = {}\n\
             calibrated = {}\ndue = {}\nclass = {}\n\n",
            self.channel.table(),
            text(&self.certificate),
            text(&self.laboratory),
            text(&self.sensor),
            text(&self.serial),
            text(&self.reference),
            text(&self.calibrated),
            text(&self.due),
            text(&self.class),
        );
        let numbers = [
            ("expanded_uncertainty", self.expanded_uncertainty, "k = 2"),
            ("per_count", self.per_count, "nominal value of one count"),
            ("capacity", self.capacity, "rated capacity of the sensor"),
            ("noise", self.noise, "standard deviation of one sample at rest"),
        ];
        for (name, value, what) in numbers {
            let _ = writeln!(file, "{} = {value:?}    # {what}", key(name));
        }
        let _ = write!(
            file,
            "\n# value = c0 + c1 * reading + c2 * reading^2 + c3 * reading^3, in {unit}, with reading = counts * {}\n\
             polynomial = {:?}\n",
            key("per_count"),
            self.polynomial
        );
        if !self.points.is_empty() {
            file += "\n# Value of the reference instrument, and readings on the way up and down. 0: the zero before and after.\n";
        }
        for point in &self.points {
            let _ = write!(
                file,
                "[[point]]\nseries = {}\n{} = {:?}\n{} = {:?}\n",
                point.series,
                key("reference"),
                point.reference,
                key("up"),
                point.up
            );
            if let Some(down) = point.down {
                let _ = writeln!(file, "{} = {down:?}", key("down"));
            }
            if let Some(reference) = point.down_reference {
                let _ = writeln!(file, "{} = {reference:?}", key("down_reference"));
            }
        }
        file
    }
}
