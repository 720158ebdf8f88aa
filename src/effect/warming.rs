//! Friction that changes with the warmth of the contacts.
//!
//! ```text
//! F = F_in + c g(h) (F_in - E),  g(h) = 1 - exp(-h / h_w),  dh = |(F_in - E) dx| - h dt / t_c
//! ```
//! h: friction work that is still in the contacts as heat, J. c: `friction_change`, change of the friction when hot, as a share of
//! it. h_w: `warming_j`. t_c: `cooling_s`. E: load that the contacts carry, N. F_in: force of the plant inside, N; without friction
//! nothing warms.
//! Source: frictional heating of a body that cools by Newton's law; a friction coefficient that goes from a cold to a hot value
//! (empirical). Range: the contacts are cold at the start of each recording.

use super::motion::BandedTravel;
use super::wording::signed;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// A share of the load that the friction takes, from which the heat of a recording is estimated for the starts.
const TYPICAL_RATIO: f64 = 0.05;
/// Change of the friction that the search starts from.
const TYPICAL_CHANGE: f64 = -0.2;
const J_PER_N_MM: f64 = 1e-3;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "warming",
    stage: Stage::Interleaf,
    follows_path: false,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "friction_change",
            unit: "",
            start: 0.0,
            bounds: [-0.95, 2.0],
            belief: [-0.8, 0.5],
            what: "change of the friction when hot, as a share of the friction",
        },
        Parameter {
            name: "warming_j",
            unit: "J",
            start: 10.0,
            bounds: [0.01, 1e6],
            belief: [0.1, 1e4],
            what: "heat in the contacts at which 63 % of the change is done",
        },
        Parameter {
            name: "cooling_s",
            unit: "s",
            start: 60.0,
            bounds: [1.0, 1e5],
            belief: [5.0, 1e5],
            what: "time after which 37 % of the heat is left",
        },
    ],
    neutral: &[0.0, 10.0, 60.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[],
    starts: |s| {
        let mean_n = 0.5 * (s.force_n[0] + s.force_n[1]).abs();
        let work_j = J_PER_N_MM * TYPICAL_RATIO * mean_n * 2.0 * s.travel_mm() * s.cycles;
        [0.3, 2.0]
            .map(|p| {
                vec![
                    TYPICAL_CHANGE,
                    (p * work_j).clamp(0.01, 1e6),
                    (p * s.duration_s).clamp(1.0, 1e5),
                ]
            })
            .to_vec()
    },
    statement: |v| {
        format!(
            "The friction changes by {} % when its contacts are hot ({:.3} J of friction work); they cool over about {:.0} s.",
            signed(100.0 * v[0], 0),
            v[1],
            v[2]
        )
    },
    attach: |v, inside| {
        wrapped(
            Warming {
                friction_change: v[0],
                warming_j: v[1],
                cooling_s: v[2],
                heat_j: 0.0,
                travel: BandedTravel::default(),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[LookAlike {
        code: "run_in",
        why: "in one recording, a friction that changes with its heat also changes with the cycles",
        test: "two blocks of cycles with a pause of some minutes between them: warm contacts cool in the pause, run-in stays",
    }],
};

#[derive(Clone)]
struct Warming {
    friction_change: f64,
    warming_j: f64,
    cooling_s: f64,
    heat_j: f64,
    travel: BandedTravel,
}

impl Wrap for Warming {
    fn reset(&mut self) {
        self.heat_j = 0.0;
        self.travel = BandedTravel::default();
    }

    fn told(&mut self, _motion: &Motion) {
        self.travel.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        let friction_n = force_n - load_n(&**inside, force_n);
        let changed = -(-self.heat_j / self.warming_j).exp_m1();
        let with_n = force_n + self.friction_change * changed * friction_n;
        let work_j = J_PER_N_MM * (friction_n * self.travel.advance(displacement_mm)).abs();
        self.heat_j = (self.heat_j + work_j) / (1.0 + dt_s / self.cooling_s);
        with_n
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::EFFECT;
    use crate::model::Plant;

    /// 100 N and 80 N/mm, with friction of a tenth of the load over 0.5 mm.
    fn with_friction() -> Box<dyn Plant> {
        let model = crate::model::find("equivalent").expect("listed");
        model
            .plant(&[100.0, 80.0, 0.1, 0.5], &toml::Table::new())
            .expect("valid")
    }

    fn forces(values: &[f64]) -> Vec<f64> {
        drive(&mut (EFFECT.attach)(values, with_friction()))
    }

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&EFFECT);
        assert_eq!(forces(EFFECT.neutral), drive(&mut with_friction()));
    }

    /// Strokes of 10 mm at 50 N of friction on average, 0.5 J each: the friction falls with them, comes back in a pause, and a spring
    /// without friction does not change.
    #[test]
    fn friction_falls_with_work_and_comes_back_in_a_pause() {
        let mut plant = (EFFECT.attach)(&[-0.5, 1.0, 20.0], with_friction());
        let mut halves = Vec::new();
        for stroke in 0..20 {
            let at = |k: i32| if stroke % 2 == 0 { k } else { 1000 - k };
            let mut middle_n = 0.0;
            for k in 0..=1000 {
                let force_n = plant.step(0.01 * f64::from(at(k)), 1e-4);
                if k == 500 {
                    middle_n = force_n;
                }
            }
            halves.push((middle_n - 500.0).abs());
        }
        // Half of the friction of 50 N is left in the end; the first stroke does 0.2 J before its middle.
        assert!((halves[0] - 50.0).abs() < 6.0, "{}", halves[0]);
        assert!((halves[19] - 25.0).abs() < 1.0, "{}", halves[19]);
        for _ in 0..20 {
            plant.step(0.0, 10.0);
        }
        let cold_n = (1..=500).map(|k| plant.step(0.01 * f64::from(k), 1e-4)).last();
        assert!((cold_n.unwrap_or(0.0) - 550.0).abs() < 6.0, "{cold_n:?}");
        assert_eq!(
            drive(&mut (EFFECT.attach)(&[-0.5, 0.1, 20.0], spring())),
            drive(&mut spring())
        );
    }

    #[test]
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered_on(with_friction, &EFFECT, &[-0.3, 0.4, 30.0]);
    }
}
