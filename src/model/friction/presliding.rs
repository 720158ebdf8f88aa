//! Gradual reversal of the friction: 32 elastic-plastic elements in parallel (Iwan 1966), spread as Dahl's law (1968).
//!
//! ```text
//! r = mean r_i,  dr_i = dx / l_i held within [-1, 1]
//! ```
//! x slip, mm; r_i drag ratio of an element; l_i its length, mm (see [`super::elements`]). Nested loops close where they
//! turned (Masing 1926). The drag does not depend on speed and holds at rest.

use super::elements::{Elements, spread};
use super::{DragLaw, FrictionLaw};

/// The entry of [`super::LAWS`].
pub(super) const LAW: FrictionLaw = FrictionLaw {
    name: "presliding",
    what: "the friction reverses gradually over presliding_mm: 32 elastic-plastic elements, Iwan 1966",
    keys: &[],
    build: |presliding_mm, _| Box::new(PreslidingElements(Elements::new(spread(presliding_mm, 1.0)))),
};

const ELEMENTS: usize = 32;

#[derive(Clone)]
struct PreslidingElements(Elements<ELEMENTS>);

impl DragLaw for PreslidingElements {
    fn drag(&mut self, slip_mm: f64, _dt_s: f64, _velocity_mm_s: Option<f64>) -> f64 {
        self.0.advance_mean(slip_mm)
    }

    fn reset(&mut self) {
        self.0.reset();
    }

    fn boxed_clone(&self) -> Box<dyn DragLaw> {
        Box::new(self.clone())
    }
}
