//! Contact of a leaf with the one above it: a sphere on an extruded surface (Kadziela et al. 2015, Fig. 1).
//!
//! ```text
//! gap   g = -eta - h + kappa xi^2 / 2          sphere centre (xi, eta) in the axes of the upper segment
//! slip  s = xi - rho (theta_lower - theta_upper)
//! force N = k (-g)  (penalty)   or   N = 4/3 E* sqrt(R) (-g)^(3/2)  (Hertz),  none where g > 0
//! ```
//! All lengths in mm: h distance of the two middle lines, rho sphere radius (half the thickness of the lower leaf), kappa
//! curvature of the upper leaf's face, 1/mm; N normal force, N; k stiffness, N/mm; E* reduced modulus, MPa; R sphere radius of
//! the Hertz law. Normal and friction force act along the gradients of g and s, so their work is exactly the energy that the
//! balance counts. It holds for contact near the station (xi small against the leaf's radius).

use super::band::{M3, V3};
use super::slip_law::SlipResponse;

/// Nodes and geometry of one contact.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contact {
    pub lower: usize,
    pub upper: usize,
    /// Distance of the two middle lines in contact, mm.
    pub standoff: f64,
    /// Sphere radius of the lower leaf, mm.
    pub sphere: f64,
    /// Curvature of the upper leaf's face, 1/mm.
    pub curvature: f64,
}

/// Normal law of a contact with its constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum NormalLaw {
    /// N = k d with the approach d, mm; k in N/mm.
    Penalty(f64),
    /// N = c d^1.5 with c in N/mm^1.5.
    Hertz(f64),
}

impl NormalLaw {
    /// Hertz's law of a sphere (radius in mm) on a plane, both of modulus `e_mpa` and Poisson's ratio 0.3.
    pub(crate) fn hertz(e_mpa: f64, radius_mm: f64) -> Self {
        let reduced = e_mpa / (2.0 * (1.0 - 0.3 * 0.3));
        NormalLaw::Hertz(4.0 / 3.0 * reduced * radius_mm.sqrt())
    }

    /// Force in N and stiffness in N/mm at an approach of `d` mm; nothing where the faces are apart.
    #[inline]
    pub(crate) fn force(self, d: f64) -> (f64, f64) {
        if d <= 0.0 {
            return (0.0, 0.0);
        }
        match self {
            NormalLaw::Penalty(k) => (k * d, k),
            NormalLaw::Hertz(c) => {
                let root = d.sqrt();
                (c * d * root, 1.5 * c * root)
            }
        }
    }

    /// Elastic energy at an approach of `d` mm, N mm.
    #[cfg(test)]
    pub(crate) fn energy_nmm(self, d: f64) -> f64 {
        let d = d.max(0.0);
        match self {
            NormalLaw::Penalty(k) => 0.5 * k * d * d,
            NormalLaw::Hertz(c) => 0.4 * c * d * d * d.sqrt(),
        }
    }
}

/// Gap and slip, mm, and their gradients by (x and y of the lower body against the upper one, upper angle, lower angle).
#[derive(Debug, Clone, Copy)]
pub(super) struct Measure {
    pub gap: f64,
    pub slip: f64,
    xi: f64,
    eta: f64,
    trig: [f64; 2],
    gap_by: [f64; 3],
    slip_by: [f64; 4],
}

impl Contact {
    #[inline]
    pub(super) fn measure(&self, upper: &V3, lower: &V3, trig: [f64; 2]) -> Measure {
        let [c, s] = trig;
        let (dx, dy) = (lower[0] - upper[0], lower[1] - upper[1]);
        let (xi, eta) = (c * dx + s * dy, c * dy - s * dx);
        let bend = self.curvature * xi;
        Measure {
            gap: 0.5 * bend * xi - eta - self.standoff,
            slip: xi - self.sphere * (lower[2] - upper[2]),
            xi,
            eta,
            trig,
            gap_by: [s + bend * c, bend * s - c, xi + bend * eta],
            slip_by: [c, s, eta + self.sphere, -self.sphere],
        }
    }
}

impl Measure {
    /// Forces on (upper, lower) from normal force `n` and friction `t`, as gradients of energy.
    #[inline]
    pub(super) fn forces(&self, n: f64, t: f64) -> (V3, V3) {
        let (g, s) = (&self.gap_by, &self.slip_by);
        let (fx, fy) = (t * s[0] - n * g[0], t * s[1] - n * g[1]);
        ([-fx, -fy, t * s[2] - n * g[2]], [fx, fy, t * s[3]])
    }

    /// Tangent blocks (upper-upper, upper-lower, lower-upper, lower-lower).
    pub(super) fn tangent(&self, curvature: f64, n: f64, n_by_d: f64, mu: f64, r: &SlipResponse) -> [M3; 4] {
        let g = [self.gap_by[0], self.gap_by[1], self.gap_by[2], 0.0];
        let s = self.slip_by;
        let mut k = [[0.0; 4]; 4];
        for i in 0..4 {
            for j in 0..4 {
                k[i][j] =
                    n_by_d * g[i] * g[j] + r.by_slip * s[i] * s[j] - r.by_limit * mu * n_by_d * s[i] * g[j];
            }
        }
        let [cos, sin] = self.trig;
        let (xi, eta, t) = (self.xi, self.eta, r.force);
        // Second derivatives, by (x, y, upper angle): the normal turns with the upper segment.
        let xi_by = [cos, sin, eta];
        for i in 0..3 {
            for j in 0..3 {
                k[i][j] -= n * curvature * xi_by[i] * xi_by[j];
            }
        }
        let w_xi = t - n * curvature * xi;
        let turn = [n * -cos - w_xi * sin, n * -sin + w_xi * cos];
        for i in 0..2 {
            k[i][2] += turn[i];
            k[2][i] += turn[i];
        }
        k[2][2] += -n * eta - w_xi * xi;
        let lower = |i: usize| if i == 2 { 3 } else { i };
        let sign = |i: usize| if i == 2 { 1.0 } else { -1.0 };
        let mut out = [[0.0; 9]; 4];
        for i in 0..3 {
            for j in 0..3 {
                let at = 3 * i + j;
                out[0][at] = sign(i) * sign(j) * k[i][j];
                out[1][at] = sign(i) * k[i][lower(j)];
                out[2][at] = sign(j) * k[lower(i)][j];
                out[3][at] = k[lower(i)][lower(j)];
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::leaf_pack::slip_law::{Slider, SlipLaw};

    /// Hertz (1882): d = (9 F^2 / (16 E*^2 R))^(1/3).
    #[test]
    fn hertz_approach() {
        let law = NormalLaw::hertz(207_000.0, 25.0);
        let (force, _) = law.force(0.01);
        let reduced = 207_000.0 / 1.82;
        let wanted = (9.0 * force * force / (16.0 * reduced * reduced * 25.0)).cbrt();
        assert!((wanted - 0.01).abs() < 1e-14, "{wanted}");
        assert_eq!(law.force(-0.01), (0.0, 0.0));
    }

    #[test]
    fn tangent_is_the_derivative() {
        let contact = Contact {
            lower: 0,
            upper: 1,
            standoff: 6.15,
            sphere: 3.0,
            curvature: 1e-3,
        };
        let slider = Slider::default();
        let (normal, slip_law, mu) = (NormalLaw::hertz(2e5, 20.0), SlipLaw::Presliding(2e5), 0.3);
        let at = |q: &[f64; 6]| {
            let (upper, lower) = ([q[0], q[1], q[2]], [q[3], q[4], q[5]]);
            let m = contact.measure(&upper, &lower, [upper[2].cos(), upper[2].sin()]);
            let (n, k) = normal.force(-m.gap);
            let r = slider.respond(slip_law, m.slip, mu * n, 1e-3);
            (m, n, k, r)
        };
        for shift in [1e-5, 0.4] {
            let mut q = [100.0f64, 20.0, 0.2, 0.0, 0.0, 0.21];
            let (sin, cos) = q[2].sin_cos();
            let xi = 0.03 + shift;
            let eta = 0.5 * 1e-3 * xi * xi - 6.15 + 0.006;
            q[3] = q[0] + cos * xi - sin * eta;
            q[4] = q[1] + sin * xi + cos * eta;
            let (m, n, k, r) = at(&q);
            let blocks = m.tangent(contact.curvature, n, k, mu, &r);
            for j in 0..6 {
                let keep = q[j];
                let force = |q: &[f64; 6]| {
                    let (m, n, _, r) = at(q);
                    let (u, l) = m.forces(n, r.force);
                    [u[0], u[1], u[2], l[0], l[1], l[2]]
                };
                q[j] = keep + 1e-7;
                let up = force(&q);
                q[j] = keep - 1e-7;
                let down = force(&q);
                q[j] = keep;
                for i in 0..6 {
                    let numeric = (up[i] - down[i]) / 2e-7;
                    let exact = blocks[2 * (i / 3) + j / 3][3 * (i % 3) + j % 3];
                    // Truncation of the 1.5 power and rounding, against stiffnesses of 1e5 to 1e6.
                    assert!(
                        (numeric - exact).abs() < 1e-4 * exact.abs() + 5.0,
                        "K{i}{j}: {exact} against {numeric}"
                    );
                }
            }
        }
    }
}
