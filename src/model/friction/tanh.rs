//! Coulomb friction smoothed by speed: `T = mu * N * tanh(v / v_transition)`. It vanishes as the speed goes to zero.
//!
//! Source: the contact law of Kadziela et al. (2015, sections 4 and 5), whose slow static test therefore loses its
//! loop. Here to reproduce that omission, not as a description of steel on steel.

use super::{COEFFICIENT, FrictionLaw, Law};
use crate::model::Parameter;

const PARAMETERS: &[Parameter] = &[
    COEFFICIENT,
    Parameter {
        name: "transition_velocity_mm_s",
        unit: "mm/s",
        start: 0.1,
        bounds: [1e-6, 1e3],
        belief: [1e-4, 5.0],
        what: "speed at which 76 % of the friction has built up",
    },
];

/// The entry of [`super::LAWS`].
pub(crate) const LAW: Law = Law {
    name: "tanh",
    what: "friction that fades below a transition velocity (Kadziela 2015)",
    parameters: PARAMETERS,
    build: |values| match *values {
        [coefficient, transition_velocity_mm_s] => Some(Box::new(Tanh {
            coefficient,
            transition_velocity_mm_s,
            slip_mm: 0.0,
        })),
        _ => None,
    },
};

/// The law with the slip it stands at.
#[derive(Debug, Clone)]
struct Tanh {
    coefficient: f64,
    transition_velocity_mm_s: f64,
    slip_mm: f64,
}

impl FrictionLaw for Tanh {
    fn name(&self) -> &'static str {
        LAW.name
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn force(&mut self, slip_mm: f64, dt_s: f64, normal_n: f64) -> f64 {
        let slipped_mm = slip_mm - self.slip_mm;
        self.slip_mm = slip_mm;
        // A step without duration is a jump: full sliding, or rest where nothing moved.
        let lengths = if slipped_mm == 0.0 {
            0.0
        } else {
            slipped_mm / (dt_s * self.transition_velocity_mm_s)
        };
        self.coefficient * normal_n.max(0.0) * lengths.tanh()
    }

    fn reset(&mut self) {
        self.slip_mm = 0.0;
    }

    fn boxed_clone(&self) -> Box<dyn FrictionLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fades_below_the_transition_velocity() {
        let mut law = LAW.law(&[0.5, 2.0]).expect("within bounds");
        // 2 mm/s: tanh(1) = 0.76159.
        assert!((law.force(0.002, 1e-3, 100.0) - 38.0797).abs() < 1e-4);
        // A hundredth of it: 1 % of the friction, almost.
        assert!((law.force(0.002_02, 1e-3, 100.0) - 0.499_983).abs() < 1e-5);
        assert_eq!(law.force(0.002_02, 1e-3, 100.0), 0.0);
    }
}
