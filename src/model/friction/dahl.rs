//! Dahl friction, exponent 1, in proportion to the normal force: exact over any step.
//!
//! `T = mu * N * r`, `dr/dx = (1 - r * sgn dx) / presliding`, so over a step of one sign
//! `r1 = s + (r0 - s) * exp(-|dx| / presliding)`. Source: P. R. Dahl, A solid friction model, 1968, with the
//! saturation written as a ratio so that the load may change while the contact drags.

use super::{COEFFICIENT, FrictionLaw, Law, PRESLIDING};
use crate::model::Parameter;

const PARAMETERS: &[Parameter] = &[COEFFICIENT, PRESLIDING];

/// The entry of [`super::LAWS`].
pub(crate) const LAW: Law = Law {
    name: "dahl",
    what: "friction that turns round exponentially after a reversal (Dahl 1968, exponent 1)",
    parameters: PARAMETERS,
    build: |values| match *values {
        [coefficient, presliding_mm] => Some(Box::new(Dahl {
            coefficient,
            presliding_mm,
            slip_mm: 0.0,
            drag: 0.0,
        })),
        _ => None,
    },
};

/// Drag ratio after a slip of `slip_lengths` presliding lengths: -1 and 1 are full sliding.
pub(crate) fn drag(drag: f64, slip_lengths: f64) -> f64 {
    if slip_lengths == 0.0 {
        return drag;
    }
    let direction = slip_lengths.signum();
    direction + (drag - direction) * (-slip_lengths.abs()).exp()
}

/// The law with its drag ratio.
#[derive(Debug, Clone)]
struct Dahl {
    coefficient: f64,
    presliding_mm: f64,
    slip_mm: f64,
    drag: f64,
}

impl FrictionLaw for Dahl {
    fn name(&self) -> &'static str {
        LAW.name
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn force(&mut self, slip_mm: f64, _dt_s: f64, normal_n: f64) -> f64 {
        self.drag = drag(self.drag, (slip_mm - self.slip_mm) / self.presliding_mm);
        self.slip_mm = slip_mm;
        self.coefficient * normal_n.max(0.0) * self.drag
    }

    fn reset(&mut self) {
        self.slip_mm = 0.0;
        self.drag = 0.0;
    }

    fn boxed_clone(&self) -> Box<dyn FrictionLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_after_ln_2_presliding_lengths() {
        let mut law = LAW.law(&[0.3, 0.1]).expect("within bounds");
        let force_n = law.force(0.1 * 2f64.ln(), 1e-3, 100.0);
        assert!((force_n - 15.0).abs() < 1e-12);
        // From half dragged back by the same slip: -1 + (0.5 + 1) / 2 = -0.25.
        assert!((law.force(0.0, 1e-3, 100.0) + 7.5).abs() < 1e-12);
    }
}
