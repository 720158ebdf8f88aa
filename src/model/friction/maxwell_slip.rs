//! Maxwell slip: elastic-plastic (Jenkins) elements in parallel, in proportion to the normal force. Exact over any step.
//!
//! `T = mu * N * mean(r_i)`, `dr_i = dx / l_i` held within [-1, 1], with `l_i = presliding * (2 i - 1) / n` for
//! i = 1..n. All elements slide once the slip after a full reversal exceeds twice the longest l_i. Sources: W. D. Iwan
//! (1966); Lampaert, Al-Bender and Swevers (2003). Unlike Dahl's law the inner loops close exactly (nonlocal memory).

use super::{COEFFICIENT, FrictionLaw, Law, PRESLIDING};
use crate::model::Parameter;

/// Elements in parallel: the virgin curve is then smooth within 1 % of full friction.
const ELEMENTS: usize = 8;

const PARAMETERS: &[Parameter] = &[COEFFICIENT, PRESLIDING];

/// The entry of [`super::LAWS`].
pub(crate) const LAW: Law = Law {
    name: "maxwell_slip",
    what: "elastic-plastic elements in parallel, loops with memory (Iwan 1966, Lampaert 2003)",
    parameters: PARAMETERS,
    build: |values| match *values {
        [coefficient, presliding_mm] => Some(Box::new(MaxwellSlip {
            coefficient,
            presliding_mm,
            slip_mm: 0.0,
            drags: [0.0; ELEMENTS],
        })),
        _ => None,
    },
};

/// The law with the drag of each element.
#[derive(Debug, Clone)]
struct MaxwellSlip {
    coefficient: f64,
    presliding_mm: f64,
    slip_mm: f64,
    drags: [f64; ELEMENTS],
}

impl FrictionLaw for MaxwellSlip {
    fn name(&self) -> &'static str {
        LAW.name
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn force(&mut self, slip_mm: f64, _dt_s: f64, normal_n: f64) -> f64 {
        let lengths = (slip_mm - self.slip_mm) / self.presliding_mm * ELEMENTS as f64;
        self.slip_mm = slip_mm;
        let mut sum = 0.0;
        for (i, drag) in self.drags.iter_mut().enumerate() {
            *drag = (*drag + lengths / (2 * i + 1) as f64).clamp(-1.0, 1.0);
            sum += *drag;
        }
        self.coefficient * normal_n.max(0.0) * sum / ELEMENTS as f64
    }

    fn reset(&mut self) {
        self.slip_mm = 0.0;
        self.drags = [0.0; ELEMENTS];
    }

    fn boxed_clone(&self) -> Box<dyn FrictionLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virgin_curve_by_hand() {
        let mut law = LAW.law(&[0.5, 0.8]).expect("within bounds");
        // Lengths 0.1, 0.3, .. 1.5 mm. At 0.3 mm: 1 + 1 + 0.3 * (1/.5 + 1/.7 + 1/.9 + 1/1.1 + 1/1.3 + 1/1.5) = 4.0658.
        let sum: f64 = 2.0
            + [0.5, 0.7, 0.9, 1.1, 1.3, 1.5]
                .iter()
                .map(|l| 0.3 / l)
                .sum::<f64>();
        assert!((law.force(0.3, 1e-3, 100.0) - 50.0 * sum / 8.0).abs() < 1e-9);
    }

    #[test]
    fn an_inner_loop_closes_and_is_forgotten() {
        let mut law = LAW.law(&[0.5, 0.8]).expect("within bounds");
        law.force(0.6, 1e-3, 100.0);
        law.force(0.2, 1e-3, 100.0);
        let back = law.force(0.6, 1e-3, 100.0);
        let mut straight = LAW.law(&[0.5, 0.8]).expect("within bounds");
        assert!((back - straight.force(0.6, 1e-3, 100.0)).abs() < 1e-9);
    }
}
