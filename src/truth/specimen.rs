//! The specimen with its hidden effects, stepped through a motion: true force at every time that is sampled.
//!
//! ```text
//! F = E (1 + mu mean(r_i)),  E = preload + rate x          64 Jenkins elements: r_i in [-1, 1] stops moving at its ends
//! ```
//! The lengths of the elements are quantiles of a gamma distribution of shape 2 raised to a power: with power 1 the steady
//! loop turns round exponentially (the second derivative of the branch is the density of the lengths; Iwan 1966), so that a
//! one-parameter presliding law can represent it. Other powers are a little off it, as a real pack is.

use super::{Hidden, Programme};
use crate::units::inertia_force_n;

/// Jenkins elements in a contact.
const ELEMENTS: usize = 64;
/// Jenkins elements in a bushing.
const BUSHING_ELEMENTS: usize = 16;
/// Travel over which friction that turns at once turns round, mm.
const SHARP_MM: f64 = 0.003;
/// Shorter than this, the transition of a sharp friction is the specimen's own: no contact turns round in no travel.
const BRIEF_MM: f64 = 0.1;
/// Travel of a bushing of the specimen, of a hidden one, and of the contact that is stickier at rest.
const BUSHING_MM: [f64; 3] = [0.03, 0.02, 0.1];
/// Longest step, s.
const STEP_S: f64 = 0.004;

/// Shape of the friction that scales with the load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Form {
    /// 64 elements.
    Gradual,
    /// Turns round at once.
    Sharp,
    /// Smoothed by speed: a numerical artefact, kept to measure what it leaves out.
    Smoothed {
        /// Speed of the smoothing, mm/s.
        speed_mm_s: f64,
    },
}

/// A leaf spring.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TruthSpecimen {
    /// Force at zero displacement, N.
    pub preload_n: f64,
    /// Spring rate, N/mm.
    pub rate_n_per_mm: f64,
    /// Friction over load.
    pub friction_ratio: f64,
    /// Travel after a reversal over which friction turns round to 1/e, mm.
    pub presliding_mm: f64,
    /// Power of the distribution of element lengths.
    pub power: f64,
    /// Shape of that friction.
    pub form: Form,
    /// Friction that does not depend on the load, N: part of the specimen where the baseline has it.
    pub bushing_n: f64,
    /// Force at the largest displacement, about, N.
    pub range_n: f64,
}

impl TruthSpecimen {
    /// Largest displacement, mm.
    pub(crate) fn top_mm(&self) -> f64 {
        (self.range_n - self.preload_n) / self.rate_n_per_mm
    }

    /// Force there, friction included, N.
    pub(crate) fn top_n(&self) -> f64 {
        self.range_n * (1.0 + self.friction_ratio)
    }

    /// True force in N at `times_s` (rising) of a motion, before the sensors.
    pub(crate) fn forces(&self, hidden: &[Hidden], motion: &Programme, times_s: &[f64]) -> Vec<f64> {
        let mut contact = SlidingContact::new(self, hidden, motion);
        let delay_s = 1e-3 * get(hidden, "channel_delay").map_or(0.0, |h| h.size);
        times_s
            .iter()
            .map(|&t| {
                let force_n = contact.go_to(t - delay_s);
                let drift = get(hidden, "sensor_drift").map_or(0.0, |h| h.size * t / 60.0);
                let limit =
                    get(hidden, "sensor_saturation").map_or(f64::INFINITY, |h| h.limit_n(self.top_n()));
                (force_n + drift).min(limit)
            })
            .collect()
    }
}

fn get<'a>(hidden: &'a [Hidden], code: &str) -> Option<&'a Hidden> {
    hidden.iter().find(|h| h.code == code)
}

/// Everything that moves.
struct SlidingContact<'a> {
    form: Form,
    specimen: &'a TruthSpecimen,
    hidden: &'a [Hidden],
    motion: &'a Programme,
    /// 1 / length and drag of each element.
    elements: Vec<[f64; 2]>,
    bushings: [Vec<[f64; 2]>; 3],
    arm_n: f64,
    time_s: f64,
    position_mm: f64,
    pin_mm: f64,
    drag: f64,
    direction: f64,
    turned_mm: f64,
    half_cycles: f64,
}

impl<'a> SlidingContact<'a> {
    fn new(specimen: &'a TruthSpecimen, hidden: &'a [Hidden], motion: &'a Programme) -> SlidingContact<'a> {
        let slow = get(hidden, "presliding").map_or(specimen.presliding_mm, |h| h.size);
        let form = match specimen.form {
            _ if get(hidden, "presliding").is_some() => Form::Gradual,
            _ if get(hidden, "rate_independent_friction").is_some() => Form::Sharp,
            form => form,
        };
        let lengths = match form {
            Form::Gradual => quantiles(slow, specimen.power, ELEMENTS),
            Form::Sharp | Form::Smoothed { .. } if specimen.presliding_mm < BRIEF_MM => {
                quantiles(specimen.presliding_mm, 1.0, BUSHING_ELEMENTS)
            }
            Form::Sharp | Form::Smoothed { .. } => vec![SHARP_MM],
        };
        SlidingContact {
            form,
            specimen,
            hidden,
            motion,
            elements: elements(lengths),
            bushings: BUSHING_MM.map(|mm| elements(quantiles(mm, 1.0, BUSHING_ELEMENTS))),
            arm_n: 0.0,
            time_s: 0.0,
            position_mm: 0.0,
            pin_mm: 0.0,
            drag: 0.0,
            direction: 0.0,
            turned_mm: 0.0,
            half_cycles: 0.0,
        }
    }

    fn get(&self, code: &str) -> Option<&'a Hidden> {
        get(self.hidden, code)
    }

    /// Steps up to a time, turning points hit exactly, and gives the force there.
    fn go_to(&mut self, time_s: f64) -> f64 {
        let from_s = self.time_s;
        let steps = ((time_s - from_s) / STEP_S).ceil().max(1.0) as usize;
        let mut force_n = self.force(time_s);
        for k in 1..=steps {
            let to = from_s + (time_s - from_s) * k as f64 / steps as f64;
            if to <= self.time_s {
                continue;
            }
            if let Some(turn) = self.turning_point(to) {
                self.advance(turn);
            }
            force_n = self.advance(to);
        }
        force_n
    }

    /// Time within the step at which the direction changes.
    fn turning_point(&self, to_s: f64) -> Option<f64> {
        let speed = |t: f64| self.motion.speed_mm_s(t);
        let (mut low, mut high) = (self.time_s, to_s);
        let first = speed(low);
        if first * speed(high) >= 0.0 {
            return None;
        }
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if speed(middle) * first > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(low)
    }

    /// One step in one direction.
    fn advance(&mut self, to_s: f64) -> f64 {
        let dt_s = to_s - self.time_s;
        self.time_s = to_s;
        let board_mm = self.motion.at_mm(to_s);
        let pin_mm = match self.get("backlash") {
            Some(h) => self
                .pin_mm
                .clamp(board_mm - 0.5 * h.size, board_mm + 0.5 * h.size),
            None => board_mm,
        };
        self.pin_mm = pin_mm;
        let mut x = self.seat(pin_mm);
        if let Some(h) = self.get("lift_off") {
            // The pusher leaves, the specimen stays where it was let go.
            x = x.max(h.size);
        }
        let travel = x - self.position_mm;
        self.position_mm = x;
        for [stiffness, drag] in self.elements.iter_mut().chain(self.bushings.iter_mut().flatten()) {
            *drag = (*drag + travel * *stiffness).clamp(-1.0, 1.0);
        }
        if let Some(h) = self.get("relaxation") {
            // Exact for constant speed within the step: the arm is fed in the middle of it.
            let half = (-0.5 * dt_s / h.place).exp();
            self.arm_n = (self.arm_n * half + h.size * travel) * half;
        }
        self.count(x, travel);
        self.force(to_s)
    }

    /// Position of the specimen behind a fixture that gives: pin and specimen carry the same force. It grows with the
    /// position, so that halving finds it.
    fn seat(&self, pin_mm: f64) -> f64 {
        let Some(h) = self.get("series_compliance") else {
            return pin_mm;
        };
        let gives = 1e-3 * h.size;
        let too_far = |x: f64| {
            let travel = x - self.position_mm;
            let drag = match self.form {
                Form::Smoothed { .. } => self.drag,
                Form::Gradual | Form::Sharp => dragged(&self.elements, travel),
            };
            let own = dragged(&self.bushings[0], travel);
            x + gives * (self.carried(x) + self.friction(x, drag, own)) > pin_mm
        };
        let (mut low, mut high) = (pin_mm - gives * 2.0 * self.specimen.top_n(), pin_mm);
        // To 1e-9 of some millimetres.
        for _ in 0..32 {
            let middle = 0.5 * (low + high);
            if too_far(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        low
    }

    /// Friction of contact and bushing at a position, by how far they are dragged along.
    fn friction(&self, x: f64, drag: f64, own: f64) -> f64 {
        let s = self.specimen;
        let mut ratio = s.friction_ratio;
        if let Some(h) = self
            .get("load_dependent_friction")
            .or(self.get("rate_independent_friction"))
        {
            ratio += h.size;
        }
        if let Some(h) = self.get("run_in") {
            ratio += h.size * (1.0 - (-0.5 * self.half_cycles / h.place).exp());
        }
        if let Some(h) = self.get("local_friction") {
            let bump = 1.0 - ((x - h.place) / (0.5 * h.width)).powi(2);
            ratio += h.size * bump.max(0.0);
        }
        self.carried(x) * ratio * drag + s.bushing_n * own
    }

    /// Half cycles, by turning points more than 2 % of the range apart.
    fn count(&mut self, x: f64, travel: f64) {
        if travel == 0.0 {
            return;
        }
        if travel * self.direction < 0.0 {
            if (self.position_mm - travel - self.turned_mm).abs() > 0.02 * self.specimen.top_mm() {
                self.half_cycles += 1.0;
            }
            self.turned_mm = x - travel;
        }
        self.direction = travel.signum();
    }

    /// Force without moving.
    fn force(&mut self, time_s: f64) -> f64 {
        let x = self.position_mm;
        let speed = self.motion.speed_mm_s(time_s);
        let carried = self.carried(x);
        let drag = match self.form {
            Form::Smoothed { speed_mm_s } => (speed / speed_mm_s).tanh(),
            Form::Gradual | Form::Sharp => mean(&self.elements),
        };
        let [own, extra, sticky] = [0, 1, 2].map(|k: usize| mean(&self.bushings[k]));
        self.drag = drag;
        let mut force_n = carried + self.friction(x, drag, own);
        if let Some(h) = self.get("stribeck") {
            force_n += carried * h.size * sticky * (-(speed / h.place).powi(2)).exp();
        }
        if let Some(h) = self.get("coulomb_friction") {
            force_n += h.size * extra;
        }
        if let Some(h) = self.get("ripple") {
            force_n += h.size * (std::f64::consts::TAU * x / h.place).sin();
        }
        if let Some(h) = self.get("viscous_damping") {
            force_n += h.size * speed;
        }
        if let Some(h) = self.get("inertia") {
            force_n += inertia_force_n(h.size, self.motion.acceleration_mm_s2(time_s));
        }
        force_n + self.arm_n
    }

    /// Load carried without friction; never tensile.
    fn carried(&self, x: f64) -> f64 {
        let s = self.specimen;
        let mut load = s.preload_n + s.rate_n_per_mm * x;
        if let Some(h) = self.get("geometric_stiffness") {
            // A link of length L swings: 1 - cos, so that the rate's change fades with the swing.
            let link = 3.0 * s.top_mm();
            load += h.size * link * link * (1.0 - (x / link).cos());
        }
        if let Some(h) = self.get("progressive_stiffness") {
            load += h.size * (x - h.place).max(0.0);
        }
        if let Some(h) = self.get("lift_off") {
            load = if x > h.size {
                s.preload_n + s.rate_n_per_mm * (x - h.size)
            } else {
                0.0
            };
        }
        if let Some(h) = self.get("strength_loss") {
            // Pinched in the middle of the travel once a crack has opened.
            if 0.5 * self.half_cycles >= h.place {
                let middle = (x / s.top_mm() - 0.45) / 0.25;
                load *= 1.0 - h.size * (-middle * middle).exp();
            }
        }
        load.max(0.0)
    }
}

/// Elements at rest: 1 / length, drag.
fn elements(lengths_mm: Vec<f64>) -> Vec<[f64; 2]> {
    lengths_mm.into_iter().map(|l| [1.0 / l, 0.0]).collect()
}

fn mean(elements: &[[f64; 2]]) -> f64 {
    elements.iter().map(|e| e[1]).sum::<f64>() / elements.len() as f64
}

/// Mean after a travel that is only thought of.
fn dragged(elements: &[[f64; 2]], travel_mm: f64) -> f64 {
    let moved = elements
        .iter()
        .map(|[stiffness, drag]| (drag + travel_mm * stiffness).clamp(-1.0, 1.0));
    moved.sum::<f64>() / elements.len() as f64
}

/// Lengths in mm at which the elements begin to slide: half of what a reversal takes.
fn quantiles(presliding_mm: f64, power: f64, count: usize) -> Vec<f64> {
    (0..count)
        .map(|i| {
            let share = (i as f64 + 0.5) / count as f64;
            let (mut low, mut high) = (0.0f64, 40.0f64);
            for _ in 0..50 {
                let x = 0.5 * (low + high);
                if 1.0 - (-x).exp() * (1.0 + x) < share {
                    low = x;
                } else {
                    high = x;
                }
            }
            0.5 * presliding_mm * low.powf(power)
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests;
