//! Damping force that grows with a power of the speed.
//!
//! ```text
//! F = F_in + c v_0 (|v| / v_0)^n sgn v,  v_0 = 10 mm/s
//! ```
//! c: `damping_n_s_per_mm`, force divided by speed at v_0. n: `exponent`. v: speed, mm/s. F_in: force of the plant inside, N.
//! Source: power law of fluid dampers; n = 1 is the linear damper, 2 an orifice, 0.2 to 0.5 a seal or grease. Range: one
//! power over the speeds of the recordings. For n = 1 nearly the same as a delay tau of the force channel,
//! F(t - tau) = F - tau dF/dx v: the cosine of the two signatures is 0.98 for ramps and sines. Steel leaf packs have
//! hardly any damping (Kadziela et al. 2015, Fig. 12: loops at 2.5 Hz and 1 Hz are alike).

use super::motion::Rates;
use super::power::power_of;
use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// Speed at which `damping_n_s_per_mm` is force divided by speed, mm/s.
const REFERENCE_MM_S: f64 = 10.0;
/// An exponent this near to 1 is called proportional.
const PROPORTIONAL: f64 = 0.1;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "viscous_damping",
    stage: Stage::Specimen,
    follows_path: false,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "damping_n_s_per_mm",
            unit: "N s/mm",
            start: 0.1,
            bounds: [0.0, 50.0],
            belief: [0.0, 5.0],
            what: "force divided by speed at 10 mm/s",
        },
        Parameter {
            name: "exponent",
            unit: "",
            start: 1.0,
            bounds: [0.2, 2.5],
            belief: [0.3, 2.2],
            what: "power of the speed that the force grows with",
        },
    ],
    neutral: &[0.0, 1.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[1],
    starts: |_| vec![vec![0.01, 1.0]],
    statement: |v| {
        if (v[1] - 1.0).abs() < PROPORTIONAL {
            return format!(
                "A damping force in proportion to the speed is missing: {} N for each mm/s.",
                shown(v[0], 3)
            );
        }
        format!(
            "A damping force that grows as the speed to the power of {:.2} is missing: {} N at {REFERENCE_MM_S:.0} mm/s.",
            v[1],
            shown(v[0] * REFERENCE_MM_S, 1)
        )
    },
    attach: |v, inside| {
        wrapped(
            ViscousDamping {
                damping_n_s_per_mm: v[0],
                exponent: v[1],
                rates: Rates::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "channel_delay",
        why: "a delay of the force channel changes the force by delay times rate times speed, as damping does",
        test: "a tap on the specimen, or a sync pulse on both channels: either shows the delay directly",
    }],
};

#[derive(Clone)]
struct ViscousDamping {
    damping_n_s_per_mm: f64,
    exponent: f64,
    rates: Rates,
}

impl Wrap for ViscousDamping {
    fn reset(&mut self) {
        self.rates = Rates::default();
    }

    fn told(&mut self, motion: &Motion) {
        self.rates.tell(motion);
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.rates.step(displacement_mm, dt_s);
        let speeds = self.rates.velocity_mm_s / REFERENCE_MM_S;
        let grown = speeds.signum() * power_of(speeds.abs(), self.exponent);
        inside.step(displacement_mm, dt_s) + self.damping_n_s_per_mm * REFERENCE_MM_S * grown
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
        // Constant 1 mm/s at 0.5 N s/mm adds 0.5 N; with the square, 5 N at 10 mm/s fall to 0.05 N.
        for (exponent, extra_n) in [(1.0, 0.5), (2.0, 0.05)] {
            let mut plant = (EFFECT.attach)(&[0.5, exponent], spring());
            let force_n = (0..=5).map(|i| plant.step(f64::from(i), 1.0)).fold(0.0, |_, f| f);
            assert!((force_n - 500.0 - extra_n).abs() < 1e-6);
        }
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.4, 1.4]);
    }
}
