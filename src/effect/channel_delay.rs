//! Delay between the two measuring channels.
//!
//! ```text
//! F(t) = F_in(x(t - tau)),  x(t - tau) = x - tau v + tau^2 a / 2
//! ```
//! tau: `delay_ms`, delay of the force behind the displacement; negative if the displacement lags. x: displacement, mm.
//! v: speed, mm/s. a: acceleration, mm/s2. F_in: force of the plant inside, N.
//! Source: second-order Taylor series in tau; without the second term, 7 ms at 40 N/mm look like a mass of 1 kg. Range:
//! delays that are short against the period; 7 ms at 2.5 Hz and 6 mm leave an error of 1 um.
//! Nearly the same as viscous damping with tau times the spring rate. Only the force step of dry friction at a sharp
//! reversal separates the two.

use super::motion::Rates;
use super::wording::shown;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "channel_delay",
    stage: Stage::Sensor,
    follows_path: false,
    only_rival: false,
    parameters: &[Parameter {
        name: "delay_ms",
        unit: "ms",
        start: 0.0,
        bounds: [-50.0, 50.0],
        belief: [-5.0, 5.0],
        what: "delay of the force behind the displacement",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |_| vec![vec![0.2]],
    statement: |v| {
        format!(
            "The {} channel lags the other channel by {} ms. Possible causes: filters, sampling order or clocks of the amplifiers.",
            if v[0] >= 0.0 { "force" } else { "displacement" },
            shown(v[0].abs(), 2)
        )
    },
    attach: |v, inside| {
        wrapped(
            ChannelDelay {
                delay_s: 1e-3 * v[0],
                rates: Rates::default(),
                reach_mm: None,
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "viscous_damping",
            why: "a delay of the force channel changes the force by delay times rate times speed, as damping does",
            test: "a tap on the specimen, or a sync pulse on both channels: either shows the delay directly",
        },
        LookAlike {
            code: "inertia",
            why: "at one frequency, the stiffness and the loop width of the baseline can absorb both",
            test: "a sine at a third frequency",
        },
    ],
};

#[derive(Clone)]
struct ChannelDelay {
    delay_s: f64,
    rates: Rates,
    reach_mm: Option<[f64; 2]>,
}

impl Wrap for ChannelDelay {
    fn reset(&mut self) {
        self.rates = Rates::default();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        self.rates.step(displacement_mm, dt_s);
        let mut x = displacement_mm
            - self.delay_s * (self.rates.velocity_mm_s - 0.5 * self.delay_s * self.rates.acceleration_mm_s2);
        if let Some([low, high]) = self.reach_mm.take() {
            // The shift must not move the displacement beyond its turning points.
            x = x.clamp(low, high);
        }
        inside.step(x, dt_s)
    }

    fn told(&mut self, motion: &Motion) {
        self.rates.tell(motion);
        self.reach_mm = (self.delay_s != 0.0).then_some(motion.reach_mm);
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
        // Constant 10 mm/s, 20 ms late: 0.2 mm behind.
        let mut plant = (EFFECT.attach)(&[20.0], spring());
        let force_n = (0..=5).map(|i| plant.step(f64::from(i), 0.1)).fold(0.0, |_, f| f);
        assert!((force_n - 484.0).abs() < 1e-6);
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[3.0]);
    }
}
