//! No friction: the drag ratio is always 0. For a baseline without friction, so that the diagnosis must find it.

use super::{DragLaw, FrictionLaw};

/// The entry of [`super::LAWS`].
pub(super) const LAW: FrictionLaw = FrictionLaw {
    name: "none",
    what: "no friction",
    keys: &[],
    build: |_, _| Box::new(Frictionless),
};

struct Frictionless;

impl DragLaw for Frictionless {
    fn drag(&mut self, _slip_mm: f64, _dt_s: f64, _velocity_mm_s: Option<f64>) -> f64 {
        0.0
    }

    fn reset(&mut self) {}

    fn boxed_clone(&self) -> Box<dyn DragLaw> {
        Box::new(Frictionless)
    }
}
