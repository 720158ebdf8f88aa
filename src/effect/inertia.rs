//! Moving mass between load cell and specimen.
//!
//! ```text
//! F = F_in + m a / 1000
//! ```
//! m: `mass_kg`. a: acceleration of the displacement, mm/s2. F_in: force of the plant inside, N.
//! Source: Newton's second law. Range: the mass moves as a rigid body with the pusher. The effect grows with the square
//! of the frequency; in a single sine it only lowers the apparent rate.

use super::motion::Rates;
use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};
use crate::units::inertia_force_n;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "inertia",
    stage: Stage::Pusher,
    follows_path: false,
    only_rival: false,
    parameters: &[Parameter {
        name: "mass_kg",
        unit: "kg",
        start: 1.0,
        bounds: [0.0, 500.0],
        belief: [0.0, 50.0],
        what: "mass that moves with the pusher",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.5]],
    statement: |v| {
        format!(
            "A mass of {} kg moves between load cell and specimen. The load cell also measures its inertia force.",
            shown(v[0], 2)
        )
    },
    attach: |v, inside| {
        wrapped(
            Inertia {
                mass_kg: v[0],
                rates: Rates::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "relaxation",
            why: "inertia lowers the apparent stiffness with frequency; relaxation raises it: with two frequencies the spring rate can balance either",
            test: "a sine at a third frequency",
        },
        LookAlike {
            code: "channel_delay",
            why: "at one frequency, the stiffness and the loop width of the baseline can absorb both",
            test: "a sine at a third frequency",
        },
    ],
};

#[derive(Clone)]
struct Inertia {
    mass_kg: f64,
    rates: Rates,
}

impl Wrap for Inertia {
    fn reset(&mut self) {
        self.rates = Rates::default();
    }

    fn told(&mut self, motion: &Motion) {
        self.rates.tell(motion);
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.rates.step(displacement_mm, dt_s);
        inside.step(displacement_mm, dt_s) + inertia_force_n(self.mass_kg, self.rates.acceleration_mm_s2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::EFFECT;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
    }

    #[test]
    fn force_by_hand() {
        // x = 50 t^2 from rest: 100 mm/s2 times 20 kg is 2 N. The steps are long compared with the filter lag.
        let mut plant = (EFFECT.attach)(&[20.0], spring());
        let mut extra_n = 0.0;
        for i in 0..=10 {
            let x = 50.0 * (0.1 * f64::from(i)).powi(2);
            extra_n = plant.step(x, 0.1) - (100.0 + 80.0 * x);
        }
        assert!((extra_n - 2.0).abs() < 1e-6, "{extra_n}");
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[8.0]);
    }
}
