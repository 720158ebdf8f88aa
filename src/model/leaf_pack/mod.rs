//! The leaf pack: every leaf a chain of rigid segments and beam elements, clamped, in contact with friction, on its mounting.
//!
//! Source: Kadziela, Manka, Uhl, Toso (2015), Arch. Appl. Mech.: eqs. (1) to (4), Table 1, Figs. 1 and 5.
//! - `geometry` leaves, mesh, options · `assembly` free arcs to clamped pack (nip)
//! - `beam`, `contact`, `friction`, `mounting` the force elements, each with its derivative
//! - `side` one half from clamp to eye · `band` its linear solver · `pack` the whole, step by step · `newton` its equilibrium · `energy` its books
//! - `path` static paths for identification · `shape` the state for drawing · `parameters` what a fit may move
//!
//! The plant is driven by the pusher's displacement (from first touch of the unloaded pack, plus `preload_mm`) and answers
//! with the pusher's force. Quasi-static steps know no rate unless the tanh law or structural damping is chosen.

mod assembly;
mod band;
mod beam;
mod contact;
mod energy;
mod friction;
mod geometry;
mod mounting;
mod newton;
mod pack;
mod parameters;
mod path;
mod shape;
mod side;

pub(crate) use friction::Grip;
#[cfg(any(test, feature = "benchmarks"))]
pub(crate) use geometry::Dynamics;
pub(crate) use geometry::{FrictionChoice, Mounting, PackStructure};
pub(crate) use pack::LeafPack;
pub(crate) use parameters::{MODEL, Values};
pub(crate) use path::graded_path;
pub(crate) use shape::{ContactShape, LeafShape, PackShape};
#[cfg(test)]
pub(crate) use {energy::Source, geometry::NormalChoice, parameters::PARAMETERS};
