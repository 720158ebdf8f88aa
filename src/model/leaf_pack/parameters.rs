//! Parameters that a fit may change in a leaf pack.

use crate::model::Parameter;

/// One value per parameter, in the order of [`PARAMETERS`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Values {
    /// Added to the thickness of every leaf, mm.
    pub thickness_correction_mm: f64,
    /// Length that the clamp holds flat, mm.
    pub clamp_length_mm: f64,
    /// Friction coefficient between leaves.
    pub interleaf_mu: f64,
    /// Friction coefficient of the eye pins and of the shackle's pin in the load frame.
    pub pin_mu: f64,
    /// Constant torque in each of those pins, N mm.
    pub pivot_torque_nmm: f64,
    /// Friction coefficient of the eye's bearing on the rail.
    pub rail_mu: f64,
    /// Constant friction of each bearing on the rail, N.
    pub rail_constant_n: f64,
    /// Friction coefficient of the pusher on the board.
    pub board_mu: f64,
    /// Tilt of the unloaded shackle against the loading direction, rad; positive where the eye is inside of the pivot.
    pub shackle_angle_rad: f64,
    /// Young's modulus, MPa.
    pub e_mpa: f64,
    /// Displacement of the pack where the LVDT reads zero, mm.
    pub preload_mm: f64,
}

const fn parameter(
    name: &'static str,
    unit: &'static str,
    start: f64,
    bounds: [f64; 2],
    belief: [f64; 2],
    what: &'static str,
) -> Parameter {
    Parameter {
        name,
        unit,
        start,
        bounds,
        belief,
        what,
    }
}

/// The bounds of the friction coefficient are wide, because the paper's own fit reached 8.5. The plausible range is narrow.
pub(crate) static PARAMETERS: &[Parameter] = &[
    parameter(
        "thickness_correction_mm",
        "mm",
        0.0,
        [-2.0, 2.0],
        [-0.185, 0.185],
        "added to the thickness of every leaf",
    ),
    parameter(
        "clamp_length_mm",
        "mm",
        100.0,
        [0.0, 300.0],
        [60.0, 120.0],
        "length that the clamp holds flat",
    ),
    parameter(
        "interleaf_mu",
        "",
        0.15,
        [0.0, 20.0],
        [0.05, 0.3],
        "friction coefficient between leaves",
    ),
    parameter(
        "pin_mu",
        "",
        0.2,
        [0.0, 2.0],
        [0.1, 0.4],
        "friction coefficient of the eye pins",
    ),
    parameter(
        "pivot_torque_nmm",
        "N mm",
        0.0,
        [0.0, 30_000.0],
        [0.0, 6_000.0],
        "constant friction torque of each pin",
    ),
    parameter(
        "rail_mu",
        "",
        0.0,
        [0.0, 2.0],
        [0.0, 0.25],
        "friction coefficient of the eye's bearing on its rail",
    ),
    parameter(
        "rail_constant_n",
        "N",
        0.0,
        [0.0, 500.0],
        [0.0, 20.0],
        "constant friction of each bearing on its rail",
    ),
    parameter(
        "board_mu",
        "",
        0.4,
        [0.0, 2.0],
        [0.2, 0.6],
        "friction coefficient of the pusher on the board",
    ),
    parameter(
        "shackle_angle_rad",
        "rad",
        0.436,
        [-1.0, 1.2],
        [0.26, 0.61],
        "tilt of the unloaded shackle, eye inside",
    ),
    parameter(
        "e_mpa",
        "MPa",
        207_000.0,
        [20_000.0, 300_000.0],
        [200_000.0, 212_000.0],
        "Young's modulus of the leaves",
    ),
    parameter(
        "preload_mm",
        "mm",
        0.0,
        [-50.0, 100.0],
        [-1.0, 20.0],
        "displacement of the pack when the reading is zero",
    ),
];

impl Values {
    /// From one value per parameter, in the order of [`PARAMETERS`].
    pub(crate) fn from_slice(values: &[f64]) -> Option<Self> {
        let &[
            thickness_correction_mm,
            clamp_length_mm,
            interleaf_mu,
            pin_mu,
            pivot_torque_nmm,
            rail_mu,
            rail_constant_n,
            board_mu,
            shackle_angle_rad,
            e_mpa,
            preload_mm,
        ] = values
        else {
            return None;
        };
        Some(Self {
            thickness_correction_mm,
            clamp_length_mm,
            interleaf_mu,
            pin_mu,
            pivot_torque_nmm,
            rail_mu,
            rail_constant_n,
            board_mu,
            shackle_angle_rad,
            e_mpa,
            preload_mm,
        })
    }

    /// One value per parameter, in the order of [`PARAMETERS`].
    pub(crate) fn to_array(self) -> [f64; 11] {
        [
            self.thickness_correction_mm,
            self.clamp_length_mm,
            self.interleaf_mu,
            self.pin_mu,
            self.pivot_torque_nmm,
            self.rail_mu,
            self.rail_constant_n,
            self.board_mu,
            self.shackle_angle_rad,
            self.e_mpa,
            self.preload_mm,
        ]
    }

    /// No friction, all other parameters at their start.
    pub(crate) fn frictionless() -> Self {
        Self {
            thickness_correction_mm: 0.0,
            clamp_length_mm: 100.0,
            interleaf_mu: 0.0,
            pin_mu: 0.0,
            pivot_torque_nmm: 0.0,
            rail_mu: 0.0,
            rail_constant_n: 0.0,
            board_mu: 0.0,
            shackle_angle_rad: 0.436,
            e_mpa: 207_000.0,
            preload_mm: 0.0,
        }
    }
}
