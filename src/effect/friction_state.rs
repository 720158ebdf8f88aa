//! The friction of the model in a general form whose slope depends on the friction itself: it forgets the reversals before the last one.
//!
//! ```text
//! F = F_in + c E (r + t dr/dt),   dr = d q(u) (1 - u) dx / l (E_0 / E)^s - m r dE / E,   u = d r
//! ```
//! E: load that the contacts carry, N. c: `ratio`, friction divided by load. r: drag, -1 to 1. d: direction, 1 or -1. x: travel, mm.
//! l: `length_mm`, travel over which the friction settles, at E_0 = 1000 N. ln q: piecewise linear over u, 0 at 0, and `bend_k` at the
//! other places of [`PLACES`]; all 0: the friction settles exponentially. s: `length_exponent`, m: `force_memory`, as in
//! `friction_form`. t: `lag_ms`, damping of the contact divided by its stiffness. F_in: force of the plant inside, N.
//! Source: a Duhem model with a free slope (A. Visintin, Differential Models of Hysteresis, 1994, chapter V); without bends it is the
//! law of P. R. Dahl (1968), the damping is that of C. Canudas de Wit et al. (1995).
//! Range: friction that settles over 0.01 to 20 mm. Small nested loops need not close.
//! It is not missing physics: the friction law is generalised first, so that its shape is not reported as missing physics.

use std::sync::Arc;

use super::motion::BandedTravel;
use super::power::Power;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, friction_form, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// Load at which the length is `length_mm`, N.
const REFERENCE_N: f64 = 1000.0;
/// Below this load the contacts are open, N.
const OPEN_N: f64 = 1.0;
/// Largest drag of a contact whose load has fallen.
const MOST_DRAG: f64 = 2.0;
/// Places along the drag at which the bends are given, and the one at which there is none.
const PLACES: [f64; BENDS + 1] = [-1.0, -0.5, 0.0, 0.35, 0.65, 0.85, 1.0];
const UNBENT: usize = 2;
/// Number of bends.
const BENDS: usize = 6;
/// Number of cells into which u from -1 to 1 is divided. In a cell q is constant, so a step has a formula and needs no integration. The
/// drag differs by less than 0.002 from that of the continuous q.
const CELLS: usize = 80;

const fn bend(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "",
        start: 0.0,
        bounds: [-2.5, 2.5],
        belief: [-2.5, 2.5],
        what: "logarithm of the factor of the slope at one place of the friction: bend 1 just after a reversal, bend 6 just before sliding",
    }
}

/// One of [`super::FORMS`].
pub(crate) const FORM: Effect = Effect {
    code: "friction_state",
    stage: Stage::Interleaf,
    follows_path: true,
    only_rival: false,
    parameters: &[
        Parameter {
            name: "ratio",
            unit: "",
            start: 0.05,
            bounds: [0.0, 0.9],
            belief: [0.0, 0.3],
            what: "friction divided by load at full sliding",
        },
        Parameter {
            name: "length_mm",
            unit: "mm",
            start: 0.3,
            bounds: [0.004, 20.0],
            belief: [0.01, 10.0],
            what: "travel over which the friction settles, at a load of 1000 N",
        },
        bend("bend_1"),
        bend("bend_2"),
        bend("bend_3"),
        bend("bend_4"),
        bend("bend_5"),
        bend("bend_6"),
        Parameter {
            name: "length_exponent",
            unit: "",
            start: 0.0,
            bounds: [0.0, 1.0],
            belief: [0.0, 1.0],
            what: "power of the load with which the length grows: 0 for the same travel at every load, 1 for a constant stiffness",
        },
        Parameter {
            name: "force_memory",
            unit: "",
            start: 1.0,
            bounds: [0.0, 1.0],
            belief: [0.0, 1.0],
            what: "share of the friction force that a contact keeps where the load changes",
        },
        Parameter {
            name: "lag_ms",
            unit: "ms",
            start: 0.0,
            bounds: [0.0, 2.0],
            belief: [0.0, 1.0],
            what: "damping of the contact while it sticks, divided by its stiffness",
        },
    ],
    neutral: &[0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    amplitudes: &[0],
    kinks: &[],
    shapes: &[2, 3, 4, 5, 6, 7, 10],
    starts: |_| {
        let lengths = [0.1, 0.4];
        let loads = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let start =
            |length_mm: f64, [s, m]: [f64; 2]| vec![0.05, length_mm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, s, m, 0.0];
        lengths
            .iter()
            .flat_map(|l| loads.map(|load| start(*l, load)))
            .collect()
    },
    statement: |v| {
        format!(
            "The friction of the model reverses in another form: {:.1} % of the load, over a travel of {:.2} mm, and it forgets the \
             reversals before the last one.",
            100.0 * v[0],
            v[1]
        )
    },
    attach: |v, inside| wrapped(FrictionState::new(v), inside),
    if_known: friction_form::FORM.if_known,
    place: everywhere,
    plausible: super::always,
    confusable_with: LOOK_ALIKES,
};

const LOOK_ALIKES: &[LookAlike] = friction_form::FORM.confusable_with;

struct FrictionState {
    ratio: f64,
    length_mm: f64,
    cells: Arc<[SlopeCell; CELLS]>,
    length_exponent: Power,
    force_memory: Power,
    lag_s: f64,
    travel: BandedTravel,
    /// Drag, -1 to 1; above where the load falls faster than the contact settles.
    drag: f64,
    /// Load at the last step, N, and the length in mm there.
    last: Option<[f64; 2]>,
}

impl Clone for FrictionState {
    fn clone(&self) -> Self {
        FrictionState {
            cells: Arc::clone(&self.cells),
            ..*self
        }
    }

    /// The solution of a compliance copies the contact at every trial, nearly always between two of the same law.
    fn clone_from(&mut self, source: &Self) {
        if !Arc::ptr_eq(&self.cells, &source.cells) {
            *self = source.clone();
            return;
        }
        (self.travel, self.drag, self.last) = (source.travel, source.drag, source.last);
    }
}

impl FrictionState {
    fn new(values: &[f64]) -> FrictionState {
        FrictionState {
            ratio: values[0],
            length_mm: values[1],
            cells: Arc::new(cells(&values[2..2 + BENDS])),
            length_exponent: Power::new(values[2 + BENDS]),
            force_memory: Power::new(values[3 + BENDS]),
            lag_s: 1e-3 * values[4 + BENDS],
            travel: BandedTravel::default(),
            drag: 0.0,
            last: None,
        }
    }

    /// Factor of the drag and length in mm at a load in N.
    fn at_load(&mut self, load_n: f64) -> [f64; 2] {
        if load_n < OPEN_N {
            self.last = None;
            return [1.0, self.length_mm];
        }
        let Some([before_n, before_mm]) = self.last else {
            let length_mm = self.length_mm * self.length_exponent.of(load_n / REFERENCE_N);
            self.last = Some([load_n, length_mm]);
            return [1.0, length_mm];
        };
        let length_mm = before_mm * self.length_exponent.of(load_n / before_n);
        self.last = Some([load_n, length_mm]);
        [self.force_memory.of(before_n / load_n), length_mm]
    }

    /// Moves the drag by a travel in settling lengths. In each cell, the distance from u to 1 falls exponentially with the travel.
    fn slide(&mut self, lengths: f64) {
        let direction = lengths.signum();
        let along = direction * self.drag;
        let (mut left, mut to_go) = (lengths.abs(), 1.0 - along);
        let mut k = ((0.5 * (along + 1.0)).max(0.0) * CELLS as f64).min((CELLS - 1) as f64) as usize;
        let mut at = to_go * (-self.cells[k].slope * left).exp();
        if k + 1 < CELLS && at < self.cells[k + 1].to_go {
            left -= (to_go / self.cells[k + 1].to_go).ln() / self.cells[k].slope;
            k += 1;
            while left > self.cells[k].lengths {
                left -= self.cells[k].lengths;
                k += 1;
            }
            to_go = self.cells[k].to_go;
            at = to_go * (-self.cells[k].slope * left).exp();
        }
        self.drag = direction * (1.0 - at);
    }
}

/// A part of the range of u in which q is constant.
#[derive(Clone, Copy)]
struct SlopeCell {
    /// 1 - u at its beginning.
    to_go: f64,
    /// q in its middle.
    slope: f64,
    /// Travel through it in settling lengths; infinite in the last one.
    lengths: f64,
}

fn cells(bends: &[f64]) -> [SlopeCell; CELLS] {
    let [back, on] = [&bends[..UNBENT], &bends[UNBENT..]];
    let all: Vec<f64> = back.iter().chain(&[0.0]).chain(on).copied().collect();
    let begins_at = |k: usize| -1.0 + 2.0 * k as f64 / CELLS as f64;
    std::array::from_fn(|k| {
        let middle = begins_at(k) + 1.0 / CELLS as f64;
        let above = PLACES.iter().position(|p| *p >= middle).unwrap_or(BENDS).max(1);
        let share = (middle - PLACES[above - 1]) / (PLACES[above] - PLACES[above - 1]);
        let slope = (all[above - 1] + share * (all[above] - all[above - 1])).exp();
        let [to_go, next] = [begins_at(k), begins_at(k + 1)].map(|along| 1.0 - along);
        SlopeCell {
            to_go,
            slope,
            lengths: if k + 1 == CELLS {
                f64::INFINITY
            } else {
                (to_go / next).ln() / slope
            },
        }
    })
}

impl Wrap for FrictionState {
    fn reset(&mut self) {
        self.travel = BandedTravel::default();
        self.last = None;
        self.drag = 0.0;
    }

    fn told(&mut self, _motion: &Motion) {
        self.travel.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let travel_mm = self.travel.advance(displacement_mm);
        let force_n = inside.step(displacement_mm, dt_s);
        if self.ratio == 0.0 {
            return force_n;
        }
        let load_n = pressing_n(&**inside, force_n);
        let [kept, length_mm] = self.at_load(load_n);
        // Above 1 where the load has fallen: the contact then settles from above.
        self.drag = (kept * self.drag).clamp(-MOST_DRAG, MOST_DRAG);
        let before = self.drag;
        if travel_mm != 0.0 {
            self.slide(travel_mm / length_mm);
        }
        let rate_per_s = if dt_s > 0.0 {
            (self.drag - before) / dt_s
        } else {
            0.0
        };
        force_n + self.ratio * load_n * (self.drag + self.lag_s * rate_per_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::*;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&FORM);
    }

    /// Without bends the drag settles as an exponential, from -1 after a reversal to 1 - 2 exp(-x / l).
    #[test]
    fn force_by_hand() {
        let mut plant = (FORM.attach)(&[0.1, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], spring());
        plant.step(50.0, 0.1);
        let drag = 1.0 - 2.0 * (-0.8f64 / 0.5).exp();
        let expected = (100.0 + 80.0 * 49.2) * (1.0 - 0.1 * drag);
        assert!((plant.step(49.2, 0.1) - expected).abs() < 0.02);
    }

    /// A bend of the slope makes the friction settle later or earlier; both ends stay.
    #[test]
    fn a_bend_changes_the_way_and_not_the_end() {
        let drag_after = |bend: f64, travel_mm: f64| {
            let mut plant = (FORM.attach)(
                &[0.1, 0.5, bend, bend, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                spring(),
            );
            plant.step(50.0, 0.1);
            let x = 50.0 - travel_mm;
            (1.0 - plant.step(x, 0.1) / (100.0 + 80.0 * x)) / 0.1
        };
        let [late, usual, early] = [-1.0, 0.0, 1.0].map(|bend| drag_after(bend, 0.2));
        assert!(late < usual && usual < early, "{late} {usual} {early}");
        assert!(
            [-1.0, 1.0]
                .iter()
                .all(|bend| (drag_after(*bend, 20.0) - 1.0).abs() < 1e-4)
        );
    }

    /// The equation of the head of this file in small steps, at a constant load: sliding, a reversal in the middle, a small loop.
    #[test]
    fn the_drag_follows_its_equation() {
        let bends = [0.5, 0.2, -0.2, -1.0, 0.4, 1.5];
        let slope = |u: f64| {
            let known = [0.5, 0.2, 0.0, -0.2, -1.0, 0.4, 1.5];
            let above = (1..BENDS).find(|k| PLACES[*k] >= u).unwrap_or(BENDS);
            let share = (u - PLACES[above - 1]) / (PLACES[above] - PLACES[above - 1]);
            (known[above - 1] + share * (known[above] - known[above - 1])).exp()
        };
        let mut values = vec![0.1, 0.5];
        values.extend(bends);
        values.extend([0.0, 1.0, 0.0]);
        let mut state = FrictionState::new(&values);
        let mut drag = 0.0;
        for travel_mm in [3.0, -0.3, 0.1, -0.1, -0.4, 0.002, -2.0, 0.7] {
            state.slide(travel_mm / 0.5);
            let steps = 20_000;
            for _ in 0..steps {
                let by = f64::abs(travel_mm) / 0.5 / f64::from(steps);
                let u = travel_mm.signum() * drag;
                drag += travel_mm.signum() * slope(u) * (1.0 - u) * by;
            }
            assert!(
                (state.drag - drag).abs() < 2e-3,
                "{travel_mm}: {} {drag}",
                state.drag
            );
        }
    }

    #[test]
    fn parameters_come_back_from_clean_data() {
        parameters_are_recovered(&FORM, &[0.08, 0.4, 0.5, 0.2, -0.2, -0.4, 0.1, 0.3, 0.6, 0.8, 0.3]);
    }
}
