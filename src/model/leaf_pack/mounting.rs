//! What holds an eye: the bearing on its rail, the pin in the frame, or the shackle; each with its friction.
//!
//! ```text
//! rail     F_y = k (Y - Y0), friction along x up to mu_rail |F_y| + constant
//! pin      F = k (P - P0)
//! shackle  F = k (l - L) along the link from eye P to pivot; its own pin turns by phi = atan2(dx, dy)
//! torque   up to mu_pin r |F| + constant, in every pin: slip is the angle between the two parts
//! ```
//! The eye is given by (X, Y) of its pin's centre and the angle of the leaf's last segment, X outward, Y away from the
//! pusher. Source of the friction budget: models.md's table; Kadziela et al. (2015), section 5.1, left it out.

use super::band::{M3, V3};
use super::friction::{Grip, Response, Slider, SlipLaw};

/// The kind of support with its geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Support {
    /// Linear bearing on the rail at height `level`.
    Rail { level: f64 },
    /// Pin fixed at a point.
    Pin { at: [f64; 2] },
    /// Link of `length` to a pivot.
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

/// The sliding places of one support.
pub(super) const PLACES: usize = 3;
/// The bearing on its rail.
pub(super) const RAIL: usize = 0;
/// The pin in the eye.
pub(super) const EYE_PIN: usize = 1;
/// The shackle's pin in the frame.
pub(super) const PIVOT: usize = 2;

/// One support with its state.
#[derive(Debug, Clone)]
pub(super) struct Mount {
    pub support: Support,
    pub values: MountValues,
    pub sliders: [Slider; PLACES],
}

/// One evaluation.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MountForce {
    /// Force on (X, Y, angle) as gradient of energy.
    pub force: V3,
    /// Its derivative.
    pub tangent: M3,
    pub grip: [Grip; PLACES],
    pub slip: [f64; PLACES],
    pub friction: [f64; PLACES],
    /// Share of each friction limit that is constant (not mu times load), for the energy's books.
    pub constant_share: [f64; PLACES],
    /// Elastic energy of the support itself, N mm.
    pub stored_nmm: f64,
}

impl Mount {
    pub(super) fn new(support: Support, values: MountValues) -> Self {
        Self {
            support,
            values,
            sliders: Default::default(),
        }
    }

    /// Starts the slips where the eye is now, without friction force.
    pub(super) fn relax(&mut self, eye: &V3) {
        for slider in &mut self.sliders {
            *slider = Slider::default();
        }
        let now = self.evaluate(eye, 1.0, &[Grip::Free; PLACES]);
        for (slider, slip) in self.sliders.iter_mut().zip(now.slip) {
            slider.release(slip);
        }
    }

    /// Law of one of its sliding places.
    pub(super) fn law(&self, place: usize) -> SlipLaw {
        if place == RAIL {
            self.values.slide_law
        } else {
            self.values.turn_law
        }
    }

    /// Force and tangent with the eye at (X, Y, angle). `last` are the grips of the last tangent (see [`Response::stuck`]).
    pub(super) fn evaluate(&self, eye: &V3, dt_s: f64, last: &[Grip; PLACES]) -> MountForce {
        let mut out = MountForce {
            grip: *last,
            ..MountForce::default()
        };
        let k = self.values.stiffness;
        match self.support {
            Support::Rail { level } => {
                out.grip[PIVOT] = Grip::Free;
                let gap = eye[1] - level;
                out.force[1] = k * gap;
                out.tangent[4] = k;
                out.stored_nmm = 0.5 * k * gap * gap;
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
                out.stored_nmm = 0.5 * k * (off[0] * off[0] + off[1] * off[1]);
                let carried = out;
                self.pin_friction(EYE_PIN, eye[2], &PinTurn::default(), &carried, dt_s, &mut out);
            }
            Support::Shackle { pivot, length } => self.link(eye, pivot, length, dt_s, &mut out),
        }
        out
    }

    /// A place's friction, noted in `out`; `out.grip` holds that of the last tangent until then.
    fn respond(&self, place: usize, slip: f64, limit: f64, dt_s: f64, out: &mut MountForce) -> Response {
        let law = self.law(place);
        let mut r = self.sliders[place].respond(law, slip, limit, dt_s);
        if out.grip[place].reversed(r.grip) {
            r = r.stuck(law);
        }
        out.slip[place] = slip;
        out.friction[place] = r.force;
        out.grip[place] = r.grip;
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

    /// Friction of a pin under the load `carried` that slips by `slip`: the angle itself (eye) and the link's.
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
        out.stored_nmm = 0.5 * f * (l - length);
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
        // Both pins carry the link's force; what their torques add to it is second order and left out.
        let carried = *out;
        let angle = dx.atan2(dy);
        self.pin_friction(EYE_PIN, eye[2] + angle, &turn, &carried, dt_s, out);
        self.pin_friction(PIVOT, angle, &turn, &carried, dt_s, out);
    }
}

/// Derivatives of the link's angle by (X, Y): zero where there is no link.
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
            // Stuck everywhere, then sliding everywhere.
            for away in [1e-9, 0.1] {
                mount.relax(&[eye[0] - away, eye[1] + 1e-6, eye[2] - away]);
                let exact = mount.evaluate(&eye, 1e-3, &[Grip::Free; PLACES]).tangent;
                for j in 0..3 {
                    let at = |step: f64| {
                        let mut moved = eye;
                        moved[j] += step;
                        mount.evaluate(&moved, 1e-3, &[Grip::Free; PLACES]).force
                    };
                    let (up, down) = (at(1e-8), at(-1e-8));
                    for i in 0..3 {
                        let numeric = (up[i] - down[i]) / 2e-8;
                        let e = exact[3 * i + j];
                        // Rounding: 1e-10 of 500 N over 2e-8; the pins' own reaction on their load is left out.
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
