//! One channel of a recording: how its counts become values, and which sensor with which calibration measured.

/// Scaling of one channel: `value = u + curve[0] u^2 + curve[1] u^3 - offset - tare`, with `u = counts * scale_per_count`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct ChannelScale {
    /// Physical value of one count, N or mm.
    pub scale_per_count: f64,
    /// Offset of the calibration, N or mm.
    pub offset: f64,
    /// Tare, N or mm.
    pub tare: f64,
    /// Curvature of the calibration: factors of the square and of the cube, per unit and per unit squared. Zero for a straight line.
    #[serde(default, skip_serializing_if = "is_straight")]
    pub curve: [f64; 2],
}

/// Most steps of the search for the counts of a value: each doubles the number of right digits.
const INVERSION_STEPS: usize = 8;
/// The curve is inverted only where its slope is above this share of the straight line's. Bench files are checked for more.
const LEAST_SLOPE: f64 = 0.1;

/// True for a calibration without curvature.
fn is_straight(curve: &[f64; 2]) -> bool {
    *curve == [0.0; 2]
}

impl ChannelScale {
    /// Physical value of a number of counts.
    pub(crate) fn value(&self, counts: i32) -> f64 {
        self.curved(f64::from(counts) * self.scale_per_count) - self.offset - self.tare
    }

    /// Counts of a physical value, rounded to the nearest.
    pub(crate) fn counts(&self, value: f64) -> i32 {
        (self.straight(value + self.offset + self.tare) / self.scale_per_count).round() as i32
    }

    /// Change of the value for one count, near `value`.
    pub(crate) fn slope_per_count(&self, value: f64) -> f64 {
        self.scale_per_count * self.slope(self.straight(value + self.offset + self.tare))
    }

    /// The formula in words, as data packages have it.
    pub(crate) fn formula(&self) -> &'static str {
        match is_straight(&self.curve) {
            true => "value = counts * scale_per_count - offset - tare",
            false => {
                "value = u + curve[0] * u^2 + curve[1] * u^3 - offset - tare, u = counts * scale_per_count"
            }
        }
    }

    fn curved(&self, u: f64) -> f64 {
        u * (1.0 + u * (self.curve[0] + u * self.curve[1]))
    }

    fn slope(&self, u: f64) -> f64 {
        1.0 + u * (2.0 * self.curve[0] + 3.0 * u * self.curve[1])
    }

    /// The `u` whose curved value is `value`.
    fn straight(&self, value: f64) -> f64 {
        let mut u = value;
        if is_straight(&self.curve) {
            return u;
        }
        for _ in 0..INVERSION_STEPS {
            u -= (self.curved(u) - value) / self.slope(u).max(LEAST_SLOPE);
        }
        u
    }
}

/// The sensor of a channel and its calibration, for those who read a recording years later. Empty where it is not known.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct SensorIdentity {
    /// Number of the calibration certificate.
    pub certificate: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Last day of the calibration, `YYYY-MM-DD`.
    pub due: String,
    /// Name of the calibration file without its folder; empty where the bench file itself has the calibration, as all below.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub file: String,
    /// Hex SHA-256 of the calibration file.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub file_sha256: String,
    /// Who calibrated the sensor.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub laboratory: String,
    /// Maker and type of the sensor.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub sensor: String,
    /// Serial number of the sensor.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub serial: String,
    /// Class with its standard.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub class: String,
    /// Expanded uncertainty (k = 2) in N or mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expanded_uncertainty: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2 % of curvature at 10 kN, off by a gain of 1 %.
    const CURVED: ChannelScale = ChannelScale {
        scale_per_count: 0.099,
        offset: 12.5,
        tare: -3.0,
        curve: [2e-6, -3e-11],
    };

    #[test]
    fn a_curved_value_comes_back_as_its_counts() {
        for counts in [-131_071, -100_000, -1, 0, 1, 777, 31_000, 100_000, 131_071] {
            assert_eq!(CURVED.counts(CURVED.value(counts)), counts);
        }
        // By hand: u = 9900 N; 2e-6 u^2 = 196.02; -3e-11 u^3 = -29.10897.
        assert!((CURVED.value(100_000) - (9900.0 + 196.02 - 29.108_97 - 12.5 + 3.0)).abs() < 1e-9);
    }

    #[test]
    fn the_slope_is_that_of_the_curve() {
        for counts in [-50_000, 0, 80_000] {
            let chord = 0.5 * (CURVED.value(counts + 1) - CURVED.value(counts - 1));
            assert!((CURVED.slope_per_count(CURVED.value(counts)) / chord - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_straight_line_is_written_as_before() {
        let line = ChannelScale {
            curve: [0.0; 2],
            ..CURVED
        };
        let text = serde_json::to_string(&line).expect("numbers");
        assert_eq!(text, r#"{"scale_per_count":0.099,"offset":12.5,"tare":-3.0}"#);
        assert_eq!(serde_json::from_str::<ChannelScale>(&text).expect("read"), line);
        assert_eq!(
            line.value(-31_415),
            f64::from(-31_415) * 0.099 - 12.5 + 3.0,
            "the same bits"
        );
    }
}
