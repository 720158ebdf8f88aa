//! Synthetic recordings whose physics is known, for blind tests of the diagnosis.
//!
//! It uses nothing of `model`, `effect`, `identify` or `diagnose`, so that it cannot share their errors;
//! `tests/architecture.rs` checks this. The formulation is its own: friction is a distribution of 64 Jenkins elements, which
//! move exactly from turning point to turning point (found by bisection of the formula of the motion); speed and
//! acceleration come from that formula; the sensors are a separate chain. The strength of a hidden effect is given in
//! detection limits, see [`limit`]. `blind` compares the diagnosis with the truth.
//!
//! That formulation is one [`world`]. `foreign` has others, in which neither the friction nor the effects follow the formulas
//! of the library, and `nuisance` has imperfect instruments. `lab` has many specimens on several benches over months.

pub(crate) mod case;
pub(crate) mod catalogue;
pub(crate) mod family;
mod forces;
mod foreign;
pub(crate) mod hidden;
mod lab;
mod lab_run;
pub(crate) mod lab_test;
pub(crate) mod limit;
pub(crate) mod motion;
mod nuisance;
pub(crate) mod path;
pub(crate) mod rig;
pub(crate) mod sensors;
pub(crate) mod specimen;
pub(crate) mod world;

pub(crate) use case::{BaselineSettings, Case, Label};
pub(crate) use family::Family;
pub(crate) use hidden::Hidden;
pub(crate) use lab::{Lab, LabFamily, LabRequest};
pub(crate) use lab_test::{LabCommand, LabTest};
pub(crate) use motion::Programme;
#[cfg(test)]
pub(crate) use nuisance::imperfections;
pub(crate) use specimen::{Form, TruthSpecimen};
pub(crate) use world::World;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A uniform random number between `low` and `high`.
pub(crate) fn between(random: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}

/// A random entry of a list; each one has the same probability.
pub(crate) fn one_of<T: Copy>(random: &mut ChaCha8Rng, list: &[T]) -> T {
    list[random.random_range(0..list.len())]
}

/// A standard normal random number (polar method).
pub(crate) fn normal(random: &mut ChaCha8Rng) -> f64 {
    loop {
        let (u, v) = (between(random, -1.0, 1.0), between(random, -1.0, 1.0));
        let s = u * u + v * v;
        if s > 0.0 && s < 1.0 {
            return u * (-2.0 * s.ln() / s).sqrt();
        }
    }
}
