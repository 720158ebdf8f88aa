//! Friction or stiffness that changes with the number of cycles.
//!
//! ```text
//! F = F_in (1 + g(n) (c r(x) + k))     g = 1 - exp(-n / n_c); n cycles since the recording's start
//!     c friction_change, k rate_change: what is added in the end, over the load
//!     r  drag of the friction inside: its share of the load over that where it was largest; of its own where there is none
//! ```
//! The same contacts run in, so that what is added turns round as their friction does.
//! Source: running-in of dry contacts, exponential in the number of cycles; the count starts with each recording.

use super::motion::{Drag, Reversals};
use super::{Effect, LookAlike, Stage, Wrap, everywhere, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// Friction over load below which there is none to follow.
const LEAST_RATIO: f64 = 1e-3;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "run_in",
    stage: Stage::Interleaf,
    what: "friction or stiffness that changes with the number of cycles",
    parameters: &[
        Parameter {
            name: "friction_change",
            unit: "",
            start: 0.0,
            bounds: [-0.5, 0.5],
            belief: [-0.2, 0.2],
            what: "friction over load that is added in the end",
        },
        Parameter {
            name: "rate_change",
            unit: "",
            start: 0.0,
            bounds: [-0.5, 0.5],
            belief: [-0.1, 0.1],
            what: "share of the force that is added in the end",
        },
        Parameter {
            name: "cycles",
            unit: "",
            start: 10.0,
            bounds: [0.5, 10000.0],
            belief: [1.0, 1000.0],
            what: "cycles after which 63 % of it have come",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 10.0],
            belief: [0.01, 3.0],
            what: "travel over which that friction turns round after a reversal, where the model has none to follow",
        },
    ],
    neutral: &[0.0, 0.0, 10.0, 0.3],
    amplitudes: &[0, 1],
    kinks: &[],
    starts: |s| {
        [0.2, 1.0]
            .map(|p| vec![0.01, 0.0, (p * s.cycles).clamp(0.5, 1e4), 0.3])
            .to_vec()
    },
    statement: |v| {
        format!(
            "With the cycles the friction changes by {:+.2} % of the load and the force by {:+.2} %, over about {:.0} cycles.",
            100.0 * v[0],
            100.0 * v[1],
            v[2]
        )
    },
    attach: |v, inside| {
        wrapped(
            RunIn {
                friction_change: v[0],
                rate_change: v[1],
                cycles: v[2],
                drag: Drag::new(v[3], 1.0),
                sliding: Sliding::default(),
                reversals: Reversals::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    confusable_with: &[
        LookAlike {
            code: "sensor_drift",
            why: "a slow change with cycles is also one with time",
            test: "a pause of some minutes between two blocks of cycles",
        },
        LookAlike {
            code: "relaxation",
            why: "a slow change with cycles is also one with time",
            test: "a pause of some minutes between two blocks of cycles",
        },
    ],
};

#[derive(Clone)]
struct RunIn {
    friction_change: f64,
    rate_change: f64,
    cycles: f64,
    drag: Drag,
    sliding: Sliding,
    reversals: Reversals,
}

/// Friction inside where it was largest: there all contacts slid.
#[derive(Clone, Default)]
struct Sliding {
    friction_n: f64,
    ratio: f64,
}

impl Sliding {
    /// How far the contacts are dragged along, -1 to 1; `None` where nothing rubs.
    fn drag(&mut self, friction_n: f64, carried_n: f64) -> Option<f64> {
        if carried_n <= 0.0 {
            return None;
        }
        let ratio = friction_n / carried_n;
        if friction_n.abs() > self.friction_n {
            (self.friction_n, self.ratio) = (friction_n.abs(), ratio.abs());
        }
        (self.ratio > LEAST_RATIO).then(|| (ratio / self.ratio).clamp(-1.0, 1.0))
    }
}

impl Wrap for RunIn {
    fn reset(&mut self) {
        self.drag.reset();
        self.sliding = Sliding::default();
        self.reversals = Reversals::default();
    }

    fn told(&mut self, motion: &Motion) {
        self.drag.tell();
        self.reversals.tell(motion);
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        self.reversals.step(displacement_mm);
        let done = -(-self.reversals.cycles() / self.cycles).exp_m1();
        let carried_n = load_n(&**inside, force_n);
        let own = self.drag.step(displacement_mm);
        let drag = self.sliding.drag(force_n - carried_n, carried_n).unwrap_or(own);
        let friction_n = self.friction_change * drag * carried_n;
        force_n + done * (friction_n + self.rate_change * force_n)
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
        // Turned at 0 (of the way 9, 0), 9 and 0: three reversals. Slid far upwards: 500 N times 1 + 0.15 g.
        let mut plant = (EFFECT.attach)(&[0.1, 0.05, 4.0, 0.3], spring());
        let force_n = [9.0, 0.0, 9.0, 0.0, 5.0].map(|x| plant.step(x, 0.1))[4];
        let reversals = 3.0;
        let gain = 0.15 * (1.0 - (-0.5 * reversals / 4.0f64).exp());
        assert!((force_n - 500.0 * (1.0 + gain)).abs() < 1e-3, "{force_n}");
    }

    #[test]
    fn what_is_added_turns_round_as_the_friction_inside_does() {
        let model = crate::model::find("equivalent").expect("listed");
        let inside = || {
            model
                .plant(&[100.0, 80.0, 0.1, 0.5], &toml::Table::new())
                .expect("valid")
        };
        let (mut plain, mut run_in) = (inside(), (EFFECT.attach)(&[0.1, 0.0, 1e-3, 0.3], inside()));
        // Run in at once: the friction is doubled, also while it turns round.
        for x in [20.0, 0.0, 20.0, 0.0, 10.0, 9.6] {
            let (force_n, more_n) = (plain.step(x, 0.1), run_in.step(x, 0.1));
            if x == 9.6 {
                let friction_n = force_n - (100.0 + 80.0 * x);
                assert!(friction_n.abs() < 0.09 * force_n);
                assert!((more_n - force_n - friction_n).abs() < 1e-9 * force_n);
            }
        }
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        comes_back(&EFFECT, &[0.05, -0.02, 3.0, 0.4]);
    }
}
