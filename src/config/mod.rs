//! Bench configs: rig, channels, limits, specimen and model, as typed and checked. `file` reads and writes them, `checks`
//! refuses what cannot be right. Opening the link and building the rig is left to the daemon and the command line.

mod checks;
mod file;
mod rig;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::effect::{self, Effect, EffectError};
use crate::model::{self, BuildError, Plant};
use crate::profile::ProfileLimits;
use crate::protocol::message::Limits;
use crate::recording::ChannelScale;

/// Why a bench or specimen file cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConfigError {
    /// The file is not there or not readable.
    #[error("{} cannot be read: {reason}: check the path and its rights", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// Something in the text is wrong.
    #[error("{origin}, line {line}, column {column}, {key}: {reason}")]
    Invalid {
        /// File.
        origin: String,
        /// From 1.
        line: usize,
        /// From 1, in characters.
        column: usize,
        /// Key with its table, `limits.force_max_n`; `toml` where the text cannot be parsed.
        key: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// A bench: checked, so that what holds it need not check again. There is no bench without limits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Bench {
    /// Name for run headers and messages.
    pub name: String,
    /// How the rig is reached.
    pub link: LinkConfig,
    /// Load cell.
    pub force_channel: ForceChannel,
    /// LVDT.
    pub displacement_channel: DisplacementChannel,
    /// What must not be passed.
    pub limits: BenchLimits,
    /// The daemon's own settings.
    pub daemon: DaemonConfig,
    /// The spring on the rig.
    pub specimen: Specimen,
    /// The model of twin and dry run: the bench's own, or the specimen's.
    pub model: ModelConfig,
    /// Settings of the mock rig, as they stand in the file; the mock rig checks them.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub mock_rig: toml::Table,
}

/// How the rig is reached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LinkConfig {
    /// `mock:` in memory, `can:can0`, `serial:/dev/ttyUSB0`.
    pub address: String,
    /// Node of the rig, 1 to 126.
    pub node: u8,
    /// Commands stand this far ahead in the rig's queue, 40 to 200 ms: the host may be late by as much.
    #[serde(default = "LinkConfig::default_queue_lead_ms")]
    pub queue_lead_ms: u64,
    /// A sample stream silent for longer aborts the run, 5 ms to the lease.
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

/// The load cell's calibration: `force_n = counts * sign * n_per_count - offset_n - tare`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ForceChannel {
    /// Newtons a count, positive.
    pub n_per_count: f64,
    /// 1 or -1: which way of the counts loads the spring.
    pub sign: i32,
    /// Offset of the calibration.
    pub offset_n: f64,
    /// Rated capacity of the cell.
    pub capacity_n: f64,
    /// Standard deviation of the noise at calibration.
    pub noise_n: f64,
    /// Certificate's number.
    pub certificate: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Date when the next is due, `YYYY-MM-DD`.
    pub due: String,
}

/// The LVDT's calibration: `displacement_mm = counts * sign * mm_per_count - offset_mm - tare`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DisplacementChannel {
    /// Millimetres a count, positive.
    pub mm_per_count: f64,
    /// 1 or -1: which way of the counts loads the spring.
    pub sign: i32,
    /// Offset of the calibration.
    pub offset_mm: f64,
    /// Half range of the transducer.
    pub capacity_mm: f64,
    /// Standard deviation of the noise at calibration.
    pub noise_mm: f64,
    /// Certificate's number.
    pub certificate: String,
    /// Date of calibration, `YYYY-MM-DD`.
    pub calibrated: String,
    /// Date when the next is due, `YYYY-MM-DD`.
    pub due: String,
}

/// What must not be passed. Every one is needed; there is no switching off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BenchLimits {
    /// Upper force, at most the cell's capacity.
    pub force_max_n: f64,
    /// Lower force, below zero: a spring that is pushed cannot pull.
    pub force_min_n: f64,
    /// Upper displacement.
    pub displacement_max_mm: f64,
    /// Lower displacement, below zero.
    pub displacement_min_mm: f64,
    /// Speed.
    pub velocity_max_mm_s: f64,
    /// Acceleration that a profile may ask for.
    pub acceleration_max_mm_s2: f64,
    /// Following error in displacement control.
    pub following_error_mm: f64,
    /// Following error in force control.
    pub following_error_n: f64,
    /// Speed of the unload ramp.
    pub unload_velocity_mm_s: f64,
    /// At or below this the specimen counts as unloaded.
    pub unloaded_force_n: f64,
    /// Where the unload ramp ends when the force did not fall before.
    pub retract_mm: f64,
    /// Lease, after which the rig unloads by itself.
    pub lease_ms: i32,
    /// Hold lapses to unload after this.
    pub hold_timeout_ms: i32,
    /// Below this level of the queue the rig slows to hold.
    pub queue_low_ms: i32,
    /// Largest tare of the load cell.
    pub tare_max_n: f64,
    /// Largest tare of the LVDT.
    pub tare_max_mm: f64,
}

/// What follows when the twin's residual leaves its band.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum MismatchAction {
    /// An event in the run and a line on the page.
    #[default]
    Tell,
    /// The rig holds; an operator resumes or stops.
    Hold,
    /// The run ends and the rig unloads.
    Stop,
}

/// The daemon's own settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DaemonConfig {
    /// Loopback address and port of the HTTP interface.
    pub listen: SocketAddr,
    /// Where runs are kept.
    pub data_folder: PathBuf,
    /// What a model mismatch does to the run, beside being told.
    #[serde(default)]
    pub model_mismatch: MismatchAction,
}

/// A spring with the model that describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Specimen {
    /// Name or serial number.
    pub name: String,
    /// Where its figures come from.
    #[serde(default)]
    pub source: String,
    /// Model and values.
    pub model: ModelConfig,
}

/// A model with its values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModelConfig {
    /// Name in `model::MODELS`.
    pub name: String,
    /// Codes of physics that it has beside the model's own (contracts.md).
    #[serde(default)]
    pub known: Vec<String>,
    /// Values by name; the model's start where one is missing.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Geometry and options of the model.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub structure: toml::Table,
    /// Effects attached to it, from the specimen outwards.
    #[serde(default, rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectConfig>,
}

/// An effect attached to a model: code of physics and values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EffectConfig {
    /// Code (contracts.md).
    pub code: String,
    /// Values by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}

impl ModelConfig {
    /// One value a parameter, in the model's order.
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

    /// The model ready to step, its effects attached; an effect's start where a value is missing.
    pub(crate) fn plant(&self) -> Result<Box<dyn Plant>, BuildError> {
        let model = model::find(&self.name)?;
        let plant = model.plant(&self.values()?, &self.structure)?;
        let refused = |e: EffectError| match e {
            EffectError::Value(e) => e,
            other => BuildError::Structure {
                model: model.name,
                reason: other.to_string(),
            },
        };
        let effects = self
            .effects
            .iter()
            .map(EffectConfig::resolved)
            .collect::<Result<Vec<_>, _>>()
            .map_err(refused)?;
        effect::attach_all(&effects, plant).map_err(refused)
    }
}

impl EffectConfig {
    /// The effect with one value a parameter.
    fn resolved(&self) -> Result<(&'static Effect, Vec<f64>), EffectError> {
        let found = effect::find(&self.code)?;
        let known = || {
            found
                .parameters
                .iter()
                .map(|p| p.name)
                .collect::<Vec<_>>()
                .join(", ")
        };
        if let Some(name) = self
            .parameters
            .keys()
            .find(|name| found.parameters.iter().all(|p| p.name != name.as_str()))
        {
            return Err(EffectError::Value(BuildError::UnknownParameter {
                model: found.code,
                name: name.clone(),
                known: known(),
            }));
        }
        let value = |p: &model::Parameter| self.parameters.get(p.name).copied().unwrap_or(p.start);
        Ok((found, found.parameters.iter().map(value).collect()))
    }
}

impl ForceChannel {
    /// Scaling without tare.
    pub(crate) fn scale(&self) -> ChannelScale {
        ChannelScale {
            scale_per_count: self.n_per_count * f64::from(self.sign),
            offset: self.offset_n,
            tare: 0.0,
        }
    }
}

impl DisplacementChannel {
    /// Scaling without tare.
    pub(crate) fn scale(&self) -> ChannelScale {
        ChannelScale {
            scale_per_count: self.mm_per_count * f64::from(self.sign),
            offset: self.offset_mm,
            tare: 0.0,
        }
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

    /// First four bytes, big endian, of the SHA-256 of the calibration's text: what the rig is asked for before arming.
    pub(crate) fn calibration_hash(&self) -> u32 {
        let digest = Sha256::digest(self.calibration_text());
        digest
            .iter()
            .take(4)
            .fold(0, |hash, &byte| hash << 8 | u32::from(byte))
    }

    /// One line a channel; numbers as shortest decimal that reads back the same.
    fn calibration_text(&self) -> String {
        let (f, d) = (&self.force_channel, &self.displacement_channel);
        format!(
            "force {:?} {} {:?} {:?} {:?} {:?}\ndisplacement {:?} {} {:?} {:?} {:?} {:?}\n",
            f.n_per_count,
            f.sign,
            f.offset_n,
            f.capacity_n,
            f.certificate,
            f.calibrated,
            d.mm_per_count,
            d.sign,
            d.offset_mm,
            d.capacity_mm,
            d.certificate,
            d.calibrated,
        )
    }

    /// The limits as the firmware holds them, for these scalings (tare included).
    pub(crate) fn wire_limits(&self, force: &ChannelScale, displacement: &ChannelScale) -> Limits {
        let l = &self.limits;
        // A channel of negative sign turns upper into lower.
        let range = |scale: &ChannelScale, low: f64, high: f64| {
            let (a, b) = (scale.counts(low), scale.counts(high));
            (a.min(b), a.max(b))
        };
        let (force_min_counts, force_max_counts) = range(force, l.force_min_n, l.force_max_n);
        let (displacement_min_counts, displacement_max_counts) =
            range(displacement, l.displacement_min_mm, l.displacement_max_mm);
        let width = |value: f64, scale: &ChannelScale| (value / scale.scale_per_count.abs()).round() as i32;
        Limits {
            force_max_counts,
            force_min_counts,
            displacement_max_counts,
            displacement_min_counts,
            velocity_max_counts_s: width(l.velocity_max_mm_s, displacement),
            following_error_displacement_counts: width(l.following_error_mm, displacement),
            following_error_force_counts: width(l.following_error_n, force),
            lease_ms: l.lease_ms,
            hold_timeout_ms: l.hold_timeout_ms,
            unload_velocity_counts_s: width(l.unload_velocity_mm_s, displacement),
            queue_low_ms: l.queue_low_ms,
            unloaded_force_counts: force.counts(l.unloaded_force_n),
            retract_counts: displacement.counts(l.retract_mm),
        }
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
