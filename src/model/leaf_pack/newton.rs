//! Equilibrium of the whole pack at one position of the pusher, by Newton's method.
//!
//! The unknowns are the bodies of one side or of both, and the two translations of the clamp, w (sideways) and v (along the
//! load). The clamp does not turn. Its columns border the band matrices of the sides and are condensed (Schur complement). The
//! factors are kept while no place changes between open, stick and slip, which is almost always: a step is then one or two
//! back substitutions.

use super::LeafPack;
use super::band::V3;
use super::clamp::{OuterStates, arm_of, eye_of};
use super::geometry::{Dynamics, FrictionChoice, Mounting};
use super::mounting::PLACES;
use super::side::{StepInfo, add};
use super::slip_law::SlipState;
use crate::units::inertia_force_n;

/// Most iterations of one step.
const ITERATIONS: usize = 20;
/// The tangent is factored again where an iteration leaves more than this share of the residual.
const SLOW: f64 = 0.1;
/// Age of the factors in steps. Beyond it a new factorisation costs less than one additional iteration per step.
const WORTH_KEEPING: u32 = 24;
/// WBZ-alpha (Wood, Bossak, Zienkiewicz 1980) for spectral radius 0.5: second order, forces at the end of the step only,
/// so that quasi-static and dynamic steps use the same elements. gamma = 1/2 - alpha, beta = (1 - alpha)^2 / 4.
const ALPHA: f64 = -1.0 / 3.0;
const GAMMA: f64 = 0.5 - ALPHA;
const BETA: f64 = (1.0 - ALPHA) * (1.0 - ALPHA) / 4.0;

/// The greater of the two, and NaN if one of them is NaN.
fn greater_or_nan(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

fn dot(a: &V3, b: &V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Part of a step's acceleration that does not depend on the new displacement.
fn inertia_known(velocity: f64, acceleration: f64, dt_s: f64) -> f64 {
    ALPHA * acceleration - (1.0 - ALPHA) * (velocity / (BETA * dt_s) + (0.5 / BETA - 1.0) * acceleration)
}

/// Weights of the last three states for the next one: a parabola for steps of similar length, else a line. None at a reversal.
fn extrapolation(next: f64, [last, before]: [f64; 2]) -> Option<[f64; 3]> {
    let (r, s) = (next / last, before / last);
    if !(r > 0.0 && r.is_finite()) {
        return None;
    }
    let r = r.min(2.0);
    if !(0.5..=2.0).contains(&s) || r > 1.5 {
        return Some([1.0 + r, -r, 0.0]);
    }
    // Lagrange weights at r for the places 0, -1 and -1 - s.
    Some([
        (r + 1.0) * (r + 1.0 + s) / (1.0 + s),
        -r * (r + 1.0 + s) / s,
        r * (r + 1.0) / (s * (1.0 + s)),
    ])
}

/// Velocity and acceleration after a displacement of `moved` within the step (Newmark's formulas).
fn newmark(moved: f64, velocity: f64, acceleration: f64, dt_s: f64) -> (f64, f64) {
    let new = (moved - dt_s * velocity) / (BETA * dt_s * dt_s) - (0.5 / BETA - 1.0) * acceleration;
    (
        velocity + dt_s * ((1.0 - GAMMA) * acceleration + GAMMA * new),
        new,
    )
}

impl LeafPack {
    /// Sign of a sideways motion of the clamp in the coordinates of a side.
    #[inline]
    pub(super) fn sense(&self, side: usize) -> f64 {
        if side == 0 { 1.0 } else { -1.0 }
    }

    /// Newton's method from the last converged step (extrapolated unless `from_rest`). False if it does not converge.
    pub(super) fn solve(&mut self, pusher_mm: f64, increment_mm: f64, dt_s: f64, from_rest: bool) -> bool {
        self.prepare(dt_s);
        if !from_rest {
            self.predict(increment_mm);
        }
        let every_time = self.structure.friction_law == FrictionChoice::Tanh;
        let mut last = f64::INFINITY;
        for k in 0..ITERATIONS {
            let residual = self.evaluate::<false>(pusher_mm);
            if residual < self.tolerance_n {
                // Old factors that need more than one correction are computed again.
                self.factor_age += 1;
                if k > 1 && self.factor_age > WORTH_KEEPING {
                    self.factors = false;
                }
                return true;
            }
            if !residual.is_finite() {
                return false;
            }
            let stale =
                every_time || !self.factors || self.states_changed() || (k > 0 && residual > SLOW * last);
            if stale && !self.refactor(pusher_mm) {
                return false;
            }
            last = residual;
            self.correct();
        }
        false
    }

    /// Constants of the step, and the known part of the inertia terms.
    fn prepare(&mut self, dt_s: f64) {
        let full = self.structure.dynamics == Dynamics::Full;
        let inertia = if full {
            (1.0 - ALPHA) / (BETA * dt_s * dt_s)
        } else {
            0.0
        };
        let viscosity = self.structure.structural_damping_s / dt_s;
        if inertia != self.step.inertia || viscosity != self.step.viscosity {
            self.factors = false;
        }
        self.step = StepInfo {
            dt_s,
            viscosity,
            inertia,
            clamp_acceleration: [0.0; 2],
        };
        if !full {
            return;
        }
        for side in &mut self.sides {
            for ((base, v), a) in side
                .inertia_base
                .iter_mut()
                .zip(&side.velocity)
                .zip(&side.acceleration)
            {
                *base = std::array::from_fn(|i| inertia_known(v[i], a[i], dt_s));
            }
        }
        let f = &mut self.clamp;
        f.inertia_base = std::array::from_fn(|i| inertia_known(f.velocity[i], f.acceleration[i], dt_s));
    }

    /// Extrapolates the last steps where the motion continues in the same direction, else starts from the last converged step.
    fn predict(&mut self, increment_mm: f64) {
        let Some([a, b, c]) = extrapolation(increment_mm, self.last_increments_mm) else {
            return;
        };
        for side in &mut self.sides {
            let fixed = side.fixed;
            let history = side.settled[fixed..]
                .iter()
                .zip(&side.before[fixed..])
                .zip(&side.older[fixed..]);
            for (node, ((now, before), older)) in side.nodes[fixed..].iter_mut().zip(history) {
                *node = std::array::from_fn(|i| a * now[i] + b * before[i] + c * older[i]);
            }
        }
        let f = &mut self.clamp;
        f.now = std::array::from_fn(|i| a * f.settled[i] + b * f.before[i] + c * f.older[i]);
    }

    /// Residuals of sides, supports and clamp at the present estimate. Returns the greatest, N.
    pub(super) fn evaluate<const TANGENT: bool>(&mut self, pusher_mm: f64) -> f64 {
        let c = self.step.inertia;
        let f = &mut self.clamp;
        let acceleration: [f64; 2] =
            std::array::from_fn(|i| c * (f.now[i] - f.settled[i]) + f.inertia_base[i]);
        let mass = inertia_force_n(self.structure.clamp_mass_kg, 1.0);
        f.residual = if c > 0.0 {
            acceleration.map(|a| mass * a)
        } else {
            [0.0; 2]
        };
        let mut worst = 0.0f64;
        for k in 0..self.sides.len() {
            let sense = self.sense(k);
            let side = &mut self.sides[k];
            side.evaluate::<TANGENT>(&StepInfo {
                clamp_acceleration: [sense * acceleration[0], acceleration[1]],
                ..self.step
            });
            let last = if TANGENT {
                self.factor_states.places[k]
            } else {
                [SlipState::Free; PLACES]
            };
            let eye = eye_of(side, self.eye, sense, self.clamp.now);
            let force = self.mounts[k].evaluate(&eye, self.step.dt_s, &last);
            let arm = arm_of(side, self.eye);
            let [x, y, turn] = force.force;
            let tip = side.tip();
            add(&mut side.residual[tip], &[x, y, turn - arm[1] * x + arm[0] * y]);
            if c > 0.0 {
                self.clamp.residual[0] += sense * side.inertia_n[0];
                self.clamp.residual[1] += self.copies * side.inertia_n[1];
            }
            self.clamp.residual[0] += sense * x;
            self.clamp.residual[1] += self.copies * y;
            worst = greater_or_nan(worst, side.residual_n());
            self.mount_forces[k] = force;
        }
        self.push::<TANGENT>(pusher_mm);
        let [w, v] = self.clamp.residual;
        greater_or_nan(greater_or_nan(worst, w.abs()), v.abs())
    }

    /// Force of the pusher on the board: it can only push along the load, and has friction sideways. With the mounting on the
    /// rail the clamp does not move sideways.
    fn push<const TANGENT: bool>(&mut self, pusher_mm: f64) {
        let clamp = &mut self.clamp;
        clamp.pusher_n = (self.structure.support_stiffness_n_per_mm * (pusher_mm - clamp.now[1])).max(0.0);
        clamp.touching = clamp.pusher_n > 0.0;
        clamp.residual[1] -= clamp.pusher_n;
        if self.structure.mounting == Mounting::Rail {
            clamp.residual[0] = 0.0;
            return;
        }
        let limit = self.values.board_mu * clamp.pusher_n;
        let mut r = self
            .board
            .respond(self.slide_law, clamp.now[0], limit, self.step.dt_s);
        if TANGENT && self.factor_states.board.reversed(r.state) {
            r = r.stuck(self.slide_law);
        }
        clamp.board = r;
        clamp.residual[0] += r.force;
    }

    fn outer_states(&self) -> OuterStates {
        OuterStates {
            places: [self.mount_forces[0].states, self.mount_forces[1].states],
            board: self.clamp.board.state,
            touching: self.clamp.touching,
        }
    }

    fn states_changed(&self) -> bool {
        self.factor_states != self.outer_states() || self.sides.iter().any(|s| s.states != s.factor_states)
    }

    /// Factors the tangent at the present estimate and condenses the two columns of the clamp. False if it is singular.
    fn refactor(&mut self, pusher_mm: f64) -> bool {
        self.factors = false;
        self.evaluate::<true>(pusher_mm);
        self.factor_states = self.outer_states();
        let mut schur = self.clamp_stiffness();
        for k in 0..self.sides.len() {
            if !self.factor_side(k, &mut schur) {
                return false;
            }
        }
        if self.structure.mounting == Mounting::Rail {
            schur = [1.0, 0.0, 0.0, schur[3]];
        }
        let det = schur[0] * schur[3] - schur[1] * schur[2];
        if !det.is_normal() {
            return false;
        }
        self.schur_inverse = [schur[3] / det, -schur[1] / det, -schur[2] / det, schur[0] / det];
        self.factors = true;
        self.factor_age = 0;
        true
    }

    /// Adds the support to a side's tangent, factors it, and subtracts the side's part from the stiffness of the clamp.
    fn factor_side(&mut self, k: usize, schur: &mut [f64; 4]) -> bool {
        let sense = self.sense(k);
        let force = &self.mount_forces[k];
        let side = &mut self.sides[k];
        let arm = arm_of(side, self.eye);
        // Derivative of the eye's (X, Y, angle) by the body's (x, y, angle): the body's angle moves the eye too.
        let turned = |v: [f64; 3]| [v[0], v[1], v[2] - arm[1] * v[0] + arm[0] * v[1]];
        let t = &force.tangent;
        let rows = [
            turned([t[0], t[1], t[2]]),
            turned([t[3], t[4], t[5]]),
            turned([t[6], t[7], t[8]]),
        ];
        let column = |j: usize| turned([rows[0][j], rows[1][j], rows[2][j]]);
        let (x, y, turn) = (column(0), column(1), column(2));
        let lean = -arm[0] * force.force[0] - arm[1] * force.force[1];
        let body = side.beams.len() - 1;
        side.band.add(
            body,
            body,
            &[
                x[0],
                y[0],
                turn[0],
                x[1],
                y[1],
                turn[1],
                x[2],
                y[2],
                turn[2] + lean,
            ],
        );
        if !side.band.factor() {
            return false;
        }
        let columns = [x.map(|x| sense * x), y];
        self.border_rows[k] = [rows[0].map(|x| sense * x), rows[1]];
        let first = if self.structure.mounting == Mounting::Rail {
            1
        } else {
            0
        };
        for (j, column) in columns.iter().enumerate().skip(first) {
            self.solve_border(k, j, column);
        }
        for i in first..2 {
            for j in first..2 {
                let share = self.border_product(k, i, |b| self.sides[k].border[b][j]);
                schur[2 * i + j] -= if i == 0 { share } else { self.copies * share };
            }
        }
        true
    }

    /// Solves column `j` of the clamp's motion with the factors of side `k`: the support acts at the tip, the masses at all bodies.
    fn solve_border(&mut self, k: usize, j: usize, column: &V3) {
        let c = self.step.inertia * if j == 0 { self.sense(k) } else { 1.0 };
        let side = &mut self.sides[k];
        side.scratch.fill([0.0; 3]);
        if let Some(tip) = side.scratch.last_mut() {
            *tip = *column;
        }
        if c == 0.0 {
            side.band.solve_upper(&mut side.scratch);
        } else {
            for (x, [m, _]) in side.scratch.iter_mut().zip(&side.mass) {
                x[j] += m * c;
            }
            side.band.solve(&mut side.scratch);
        }
        for (z, x) in side.border.iter_mut().zip(&side.scratch) {
            z[j] = *x;
        }
    }

    /// Row `i` of the clamp's equilibrium times a vector over the bodies of side `k`.
    fn border_product(&self, k: usize, i: usize, x: impl Fn(usize) -> V3) -> f64 {
        let side = &self.sides[k];
        let mut sum = dot(&self.border_rows[k][i], &x(side.beams.len() - 1));
        let c = self.step.inertia * if i == 0 { self.sense(k) } else { 1.0 };
        if c != 0.0 {
            sum += side
                .mass
                .iter()
                .enumerate()
                .map(|(b, [m, _])| m * c * x(b)[i])
                .sum::<f64>();
        }
        sum
    }

    /// The 2 x 2 stiffness of the clamp (w, v): pusher, board, supports and masses.
    fn clamp_stiffness(&self) -> [f64; 4] {
        let mut a = [0.0; 4];
        let mut mass = inertia_force_n(self.structure.clamp_mass_kg, 1.0);
        for (k, side) in self.sides.iter().enumerate() {
            let (t, sense) = (&self.mount_forces[k].tangent, self.sense(k));
            a[0] += t[0];
            a[1] += sense * t[1];
            a[2] += sense * t[3];
            a[3] += self.copies * t[4];
            mass += self.copies * side.mass.iter().map(|m| m[0]).sum::<f64>();
        }
        let push_by = if self.clamp.touching {
            self.structure.support_stiffness_n_per_mm
        } else {
            0.0
        };
        let mu = self.values.board_mu;
        let r = &self.clamp.board;
        a[0] += self.step.inertia * mass + r.by_slip;
        a[1] -= r.by_limit * mu * push_by;
        a[3] += self.step.inertia * mass + push_by;
        a
    }

    /// One Newton correction with the present factors.
    fn correct(&mut self) {
        let mut rest = self.clamp.residual;
        for k in 0..self.sides.len() {
            let side = &mut self.sides[k];
            side.scratch.copy_from_slice(&side.residual[side.fixed..]);
            side.band.solve(&mut side.scratch);
            let side = &self.sides[k];
            rest[0] -= self.border_product(k, 0, |b| side.scratch[b]);
            rest[1] -= self.copies * self.border_product(k, 1, |b| side.scratch[b]);
        }
        if self.structure.mounting == Mounting::Rail {
            rest[0] = 0.0;
        }
        let s = &self.schur_inverse;
        let move_by = [s[0] * rest[0] + s[1] * rest[1], s[2] * rest[0] + s[3] * rest[1]];
        self.clamp.now[0] -= move_by[0];
        self.clamp.now[1] -= move_by[1];
        for side in &mut self.sides {
            let fixed = side.fixed;
            for ((node, d), z) in side.nodes[fixed..]
                .iter_mut()
                .zip(&side.scratch)
                .zip(&side.border)
            {
                for i in 0..3 {
                    node[i] -= d[i] - z[0][i] * move_by[0] - z[1][i] * move_by[1];
                }
            }
        }
    }

    /// New velocities and accelerations after a converged step of the full dynamics.
    pub(super) fn commit_motion(&mut self) {
        if self.step.inertia == 0.0 {
            return;
        }
        let dt_s = self.step.dt_s;
        for side in &mut self.sides {
            for b in 0..side.beams.len() {
                let node = b + side.fixed;
                for i in 0..3 {
                    let moved = side.nodes[node][i] - side.settled[node][i];
                    let (v, a) = newmark(moved, side.velocity[b][i], side.acceleration[b][i], dt_s);
                    side.velocity[b][i] = v;
                    side.acceleration[b][i] = a;
                }
            }
        }
        let f = &mut self.clamp;
        for i in 0..2 {
            let (v, a) = newmark(f.now[i] - f.settled[i], f.velocity[i], f.acceleration[i], dt_s);
            f.velocity[i] = v;
            f.acceleration[i] = a;
        }
    }
}
