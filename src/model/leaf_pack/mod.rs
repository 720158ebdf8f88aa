//! The leaf pack: each leaf is a chain of rigid segments and beam elements, clamped, in contact with friction, on its mounting.
//!
//! Source: Kadziela, Manka, Uhl, Toso (2015), Arch. Appl. Mech.: eqs. (1) to (4), Table 1, Figs. 1 and 5. The model is planar. It
//! holds for any rotation of the leaves, for linear elastic leaves and for a load in the middle. The modules are:
//!
//! | module | subject |
//! |---|---|
//! | `parameters`, `geometry` | what a fit may change; leaves, mesh and options of the structure table |
//! | `assembly` | free arcs are clamped to a pack with nip |
//! | `beam`, `contact`, `slip_law`, `mounting` | force elements, each with its derivative |
//! | `side`, `band` | one half from clamp to eye, and its linear solver |
//! | `clamp`, `newton`, `pack` | clamp between the sides, equilibrium at one position of the pusher, and the plant step by step |
//! | `energy`, `path`, `shape` | energy balance, static paths for identification, state for drawing |
//!
//! The plant is driven by the pusher's displacement (0 at first contact with the unloaded pack, plus `preload_mm`) and returns
//! the pusher's force. Quasi-static steps do not depend on the rate, except with the tanh law or structural damping.

mod assembly;
mod band;
mod beam;
mod clamp;
mod contact;
mod energy;
mod geometry;
mod mounting;
mod newton;
mod pack;
mod parameters;
mod path;
mod shape;
mod side;
mod slip_law;

#[cfg(any(test, feature = "benchmarks"))]
pub(crate) use geometry::Dynamics;
pub(crate) use geometry::{FrictionChoice, Mounting, PackStructure};
pub(crate) use pack::{LeafPack, MODEL};
pub(crate) use parameters::Values;
pub(crate) use path::graded_path;
pub(crate) use shape::{ContactShape, LeafShape, PackShape};
pub(crate) use slip_law::SlipState;
#[cfg(test)]
pub(crate) use {energy::FrictionSource, geometry::ContactChoice, parameters::PARAMETERS};
