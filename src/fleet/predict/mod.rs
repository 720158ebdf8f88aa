//! What the next run of a specimen will measure, before it runs: each quantity of the table with its uncertainty.
//!
//! [`next_run`] asks and [`quantity`] predicts one quantity; [`coverage`] holds all runs of a table against what the runs before them
//! predicted; [`loops`] plays a profile on a model, and [`band`] makes limits of both. `docs/fleet.md` has the equations.

pub(crate) mod band;
pub(crate) mod coverage;
pub(crate) mod loops;
pub(crate) mod measured;
pub(crate) mod modelled;
pub(crate) mod next_run;
pub(crate) mod quantity;
