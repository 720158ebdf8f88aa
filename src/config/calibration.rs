//! The calibration of a channel: in the bench file itself, or in a file of the sensor that the bench file names.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::document::Document;
use super::{ConfigError, DisplacementChannel, ForceChannel, SensorFile, checks};
use crate::calibration::{CalibratedChannel, CalibrationFile};
use crate::recording::{ChannelScale, SensorIdentity};

/// A calibration file that was read and checked.
pub(crate) struct ReadCalibration {
    pub(crate) content: CalibrationFile,
    pub(super) file: SensorFile,
}

/// Reads the calibration file that a bench file names.
pub(super) type ReadFile<'a> = &'a dyn Fn(&str) -> Result<ReadCalibration, ConfigError>;

/// What may stand in the table of a channel.
pub(super) trait ChannelSource<C>: DeserializeOwned {
    /// The channel, complete.
    fn resolve(self, document: &Document, read: ReadFile) -> Result<C, ConfigError>;
}

/// A channel whose calibration is in a file of its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NamedCalibration {
    calibration: String,
}

impl ChannelSource<ForceChannel> for ForceChannel {
    fn resolve(self, _: &Document, _: ReadFile) -> Result<ForceChannel, ConfigError> {
        Ok(self)
    }
}

impl ChannelSource<DisplacementChannel> for DisplacementChannel {
    fn resolve(self, _: &Document, _: ReadFile) -> Result<DisplacementChannel, ConfigError> {
        Ok(self)
    }
}

impl ChannelSource<ForceChannel> for NamedCalibration {
    fn resolve(self, document: &Document, read: ReadFile) -> Result<ForceChannel, ConfigError> {
        let read = read(&self.calibration)?;
        read.require(document, CalibratedChannel::Force)?;
        Ok(read.force())
    }
}

impl ChannelSource<DisplacementChannel> for NamedCalibration {
    fn resolve(self, document: &Document, read: ReadFile) -> Result<DisplacementChannel, ConfigError> {
        let read = read(&self.calibration)?;
        read.require(document, CalibratedChannel::Displacement)?;
        Ok(read.displacement())
    }
}

impl ReadCalibration {
    /// Reads a calibration from its file's text; `origin` is the path for messages.
    pub(crate) fn parse(text: &str, origin: &str) -> Result<ReadCalibration, ConfigError> {
        let (document, content) = Document::read::<CalibrationFile>(text, origin)?;
        checks::calibration(&document, &content)?;
        let name = Path::new(origin).file_name().unwrap_or_default();
        let hash = Sha256::digest(text);
        let file = SensorFile {
            file: name.to_string_lossy().into_owned(),
            file_sha256: hash.iter().map(|b| format!("{b:02x}")).collect(),
            laboratory: content.laboratory.clone(),
            sensor: content.sensor.clone(),
            serial: content.serial.clone(),
            class: content.class.clone(),
        };
        Ok(ReadCalibration { content, file })
    }

    /// Refuses the file of another kind of sensor.
    fn require(&self, document: &Document, wanted: CalibratedChannel) -> Result<(), ConfigError> {
        if self.content.channel == wanted {
            return Ok(());
        }
        let reason = format!(
            "{} is the calibration of a {:?} sensor: name the file of this channel's sensor",
            self.file.file, self.content.channel
        );
        Err(document.refuse(&format!("{}.calibration", wanted.table()), reason.to_lowercase()))
    }

    /// The load cell with this calibration.
    pub(crate) fn force(self) -> ForceChannel {
        let c = self.content;
        ForceChannel {
            n_per_count: c.per_count,
            sign: 1,
            offset_n: 0.0,
            capacity_n: c.capacity,
            noise_n: c.noise,
            certificate: c.certificate,
            calibrated: c.calibrated,
            due: c.due,
            polynomial: c.polynomial,
            expanded_uncertainty_n: Some(c.expanded_uncertainty),
            file: Some(self.file),
        }
    }

    /// The LVDT with this calibration.
    pub(crate) fn displacement(self) -> DisplacementChannel {
        let c = self.content;
        DisplacementChannel {
            mm_per_count: c.per_count,
            sign: 1,
            offset_mm: 0.0,
            capacity_mm: c.capacity,
            noise_mm: c.noise,
            certificate: c.certificate,
            calibrated: c.calibrated,
            due: c.due,
            polynomial: c.polynomial,
            expanded_uncertainty_mm: Some(c.expanded_uncertainty),
            file: Some(self.file),
        }
    }
}

/// Scaling without tare of counts that are worth `per_count`. An empty polynomial corrects nothing.
fn scale(per_count: f64, offset: f64, polynomial: &[f64]) -> ChannelScale {
    let term = |power: usize, absent: f64| polynomial.get(power).copied().unwrap_or(absent);
    let gain = term(1, 1.0);
    ChannelScale {
        scale_per_count: per_count * gain,
        offset: offset - term(0, 0.0),
        tare: 0.0,
        curve: [term(2, 0.0) / gain.powi(2), term(3, 0.0) / gain.powi(3)],
    }
}

/// The part of the calibration's text (the text behind the calibration hash) that a polynomial adds.
fn polynomial_text(polynomial: &[f64]) -> String {
    polynomial.iter().map(|c| format!(" {c:?}")).collect()
}

fn identity(
    certificate: &str,
    [calibrated, due]: [&str; 2],
    file: Option<&SensorFile>,
    expanded_uncertainty: Option<f64>,
) -> SensorIdentity {
    let file = file.cloned().unwrap_or_default();
    SensorIdentity {
        certificate: certificate.to_owned(),
        calibrated: calibrated.to_owned(),
        due: due.to_owned(),
        file: file.file,
        file_sha256: file.file_sha256,
        laboratory: file.laboratory,
        sensor: file.sensor,
        serial: file.serial,
        class: file.class,
        expanded_uncertainty,
    }
}

impl ForceChannel {
    /// Scaling without tare.
    pub(crate) fn scale(&self) -> ChannelScale {
        scale(
            self.n_per_count * f64::from(self.sign),
            self.offset_n,
            &self.polynomial,
        )
    }

    /// Which load cell it is, and by which calibration it measures.
    pub(crate) fn sensor(&self) -> SensorIdentity {
        let dates = [self.calibrated.as_str(), self.due.as_str()];
        identity(
            &self.certificate,
            dates,
            self.file.as_ref(),
            self.expanded_uncertainty_n,
        )
    }

    /// The line of the calibration's text.
    pub(super) fn calibration_line(&self) -> String {
        format!(
            "force {:?} {} {:?} {:?} {:?} {:?}{}\n",
            self.n_per_count,
            self.sign,
            self.offset_n,
            self.capacity_n,
            self.certificate,
            self.calibrated,
            polynomial_text(&self.polynomial)
        )
    }
}

impl DisplacementChannel {
    /// Scaling without tare.
    pub(crate) fn scale(&self) -> ChannelScale {
        scale(
            self.mm_per_count * f64::from(self.sign),
            self.offset_mm,
            &self.polynomial,
        )
    }

    /// Which LVDT it is, and by which calibration it measures.
    pub(crate) fn sensor(&self) -> SensorIdentity {
        let dates = [self.calibrated.as_str(), self.due.as_str()];
        identity(
            &self.certificate,
            dates,
            self.file.as_ref(),
            self.expanded_uncertainty_mm,
        )
    }

    /// The line of the calibration's text.
    pub(super) fn calibration_line(&self) -> String {
        format!(
            "displacement {:?} {} {:?} {:?} {:?} {:?}{}\n",
            self.mm_per_count,
            self.sign,
            self.offset_mm,
            self.capacity_mm,
            self.certificate,
            self.calibrated,
            polynomial_text(&self.polynomial)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::CalibrationPoint;
    use crate::config::Bench;

    /// A load cell that reads 2 % high at 10 kN, and bends.
    fn load_cell() -> CalibrationFile {
        CalibrationFile {
            channel: CalibratedChannel::Force,
            certificate: "LC-2026-041".to_owned(),
            laboratory: "D-K \"15\"".to_owned(),
            sensor: "U10M 10 kN".to_owned(),
            serial: "0041".to_owned(),
            reference: String::new(),
            calibrated: "2026-09-01".to_owned(),
            due: "2027-09-01".to_owned(),
            class: "ISO 7500-1 class 1".to_owned(),
            expanded_uncertainty: 6.5,
            per_count: 0.1,
            capacity: 10_000.0,
            noise: 0.5,
            polynomial: vec![1.5, 0.98, 1e-6, -2e-11],
            points: vec![
                CalibrationPoint {
                    series: 1,
                    reference: 0.0,
                    up: 0.1,
                    down: Some(0.2),
                    down_reference: None,
                },
                CalibrationPoint {
                    series: 1,
                    reference: 2000.0,
                    up: 2040.0,
                    down: None,
                    down_reference: None,
                },
            ],
        }
    }

    /// The shipped bench whose load cell has this calibration file.
    fn bench_with(text: &str) -> Result<Bench, ConfigError> {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("cell.toml"), text).expect("written");
        let shipped = Bench::shipped().expect("built in").to_toml();
        let (before, rest) = shipped.split_once("[force_channel]\n").expect("a table");
        let (_, after) = rest.split_once("\n[").expect("another table");
        let bench = format!("{before}[force_channel]\ncalibration = \"cell.toml\"\n\n[{after}");
        let path = folder.path().join("bench.toml");
        std::fs::write(&path, bench).expect("written");
        Bench::load(&path)
    }

    #[test]
    fn a_bench_measures_by_the_file_that_it_names_and_keeps_its_identity() {
        let file = load_cell();
        let bench = bench_with(&file.to_toml()).expect("a bench");
        let scale = bench.force_channel.scale();
        for counts in [-2000, 0, 20_000, 100_000] {
            let reading = f64::from(counts) * 0.1;
            let wanted = crate::calibration::fit::value(&file.polynomial, reading);
            assert!((scale.value(counts) - wanted).abs() < 1e-8, "{counts}");
        }
        let sensor = bench.force_channel.sensor();
        assert_eq!(
            (sensor.serial.as_str(), sensor.file.as_str()),
            ("0041", "cell.toml")
        );
        assert_eq!(sensor.laboratory, "D-K \"15\"");
        let hash: String = Sha256::digest(file.to_toml())
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect();
        assert_eq!(sensor.file_sha256, hash);
        // The copy that a run keeps needs no other file.
        let again = Bench::parse(&bench.to_toml(), "copy").expect("complete");
        assert_eq!(again, bench);
        assert_eq!(again.calibration_hash(), bench.calibration_hash());
    }

    #[test]
    fn the_shipped_example_is_a_calibration() {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/calibrations/example-load-cell.toml");
        let text = std::fs::read_to_string(path).expect("shipped");
        let bench = bench_with(&text).expect("a bench");
        assert_eq!(bench.force_channel.sensor().serial, "0041");
    }

    #[test]
    fn the_calibration_hash_knows_the_polynomial() {
        let hash = |file: &CalibrationFile| bench_with(&file.to_toml()).expect("a bench").calibration_hash();
        let mut file = load_cell();
        let first = hash(&file);
        file.expanded_uncertainty = 7.0;
        assert_eq!(hash(&file), first, "it changes no reading");
        file.polynomial[2] = 1.1e-6;
        assert_ne!(hash(&file), first);
    }

    #[test]
    fn a_file_that_is_written_reads_back_the_same() {
        let file = load_cell();
        let read = ReadCalibration::parse(&file.to_toml(), "folder/cell.toml").expect("sound");
        assert_eq!(read.content, file);
    }

    #[test]
    fn what_is_wrong_is_refused_at_its_place() {
        let text = load_cell().to_toml();
        for (from, to, wanted) in [
            (
                "noise_n = 0.5",
                "noise_mm = 0.5",
                "noise_mm: the channel is in N: write noise_n",
            ),
            ("0.98, ", "0.4, ", "polynomial: its slope at "),
            ("1e-6", "1e-3", "polynomial: its slope at "),
            (
                "[1.5, 0.98, 1e-6, -2e-11]",
                "[1.0]",
                "polynomial: needs two to four numbers",
            ),
            (
                "[1.5, ",
                "[1500.0, 0.0, ",
                "polynomial: needs two to four numbers",
            ),
            ("\"0041\"", "\" \"", "serial: the text is empty"),
            (
                "due = \"2027",
                "due = \"2025",
                "due: 2025-09-01 is not after the calibration",
            ),
            (
                "capacity_n = 10000.0",
                "capacity_n = 10.0",
                "capacity_n: 10 is outside",
            ),
            (
                "up_n = 2040.0",
                "up_n = 2040000.0",
                "point: a point is above twice the capacity",
            ),
            ("laboratory", "labor", "unknown field `labor`"),
        ] {
            let text = text.replace(from, to).replace(
                "-2e-11]",
                if to.starts_with("[1500") {
                    "-2e-11, 0.0]"
                } else {
                    "-2e-11]"
                },
            );
            let error = bench_with(&text).expect_err(to).to_string();
            assert!(
                error.contains(wanted) && error.contains("cell.toml, line "),
                "{error}"
            );
        }
        let error = bench_with("channel = 3").expect_err("no word").to_string();
        assert!(error.contains("cell.toml, line 1"), "{error}");
    }

    #[test]
    fn a_channel_has_a_file_or_values_and_the_file_is_of_its_kind() {
        let mut lvdt = load_cell();
        lvdt.channel = CalibratedChannel::Displacement;
        (lvdt.per_count, lvdt.capacity, lvdt.noise, lvdt.points) = (0.0005, 60.0, 0.001, Vec::new());
        (lvdt.polynomial, lvdt.expanded_uncertainty) = (vec![0.0, 1.0], 0.01);
        let error = bench_with(&lvdt.to_toml()).expect_err("another kind").to_string();
        assert!(
            error
                .contains("force_channel.calibration: cell.toml is the calibration of a displacement sensor"),
            "{error}"
        );
        let shipped = Bench::shipped().expect("built in").to_toml();
        let both = shipped.replace(
            "[force_channel]\n",
            "[force_channel]\ncalibration = \"cell.toml\"\n",
        );
        let error = Bench::parse(&both, "both.toml").expect_err("both").to_string();
        assert!(
            error.contains("expected `calibration`") && error.contains("line "),
            "{error}"
        );
    }
}
