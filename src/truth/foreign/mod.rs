//! Specimens of all worlds but [`World::Own`](super::World): other friction operators, and several laws for each effect.
//!
//! `laws` has the laws without memory and `memory` those with one, `operator` the friction of all contacts as one, `stack` the leaves
//! of a pack, `outside` what the library does not have. `moving` puts them together and steps through the motion.

mod laws;
mod memory;
mod moving;
mod operator;
mod outside;
mod stack;

pub(super) use laws::clipped_n;
pub(super) use moving::{forces, seen_mm};
