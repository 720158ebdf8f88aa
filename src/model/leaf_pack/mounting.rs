//! Support of an eye: the bearing on its rail, the pin in the load frame, or the shackle; each with its friction.
//!
//! ```text
//! rail     F_y = k (Y - Y0), friction along x up to mu_rail |F_y| + constant
//! pin      F = k (P - P0)
//! shackle  F = k (l - L) along the link from eye P to pivot; its own pin turns by phi = atan2(dx, dy)
//! torque   up to mu_pin r |F| + constant, in every pin: slip is the angle between the two parts
//! ```
//! F forces, N; k support stiffness, N/mm; (X, Y) centre of the eye's pin, mm, X outward, Y away from the pusher; l and L length
//! of the link now and unloaded, mm; r pin radius, mm; torques in N mm. The eye is given by (X, Y) and the angle of the leaf's
//! last segment, rad. For the friction budget see docs/models.md; Kadziela et al. (2015), section 5.1, left it out. It holds
//! where the pin torques are small against the load times the length of the link.

use super::band::{M3, V3};
use super::slip_law::{Slider, SlipLaw, SlipResponse, SlipState};

/// Kind of support with its geometry, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Support {
    /// Linear bearing on the rail at height `level`.
    Rail { level: f64 },
    /// Pin fixed at a point.
    Pin { at: [f64; 2] },
    /// Link of `length` to a pivot in the load frame.
    Shackle { pivot: [f64; 2], length: f64 },
}

/// Coefficients and laws of one support.
#[derive(Debug, Clone, Copy)]
pub(super) struct MountValues {
    pub stiffness: f64,
    pub rail_mu: f64,
    pub rail_constant_n: f64,
    pub pin_mu: f64,
    pub pin_radius_mm: f64,
    pub pivot_torque_nmm: f64,
    pub slide_law: SlipLaw,
    pub turn_law: SlipLaw,
}

/// Number of sliding places of one support.
pub(super) const PLACES: usize = 3;
/// Index of the bearing on its rail.
pub(super) const RAIL: usize = 0;
/// Index of the pin in the eye.
pub(super) const EYE_PIN: usize = 1;
/// Index of the shackle's pin in the load frame.
pub(super) const PIVOT: usize = 2;

/// One support with the state of its sliding places.
#[derive(Debug, Clone)]
pub(super) struct Mount {
    pub support: Support,
    pub values: MountValues,
    pub sliders: [Slider; PLACES],
}

/// Forces, tangent and friction of one support at one estimate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MountForce {
    /// Force on (X, Y, angle) as gradient of energy.
    pub force: V3,
    /// Derivative of `force` by (X, Y, angle), row by row.
    pub tangent: M3,
    pub states: [SlipState; PLACES],
    pub slip: [f64; PLACES],
    pub friction: [f64; PLACES],
    /// Share of each friction limit that is constant (not mu times load), for the energy balance.
    pub constant_share: [f64; PLACES],
}

impl Mount {
    pub(super) fn new(support: Support, values: MountValues) -> Self {
        Self {
            support,
            values,
            sliders: Default::default(),
        }
    }

    /// Sets all slips to zero force at this place of the eye.
    pub(super) fn relax(&mut self, eye: &V3) {
        for slider in &mut self.sliders {
            *slider = Slider::default();
        }
        let now = self.evaluate(eye, 1.0, &[SlipState::Free; PLACES]);
        for (slider, slip) in self.sliders.iter_mut().zip(now.slip) {
            slider.release(slip);
        }
    }

    /// Friction law of one of its sliding places.
    pub(super) fn law(&self, place: usize) -> SlipLaw {
        if place == RAIL {
            self.values.slide_law
        } else {
            self.values.turn_law
        }
    }

    /// Force and tangent with the eye at (X, Y, angle). `last` are the stick-slip states of
    /// the last tangent (see [`SlipResponse::stuck`]).
    pub(super) fn evaluate(&self, eye: &V3, dt_s: f64, last: &[SlipState; PLACES]) -> MountForce {
        let mut out = MountForce {
            states: *last,
            ..MountForce::default()
        };
        let k = self.values.stiffness;
        match self.support {
            Support::Rail { level } => {
                out.states[PIVOT] = SlipState::Free;
                let gap = eye[1] - level;
                out.force[1] = k * gap;
                out.tangent[4] = k;
                self.rail_friction(eye, dt_s, &mut out);
                let carried = out;
                self.pin_friction(EYE_PIN, eye[2], &PinTurn::default(), &carried, dt_s, &mut out);
            }
            Support::Pin { at } => {
                let off = [eye[0] - at[0], eye[1] - at[1]];
                out.force[0] = k * off[0];
                out.force[1] = k * off[1];
                out.tangent[0] = k;
                out.tangent[4] = k;
                let carried = out;
                self.pin_friction(EYE_PIN, eye[2], &PinTurn::default(), &carried, dt_s, &mut out);
            }
            Support::Shackle { pivot, length } => self.link(eye, pivot, length, dt_s, &mut out),
        }
        out
    }

    /// Friction of one place, written to `out`. Before the call `out.states` holds the state of the last tangent.
    fn respond(&self, place: usize, slip: f64, limit: f64, dt_s: f64, out: &mut MountForce) -> SlipResponse {
        let law = self.law(place);
        let mut r = self.sliders[place].respond(law, slip, limit, dt_s);
        if out.states[place].reversed(r.state) {
            r = r.stuck(law);
        }
        out.slip[place] = slip;
        out.friction[place] = r.force;
        out.states[place] = r.state;
        r
    }

    fn rail_friction(&self, eye: &V3, dt_s: f64, out: &mut MountForce) {
        let v = &self.values;
        let limit = v.rail_mu * out.force[1].abs() + v.rail_constant_n;
        let r = self.respond(RAIL, eye[0], limit, dt_s, out);
        out.constant_share[RAIL] = if limit > 0.0 {
            v.rail_constant_n / limit
        } else {
            0.0
        };
        out.tangent[0] += r.by_slip;
        out.tangent[1] += r.by_limit * v.rail_mu * out.tangent[4] * out.force[1].signum();
        out.force[0] += r.force;
    }

    /// Friction of a pin under the load `carried`. `slip` is the angle between its two parts, rad, and `turn` the derivative of
    /// the link's angle.
    fn pin_friction(
        &self,
        place: usize,
        slip: f64,
        turn: &PinTurn,
        carried: &MountForce,
        dt_s: f64,
        out: &mut MountForce,
    ) {
        let v = &self.values;
        let [fx, fy, _] = carried.force;
        let load = fx.hypot(fy);
        let limit = v.pin_mu * v.pin_radius_mm * load + v.pivot_torque_nmm;
        let r = self.respond(place, slip, limit, dt_s, out);
        if limit <= 0.0 {
            return;
        }
        out.constant_share[place] = v.pivot_torque_nmm / limit;
        let slip_by = [turn.by[0], turn.by[1], if place == PIVOT { 0.0 } else { 1.0 }];
        let lever = if load > 1e-9 {
            r.by_limit * v.pin_mu * v.pin_radius_mm / load
        } else {
            0.0
        };
        let t = &carried.tangent;
        for i in 0..3 {
            out.force[i] += r.force * slip_by[i];
            for j in 0..3 {
                let limit_by = lever * (fx * t[j] + fy * t[3 + j]);
                out.tangent[3 * i + j] += slip_by[i] * (r.by_slip * slip_by[j] + limit_by);
            }
        }
        for (at, h) in [
            (0, turn.hess[0]),
            (1, turn.hess[1]),
            (3, turn.hess[1]),
            (4, turn.hess[2]),
        ] {
            out.tangent[at] += r.force * h;
        }
    }

    fn link(&self, eye: &V3, pivot: [f64; 2], length: f64, dt_s: f64, out: &mut MountForce) {
        let k = self.values.stiffness;
        let (dx, dy) = (pivot[0] - eye[0], pivot[1] - eye[1]);
        let square = dx * dx + dy * dy;
        let l = square.sqrt();
        let along = [-dx / l, -dy / l];
        let f = k * (l - length);
        out.force = [f * along[0], f * along[1], 0.0];
        let side = f / l;
        out.tangent[0] = k * along[0] * along[0] + side * (1.0 - along[0] * along[0]);
        out.tangent[1] = (k - side) * along[0] * along[1];
        out.tangent[3] = out.tangent[1];
        out.tangent[4] = k * along[1] * along[1] + side * (1.0 - along[1] * along[1]);
        let twist = 2.0 * dx * dy / (square * square);
        let turn = PinTurn {
            by: [-dy / square, dx / square],
            hess: [-twist, (dx * dx - dy * dy) / (square * square), twist],
        };
        // Both pins carry the link's force. Their torques change that force by a second-order term, which is left out.
        let carried = *out;
        let angle = dx.atan2(dy);
        self.pin_friction(EYE_PIN, eye[2] + angle, &turn, &carried, dt_s, out);
        self.pin_friction(PIVOT, angle, &turn, &carried, dt_s, out);
    }
}

#[cfg(test)]
impl Mount {
    /// Elastic energy of the support and of its sliding places, N mm, with the eye at (X, Y, angle).
    pub(super) fn stored_nmm(&self, eye: &V3) -> f64 {
        let stretch_mm = match self.support {
            Support::Rail { level } => eye[1] - level,
            Support::Pin { at } => (eye[0] - at[0]).hypot(eye[1] - at[1]),
            Support::Shackle { pivot, length } => (pivot[0] - eye[0]).hypot(pivot[1] - eye[1]) - length,
        };
        let places = self.sliders.iter().enumerate();
        let sliders: f64 = places.map(|(place, s)| s.stored_nmm(self.law(place))).sum();
        0.5 * self.values.stiffness * stretch_mm * stretch_mm + sliders
    }
}

/// First and second derivatives of the link's angle by (X, Y); zero where there is no link.
#[derive(Default)]
struct PinTurn {
    by: [f64; 2],
    hess: [f64; 3],
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values() -> MountValues {
        MountValues {
            stiffness: 1e6,
            rail_mu: 0.2,
            rail_constant_n: 3.0,
            pin_mu: 0.3,
            pin_radius_mm: 8.0,
            pivot_torque_nmm: 500.0,
            slide_law: SlipLaw::Presliding(2e5),
            turn_law: SlipLaw::Presliding(1e8),
        }
    }

    #[test]
    fn tangents_are_the_derivatives() {
        let supports = [
            (Support::Rail { level: 10.0 }, [400.0, 10.0005, 0.2]),
            (Support::Pin { at: [400.0, 10.0] }, [400.0003, 10.0005, 0.2]),
            (
                Support::Shackle {
                    pivot: [430.0, 90.0],
                    length: (900.0f64 + 6400.0).sqrt() + 1e-3,
                },
                [400.0, 10.0, 0.2],
            ),
        ];
        for (support, eye) in supports {
            let mut mount = Mount::new(support, values());
            // Stick at all places, then slip at all places.
            for away in [1e-9, 0.1] {
                mount.relax(&[eye[0] - away, eye[1] + 1e-6, eye[2] - away]);
                let exact = mount.evaluate(&eye, 1e-3, &[SlipState::Free; PLACES]).tangent;
                for j in 0..3 {
                    let at = |step: f64| {
                        let mut moved = eye;
                        moved[j] += step;
                        mount.evaluate(&moved, 1e-3, &[SlipState::Free; PLACES]).force
                    };
                    let (up, down) = (at(1e-8), at(-1e-8));
                    for i in 0..3 {
                        let numeric = (up[i] - down[i]) / 2e-8;
                        let e = exact[3 * i + j];
                        // Rounding: 1e-10 of 500 N over 2e-8; the effect of the pin torques on their own load is left out.
                        assert!(
                            (numeric - e).abs() < 2e-3 * e.abs() + 50.0,
                            "{support:?} K{i}{j}: {e} against {numeric}"
                        );
                    }
                }
            }
        }
    }
}
