//! Recordings whose physics is known, for sealed tests of the diagnosis. It is written apart on purpose: nothing of
//! `model`, `effect`, `identify` or `diagnose` is used here (a test holds that), so that no error is shared.
//!
//! Own formulation: friction is a distribution of 64 Jenkins elements moved exactly from turning point to turning point
//! (found by bisection on the motion's formula), rates come from that formula, and the sensors are a chain of their own.
//! How much of an effect is hidden is counted in detection limits, see [`limit`]. Judging an answer is left to `blind`.

pub(crate) mod case;
pub(crate) mod family;
pub(crate) mod hidden;
pub(crate) mod limit;
pub(crate) mod motion;
pub(crate) mod path;
pub(crate) mod rig;
pub(crate) mod sensors;
pub(crate) mod specimen;

pub(crate) use case::{Case, Label, Start};
pub(crate) use family::Family;
pub(crate) use hidden::Hidden;
pub(crate) use motion::Programme;
pub(crate) use specimen::{Form, TruthSpecimen};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Uniform between two numbers.
pub(crate) fn between(random: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}

/// One of a list.
pub(crate) fn one_of<T: Copy>(random: &mut ChaCha8Rng, list: &[T]) -> T {
    list[random.random_range(0..list.len())]
}

/// Standard normal, by the polar method.
pub(crate) fn normal(random: &mut ChaCha8Rng) -> f64 {
    loop {
        let (u, v) = (between(random, -1.0, 1.0), between(random, -1.0, 1.0));
        let s = u * u + v * v;
        if s > 0.0 && s < 1.0 {
            return u * (-2.0 * s.ln() / s).sqrt();
        }
    }
}
