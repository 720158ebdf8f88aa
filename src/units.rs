//! The unit system, the sign rule and the few conversions.
//!
//! Inside leafbench: N, mm, s, rad, MPa (= N/mm2), N mm. Names end in their unit. Loading the spring is positive, for
//! force and displacement. The wire carries counts; energy is reported in joules.

/// Which channel the rig's servo loop closes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The LVDT's displacement is the feedback.
    Displacement,
    /// The load cell's force is the feedback.
    Force,
}

/// The set point of one moment. It carries its mode, so that newtons cannot be sent as millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Command {
    /// Displacement in mm.
    Displacement(f64),
    /// Force in N.
    Force(f64),
}

impl Command {
    /// A command of `mode` with `value` in that mode's unit.
    pub(crate) fn new(mode: Mode, value: f64) -> Self {
        match mode {
            Mode::Displacement => Command::Displacement(value),
            Mode::Force => Command::Force(value),
        }
    }

    /// The channel that the command is for.
    pub(crate) fn mode(self) -> Mode {
        match self {
            Command::Displacement(_) => Mode::Displacement,
            Command::Force(_) => Mode::Force,
        }
    }

    /// The number, in mm or N according to the mode.
    pub(crate) fn value(self) -> f64 {
        match self {
            Command::Displacement(v) | Command::Force(v) => v,
        }
    }
}

impl Mode {
    /// `mm` or `n`: the unit's ending in names of columns and keys.
    pub(crate) fn unit_suffix(self) -> &'static str {
        match self {
            Mode::Displacement => "mm",
            Mode::Force => "n",
        }
    }
}

/// Nanoseconds in a millisecond.
pub(crate) const NS_PER_MS: u64 = 1_000_000;
/// Nanoseconds in a second.
pub(crate) const NS_PER_S: u64 = 1_000_000_000;

/// Converts N mm to J.
pub(crate) fn joules_from_nmm(energy_nmm: f64) -> f64 {
    energy_nmm * 1e-3
}

/// Force in N of a mass in kg that accelerates by mm/s2.
pub(crate) fn inertia_force_n(mass_kg: f64, acceleration_mm_s2: f64) -> f64 {
    mass_kg * acceleration_mm_s2 * 1e-3
}
