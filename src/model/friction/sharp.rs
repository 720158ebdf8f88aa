//! Sharp reversal of the friction: Dahl's ratio (1968, exponent 1) over 5 um of slip, exact over any step.
//!
//! ```text
//! dr/dx = (1 - r s) / l,  s = sgn dx,  l = 0.005 mm
//! r1 = s + (r0 - s) exp(-|dx| / l)                    over a step of one sign
//! ```
//! x slip, mm; r drag ratio. 5 um is below the noise of an LVDT, so a recording cannot tell it from Coulomb's law.

use super::{DragLaw, FrictionLaw};

/// The entry of [`super::LAWS`].
pub(super) const LAW: FrictionLaw = FrictionLaw {
    name: "sharp",
    what: "the friction reverses within 0.005 mm: Dahl 1968",
    keys: &[],
    build: |_, _| Box::new(Sharp { ratio: 0.0 }),
};

/// Travel over which the friction reverses (to 1/e of the remainder), mm.
const REVERSAL_MM: f64 = 0.005;

/// Dahl's drag ratio after a slip of `slip_lengths` reversal lengths.
fn dahl(ratio: f64, slip_lengths: f64) -> f64 {
    if slip_lengths == 0.0 {
        return ratio;
    }
    let direction = slip_lengths.signum();
    direction + (ratio - direction) * (-slip_lengths.abs()).exp()
}

#[derive(Clone)]
struct Sharp {
    ratio: f64,
}

impl DragLaw for Sharp {
    fn drag(&mut self, slip_mm: f64, _dt_s: f64, _velocity_mm_s: Option<f64>) -> f64 {
        self.ratio = dahl(self.ratio, slip_mm / REVERSAL_MM);
        self.ratio
    }

    fn reset(&mut self) {
        self.ratio = 0.0;
    }

    fn boxed_clone(&self) -> Box<dyn DragLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_after_ln_2_lengths() {
        let half = dahl(0.0, 2f64.ln());
        assert!((half - 0.5).abs() < 1e-15);
        // From half dragged back by the same slip: -1 + (0.5 + 1) / 2 = -0.25.
        assert!((dahl(half, -(2f64.ln())) + 0.25).abs() < 1e-15);
        assert_eq!(dahl(half, 0.0), half);
    }
}
