//! How an effect is put around a plant, and what it tells of the load inside.

use crate::model::{Motion, Plant, as_kind};

/// The behaviour of an effect around the plant inside.
pub(crate) trait Wrap: Clone + Send + 'static {
    /// Back to the virgin state.
    fn reset(&mut self);
    /// Steps the plant inside and returns the force in N.
    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64;
    /// See [`Plant::told`]. The caller also tells the plant inside.
    fn told(&mut self, _motion: &Motion) {}
    /// See [`Plant::carried_n`], calculated from the load that the plant inside carried, N.
    fn carried_n(&self, inside_n: f64) -> f64 {
        inside_n
    }
    /// See [`Plant::pressing_n`], calculated from that of the plant inside, N.
    fn pressing_n(&self, inside_n: f64) -> f64 {
        self.carried_n(inside_n)
    }
}

/// Load that friction is proportional to, N ([`Plant::pressing_n`] of the plant inside), or the whole force if that is unknown.
pub(crate) fn pressing_n(inside: &dyn Plant, force_n: f64) -> f64 {
    inside.pressing_n().unwrap_or(force_n)
}

/// Load that the contacts inside carried, N, or the whole force if that is unknown.
pub(crate) fn load_n(inside: &dyn Plant, force_n: f64) -> f64 {
    inside.carried_n().unwrap_or(force_n)
}

/// Force of the plant inside, N, with more load on its contacts: its friction grows in proportion.
pub(crate) fn with_more_load(inside: &dyn Plant, force_n: f64, extra_n: f64) -> f64 {
    match inside.carried_n() {
        Some(carried_n) if carried_n > extra_n.abs() * 1e-3 => force_n * (1.0 + extra_n / carried_n),
        _ => force_n + extra_n,
    }
}

/// Zero offset of the force channel in N: the rest that the tare left. It is added before the faults of the channel.
#[derive(Clone)]
struct Offset(f64);

impl Wrap for Offset {
    fn reset(&mut self) {}

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        inside.step(displacement_mm, dt_s) + self.0
    }
}

/// Adds a zero offset of the force channel to `inside`.
pub(crate) fn with_zero(zero_n: f64, inside: Box<dyn Plant>) -> Box<dyn Plant> {
    if zero_n == 0.0 {
        inside
    } else {
        wrapped(Offset(zero_n), inside)
    }
}

/// A plant with an effect around it, itself a plant.
#[derive(Clone)]
struct Wrapped<W: Wrap> {
    wrap: W,
    inside: Box<dyn Plant>,
}

impl<W: Wrap> Plant for Wrapped<W> {
    fn reset(&mut self) {
        self.wrap.reset();
        self.inside.reset();
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        self.wrap.step(&mut self.inside, displacement_mm, dt_s)
    }

    fn told(&mut self, motion: &Motion) {
        self.wrap.told(motion);
        self.inside.told(motion);
    }

    fn carried_n(&self) -> Option<f64> {
        self.inside.carried_n().map(|n| self.wrap.carried_n(n))
    }

    fn pressing_n(&self) -> Option<f64> {
        self.inside.pressing_n().map(|n| self.wrap.pressing_n(n))
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }

    fn copy_to(&self, copy: &mut Box<dyn Plant>) {
        match as_kind::<Self>(copy) {
            Some(copy) => {
                copy.wrap.clone_from(&self.wrap);
                self.inside.copy_to(&mut copy.inside);
            }
            None => *copy = self.boxed_clone(),
        }
    }
}

/// Wraps `inside` in an effect.
pub(crate) fn wrapped<W: Wrap>(wrap: W, inside: Box<dyn Plant>) -> Box<dyn Plant> {
    Box::new(Wrapped { wrap, inside })
}
