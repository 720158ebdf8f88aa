//! Five-link spring with modified Dahl torques at its two inner joints. Source: Chula thesis, chapter V, eqs. 5-1 to 5-6.
//!
//! ```text
//! links   A-B, B-C (clamped middle), C-D, D-E (shackle), E-A (ground, theta5 = 180 deg); centre height y = Y - u
//! joint   dT/dphi = beta * (h - T s)^mu             (5-1)   s = sgn dphi, T torque as lever times joint force
//!         h = [(h_u + h_l) s + (h_u - h_l)] / 2     (5-2)   h_u = a u + b (5-3), h_l = d u + e (5-4)
//! force   F = T_B dphi_B/du + T_C dphi_C/du                 virtual work; the clamped middle does not turn
//! ```
//! u travel of the centre, mm; phi angle of a joint, rad; a and d slopes of the envelopes, N/mm; b and e their offsets, N; h
//! envelope that the joint approaches; F force, N. It does not depend on speed. It holds while the links reach the travel and
//! are not near a dead centre; beyond that the travel is limited.
//!
//! The thesis leaves some points open. They are read as follows:
//! - The envelopes are printed as force over travel (a in N/m, b in N), but the law acts on joint torque over joint angle. Each
//!   joint carries half of the envelope through its lever at installation, `l = du/dphi`: `T = l F_j`, `u_j = l phi_j`. In the
//!   installed position the pair gives exactly the printed lines. Away from it the geometry bends them.
//! - beta = 100 has no unit. Its argument is the angle of the joint, so it is read per radian (0.24 per mm of travel). Read per
//!   metre, each reversal would take 10 mm and a third of the loop in the thesis would be missing.
//! - L is not printed. AB = CD = 0.75 L (5-5). With A, D, theta1 and Y as printed, the whole length 2 L of the leaf also gives
//!   BC = 0.5 L, and 5-6 then gives L = 593 mm with the middle link level within a degree.
//! - beta has the unit N^(1-mu) per radian. With mu = 1 (the printed value) a step is exact, otherwise it has substeps.
//!
//! `preload_mm` is not in the thesis: Table 5-1 has 294 N at 0.03 mm, and the model of the thesis cannot give that.
//!
//! The spring cannot pull. Where the force would become negative the pusher leaves and the spring keeps its shape. The travel
//! where this happens is searched within the step, so that the shape does not depend on the step size.

use super::{BuildError, Model, Parameter, Plant, structure_numbers};

const fn envelope(
    name: &'static str,
    unit: &'static str,
    start: f64,
    bounds: [f64; 2],
    what: &'static str,
) -> Parameter {
    Parameter {
        name,
        unit,
        start,
        bounds,
        belief: bounds,
        what,
    }
}

/// The entry of [`super::MODELS`]. The starts are the final values of the thesis, without preload.
pub(crate) const MODEL: Model = Model {
    name: "five-link",
    what: "three-link spring with shackle and modified Dahl joints (Chula thesis, eqs. 5-1 to 5-6)",
    parameters: &[
        envelope(
            "upper_rate_n_per_mm",
            "N/mm",
            33.354,
            [0.1, 1000.0],
            "slope a of the upper envelope",
        ),
        envelope(
            "upper_offset_n",
            "N",
            499.07,
            [-5000.0, 5000.0],
            "offset b of the upper envelope",
        ),
        envelope(
            "lower_rate_n_per_mm",
            "N/mm",
            33.354,
            [0.1, 1000.0],
            "slope d of the lower envelope",
        ),
        envelope(
            "lower_offset_n",
            "N",
            -206.53,
            [-5000.0, 5000.0],
            "offset e of the lower envelope",
        ),
        Parameter {
            name: "beta_per_rad",
            unit: "1/rad",
            start: 100.0,
            bounds: [1.0, 1e5],
            belief: [20.0, 2e4],
            what: "rate at which a joint changes from one envelope to the other",
        },
        Parameter {
            name: "mu",
            unit: "",
            start: 1.0,
            bounds: [0.5, 2.0],
            belief: [0.7, 1.5],
            what: "exponent of the transition between the envelopes",
        },
        Parameter {
            name: "preload_mm",
            unit: "mm",
            start: 0.0,
            bounds: [0.0, 40.0],
            belief: [0.0, 20.0],
            what: "travel from the free spring to the displacement sensor's zero",
        },
    ],
    physics: &[
        "rate_independent_friction",
        "presliding",
        "coulomb_friction",
        "load_dependent_friction",
        "geometric_stiffness",
    ],
    slow: false,
    friction_ratio: None,
    limit_friction: None,
    build: |values, structure| {
        FiveLink::new(values, structure).map(|plant| Box::new(plant) as Box<dyn Plant>)
    },
};

/// Lengths in mm and angles in rad of the mechanism in the axes of 5-6: A at the origin, E at (AE, 0), y upwards.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LinkGeometry {
    ae: f64,
    de: f64,
    /// Length of AB and of CD, which are equal.
    ab: f64,
    bc: f64,
    theta2: f64,
    /// Height of the centre at installation, negative because the spring is below its eyes.
    y: f64,
}

/// Joint angles from the horizontal, and their derivatives by travel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pose {
    /// Opening angles of B and C, rad: theta1 and -theta3.
    phi: [f64; 2],
    /// Derivative dphi/du of each, rad/mm.
    slope: [f64; 2],
}

impl LinkGeometry {
    /// Eqs. 5-5 and 5-6 at installation, with L from the leaf's length where it is not given.
    fn new(structure: &toml::Table) -> Result<Self, BuildError> {
        let [ae, de, height, theta1_deg, theta4_deg, half_length] = structure_numbers(
            "five-link",
            structure,
            [
                ("ae_mm", 1190.0),
                ("de_mm", 100.0),
                ("height_mm", 150.0),
                ("theta1_deg", 340.0),
                ("theta4_deg", 70.0),
                ("half_length_mm", 0.0),
            ],
        )?;
        let (theta1, theta4) = (theta1_deg.to_radians(), theta4_deg.to_radians());
        let middle = |half_length: f64| {
            let ab = 0.75 * half_length;
            let (y1, x1) = (ab * theta1.sin(), ab * theta1.cos());
            let y2 = -2.0 * height - y1;
            let (x3, y3) = (ae - de * theta4.cos(), -de * theta4.sin());
            let theta3 = ((y3 - y2) / ab).asin();
            let x2 = x3 - ab * theta3.cos();
            let theta2 = ((y2 - y1) / (x2 - x1)).atan();
            (ab, (x2 - x1) / theta2.cos(), theta2)
        };
        let half_length = if half_length > 0.0 {
            half_length
        } else {
            // BC falls and 0.5 L rises with L, so there is one crossing: 60 bisections.
            let (mut low, mut high) = (0.25 * ae, ae);
            for _ in 0..60 {
                let mid = 0.5 * (low + high);
                let (_, bc, _) = middle(mid);
                // A length too short to close the mechanism gives NaN, which counts as too short.
                if bc < 0.5 * mid { high = mid } else { low = mid }
            }
            0.5 * (low + high)
        };
        let (ab, bc, theta2) = middle(half_length);
        if !(bc.is_finite() && bc > 0.0 && de > 0.0) {
            return Err(BuildError::Structure {
                model: "five-link",
                reason: format!(
                    "the links do not close with half_length_mm = {half_length:.1}: check ae_mm, de_mm, height_mm, theta1_deg and theta4_deg"
                ),
            });
        }
        Ok(LinkGeometry {
            ae,
            de,
            ab,
            bc,
            theta2,
            y: -height,
        })
    }

    /// Pose with the centre loaded by `travel_mm` from installation; `None` where the links do not reach.
    fn pose(&self, travel_mm: f64) -> Option<Pose> {
        let half_rise = 0.5 * self.bc * self.theta2.sin();
        let sin1 = (self.y + travel_mm - half_rise) / self.ab;
        let cos1 = (1.0 - sin1 * sin1).sqrt();
        let cx = self.ab * cos1 + self.bc * self.theta2.cos();
        let cy = self.y + travel_mm + half_rise;
        // D is the intersection of the circle of CD about C and of the shackle's circle about E, below the line C-E.
        let (ex, ey) = (self.ae - cx, -cy);
        let distance2 = ex * ex + ey * ey;
        let along = (self.ab * self.ab - self.de * self.de + distance2) / (2.0 * distance2);
        let across = (self.ab * self.ab / distance2 - along * along).sqrt();
        let (dx, dy) = (along * ex + across * ey, along * ey - across * ex);
        let (sin3, cos3) = (dy / self.ab, dx / self.ab);
        let (sin4, cos4) = ((ey - dy) / self.de, (ex - dx) / self.de);
        // Velocity of D along the shackle, from C and from E: the shackle does not stretch.
        let leverage = self.ab * (sin4 * cos3 - cos4 * sin3);
        let slope3 = (sin1 / cos1 * cos4 - sin4) / leverage;
        let pose = Pose {
            phi: [sin1.asin(), -sin3.atan2(cos3)],
            slope: [1.0 / (self.ab * cos1), -slope3],
        };
        // Near a dead centre the levers grow without bound. A lever of 5 % of CD is far outside any real spring.
        let works = leverage > 0.05 * self.ab && cos1 > 0.05;
        (works && pose.slope.iter().chain(&pose.phi).all(|v| v.is_finite())).then_some(pose)
    }
}

/// Longest step while the preload is applied, mm: the geometry changes little over it.
const LONGEST_STEP_MM: f64 = 0.5;
/// Bisections for the travel where the pusher leaves: from a metre to a nanometre.
const HALVINGS: u32 = 30;

/// One joint: its lever, its angle at installation, its angle now, rad, and its torque divided by the lever, N.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Joint {
    lever_mm: f64,
    phi_0: f64,
    phi: f64,
    force_n: f64,
}

/// The model ready to step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FiveLink {
    geometry: LinkGeometry,
    /// a, b of half the upper and d, e of half the lower envelope, N/mm and N.
    envelopes: [[f64; 2]; 2],
    beta_per_rad: f64,
    mu: f64,
    /// Travel from the free spring where the LVDT reads zero, mm.
    preload_mm: f64,
    /// Travel that the links can reach, mm.
    range_mm: [f64; 2],
    joints: [Joint; 2],
    /// Travel of the joints' last state, mm.
    travel_mm: f64,
    /// True where the pusher has left the spring at that travel.
    apart: bool,
}

impl FiveLink {
    /// From values in the order of [`MODEL`]'s parameters and the measured geometry.
    pub(crate) fn new(values: &[f64], structure: &toml::Table) -> Result<Self, BuildError> {
        let &[a, b, d, e, beta_per_rad, mu, preload_mm] = values else {
            return Err(BuildError::Structure {
                model: "five-link",
                reason: format!(
                    "{} values given for 7 parameters: give one for each",
                    values.len()
                ),
            });
        };
        let geometry = LinkGeometry::new(structure)?;
        let installed = geometry.pose(0.0).ok_or_else(|| BuildError::Structure {
            model: "five-link",
            reason: "the links are at a dead centre in the installed position: check theta4_deg and de_mm"
                .to_owned(),
        })?;
        let joint = |j: usize| Joint {
            lever_mm: 1.0 / installed.slope[j],
            phi_0: installed.phi[j],
            phi: installed.phi[j],
            force_n: 0.0,
        };
        let reach = |sign: f64| {
            let steps = (1..=500).take_while(|&i| geometry.pose(sign * f64::from(i)).is_some());
            sign * steps.last().map_or(0.0, f64::from)
        };
        let mut plant = FiveLink {
            geometry,
            envelopes: [[0.5 * a, 0.5 * b], [0.5 * d, 0.5 * e]],
            beta_per_rad,
            mu,
            preload_mm,
            range_mm: [reach(-1.0), reach(1.0)],
            joints: [joint(0), joint(1)],
            travel_mm: 0.0,
            apart: false,
        };
        plant.preload();
        Ok(plant)
    }

    /// Moves from the free spring to the travel where the LVDT reads zero.
    fn preload(&mut self) {
        let steps = (self.preload_mm / LONGEST_STEP_MM).ceil();
        for i in 1..=steps as u32 {
            self.go(self.preload_mm * f64::from(i) / steps);
        }
    }

    /// Moves to a travel from the free spring in one monotone step and returns the force.
    fn go(&mut self, travel_mm: f64) -> f64 {
        let travel_mm = travel_mm.clamp(self.range_mm[0], self.range_mm[1]);
        let Some((joints, force_n)) = self.trial(travel_mm) else {
            return 0.0;
        };
        if force_n >= 0.0 {
            (self.joints, self.travel_mm, self.apart) = (joints, travel_mm, false);
            return force_n;
        }
        if !self.apart {
            self.leave_before(travel_mm);
        }
        0.0
    }

    /// Joints and force after one monotone step to `travel_mm`; the state does not change.
    fn trial(&self, travel_mm: f64) -> Option<([Joint; 2], f64)> {
        let pose = self.geometry.pose(travel_mm)?;
        let joints = [
            self.turned(self.joints[0], pose.phi[0]),
            self.turned(self.joints[1], pose.phi[1]),
        ];
        let force = |(j, slope): (&Joint, f64)| j.force_n * j.lever_mm * slope;
        Some((joints, joints.iter().zip(pose.slope).map(force).sum()))
    }

    /// Moves to the travel where the force becomes zero on the way to `pulling_mm`.
    fn leave_before(&mut self, pulling_mm: f64) {
        let (mut pushes, mut pulls) = (self.travel_mm, pulling_mm);
        let mut left = None;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (pushes + pulls);
            match self.trial(middle) {
                Some((joints, force_n)) if force_n >= 0.0 => {
                    pushes = middle;
                    left = Some(joints);
                }
                _ => pulls = middle,
            }
        }
        self.joints = left.unwrap_or(self.joints);
        (self.travel_mm, self.apart) = (pushes, true);
    }

    /// Joint after a monotone rotation to `phi`: eqs. 5-1 to 5-4.
    fn turned(&self, joint: Joint, phi: f64) -> Joint {
        let dphi = phi - joint.phi;
        if dphi == 0.0 {
            return joint;
        }
        let direction = dphi.signum();
        let [rate, offset] = self.envelopes[usize::from(direction < 0.0)];
        let line = |phi: f64| rate * joint.lever_mm * (phi - joint.phi_0) + offset;
        // Distance to the envelope ahead, z = h - T s. It falls by beta z^mu and rises with the slope of the line.
        let z = direction * (line(joint.phi) - joint.force_n);
        let z = self.distance_after(z, rate * joint.lever_mm, dphi.abs());
        Joint {
            phi,
            force_n: line(phi) - direction * z,
            ..joint
        }
    }

    /// Solves `dz/dy = slope - beta sgn(z) |z|^mu` over `angle`; exact for mu = 1, else linearised over short substeps.
    fn distance_after(&self, mut z: f64, slope: f64, angle: f64) -> f64 {
        if self.mu == 1.0 {
            let end = slope / self.beta_per_rad;
            return end + (z - end) * (-self.beta_per_rad * angle).exp();
        }
        let rate = |z: f64| self.beta_per_rad * self.mu * z.abs().max(1e-3).powf(self.mu - 1.0);
        // A tenth of the local decay length per substep, at most 100 substeps. More would not change the result visibly.
        let substeps = (10.0 * rate(z) * angle).ceil().clamp(1.0, 100.0);
        let part = angle / substeps;
        for _ in 0..substeps as u32 {
            let decay = rate(z);
            let change = slope - self.beta_per_rad * z.signum() * z.abs().powf(self.mu);
            z += change * -(-decay * part).exp_m1() / decay;
        }
        z
    }
}

impl Plant for FiveLink {
    fn reset(&mut self) {
        for joint in &mut self.joints {
            joint.phi = joint.phi_0;
            joint.force_n = 0.0;
        }
        self.travel_mm = 0.0;
        self.apart = false;
        self.preload();
    }

    fn step(&mut self, displacement_mm: f64, _dt_s: f64) -> f64 {
        self.go(self.preload_mm + displacement_mm)
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests;
