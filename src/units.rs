//! The unit system, the sign rule and the few conversions.
//!
//! Inside leafbench: N, mm, s, rad, MPa (= N/mm2), N mm. Names end in their unit. Loading the spring is positive, for
//! force and displacement. The wire carries counts; energy leaves as joules.

/// Which channel the rig's servo loop closes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mode {
    /// The LVDT's displacement is the feedback.
    Displacement,
    /// The load cell's force is the feedback.
    Force,
}

/// The value asked for now. It carries its mode, because a newton sent as a millimetre moves oil.
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

/// Standard gravity in mm/s2 (CGPM 1901).
pub(crate) const GRAVITY_MM_S2: f64 = 9806.65;

/// N mm to J.
pub(crate) fn joules_from_nmm(energy_nmm: f64) -> f64 {
    energy_nmm * 1e-3
}

/// Force in N of a mass in kg that accelerates by mm/s2.
pub(crate) fn inertia_force_n(mass_kg: f64, acceleration_mm_s2: f64) -> f64 {
    mass_kg * acceleration_mm_s2 * 1e-3
}

/// kgf to N.
pub(crate) fn newtons_from_kgf(force_kgf: f64) -> f64 {
    force_kgf * GRAVITY_MM_S2 * 1e-3
}

/// Degrees to rad.
pub(crate) fn radians_from_degrees(angle_deg: f64) -> f64 {
    angle_deg.to_radians()
}
