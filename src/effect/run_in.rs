//! Friction or stiffness that changes with the number of cycles.
//!
//! ```text
//! F = F_in + g(n) (c E r(x) + k F_in),  g(n) = 1 - exp(-(n / n_c)^p),  n = sum of (s / 30 mm)^q / 2 over the strokes s
//! ```
//! n: cycles since the start of the recording. A stroke of length s counts as half a cycle if q is 0, and in proportion to s^q otherwise.
//! q: `stroke_power`: 0 counts cycles, 1 their travel, 2 about the work of a friction that grows with the load. n_c: `cycles`; if q is
//! not 0, cycles with strokes of 30 mm. p: `power`. c: `friction_change`, final change of friction divided by load.
//! k: `rate_change`, final change of the force as a share of the force. E: load that the contacts carry, N (F_in if the
//! plant has none). F_in: force of the plant inside, N. r: drag of the friction inside, -1 to 1, that is its ratio to
//! the load relative to that ratio where the friction was largest; if the plant has no friction, a drag of its own over
//! `transition_mm`. So the changed friction reverses as the friction of the same contacts does.
//! Source: run-in of dry contacts, exponential in the number of cycles (empirical). Range: monotonic run-in; the count
//! starts again with each recording.

use super::motion::{BandedTravel, Drag, Reversals};
use super::power::power_of;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, load_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// Friction divided by load below which the plant inside counts as frictionless.
const SMALLEST_RATIO: f64 = 1e-3;
/// Power of the stroke that the search starts from, beside 0: about that of work.
const WORK_POWER: f64 = 1.5;
/// A stroke of this length counts as half a cycle for every power, mm. If it is short, usual strokes count as many cycles. Then the change
/// can end within the first stroke and imitate a constant friction: with 10 mm, run-in was a rival of constant friction in sealed cases.
const REFERENCE_STROKE_MM: f64 = 30.0;

/// The entry of [`super::EFFECTS`].
pub(crate) const EFFECT: Effect = Effect {
    code: "run_in",
    stage: Stage::Interleaf,
    follows_path: false,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "friction_change",
            unit: "",
            start: 0.0,
            bounds: [-0.5, 0.5],
            belief: [-0.2, 0.2],
            what: "final change of friction divided by load",
        },
        Parameter {
            name: "rate_change",
            unit: "",
            start: 0.0,
            bounds: [-0.5, 0.5],
            belief: [-0.1, 0.1],
            what: "final change of the force, as a share of the force",
        },
        Parameter {
            name: "cycles",
            unit: "",
            start: 10.0,
            bounds: [0.5, 10000.0],
            belief: [1.0, 1000.0],
            what: "number of cycles after which 63 % of the change is done",
        },
        Parameter {
            name: "transition_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.001, 10.0],
            belief: [0.01, 3.0],
            what: "travel after a reversal over which the changed friction reverses; used where the model has no friction",
        },
        Parameter {
            name: "power",
            unit: "",
            start: 1.0,
            bounds: [0.3, 2.0],
            belief: [0.4, 1.5],
            what: "shape of the change: 1 is exponential, below 1 it begins fast and goes on for long",
        },
        Parameter {
            name: "stroke_power",
            unit: "",
            start: 0.0,
            bounds: [0.0, 2.0],
            belief: [0.0, 2.0],
            what: "what runs the contacts in: 0 the number of cycles, 1 their travel, 2 about the work of the friction",
        },
    ],
    neutral: &[0.0, 0.0, 10.0, 0.3, 1.0, 0.0],
    amplitudes: &[0, 1],
    kinks: &[],
    shapes: &[4, 5],
    starts: |s| {
        let by_stroke = (s.travel_mm() / REFERENCE_STROKE_MM).powf(WORK_POWER);
        [(0.2, 0.0), (1.0, 0.0), (0.2, WORK_POWER), (1.0, WORK_POWER)]
            .map(|(share, stroke_power)| {
                let counted = share * s.cycles * if stroke_power > 0.0 { by_stroke } else { 1.0 };
                vec![0.01, 0.0, counted.clamp(0.5, 1e4), 0.3, 1.0, stroke_power]
            })
            .to_vec()
    },
    statement: |v| {
        let longer = if v[5] == 0.0 {
            String::new()
        } else {
            format!(
                " A cycle here has strokes of 30 mm; a longer stroke counts more, by its length to the power {:.1}.",
                v[5]
            )
        };
        // Half a cycle is not to be read as none.
        let decimals = usize::from(v[2] < 10.0);
        format!(
            "Over about {2:.decimals$} cycles the friction changes by {0:+.2} % of the load and the force by {1:+.2} %.{longer}",
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
                power: v[4],
                stroke_power: v[5],
                stroke: Stroke::default(),
                drag: Drag::new(v[3], 1.0),
                largest: LargestFriction::default(),
                reversals: Reversals::default(),
                done: (0, 0.0),
            },
            inside,
        )
    },
    if_known: super::unchanged,
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "sensor_drift",
            why: "in one recording, a slow change with cycles is also a slow change with time",
            test: "two blocks of cycles with a pause of some minutes between them: run-in stops in the pause, a change with time continues",
        },
        LookAlike {
            code: "relaxation",
            why: "in one recording, a slow change with cycles is also a slow change with time",
            test: "two blocks of cycles with a pause of some minutes between them: run-in stops in the pause, a change with time continues",
        },
        LookAlike {
            code: "warming",
            why: "in one recording, a friction that changes with the cycles also changes with the heat of the contacts",
            test: "two blocks of cycles with a pause of some minutes between them: warm contacts cool in the pause, run-in stays",
        },
    ],
};

#[derive(Clone)]
struct RunIn {
    friction_change: f64,
    rate_change: f64,
    cycles: f64,
    power: f64,
    stroke_power: f64,
    stroke: Stroke,
    drag: Drag,
    largest: LargestFriction,
    reversals: Reversals,
    /// Number of reversals, and the share of the change that is done then.
    done: (u32, f64),
}

/// The strokes so far.
#[derive(Clone, Default)]
struct Stroke {
    travel: BandedTravel,
    /// Travel since the last reversal, mm.
    length_mm: f64,
    /// Cycles that are counted.
    cycles: f64,
}

impl Stroke {
    /// Cycles so far, with the stroke that has begun. At power 0 the count rises only at the reversals. From power 1 on it rises along the
    /// stroke. Between them, it rises in part along the stroke and in part at its end.
    fn cycles_so_far(&self, power: f64) -> f64 {
        let along = 0.5 * power_of(self.length_mm / REFERENCE_STROKE_MM, power);
        self.cycles + power.clamp(0.0, 1.0) * along
    }

    /// Counts the stroke that ends as half a cycle, by its length.
    fn end(&mut self, power: f64) {
        self.cycles += 0.5 * power_of(self.length_mm / REFERENCE_STROKE_MM, power);
        self.length_mm = 0.0;
    }
}

/// Largest friction of the plant inside so far. At that instant, all contacts slid.
#[derive(Clone, Default)]
struct LargestFriction {
    /// Largest friction force so far, N.
    friction_n: f64,
    /// Friction divided by load at that instant.
    ratio: f64,
}

impl LargestFriction {
    /// Drag of the contacts, -1 to 1; `None` without friction.
    fn drag(&mut self, friction_n: f64, carried_n: f64) -> Option<f64> {
        if carried_n <= 0.0 {
            return None;
        }
        let ratio = friction_n / carried_n;
        if friction_n.abs() > self.friction_n {
            (self.friction_n, self.ratio) = (friction_n.abs(), ratio.abs());
        }
        (self.ratio > SMALLEST_RATIO).then(|| (ratio / self.ratio).clamp(-1.0, 1.0))
    }
}

impl Wrap for RunIn {
    fn reset(&mut self) {
        self.drag.reset();
        self.largest = LargestFriction::default();
        self.reversals = Reversals::default();
        self.stroke = Stroke::default();
        self.done = (0, 0.0);
    }

    fn told(&mut self, motion: &Motion) {
        self.drag.tell();
        self.stroke.travel.tell();
        self.reversals.tell(motion);
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let force_n = inside.step(displacement_mm, dt_s);
        self.reversals.step(displacement_mm);
        let reversed = self.reversals.count != self.done.0;
        if reversed {
            self.stroke.end(self.stroke_power);
        }
        self.stroke.length_mm += self.stroke.travel.advance(displacement_mm).abs();
        if reversed || self.stroke_power > 0.0 {
            let cycles = self.stroke.cycles_so_far(self.stroke_power);
            let done = -(-power_of(cycles / self.cycles, self.power)).exp_m1();
            self.done = (self.reversals.count, done);
        }
        let carried_n = load_n(&**inside, force_n);
        // The drag of its own is for a plant without friction: with friction it is not moved.
        let drag = match self.largest.drag(force_n - carried_n, carried_n) {
            Some(drag) => drag,
            None => self.drag.step(displacement_mm),
        };
        let friction_n = self.friction_change * drag * carried_n;
        force_n + self.done.1 * (friction_n + self.rate_change * force_n)
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
        // Path 9, 0, 9, 0, 5: three reversals. Full sliding upwards: 500 N times 1 + 0.15 g.
        let mut plant = (EFFECT.attach)(&[0.1, 0.05, 4.0, 0.3, 1.0, 0.0], spring());
        let force_n = [9.0, 0.0, 9.0, 0.0, 5.0].map(|x| plant.step(x, 0.1))[4];
        let reversals = 3.0;
        let gain = 0.15 * (1.0 - (-0.5 * reversals / 4.0f64).exp());
        assert!((force_n - 500.0 * (1.0 + gain)).abs() < 1e-3, "{force_n}");
    }

    #[test]
    fn a_longer_stroke_runs_the_contacts_in_faster() {
        // Strokes of 60, 60 and 5 mm: with power 2, they count as 4, 4 and 1/36 halves of a cycle.
        let mut plant = (EFFECT.attach)(&[0.1, 0.05, 4.0, 0.3, 1.0, 2.0], spring());
        let force_n = [0.0, 60.0, 0.0, 5.0].map(|x| plant.step(x, 0.1))[3];
        let gain = 0.15 * (1.0 - (-0.5 * (8.0 + 1.0 / 36.0) / 4.0f64).exp());
        assert!((force_n - 500.0 * (1.0 + gain)).abs() < 1e-3, "{force_n}");
    }

    #[test]
    fn the_added_friction_reverses_as_the_friction_inside_does() {
        let model = crate::model::find("equivalent").expect("listed");
        let inside = || {
            model
                .plant(&[100.0, 80.0, 0.1, 0.5], &toml::Table::new())
                .expect("valid")
        };
        let (mut plain, mut run_in) = (
            inside(),
            (EFFECT.attach)(&[0.1, 0.0, 1e-3, 0.3, 1.0, 0.0], inside()),
        );
        // Run-in is complete at once: the friction is doubled, also while it reverses.
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
    fn parameters_are_recovered_from_clean_data() {
        parameters_are_recovered(&EFFECT, &[0.05, -0.02, 3.0, 0.4, 0.8, 0.7]);
    }
}
