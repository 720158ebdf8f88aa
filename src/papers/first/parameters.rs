//! What the first paper's rows are fitted with: the leaf pack's parameters and the rig's, with bounds and belief.

use crate::model::Parameter;

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

/// Within belief; leaves, interleaf and pins first, then what each mounting has for itself.
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
    // 0.1 to 0.4, at a bolt's 6 mm to a bush's 15 mm in the eye: the paper prints neither.
    parameter(
        "pin_friction_mm",
        "mm",
        2.0,
        [0.6, 6.0],
        "friction coefficient of the pins times the radius at which they turn",
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
