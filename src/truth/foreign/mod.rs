//! Specimens of all worlds but [`World::Own`](super::World): other friction operators, and several laws for each effect.
//!
//! Data walk from the board to the amplifier: [`memory`] has the gap, `laws` the seat and the joint, [`operator`] the friction
//! of the leaves, [`stack`] the leaves of a pack, `outside` what the library does not have; [`moving`] puts them together and steps through the motion.

mod laws;
mod memory;
mod moving;
mod operator;
mod outside;
mod stack;

pub(super) use laws::clipped_n;
pub(super) use moving::{forces, seen_mm};
