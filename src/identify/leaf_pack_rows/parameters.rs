//! What the tests are fitted with: parameters of the leaf pack and of the rig, each with its range.
//!
//! The ranges are wider than the plausible ranges of the leaf-pack model where a paper does not print what they depend on.

use crate::model::Parameter;

/// Places in [`PARAMETERS`].
pub(super) const THICKNESS: usize = 0;
pub(super) const CLAMP: usize = 1;
pub(super) const EYE: usize = 2;
pub(super) const INTERLEAF: usize = 3;
pub(super) const PINS: usize = 4;
pub(super) const SHACKLE_TORQUE: usize = 5;
pub(super) const RAIL_MU: usize = 6;
pub(super) const RAIL_CONSTANT: usize = 7;
pub(super) const RAIL_TROUGH: usize = 8;
pub(super) const BOARD: usize = 9;
pub(super) const SHACKLE_ANGLE: usize = 10;
pub(super) const SHACKLE_TROUGH: usize = 11;
pub(super) const RAIL_TORQUE: usize = 12;

/// Parameters that only the mounting without shackle has.
pub(super) const RAIL_ONLY: [usize; 4] = [RAIL_MU, RAIL_CONSTANT, RAIL_TROUGH, RAIL_TORQUE];
/// Parameters that only the mounting with shackle has.
pub(super) const SHACKLE_ONLY: [usize; 4] = [SHACKLE_TORQUE, BOARD, SHACKLE_ANGLE, SHACKLE_TROUGH];

const fn parameter(
    name: &'static str,
    unit: &'static str,
    start: f64,
    bounds: [f64; 2],
    what: &'static str,
) -> Parameter {
    Parameter {
        name,
        unit,
        start,
        bounds,
        belief: bounds,
        what,
    }
}

/// The first five are of leaves, interleaf and pins and hold for both mountings; the others are of one mounting each.
pub(crate) const PARAMETERS: [Parameter; 13] = [
    parameter(
        "thickness_correction_mm",
        "mm",
        0.0,
        [-0.185, 0.185],
        "added to the thickness of every leaf",
    ),
    parameter(
        "clamp_length_mm",
        "mm",
        95.0,
        [60.0, 120.0],
        "length that the clamp holds flat",
    ),
    parameter(
        "eye_offset_mm",
        "mm",
        18.0,
        [0.0, 25.0],
        "pin above the middle of leaf 1",
    ),
    parameter("interleaf_mu", "", 0.15, [0.05, 0.3], "friction between leaves"),
    // Coefficients of 0.1 to 0.4 at radii of 6 mm (bolt) to 15 mm (bush in the eye).
    parameter(
        "pin_friction_mm",
        "mm",
        2.0,
        [0.6, 6.0],
        "friction coefficient of the pins times their radius",
    ),
    parameter(
        "shackle_pivot_torque_nmm",
        "N mm",
        3000.0,
        [0.0, 6000.0],
        "constant torque of each pin with shackle",
    ),
    parameter("rail_mu", "", 0.2, [0.0, 0.3], "friction on the rail"),
    parameter(
        "rail_constant_n",
        "N",
        5.0,
        [0.0, 20.0],
        "constant friction of each bearing on the rail",
    ),
    parameter(
        "rail_trough_mm",
        "mm",
        1.6,
        [0.0, 8.0],
        "trough of the sines without shackle",
    ),
    parameter(
        "board_mu",
        "",
        0.4,
        [0.2, 0.6],
        "friction of the pusher on the board",
    ),
    parameter(
        "shackle_angle_rad",
        "rad",
        0.45,
        [0.26, 0.61],
        "tilt of the unloaded shackle",
    ),
    parameter(
        "shackle_trough_mm",
        "mm",
        0.3,
        [0.0, 8.0],
        "trough of the sines with shackle",
    ),
    parameter(
        "rail_pivot_torque_nmm",
        "N mm",
        1000.0,
        [0.0, 6000.0],
        "constant torque of each pin without shackle",
    ),
];
