//! Damping force in proportion to speed.
//!
//! ```text
//! F = F_in + c v
//! ```
//! c: `damping_n_s_per_mm`. v: speed, mm/s. F_in: force of the plant inside, N.
//! Source: linear viscous damper, any textbook. Range: linear damping. Nearly the same as a delay tau of the force channel,
//! F(t - tau) = F - tau dF/dx v: the cosine of the two signatures is 0.98 for ramps and sines. Steel leaf packs have
//! hardly any damping (Kadziela et al. 2015, Fig. 12: loops at 2.5 Hz and 1 Hz are alike).

use super::motion::Rates;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "viscous_damping",
    stage: Stage::Specimen,
    parameters: &[Parameter {
        name: "damping_n_s_per_mm",
        unit: "N s/mm",
        start: 0.1,
        bounds: [0.0, 50.0],
        belief: [0.0, 5.0],
        what: "force divided by speed",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| vec![vec![0.01]],
    statement: |v| {
        format!(
            "A damping force in proportion to the speed is missing: {:.3} N for each mm/s.",
            v[0]
        )
    },
    attach: |v, inside| {
        wrapped(
            ViscousDamping {
                damping_n_s_per_mm: v[0],
                rates: Rates::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[LookAlike {
        code: "channel_delay",
        why: "a delay of the force channel changes the force by delay times rate times speed, as damping does",
        test: "a tap on the specimen, or a sync pulse on both channels: either shows the delay directly",
    }],
};

#[derive(Clone)]
struct ViscousDamping {
    damping_n_s_per_mm: f64,
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
        inside.step(displacement_mm, dt_s) + self.damping_n_s_per_mm * self.rates.velocity_mm_s
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
        // Constant 1 mm/s at 0.5 N s/mm adds 0.5 N.
        let mut plant = (EFFECT.attach)(&[0.5], spring());
        let force_n = (0..=5).map(|i| plant.step(f64::from(i), 1.0)).fold(0.0, |_, f| f);
        assert!((force_n - 500.5).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.4]);
    }
}
