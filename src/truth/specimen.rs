//! The specimen with its hidden effects: the true force at every sampling time of a motion.
//!
//! ```text
//! F = E (1 + mu mean(r_i)),  E = preload + rate x,  dr_i = dx / l_i limited to [-1, 1]
//! ```
//! E: carried load, N. mu: friction divided by load. r_i: drag of 64 Jenkins elements. l_i: their lengths, mm. x:
//! displacement, mm. The lengths are quantiles of a gamma distribution of shape 2, raised to a power. With power 1 the friction
//! of the steady loop reverses exponentially (the second derivative of the branch is the density of the lengths; W. D. Iwan
//! 1966), as a presliding law with one parameter does. Other powers deviate a little from that law, as a real pack does.

use super::{Hidden, Programme, World};
use crate::units::inertia_force_n;

/// Number of Jenkins elements in a contact.
const ELEMENTS: usize = 64;
/// Number of Jenkins elements in a bushing.
const BUSHING_ELEMENTS: usize = 16;
/// Travel in mm over which a sharp friction reverses.
const SHARP_MM: f64 = 0.003;
/// A presliding travel below this, in mm, is kept for a sharp friction; above it, [`SHARP_MM`] replaces it.
const BRIEF_MM: f64 = 0.1;
/// Travel in mm over which three frictions reverse: a bushing of the specimen, a hidden bushing, Stribeck friction.
const BUSHING_MM: [f64; 3] = [0.03, 0.02, 0.1];
/// Largest time step, s.
const STEP_S: f64 = 0.004;

/// Form of the friction in proportion to the load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Form {
    /// It reverses gradually, with 64 elements.
    Gradual,
    /// It reverses at once.
    Sharp,
    /// It is smoothed by speed, as in some simulations: a numerical artefact that the diagnosis must find.
    Smoothed { speed_mm_s: f64 },
}

/// A leaf spring without hidden effects.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TruthSpecimen {
    /// Force at zero displacement, N.
    pub preload_n: f64,
    /// Spring rate, N/mm.
    pub rate_n_per_mm: f64,
    /// Friction divided by load.
    pub friction_ratio: f64,
    /// Travel after a reversal over which the friction reverses to 1/e of the remainder, mm.
    pub presliding_mm: f64,
    /// Power of the distribution of element lengths; in another world the shape of its operator, see [`World::shapes`].
    pub power: f64,
    pub form: Form,
    /// Friction that does not depend on the load, N; only in cases whose baseline has it too.
    pub bushing_n: f64,
    /// Force at the largest displacement without friction, N.
    pub range_n: f64,
    /// Equations that it follows. Those of [`World::Own`] are in this file.
    pub world: World,
    /// Random number in [0, 1) that sets number, lengths and gaps of the leaves in [`World::Pack`], and up to which force the bristles are
    /// elastic in [`World::Lugre`]; 0 in the others.
    pub build: f64,
}

impl TruthSpecimen {
    /// Largest displacement, mm.
    pub(crate) fn top_mm(&self) -> f64 {
        (self.range_n - self.preload_n) / self.rate_n_per_mm
    }

    /// Force at the largest displacement with friction, N.
    pub(crate) fn top_n(&self) -> f64 {
        self.range_n * (1.0 + self.friction_ratio)
    }

    /// True force in N in [`World::Own`] at the rising times `times_s` of a motion, before the sensors.
    pub(super) fn own_forces(&self, hidden: &[Hidden], motion: &Programme, times_s: &[f64]) -> Vec<f64> {
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

/// The specimen in motion: its state at one time.
struct SlidingContact<'a> {
    form: Form,
    specimen: &'a TruthSpecimen,
    hidden: &'a [Hidden],
    motion: &'a Programme,
    /// 1 / length in 1/mm and drag of each element.
    elements: Vec<[f64; 2]>,
    /// The same for the frictions of [`BUSHING_MM`].
    bushings: [Vec<[f64; 2]>; 3],
    /// Force of the relaxing spring, N.
    arm_n: f64,
    time_s: f64,
    /// Displacement of the specimen, mm.
    position_mm: f64,
    /// Displacement behind the backlash, mm.
    pin_mm: f64,
    /// Mean drag of the contact at the last step, -1 to 1.
    drag: f64,
    /// Sign of the last travel.
    direction: f64,
    /// Displacement of the last turning point, mm.
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

    /// Steps exactly through the turning points up to a time in s, and returns the force there in N.
    fn go_to(&mut self, time_s: f64) -> f64 {
        let from_s = self.time_s;
        let steps = ((time_s - from_s) / STEP_S).ceil().max(1.0) as usize;
        let mut force_n = self.force(time_s);
        for k in 1..=steps {
            let to = from_s + (time_s - from_s) * k as f64 / steps as f64;
            if to <= self.time_s {
                continue;
            }
            if let Some(turn) = self.motion.turning_point_s(self.time_s, to) {
                self.advance(turn);
            }
            force_n = self.advance(to);
        }
        force_n
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
            // The pusher leaves; the specimen stays at the contact.
            x = x.max(h.size);
        }
        let travel = x - self.position_mm;
        self.position_mm = x;
        for [stiffness, drag] in self.elements.iter_mut().chain(self.bushings.iter_mut().flatten()) {
            *drag = (*drag + travel * *stiffness).clamp(-1.0, 1.0);
        }
        if let Some(h) = self.get("relaxation") {
            // The travel of the step is added in the middle of the step.
            let half = (-0.5 * dt_s / h.place).exp();
            self.arm_n = (self.arm_n * half + h.size * travel) * half;
        }
        self.count(x, travel);
        self.force(to_s)
    }

    /// Displacement in mm of the specimen in series with a compliant fixture: both carry the same force. The force grows with
    /// the displacement, so bisection finds it.
    fn seat(&self, pin_mm: f64) -> f64 {
        let Some(h) = self.get("series_compliance") else {
            return pin_mm;
        };
        let compliance_mm_per_n = 1e-3 * h.size;
        let too_far = |x: f64| {
            let travel = x - self.position_mm;
            let drag = match self.form {
                Form::Smoothed { .. } => self.drag,
                Form::Gradual | Form::Sharp => mean_after(&self.elements, travel),
            };
            let own = mean_after(&self.bushings[0], travel);
            x + compliance_mm_per_n * (self.carried(x) + self.friction(x, drag, own)) > pin_mm
        };
        let (mut low, mut high) = (pin_mm - compliance_mm_per_n * 2.0 * self.specimen.top_n(), pin_mm);
        // 32 halvings of some millimetres leave 1e-9 mm.
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

    /// Friction in N of contact and bushing at a displacement, from the drag of each (`drag`, `own`).
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

    /// Counts half cycles: turning points that are more than 2 % of the range apart.
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

    /// Force in N at the present displacement.
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

    /// Carried load in N, without friction; never tensile.
    fn carried(&self, x: f64) -> f64 {
        let s = self.specimen;
        let mut load = s.preload_n + s.rate_n_per_mm * x;
        if let Some(h) = self.get("geometric_stiffness") {
            // A swinging link: 1 - cos, so that the change of the rate fades with the angle.
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
            // After a crack has opened, the load is lower in the middle of the travel.
            if 0.5 * self.half_cycles >= h.place {
                let middle = (x / s.top_mm() - 0.45) / 0.25;
                load *= 1.0 - h.size * (-middle * middle).exp();
            }
        }
        load.max(0.0)
    }
}

/// Elements at rest: 1 / length in 1/mm, and drag.
fn elements(lengths_mm: Vec<f64>) -> Vec<[f64; 2]> {
    lengths_mm.into_iter().map(|l| [1.0 / l, 0.0]).collect()
}

/// Mean drag of elements, -1 to 1.
fn mean(elements: &[[f64; 2]]) -> f64 {
    elements.iter().map(|e| e[1]).sum::<f64>() / elements.len() as f64
}

/// Mean drag of elements after a trial travel in mm.
fn mean_after(elements: &[[f64; 2]], travel_mm: f64) -> f64 {
    let moved = elements
        .iter()
        .map(|[stiffness, drag]| (drag + travel_mm * stiffness).clamp(-1.0, 1.0));
    moved.sum::<f64>() / elements.len() as f64
}

/// Lengths in mm of `count` elements: half of the travel that each needs to reverse.
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
