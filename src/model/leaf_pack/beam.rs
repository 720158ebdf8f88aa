//! Beam force element between two rigid segments, in the plane and for any rotation.
//!
//! ```text
//! F = [K] x + [D] x'                          (1)   Kadziela et al. (2015)
//! K: EA/L, 12EI/L^3, 6EI/L^2, 4EI/L (2EI/L)   (2)   the planar part
//! D = xi diag(K)                              (4)
//! ```
//! F end forces, N, and moments, N mm; E Young's modulus, MPa; A and I area, mm2, and second moment, mm4, of the section; L arc
//! length, mm; xi damping time, s. x are the deformations without the rigid motion of the chord (corotational formulation:
//! Crisfield 1991, ch. 7): stretch of the chord, mm, and the two end angles against it, rad. So a rigid rotation gives no
//! force, and eq. 2 becomes EA/L and EI/L [4 2; 2 4] in the axes of the chord. The unstressed shape is an arc: a leaf keeps its
//! camber. It holds for small strains and without shear deformation.

use super::band::{M3, V3};

/// Constants of one element.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beam {
    /// Axial stiffness EA/L, N/mm.
    pub axial: f64,
    /// Bending stiffness EI/L, N mm per rad.
    pub bending: f64,
    /// Unstressed chord, mm.
    pub chord: f64,
    /// Half the unstressed arc's angle, rad.
    pub half_angle: f64,
    /// Arc length L, mm.
    pub length: f64,
}

/// Deformation in the axes of the chord: stretch, mm, and both end angles, rad.
pub(super) type Strain = V3;

/// End forces at one estimate, with the values that the tangent needs.
#[derive(Debug, Clone, Copy)]
pub(super) struct BeamForce {
    pub inner: V3,
    pub outer: V3,
    pub strain: Strain,
    cosine: f64,
    sine: f64,
    length: f64,
    normal: f64,
    moment: f64,
}

impl Beam {
    /// An element of arc `length_mm` and natural `curvature` (1/mm) of a rectangular section.
    pub(super) fn new(e_mpa: f64, width_mm: f64, thickness_mm: f64, length_mm: f64, curvature: f64) -> Self {
        let mut beam = Beam {
            axial: e_mpa * width_mm * thickness_mm / length_mm,
            bending: e_mpa * width_mm * thickness_mm.powi(3) / 12.0 / length_mm,
            chord: length_mm,
            half_angle: 0.0,
            length: length_mm,
        };
        beam.set_curvature(curvature);
        beam
    }

    pub(super) fn set_curvature(&mut self, curvature: f64) {
        self.half_angle = 0.5 * curvature * self.length;
        let h = self.half_angle;
        let ratio = if h.abs() < 1e-4 {
            1.0 - h * h / 6.0
        } else {
            h.sin() / h
        };
        self.chord = self.length * ratio;
    }

    /// End forces with the ends at `a` and `b`; `trig` is (cos, sin) of a's angle.
    /// `before` and `viscosity` (xi / dt, 0 for none) give the structural damping.
    #[inline]
    pub(super) fn force(&self, a: &V3, b: &V3, trig: [f64; 2], before: &Strain, viscosity: f64) -> BeamForce {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let l = (dx * dx + dy * dy).sqrt();
        let per_l = 1.0 / l;
        let (cosine, sine) = (dx * per_l, dy * per_l);
        // Angle of the chord against end a, so that rotations beyond pi are allowed.
        let turn = small_atan2(trig[0] * dy - trig[1] * dx, trig[0] * dx + trig[1] * dy);
        let strain = [
            l - self.chord,
            self.half_angle - turn,
            b[2] - a[2] - turn - self.half_angle,
        ];
        let ei = self.bending;
        let mut n = self.axial * strain[0];
        let mut ma = ei * (4.0 * strain[1] + 2.0 * strain[2]);
        let mut mb = ei * (2.0 * strain[1] + 4.0 * strain[2]);
        if viscosity != 0.0 {
            n += viscosity * self.axial * (strain[0] - before[0]);
            ma += viscosity * 4.0 * ei * (strain[1] - before[1]);
            mb += viscosity * 4.0 * ei * (strain[2] - before[2]);
        }
        let moment = ma + mb;
        let shear = moment * per_l;
        let (fx, fy) = (n * cosine + shear * sine, n * sine - shear * cosine);
        BeamForce {
            inner: [-fx, -fy, ma],
            outer: [fx, fy, mb],
            strain,
            cosine,
            sine,
            length: l,
            normal: n,
            moment,
        }
    }

    /// Tangent blocks (inner-inner, inner-outer, outer-outer); the fourth is the transpose of the second.
    pub(super) fn tangent(&self, f: &BeamForce, viscosity: f64) -> [M3; 3] {
        let (c, s, l) = (f.cosine, f.sine, f.length);
        let n_k = self.axial * (1.0 + viscosity);
        let d = self.bending * 4.0 * (1.0 + viscosity);
        let o = self.bending * 2.0;
        // Axial and shear stiffness in the axes of the chord, with the geometric part.
        let k_l = n_k;
        let k_t = (2.0 * d + 2.0 * o) / (l * l) + f.normal / l;
        let k_x = f.moment / (l * l);
        let a11 = k_l * c * c + k_t * s * s - 2.0 * k_x * c * s;
        let a12 = (k_l - k_t) * c * s + k_x * (c * c - s * s);
        let a22 = k_l * s * s + k_t * c * c + 2.0 * k_x * c * s;
        let m = (d + o) / l;
        let inner = [a11, a12, -m * s, a12, a22, m * c, -m * s, m * c, d];
        let cross = [-a11, -a12, -m * s, -a12, -a22, m * c, m * s, -m * c, o];
        let outer = [a11, a12, m * s, a12, a22, -m * c, m * s, -m * c, d];
        [inner, cross, outer]
    }

    /// Elastic energy, N mm.
    #[cfg(test)]
    pub(super) fn energy_nmm(&self, strain: &Strain) -> f64 {
        let [e, a, b] = *strain;
        0.5 * self.axial * e * e + self.bending * 2.0 * (a * a + a * b + b * b)
    }
}

/// atan2 for the small angles between a chord and its end: a series below 0.1 rad, the standard library beyond.
#[inline]
fn small_atan2(y: f64, x: f64) -> f64 {
    let z = y / x;
    if x > 0.0 && z.abs() < 0.1 {
        let q = z * z;
        // Odd series to z^17: the next term is below 1e-20 here.
        let p = 1.0 / 13.0 - q * (1.0 / 15.0 - q / 17.0);
        let p = 1.0 / 7.0 - q * (1.0 / 9.0 - q * (1.0 / 11.0 - q * p));
        z * (1.0 - q * (1.0 / 3.0 - q * (1.0 / 5.0 - q * p)))
    } else {
        y.atan2(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEAM: (f64, f64, f64, f64) = (207_000.0, 50.0, 6.15, 30.0);

    fn beam(curvature: f64) -> Beam {
        Beam::new(BEAM.0, BEAM.1, BEAM.2, BEAM.3, curvature)
    }

    fn forces(beam: &Beam, a: &V3, b: &V3) -> [f64; 6] {
        let f = beam.force(a, b, [a[2].cos(), a[2].sin()], &[0.0; 3], 0.0);
        [
            f.inner[0], f.inner[1], f.inner[2], f.outer[0], f.outer[1], f.outer[2],
        ]
    }

    #[test]
    fn rigid_rotation_gives_no_force() {
        let beam = beam(1e-3);
        for k in 0..=12 {
            let angle = 0.6 * f64::from(k);
            let h = beam.half_angle;
            let b = [
                3.0 + beam.chord * (angle + h).cos(),
                4.0 + beam.chord * (angle + h).sin(),
                angle + 2.0 * h,
            ];
            let worst = forces(&beam, &[3.0, 4.0, angle], &b)
                .iter()
                .fold(0.0f64, |m, f| m.max(f.abs()));
            // Rounding of 30 mm against EA/L = 2.1e6 N/mm.
            assert!(worst < 1e-7, "turn {angle:.1} rad: {worst:.1e} N");
        }
    }

    #[test]
    fn tangent_is_the_derivative() {
        let beam = beam(1e-3);
        let mut q = [
            1.0f64,
            2.0,
            0.3,
            1.0 + 29.99 * 0.33f64.cos(),
            2.0 + 29.99 * 0.33f64.sin(),
            0.37,
        ];
        let at = |q: &[f64; 6]| forces(&beam, &[q[0], q[1], q[2]], &[q[3], q[4], q[5]]);
        let f = beam.force(
            &[q[0], q[1], q[2]],
            &[q[3], q[4], q[5]],
            [q[2].cos(), q[2].sin()],
            &[0.0; 3],
            0.0,
        );
        let [aa, ab, bb] = beam.tangent(&f, 0.0);
        for j in 0..6 {
            let keep = q[j];
            q[j] = keep + 1e-6;
            let up = at(&q);
            q[j] = keep - 1e-6;
            let down = at(&q);
            q[j] = keep;
            for i in 0..6 {
                let numeric = (up[i] - down[i]) / 2e-6;
                let exact = match (i < 3, j < 3) {
                    (true, true) => aa[3 * i + j],
                    (true, false) => ab[3 * i + j - 3],
                    (false, true) => ab[3 * j + i - 3],
                    (false, false) => bb[3 * (i - 3) + j - 3],
                };
                // Central difference: rounding 1e-10 of the force over 2e-6, truncation below that.
                assert!(
                    (numeric - exact).abs() < 1e-5 * exact.abs() + 10.0,
                    "K{i}{j} {exact} against {numeric}"
                );
            }
        }
    }

    #[test]
    fn the_series_agrees_with_atan2() {
        for k in -20..=20 {
            let angle = 0.02 * f64::from(k);
            assert!((small_atan2(3.0 * angle.sin(), 3.0 * angle.cos()) - angle).abs() < 1e-15);
        }
    }
}
