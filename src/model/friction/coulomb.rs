//! Coulomb friction: `T = mu * N * sgn(dx)`; at rest the force of the last motion stays.

use super::{COEFFICIENT, FrictionLaw, Law};
use crate::model::Parameter;

const PARAMETERS: &[Parameter] = &[COEFFICIENT];

/// The entry of [`super::LAWS`].
pub(crate) const LAW: Law = Law {
    name: "coulomb",
    what: "constant friction in proportion to the normal force, at once after a reversal",
    parameters: PARAMETERS,
    build: |values| match *values {
        [coefficient] => Some(Box::new(Coulomb {
            coefficient,
            slip_mm: 0.0,
            direction: 0.0,
        })),
        _ => None,
    },
};

/// The law with its last direction.
#[derive(Debug, Clone)]
struct Coulomb {
    coefficient: f64,
    slip_mm: f64,
    direction: f64,
}

impl FrictionLaw for Coulomb {
    fn name(&self) -> &'static str {
        LAW.name
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn force(&mut self, slip_mm: f64, _dt_s: f64, normal_n: f64) -> f64 {
        if slip_mm != self.slip_mm {
            self.direction = (slip_mm - self.slip_mm).signum();
            self.slip_mm = slip_mm;
        }
        self.coefficient * normal_n.max(0.0) * self.direction
    }

    fn reset(&mut self) {
        self.slip_mm = 0.0;
        self.direction = 0.0;
    }

    fn boxed_clone(&self) -> Box<dyn FrictionLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_at_once_and_keeps_its_force_at_rest() {
        let mut law = LAW.law(&[0.2]).expect("within bounds");
        assert_eq!(law.force(0.0, 1e-3, 100.0), 0.0);
        assert_eq!(law.force(1.0, 1e-3, 100.0), 20.0);
        assert_eq!(law.force(1.0, 1e-3, 150.0), 30.0);
        assert_eq!(law.force(0.9, 1e-3, 100.0), -20.0);
    }
}
