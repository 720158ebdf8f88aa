//! Bench configs: link, channels, limits, specimen and model. `file` reads and writes them, `calibration` the calibration of a
//! sensor, `checks` refuses values that cannot be right, `rig` gives control and twin their figures. Opening the link and building the mock rig is left to the daemon and
//! the command line. docs/profiles-and-benches.md lists every key.

pub(crate) mod calibration;
mod checks;
mod document;
mod file;
mod rig;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::effect::law::ForceLaw;
use crate::effect::{self, Effect, EffectError};
use crate::model::{self, BuildError, Plant};
use crate::profile::ProfileLimits;

/// Why a bench or specimen file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("{} cannot be read ({reason}): check the path and the permissions", path.display())]
    Read { path: PathBuf, reason: String },
    #[error("{origin}, line {line}, column {column}, {key}: {reason}")]
    Invalid {
        /// Name of the file.
        origin: String,
        /// Line of the file, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// Key with its table, `limits.force_max_n`; `toml` where the text cannot be parsed.
        key: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// A bench. It is checked when it is read, so its users need not check it again.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bench {
    /// Name for run headers and messages.
    pub name: String,
    /// How the rig is reached.
    pub(crate) link: LinkConfig,
    pub(crate) force_channel: ForceChannel,
    pub(crate) displacement_channel: DisplacementChannel,
    pub(crate) limits: BenchLimits,
    pub(crate) daemon: DaemonConfig,
    /// The spring on the rig.
    pub(crate) specimen: Specimen,
    /// The model of the twin and of the dry run: that of the bench, or else that of the specimen.
    pub(crate) model: ModelConfig,
    /// Settings of the mock rig as in the file.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub(crate) mock_rig: toml::Table,
}

impl Bench {
    /// Name or serial number of the spring on the rig.
    pub fn specimen_name(&self) -> &str {
        &self.specimen.name
    }

    /// The bench with one more effect in the specimen of its mock rig. Twin and diagnosis do not have it.
    #[must_use]
    pub fn with_concealed_effect(mut self, code: &str, parameters: &[(&str, f64)]) -> Bench {
        self.specimen.model.effects.push(EffectConfig {
            code: code.to_owned(),
            parameters: parameters.iter().map(|(n, v)| ((*n).to_owned(), *v)).collect(),
        });
        self
    }
}

/// How the rig is reached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LinkConfig {
    /// `mock:` in memory, `can:can0`, `serial:/dev/ttyUSB0`.
    pub address: String,
    /// Node of the rig, 1 to 126.
    pub node: u8,
    /// Time by which commands are sent ahead to the queue of the rig, 40 to 200 ms and above `limits.queue_low_ms`.
    #[serde(default = "LinkConfig::default_queue_lead_ms")]
    pub queue_lead_ms: u64,
    /// A run is aborted if no sample arrives for longer than this, 5 to 500 ms and at most `limits.lease_ms`.
    #[serde(default = "LinkConfig::default_silence_ms")]
    pub silence_ms: u64,
}

impl LinkConfig {
    fn default_queue_lead_ms() -> u64 {
        100
    }

    fn default_silence_ms() -> u64 {
        20
    }
}

/// The load cell's calibration: `force_n = p(counts * sign * n_per_count) - offset_n - tare`, where `p` is the polynomial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ForceChannel {
    /// Newtons for each count, above 0.
    pub n_per_count: f64,
    /// 1: the counts rise when the spring is loaded. The firmware requires it.
    pub sign: i32,
    /// Offset of the calibration in N.
    pub offset_n: f64,
    /// Rated capacity of the load cell in N.
    pub capacity_n: f64,
    /// Standard deviation of the noise at calibration in N.
    pub noise_n: f64,
    /// Number of the calibration certificate.
    pub certificate: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Date of the next calibration, `YYYY-MM-DD`. After it no run starts, unless a person answers for it.
    pub due: String,
    /// Factors of the powers of the reading, from the constant on: two to four. Empty: the reading itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub polynomial: Vec<f64>,
    /// Expanded uncertainty (k = 2) in N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expanded_uncertainty_n: Option<f64>,
    /// The calibration file from which all this was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<SensorFile>,
}

/// The LVDT's calibration: `displacement_mm = p(counts * sign * mm_per_count) - offset_mm - tare`, where `p` is the polynomial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DisplacementChannel {
    /// Millimetres for each count, above 0.
    pub mm_per_count: f64,
    /// 1: the counts rise when the spring is loaded. The firmware requires it.
    pub sign: i32,
    /// Offset of the calibration in mm.
    pub offset_mm: f64,
    /// Half of the range of the LVDT in mm.
    pub capacity_mm: f64,
    /// Standard deviation of the noise at calibration in mm.
    pub noise_mm: f64,
    /// Number of the calibration certificate.
    pub certificate: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Date of the next calibration, `YYYY-MM-DD`. After it no run starts, unless a person answers for it.
    pub due: String,
    /// Factors of the powers of the reading, from the constant on: two to four. Empty: the reading itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub polynomial: Vec<f64>,
    /// Expanded uncertainty (k = 2) in mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expanded_uncertainty_mm: Option<f64>,
    /// The calibration file from which all this was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<SensorFile>,
}

/// A calibration file that a bench uses, in the copy of the bench that a run keeps.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SensorFile {
    /// Name of the file without its folder.
    pub file: String,
    /// Hex SHA-256 of the file.
    pub file_sha256: String,
    /// Who calibrated the sensor.
    pub laboratory: String,
    /// Maker and type of the sensor.
    #[serde(default)]
    pub sensor: String,
    /// Serial number of the sensor.
    pub serial: String,
    /// Class with its standard.
    pub class: String,
}

/// Limits of a bench. Every one is required and none can be switched off. `checks` has their ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BenchLimits {
    /// Upper force limit in N, at most the capacity of the load cell.
    pub force_max_n: f64,
    /// Lower force limit in N, below zero: a spring that is pushed cannot pull.
    pub force_min_n: f64,
    /// Upper displacement limit in mm.
    pub displacement_max_mm: f64,
    /// Lower displacement limit in mm, below zero.
    pub displacement_min_mm: f64,
    /// Limit of the speed of the LVDT in mm/s.
    pub velocity_max_mm_s: f64,
    /// Largest mean acceleration of a profile over 20 ms, in mm/s2.
    pub acceleration_max_mm_s2: f64,
    /// Allowed difference of command and displacement in displacement control, in mm.
    pub following_error_mm: f64,
    /// Allowed difference of command and force in force control, in N.
    pub following_error_n: f64,
    /// Speed of the unload ramp in mm/s.
    pub unload_velocity_mm_s: f64,
    /// The specimen counts as unloaded at or below this force in N.
    pub unloaded_force_n: f64,
    /// Displacement in mm at which the unload ramp ends if the force has not fallen before.
    pub retract_mm: f64,
    /// The rig unloads without the host if it gets no lease frame for this time.
    pub lease_ms: i32,
    /// A hold becomes an unload after this time.
    pub hold_timeout_ms: i32,
    /// The rig goes to hold if its queue has fewer commands than this.
    pub queue_low_ms: i32,
    /// Largest tare of the load cell in N.
    pub tare_max_n: f64,
    /// Largest tare of the LVDT in mm.
    pub tare_max_mm: f64,
}

/// Reaction when the residual of the twin leaves its band.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum MismatchAction {
    /// An event in the run and a message on the page.
    #[default]
    Tell,
    /// As `Tell`, and the rig holds until an operator resumes or stops.
    Hold,
    /// As `Tell`, and the run ends.
    Stop,
}

/// Settings of the daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DaemonConfig {
    /// Loopback address and port of the HTTP interface.
    pub listen: SocketAddr,
    /// Folder of the run files.
    pub data_folder: PathBuf,
    #[serde(default)]
    pub model_mismatch: MismatchAction,
}

/// The spring on the rig, with its model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Specimen {
    /// Name or serial number.
    pub name: String,
    /// Where its values come from. Recorded only.
    #[serde(default)]
    pub source: String,
    pub model: ModelConfig,
}

/// A model with its values, structure and effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModelConfig {
    /// Name in `model::MODELS`.
    pub name: String,
    /// Codes of physics (docs/formats.md) that the specimen is known to have and the model does not contain. `diagnose` does
    /// not report them as missing.
    #[serde(default)]
    pub known: Vec<String>,
    /// Zero of the force channel in N that the tare left. It is added to the force of the model.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub force_zero_n: f64,
    /// Values of the parameters by name. A parameter that is not written has its start value.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Geometry and options of the model.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub structure: toml::Table,
    /// Effects attached to the model. They act in the order of their stages, not of the file.
    #[serde(default, rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectConfig>,
    /// A law that was read off recordings, around the model and below its effects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<ForceLaw>,
}

/// True for a value that is not written, because it changes nothing.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes fields by reference"
)]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// An effect attached to a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EffectConfig {
    /// Code of physics, see docs/formats.md.
    pub code: String,
    /// Values of the parameters by name. A parameter that is not written has its start value.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}

impl ModelConfig {
    /// The value of each parameter, in the order of the model.
    pub(crate) fn values(&self) -> Result<Vec<f64>, BuildError> {
        let model = model::find(&self.name)?;
        let mut values = model.start_values();
        for (name, &value) in &self.parameters {
            let index = model.parameter_index(name)?;
            if let Some(slot) = values.get_mut(index) {
                *slot = value;
            }
        }
        Ok(values)
    }

    /// The model ready to step, with its effects.
    pub(crate) fn plant(&self) -> Result<Box<dyn Plant>, BuildError> {
        self.with_effects(self.plant_without_effects()?)
            .map_err(|e| match e {
                EffectError::Value(e) => e,
                other => BuildError::Structure {
                    model: model::find(&self.name).map_or("", |m| m.name),
                    reason: other.to_string(),
                },
            })
    }

    fn plant_without_effects(&self) -> Result<Box<dyn Plant>, BuildError> {
        let model = model::find(&self.name)?;
        let plant = model.plant(&self.values()?, &self.structure)?;
        let Some(law) = &self.law else {
            return Ok(plant);
        };
        law.attached(plant).map_err(|error| BuildError::Structure {
            model: model.name,
            reason: error.to_string(),
        })
    }

    fn with_effects(&self, plant: Box<dyn Plant>) -> Result<Box<dyn Plant>, EffectError> {
        let effects: Vec<_> = self
            .effects
            .iter()
            .map(EffectConfig::resolved)
            .collect::<Result<_, _>>()?;
        effect::attach_all(&effects, self.force_zero_n, plant)
    }
}

impl EffectConfig {
    /// The effect with the value of each of its parameters.
    fn resolved(&self) -> Result<(&'static Effect, Vec<f64>), EffectError> {
        let found = effect::find(&self.code)?;
        let names: Vec<&str> = found.parameters.iter().map(|p| p.name).collect();
        let unknown = self
            .parameters
            .keys()
            .find(|name| !names.contains(&name.as_str()));
        if let Some(name) = unknown {
            return Err(EffectError::Value(BuildError::UnknownParameter {
                model: found.code,
                name: name.clone(),
                known: names.join(", "),
            }));
        }
        let value = |p: &model::Parameter| self.parameters.get(p.name).copied().unwrap_or(p.start);
        Ok((found, found.parameters.iter().map(value).collect()))
    }
}

impl Bench {
    /// Hex SHA-256 of [`Bench::to_toml`].
    pub(crate) fn sha256(&self) -> String {
        Sha256::digest(self.to_toml())
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect()
    }

    /// First four bytes, big endian, of the SHA-256 of the calibration's text. Compared with the rig's before arming.
    pub(crate) fn calibration_hash(&self) -> u32 {
        let digest = Sha256::digest(self.calibration_text());
        digest
            .iter()
            .take(4)
            .fold(0, |hash, &byte| hash << 8 | u32::from(byte))
    }

    /// One line for each channel, each number as the shortest decimal that reads back the same.
    fn calibration_text(&self) -> String {
        self.force_channel.calibration_line() + &self.displacement_channel.calibration_line()
    }

    /// The limits that a profile is checked against.
    pub(crate) fn profile_limits(&self) -> ProfileLimits {
        let l = &self.limits;
        ProfileLimits {
            force_min_n: l.force_min_n,
            force_max_n: l.force_max_n,
            displacement_min_mm: l.displacement_min_mm,
            displacement_max_mm: l.displacement_max_mm,
            velocity_max_mm_s: l.velocity_max_mm_s,
            acceleration_max_mm_s2: l.acceleration_max_mm_s2,
        }
    }
}
