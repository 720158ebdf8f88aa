//! Reads bench and specimen files strictly, with line and column in every error, and writes a bench as one complete file.
//! `checks` decides which values are allowed.

use std::path::Path;

use serde::Deserialize;

use super::calibration::{ChannelSource, NamedCalibration, ReadCalibration, ReadFile};
use super::document::Document;
use super::{
    Bench, BenchLimits, ConfigError, DaemonConfig, DisplacementChannel, ForceChannel, LinkConfig,
    ModelConfig, Specimen, checks,
};
use crate::mockrig::MockRigConfig;
use crate::regular_file::{self, WRITTEN_MAX_BYTES};

/// A bench file as it is written. Its specimen may be in a file of its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBench<F, D> {
    name: String,
    link: LinkConfig,
    force_channel: F,
    displacement_channel: D,
    limits: BenchLimits,
    daemon: DaemonConfig,
    specimen: RawSpecimen,
    model: Option<ModelConfig>,
    #[serde(default)]
    mock_rig: toml::Table,
}

/// Whether each channel names a calibration file, which decides what else its table may have.
#[derive(Deserialize)]
struct RawChannels {
    #[serde(default)]
    force_channel: toml::Table,
    #[serde(default)]
    displacement_channel: toml::Table,
}

/// Reads the files that a bench file names.
struct NamedFiles<'a> {
    specimen: &'a dyn Fn(&str) -> Result<Specimen, ConfigError>,
    calibration: ReadFile<'a>,
}

/// The settings of the mock rig alone, so that an error in them has its line and column.
#[derive(Deserialize)]
struct RawMockRig {
    #[serde(default)]
    mock_rig: MockRigConfig,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSpecimen {
    file: Option<String>,
    name: Option<String>,
    source: Option<String>,
    model: Option<ModelConfig>,
}

impl Bench {
    /// Reads a bench file and the specimen file that it names.
    pub fn load(path: &Path) -> Result<Bench, ConfigError> {
        let text = read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Bench::parse_in(&text, &path.display().to_string(), folder)
    }

    /// Reads a bench from a text; `origin` is for messages. Files that it names are looked for in the working folder.
    pub(crate) fn parse(text: &str, origin: &str) -> Result<Bench, ConfigError> {
        Bench::parse_in(text, origin, Path::new(""))
    }

    /// `folder`: where the files that the text names are looked for.
    fn parse_in(text: &str, origin: &str, folder: &Path) -> Result<Bench, ConfigError> {
        let files = NamedFiles {
            specimen: &|file| Specimen::load(&folder.join(file)),
            calibration: &|file| ReadCalibration::load(&folder.join(file)),
        };
        Bench::parse_with(text, origin, &files)
    }

    /// The shipped mock bench, compiled into the program, for use without its file.
    pub fn shipped() -> Result<Bench, ConfigError> {
        let bench = include_str!("../../bench-configs/benches/mock.toml");
        let specimen = include_str!("../../bench-configs/specimens/samurai-front-equivalent.toml");
        let files = NamedFiles {
            specimen: &|file| Specimen::parse(specimen, file),
            calibration: &|file| ReadCalibration::load(Path::new(file)),
        };
        Bench::parse_with(bench, "the built-in mock bench", &files)
    }

    fn parse_with(text: &str, origin: &str, files: &NamedFiles) -> Result<Bench, ConfigError> {
        // Tables of another form are refused by the second reading, with their place.
        let names_file = |channels: &RawChannels| {
            let named = |table: &toml::Table| table.contains_key("calibration");
            (
                named(&channels.force_channel),
                named(&channels.displacement_channel),
            )
        };
        let named = toml::from_str(text).map_or((false, false), |channels| names_file(&channels));
        match named {
            (false, false) => Bench::parse_as::<ForceChannel, DisplacementChannel>(text, origin, files),
            (true, false) => Bench::parse_as::<NamedCalibration, DisplacementChannel>(text, origin, files),
            (false, true) => Bench::parse_as::<ForceChannel, NamedCalibration>(text, origin, files),
            (true, true) => Bench::parse_as::<NamedCalibration, NamedCalibration>(text, origin, files),
        }
    }

    fn parse_as<F: ChannelSource<ForceChannel>, D: ChannelSource<DisplacementChannel>>(
        text: &str,
        origin: &str,
        files: &NamedFiles,
    ) -> Result<Bench, ConfigError> {
        let (document, raw) = Document::read::<RawBench<F, D>>(text, origin)?;
        let (_, RawMockRig { mock_rig }) = Document::read(text, origin)?;
        checks::mock_rig(&document, &mock_rig)?;
        let specimen = match raw.specimen {
            RawSpecimen {
                file: Some(file),
                name: None,
                source: None,
                model: None,
            } => (files.specimen)(&file)?,
            RawSpecimen {
                file: None,
                name: Some(name),
                source,
                model: Some(model),
            } => {
                let specimen = Specimen {
                    name,
                    source: source.unwrap_or_default(),
                    model,
                };
                checks::specimen(&document, "specimen.", &specimen)?;
                specimen
            }
            _ => {
                let reason = "needs either file, or name and model, and not both: keep one of them";
                return Err(document.refuse("specimen", reason));
            }
        };
        if let Some(model) = &raw.model {
            checks::model(&document, "model", model)?;
        }
        let bench = Bench {
            name: raw.name,
            link: raw.link,
            force_channel: raw.force_channel.resolve(&document, files.calibration)?,
            displacement_channel: raw.displacement_channel.resolve(&document, files.calibration)?,
            limits: raw.limits,
            daemon: raw.daemon,
            model: raw.model.unwrap_or_else(|| specimen.model.clone()),
            specimen,
            mock_rig: raw.mock_rig,
        };
        checks::bench(&document, &bench)?;
        Ok(bench)
    }

    /// The bench as one complete file that includes the specimen. Reading it gives the same bench again.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a bench has tables, strings and numbers only")
    }
}

impl Specimen {
    /// Reads a specimen file.
    pub(crate) fn load(path: &Path) -> Result<Specimen, ConfigError> {
        Specimen::parse(&read_text(path)?, &path.display().to_string())
    }

    /// Reads a specimen from its file's text.
    pub(crate) fn parse(text: &str, origin: &str) -> Result<Specimen, ConfigError> {
        let (document, specimen) = Document::read::<Specimen>(text, origin)?;
        checks::specimen(&document, "", &specimen)?;
        Ok(specimen)
    }
}

impl ReadCalibration {
    /// Reads a calibration file.
    pub(crate) fn load(path: &Path) -> Result<ReadCalibration, ConfigError> {
        ReadCalibration::parse(&read_text(path)?, &path.display().to_string())
    }
}

fn read_text(path: &Path) -> Result<String, ConfigError> {
    let failed = |reason: String| ConfigError::Read {
        path: path.to_owned(),
        reason,
    };
    regular_file::read_text(path, WRITTEN_MAX_BYTES).map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_too_large_is_refused_before_it_is_read() {
        let file = tempfile::NamedTempFile::new().unwrap();
        file.as_file().set_len(1 << 40).unwrap();
        let error = Bench::load(file.path()).unwrap_err().to_string();
        assert!(error.contains("it has more than 1048576 bytes"), "{error}");
    }

    #[test]
    fn an_effect_is_refused_at_its_own_key() {
        let text = include_str!("../../bench-configs/specimens/samurai-front-equivalent.toml");
        for (effect, wanted) in [
            ("code = \"rust\"", "no effect has the code \"rust\""),
            ("code = \"backlash\"\nparameters = { gap_mm = 1000.0 }", "gap_mm"),
            (
                "code = \"backlash\"\nparameters = { gap = 1.0 }",
                "has no parameter",
            ),
        ] {
            let error =
                Specimen::parse(&format!("{text}\n[[model.effect]]\n{effect}\n"), "s.toml").unwrap_err();
            let ConfigError::Invalid {
                line, key, reason, ..
            } = &error
            else {
                panic!("{error}")
            };
            assert_eq!(key, "model.effect", "{error}");
            assert!(*line > text.lines().count() && reason.contains(wanted), "{error}");
        }
    }

    #[test]
    fn what_the_mock_rig_would_refuse_at_its_start_is_refused_with_its_line() {
        let shipped = include_str!("../../bench-configs/benches/mock.toml")
            .replace("../specimens/", "bench-configs/specimens/");
        let line_of = |text: &str, key: &str| 1 + text.lines().position(|l| l.starts_with(key)).unwrap();
        for (from, to, wanted) in [
            ("seed = 1", "sed = 1", "unknown field `sed`"),
            (
                "seed = 1",
                "plant_steps_per_ms = 3",
                "mock_rig.plant_steps_per_ms: 3 is out of range: set it to 1 or 5",
            ),
            (
                "seed = 1",
                "load_cell.noise_rms_counts = -1.0",
                "mock_rig.load_cell.noise_rms_counts: -1 is out of range",
            ),
            ("sign = 1", "sign = -1", "force_channel.sign: -1 is not allowed"),
            (
                "unload_velocity_mm_s = 5.0",
                "unload_velocity_mm_s = 5.1",
                "limits.unload_velocity_mm_s: 5.1 is outside 0.1 to 5",
            ),
        ] {
            assert!(shipped.contains(from), "{from}");
            let text = shipped.replacen(from, to, 1);
            let error = Bench::parse(&text, "bad.toml").unwrap_err().to_string();
            let line = line_of(&text, to);
            assert!(
                error.contains(wanted) && error.contains(&format!("line {line}, ")),
                "{error} (line {line})"
            );
        }
    }

    #[test]
    fn the_calibration_of_a_shipped_mock_bench_does_not_run_out() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches");
        for file in std::fs::read_dir(folder).unwrap() {
            let bench = Bench::load(&file.unwrap().path()).unwrap();
            for (certificate, due) in [
                (&bench.force_channel.certificate, &bench.force_channel.due),
                (
                    &bench.displacement_channel.certificate,
                    &bench.displacement_channel.due,
                ),
            ] {
                assert!(
                    certificate != "mock" || due.as_str() > "2099",
                    "{}: {due}",
                    bench.name
                );
            }
        }
    }

    #[test]
    fn a_specimen_without_a_name_is_refused() {
        let text = include_str!("../../bench-configs/specimens/samurai-front-equivalent.toml")
            .replace("name = \"samurai-front\"", "name = \" \"");
        let error = Specimen::parse(&text, "s.toml").unwrap_err().to_string();
        assert!(error.contains("name: the text is empty"), "{error}");
    }

    #[test]
    fn times_of_the_link_fit_the_limits() {
        let text = mock().to_toml();
        for (from, to, key) in [
            ("queue_low_ms = 30", "queue_low_ms = 90", "link.queue_lead_ms"),
            ("silence_ms = 20", "silence_ms = 60", "link.silence_ms"),
        ] {
            assert!(text.contains(from));
            let text = text
                .replace(from, to)
                .replace("queue_lead_ms = 100", "queue_lead_ms = 90");
            let error = Bench::parse(&text, "bad.toml").unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
    }

    fn mock() -> Bench {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/benches/mock.toml");
        Bench::load(&path).unwrap()
    }

    #[test]
    fn the_built_in_bench_is_the_shipped_file() {
        assert_eq!(Bench::shipped().unwrap(), mock());
    }

    #[test]
    fn what_is_written_reads_back_the_same_and_hashes_the_same() {
        let bench = mock();
        let again = Bench::parse(&bench.to_toml(), "again").unwrap();
        assert_eq!(again, bench);
        assert_eq!(again.sha256(), bench.sha256());
        assert_eq!(again.calibration_hash(), bench.calibration_hash());
    }

    #[test]
    fn another_calibration_has_another_hash() {
        let mut bench = mock();
        let before = bench.calibration_hash();
        bench.limits.force_max_n -= 1.0;
        assert_eq!(
            bench.calibration_hash(),
            before,
            "limits are not part of the calibration"
        );
        bench.force_channel.offset_n = 0.1;
        assert_ne!(bench.calibration_hash(), before);
    }

    #[test]
    fn an_error_points_at_the_key() {
        let text = mock()
            .to_toml()
            .replace("force_max_n = 3200.0", "force_max_n = 12000.0");
        let error = Bench::parse(&text, "bad.toml").unwrap_err();
        let line = text.lines().position(|l| l.starts_with("force_max_n")).unwrap() + 1;
        let ConfigError::Invalid {
            line: found,
            column,
            key,
            ..
        } = &error
        else {
            panic!("{error}")
        };
        assert_eq!((*found, *column, key.as_str()), (line, 15, "limits.force_max_n"));
        assert!(
            error.to_string().contains("above the load cell's 10000 N"),
            "{error}"
        );
    }

    #[test]
    fn the_limits_of_a_bench_become_counts() {
        let limits = mock().rig_config(1);
        let counts = limits.limits.in_counts(&limits.channels);
        assert_eq!(
            (counts.force_max_counts, counts.force_min_counts),
            (32_000, -2_000)
        );
        assert_eq!((counts.lease_ms, counts.velocity_max_counts_s), (50, 300_000));
    }
}
