//! The clamp between the two sides: its motion and forces, and the place of an eye that moves with it.

use super::band::V3;
use super::mounting::PLACES;
use super::side::HalfPack;
use super::slip_law::{SlipResponse, SlipState};

/// Motion and forces of the clamp with board and pusher. Pairs are (w, v), mm, mm/s, mm/s2 or N.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Clamp {
    pub now: [f64; 2],
    /// Place at the last converged step, one step before, and two steps before.
    pub settled: [f64; 2],
    pub before: [f64; 2],
    pub older: [f64; 2],
    pub velocity: [f64; 2],
    pub acceleration: [f64; 2],
    pub inertia_base: [f64; 2],
    pub residual: [f64; 2],
    pub pusher_n: f64,
    pub board: SlipResponse,
    pub touching: bool,
}

/// Stick-slip states of supports and board, on which the tangent depends too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct OuterStates {
    pub places: [[SlipState; PLACES]; 2],
    pub board: SlipState,
    pub touching: bool,
}

/// Place (X, Y) of the eye's pin, mm, and angle of the segment that carries it, rad, with the clamp at (w, v).
#[inline]
pub(super) fn eye_of(side: &HalfPack, offset: [f64; 2], sense: f64, clamp: [f64; 2]) -> V3 {
    let tip = &side.nodes[side.tip()];
    let arm = arm_of(side, offset);
    [
        tip[0] + arm[0] + sense * clamp[0],
        tip[1] + arm[1] + clamp[1],
        tip[2],
    ]
}

/// Vector from the last body to the centre of the eye, mm.
#[inline]
pub(super) fn arm_of(side: &HalfPack, offset: [f64; 2]) -> [f64; 2] {
    let (s, c) = side.nodes[side.tip()][2].sin_cos();
    [c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]]
}
