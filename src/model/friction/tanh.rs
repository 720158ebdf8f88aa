//! Friction that depends on speed: Coulomb's law smoothed by a transition velocity.
//!
//! ```text
//! r = tanh(v / v_t)
//! ```
//! v speed, mm/s; v_t `transition_velocity_mm_s`; r drag ratio. Source: the contact law of Kadziela et al. (2015, sections
//! 6 and 7.5). It fades with the speed, so a slow static test loses its loop. It is here to reproduce that model. It does
//! not describe steel on steel.

use super::{DragLaw, FrictionLaw, LawKey};

/// The entry of [`super::LAWS`].
pub(super) const LAW: FrictionLaw = FrictionLaw {
    name: "tanh",
    what: "the friction fades below transition_velocity_mm_s: Kadziela et al. 2015, sections 6 and 7.5",
    keys: &[LawKey {
        name: "transition_velocity_mm_s",
        unit: "mm/s",
        default: 5.0,
    }],
    build: |_, numbers| {
        Box::new(Tanh {
            transition_mm_s: numbers[0],
        })
    },
};

#[derive(Clone)]
struct Tanh {
    transition_mm_s: f64,
}

impl DragLaw for Tanh {
    fn drag(&mut self, slip_mm: f64, dt_s: f64, velocity_mm_s: Option<f64>) -> f64 {
        if dt_s > 0.0 {
            (velocity_mm_s.unwrap_or(slip_mm / dt_s) / self.transition_mm_s).tanh()
        } else {
            0.0
        }
    }

    fn reset(&mut self) {}

    fn boxed_clone(&self) -> Box<dyn DragLaw> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fades_below_the_transition_velocity() {
        let mut law = LAW.at_rest(0.5, &[2.0]).expect("above 0");
        // 2 mm/s: tanh(1) = 0.76159. A hundredth of it: tanh(0.01) = 0.0099997.
        assert!((law.drag(0.002, 1e-3, None) - 0.761_594).abs() < 1e-6);
        assert!((law.drag(0.000_02, 1e-3, None) - 0.009_999_7).abs() < 1e-7);
        assert_eq!(law.drag(0.0, 1e-3, None), 0.0);
        // A given speed replaces slip over time; a step without duration has no speed.
        assert!((law.drag(0.0, 1e-3, Some(-2.0)) + 0.761_594).abs() < 1e-6);
        assert_eq!(law.drag(0.1, 0.0, None), 0.0);
    }

    #[test]
    fn a_transition_velocity_of_0_is_refused() {
        let error = LAW.at_rest(0.5, &[0.0]).err().expect("refused");
        assert!(
            error.contains("transition_velocity_mm_s = 0") && error.contains("above 0 mm/s"),
            "{error}"
        );
    }
}
