//! What the next run of a specimen will measure, before it runs: each quantity of the table with its uncertainty.
//!
//! | file | what it does |
//! |---|---|
//! | `next_run` | which run is asked about |
//! | `quantity` | predicts one quantity of it |
//! | `coverage` | compares every run of a table with its prediction from earlier runs |
//! | `loops` | the values of a profile's loops that get limits |
//! | `measured` | draws of these values from earlier runs of the same profile |
//! | `modelled` | draws of these values from a model at the predicted parameters |
//! | `band` | the limits, from such draws |
//!
//! `docs/fleet.md` has the equations.

pub(crate) mod band;
pub(crate) mod coverage;
pub(crate) mod loops;
pub(crate) mod measured;
pub(crate) mod modelled;
pub(crate) mod next_run;
pub(crate) mod quantity;
