//! One measuring channel lags the other.
//!
//! ```text
//! F(t) = F_in(x(t - tau)), x(t - tau) = x - tau v    tau delay_ms of force behind displacement; negative: displacement lags
//! ```
//! First order in tau, which is a few samples: 3 ms at 94 mm/s and 1500 mm/s2 leave 7 um. Nearly the same as viscous
//! damping of tau times rate; only the force step of dry friction at a sharp reversal dates the channels.

use super::motion::Rates;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "channel_delay",
    stage: Stage::Sensor,
    what: "one measuring channel lags the other",
    parameters: &[Parameter {
        name: "delay_ms",
        unit: "ms",
        start: 0.0,
        bounds: [-50.0, 50.0],
        belief: [-5.0, 5.0],
        what: "force behind displacement",
    }],
    neutral: &[0.0],
    amplitudes: &[0],
    kinks: &[],
    starts: |_| vec![vec![0.2]],
    statement: |v| {
        format!(
            "The {} channel lags the other by {:.2} ms: filters, sampling order or clocks of the amplifiers.",
            if v[0] >= 0.0 { "force" } else { "displacement" },
            v[0].abs()
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
    confusable_with: &[
        LookAlike {
            code: "viscous_damping",
            why: "a lag of the force channel adds a force in proportion to speed times rate",
            test: "a tap on the specimen: it dates both channels; or a sync pulse on both",
        },
        LookAlike {
            code: "inertia",
            why: "at one frequency both are a phase",
            test: "a third frequency",
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
        let mut x = displacement_mm - self.delay_s * self.rates.velocity_mm_s;
        if let Some([low, high]) = self.reach_mm.take() {
            // A shifted turning point is no longer a turning point of another size.
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
        // 10 mm/s, steady, 20 ms late: 0.2 mm behind.
        let mut plant = (EFFECT.attach)(&[20.0], spring());
        let force_n = (0..=5).map(|i| plant.step(f64::from(i), 0.1)).fold(0.0, |_, f| f);
        assert!((force_n - 484.0).abs() < 1e-6);
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[3.0]);
    }
}
