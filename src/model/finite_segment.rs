//! Finite-segment spring: three rigid segments, bilinear joint torque, friction in proportion to the torque.
//!
//! Source: Polach and Hajzman, Parameter identification of a leaf spring dynamic model (UIC spring, GRP and steel), eq. 1.
//!
//! ```text
//! torque    M_e = k1 q + (k2 - k1) G(q - q1)                  eq. 1; G is max(0, x), rounded over |x| < smoothing
//! friction  M_f = f (r_f / 1 m) |M_e| S(dq/dt / v_eps)        S(u) = u (3 - u^2) / 2, +-1 beyond |u| = 1
//! centre    w   = L [sin(q - c) + sin c] + l [cos p - cos p0] q joint angle, c camber, L outer segment
//! links         l sin p = l sin p0 - L [cos(q - c) - cos c]   l link, p its angle from the vertical
//! force     F   = 2 (M_e + b dq/dt + M_f) / (dw/dq)           virtual work of the two joints; symmetric, no inertia
//! ```
//! q joint angle, rad; M_e elastic and M_f friction torque, N mm; k1 and k2 stiffnesses, N mm/rad; b damping, N mm s/rad; w
//! displacement of the centre, mm; lengths in mm; F force, N. It holds for joint angles where dw/dq is at least 0.3 L.
//!
//! The paper leaves some points open. They are read as follows:
//! - The break "is made by the step function": here the stiffness steps (cubic 3 s^2 - 2 s^3 from q1 - smoothing to
//!   q1 + smoothing), so that the torque meets both straight lines and the stiffness never falls.
//! - The friction element has the elastic torque as its normal force, a coefficient f and an effective moment arm r_f:
//!   f * N * r_f with N = M_e / (1 m). So f and r_f enter as a product and no curve can separate them. (The quotient would make
//!   the friction four times the elastic torque. The product makes it 3.6 % for GRP and 8.1 % for steel.)
//! - v_eps is half the width of the range in which the sign of the velocity changes. Below it the friction falls with the speed.
//! - Lengths are not printed. 400 mm per segment (1200 mm from eye to eye) and the printed torques give 540 and
//!   1800 N/mm for GRP, 750 and 1650 N/mm for steel, which is usual for such springs. Camber 0.1 rad is assumed.
//! - The test stand has no shackles: the eyes slide freely (`link_length_mm = 0`). A vehicle has links.

use super::{BuildError, Model, Parameter, Plant, structure_numbers};

const NAME: &str = "finite-segment";
/// Lever that turns the elastic torque into the friction element's normal force: the paper's units (N m, m).
const UNIT_LEVER_MM: f64 = 1000.0;
/// Least motion of the centre per rad of joint angle, as a share of a segment. Below it the spring folds or the links stretch.
const LEAST_SLOPE: f64 = 0.3;

/// Values of one of the paper's tables in the order and units of this model, without material damping and preload.
const fn table(k1_nm: f64, k2_nm: f64, q1: f64, f: f64, r_f_m: f64, v_eps: f64) -> [f64; 8] {
    [k1_nm * 1e3, k2_nm * 1e3, q1, f, r_f_m * 1e3, v_eps, 0.0, 0.0]
}

/// Table 1, start of the GRP spring's identification.
pub(crate) const GRP_START: [f64; 8] = table(6e4, 1.7e5, 0.09, 0.7, 0.08, 0.3e-3);
/// Table 1, optimum of the GRP spring.
pub(crate) const GRP_OPTIMUM: [f64; 8] = table(43_224.0, 144_150.0, 0.0607, 0.3779, 0.0951, 0.5108e-3);
/// Table 2, start of the steel spring's identification.
pub(crate) const STEEL_START: [f64; 8] = table(7e4, 1.4e5, 0.12, 0.7, 0.08, 0.3e-3);
/// Table 2, optimum of the steel spring.
pub(crate) const STEEL_OPTIMUM: [f64; 8] = table(59_897.0, 132_300.0, 0.1365, 0.8542, 0.0948, 0.3170e-3);

/// The entry of [`super::MODELS`]. The starts are those of Table 1 (GRP).
pub(crate) const MODEL: Model = Model {
    name: NAME,
    what: "three rigid segments with bilinear torque and torque-proportional friction (Polach and Hajzman, eq. 1)",
    parameters: &[
        Parameter {
            name: "k1_nmm_per_rad",
            unit: "N mm/rad",
            start: GRP_START[0],
            bounds: [1e5, 1e10],
            belief: [1e7, 3e8],
            what: "torsional stiffness of a joint before the helper leaf is in contact",
        },
        Parameter {
            name: "k2_nmm_per_rad",
            unit: "N mm/rad",
            start: GRP_START[1],
            bounds: [1e5, 1e10],
            belief: [1e7, 1e9],
            what: "torsional stiffness of a joint beyond the break",
        },
        Parameter {
            name: "q1_rad",
            unit: "rad",
            start: GRP_START[2],
            bounds: [-0.5, 1.0],
            belief: [0.0, 0.4],
            what: "joint angle of the break",
        },
        Parameter {
            name: "f",
            unit: "",
            start: GRP_START[3],
            bounds: [0.0, 10.0],
            belief: [0.05, 1.0],
            what: "friction coefficient of the joint",
        },
        Parameter {
            name: "r_f_mm",
            unit: "mm",
            start: GRP_START[4],
            bounds: [0.0, 1000.0],
            belief: [10.0, 300.0],
            what: "effective moment arm of the joint's friction",
        },
        Parameter {
            name: "v_eps_rad_s",
            unit: "rad/s",
            start: GRP_START[5],
            bounds: [1e-7, 1.0],
            belief: [1e-5, 1e-2],
            what: "joint speed within which the friction changes its sign",
        },
        Parameter {
            name: "b_nmm_s_per_rad",
            unit: "N mm s/rad",
            start: 0.0,
            bounds: [0.0, 1e9],
            belief: [0.0, 1e7],
            what: "material damping of a joint",
        },
        Parameter {
            name: "preload_n",
            unit: "N",
            start: 0.0,
            bounds: [0.0, 100_000.0],
            belief: [0.0, 50_000.0],
            what: "force that the spring carries at the datum, without friction",
        },
    ],
    physics: &[
        "load_dependent_friction",
        "viscous_damping",
        "progressive_stiffness",
        "geometric_stiffness",
    ],
    slow: false,
    friction_ratio: None,
    limit_friction: None,
    build: |values, structure| {
        FiniteSegment::new(values, structure).map(|plant| Box::new(plant) as Box<dyn Plant>)
    },
};

/// Segments and links: displacement of the centre by joint angle.
#[derive(Debug, Clone, PartialEq)]
struct SegmentGeometry {
    segment_mm: f64,
    camber: f64,
    sin_camber: f64,
    cos_camber: f64,
    link_mm: f64,
    sin_link0: f64,
    cos_link0: f64,
    /// Joint angles within which the mechanism works, rad.
    range: [f64; 2],
}

impl SegmentGeometry {
    /// Widens `range` from the unloaded spring until dw/dq is too small.
    fn find_range(&mut self) {
        let works = |q: f64| self.centre(q).1 > LEAST_SLOPE * self.segment_mm;
        let reach = |direction: f64| {
            let steps = (1..300).take_while(|&i| works(0.01 * direction * f64::from(i)));
            0.01 * direction * steps.count() as f64
        };
        self.range = [reach(-1.0), reach(1.0)];
    }

    /// Centre displacement w in mm and dw/dq in mm/rad.
    fn centre(&self, q: f64) -> (f64, f64) {
        let (sin, cos) = (q - self.camber).sin_cos();
        let mut w = self.segment_mm * (sin + self.sin_camber);
        let mut slope = self.segment_mm * cos;
        if self.link_mm > 0.0 {
            let sin_link = (self.sin_link0 - self.segment_mm / self.link_mm * (cos - self.cos_camber))
                .clamp(-0.95, 0.95);
            let cos_link = (1.0 - sin_link * sin_link).sqrt();
            w += self.link_mm * (cos_link - self.cos_link0);
            slope -= self.segment_mm * sin * sin_link / cos_link;
        }
        (w, slope)
    }

    /// Joint angle at centre displacement `w`, and dw/dq there. The search begins at `q`.
    fn joint(&self, w: f64, q: f64) -> (f64, f64) {
        if self.link_mm == 0.0 {
            let sin = (w / self.segment_mm - self.sin_camber).clamp(-0.95, 0.95);
            return (
                sin.asin() + self.camber,
                self.segment_mm * (1.0 - sin * sin).sqrt(),
            );
        }
        let mut q = q;
        // Newton's method converges quadratically: from the angle of the last sample two iterations reach the rounding error.
        for _ in 0..20 {
            let (reached, slope) = self.centre(q);
            let correction = (w - reached) / slope;
            q = (q + correction).clamp(self.range[0], self.range[1]);
            if correction.abs() < 1e-13 {
                break;
            }
        }
        (q, self.centre(q).1)
    }
}

/// The model ready to step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FiniteSegment {
    geometry: SegmentGeometry,
    k1: f64,
    k2: f64,
    q1: f64,
    /// Friction torque divided by elastic torque, f * r_f / 1 m.
    friction: f64,
    v_eps: f64,
    b: f64,
    smoothing: f64,
    /// Joint angle, rad, and centre displacement, mm, at the datum.
    q_datum: f64,
    w_datum: f64,
    q: f64,
}

impl FiniteSegment {
    /// From values in the order of [`MODEL`]'s parameters. `structure` may have `segment_length_mm`, `camber_rad`,
    /// `smoothing_rad`, `link_length_mm` (0: eyes slide freely, as on the test stand) and `link_angle_rad`.
    pub(crate) fn new(values: &[f64], structure: &toml::Table) -> Result<Self, BuildError> {
        let &[k1, k2, q1, f, r_f_mm, v_eps, b, preload_n] = values else {
            return Err(refused(format!(
                "{} values given for 8 parameters: give one for each",
                values.len()
            )));
        };
        let [segment_mm, camber, smoothing, link_mm, link_angle] = structure_numbers(
            NAME,
            structure,
            [
                ("segment_length_mm", 400.0),
                ("camber_rad", 0.1),
                ("smoothing_rad", 0.005),
                ("link_length_mm", 0.0),
                ("link_angle_rad", 0.3),
            ],
        )?;
        let sane = segment_mm > 0.0
            && camber.abs() < 0.8
            && smoothing > 0.0
            && link_mm >= 0.0
            && link_angle.abs() < 1.2;
        if !sane {
            return Err(refused(
                "segment_length_mm and smoothing_rad must be above 0, link_length_mm 0 or more, camber_rad within -0.8 to 0.8 and \
                 link_angle_rad within -1.2 to 1.2: enter values in these ranges"
                    .to_owned(),
            ));
        }
        let mut plant = FiniteSegment {
            geometry: SegmentGeometry {
                segment_mm,
                camber,
                sin_camber: camber.sin(),
                cos_camber: camber.cos(),
                link_mm,
                sin_link0: link_angle.sin(),
                cos_link0: link_angle.cos(),
                range: [0.0; 2],
            },
            k1,
            k2,
            q1,
            friction: f * r_f_mm / UNIT_LEVER_MM,
            v_eps,
            b,
            smoothing,
            q_datum: 0.0,
            w_datum: 0.0,
            q: 0.0,
        };
        plant.geometry.find_range();
        plant.q_datum = plant.angle_at(preload_n)?;
        plant.w_datum = plant.geometry.centre(plant.q_datum).0;
        plant.q = plant.q_datum;
        Ok(plant)
    }

    /// Elastic torque of one joint, N mm.
    fn elastic_torque(&self, q: f64) -> f64 {
        let (x, width) = (q - self.q1, self.smoothing);
        // G is the integral of the cubic step: 0 before, x after, 2 width (s^3 - s^4 / 2) between.
        let beyond = if x <= -width {
            0.0
        } else if x >= width {
            x
        } else {
            let s = 0.5 * (x / width + 1.0);
            2.0 * width * s * s * s * (1.0 - 0.5 * s)
        };
        self.k1 * q + (self.k2 - self.k1) * beyond
    }

    /// Joint angle at which the elastic force alone is `force_n`.
    fn angle_at(&self, force_n: f64) -> Result<f64, BuildError> {
        if force_n == 0.0 {
            return Ok(0.0);
        }
        let elastic = |q: f64| 2.0 * self.elastic_torque(q) / self.geometry.centre(q).1;
        let (mut low, mut high) = (0.0, self.geometry.range[1]);
        if elastic(high) < force_n {
            return Err(refused(format!(
                "preload_n = {force_n} folds the spring: enter a smaller preload"
            )));
        }
        // Bisection until the interval is one rounding error wide.
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if elastic(middle) < force_n {
                low = middle;
            } else {
                high = middle;
            }
        }
        Ok(0.5 * (low + high))
    }
}

fn refused(reason: String) -> BuildError {
    BuildError::Structure { model: NAME, reason }
}

impl Plant for FiniteSegment {
    fn reset(&mut self) {
        self.q = self.q_datum;
    }

    fn step(&mut self, displacement_mm: f64, dt_s: f64) -> f64 {
        let (q, slope) = self.geometry.joint(displacement_mm + self.w_datum, self.q);
        let velocity = if dt_s > 0.0 { (q - self.q) / dt_s } else { 0.0 };
        self.q = q;
        let elastic = self.elastic_torque(q);
        let u = (velocity / self.v_eps).clamp(-1.0, 1.0);
        let sign = 0.5 * u * (3.0 - u * u);
        2.0 * (elastic + self.b * velocity + self.friction * elastic.abs() * sign) / slope
    }

    fn boxed_clone(&self) -> Box<dyn Plant> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(values: &[f64; 8], structure: &str) -> FiniteSegment {
        let structure = structure.parse().expect("valid TOML");
        FiniteSegment::new(values, &structure).expect("plausible values")
    }

    /// Force at `w` reached at a speed far above v_eps, loading (+1) or unloading (-1).
    fn sliding_force(plant: &mut FiniteSegment, w: f64, direction: f64) -> f64 {
        plant.step(w - direction, 1e-3);
        plant.step(w, 1e-3)
    }

    #[test]
    fn force_by_hand_on_the_test_stand() {
        let mut spring = plant(&GRP_OPTIMUM, "");
        // Flat spring: q = camber 0.1, lever 400 mm, M_e = 43224 * 0.1 + 100926 * 0.0393 N m.
        let w = 400.0 * 0.1f64.sin();
        let torque = (43_224.0 * 0.1 + (144_150.0 - 43_224.0) * (0.1 - 0.0607)) * 1e3;
        let friction = 0.3779 * 0.0951;
        for direction in [1.0, -1.0] {
            let expected = 2.0 * torque * (1.0 + direction * friction) / 400.0;
            let force_n = sliding_force(&mut spring, w, direction);
            // asin and sin in sequence: rounding only.
            assert!(
                (force_n / expected - 1.0).abs() < 1e-12,
                "{force_n} against {expected}"
            );
        }
    }

    #[test]
    fn the_torque_meets_both_lines_and_its_stiffness_never_falls() {
        let spring = plant(&STEEL_OPTIMUM, "smoothing_rad = 0.02");
        let (k1, k2, q1) = (spring.k1, spring.k2, spring.q1);
        assert_eq!(spring.elastic_torque(q1 - 0.02), k1 * (q1 - 0.02));
        let after = k1 * (q1 + 0.02) + (k2 - k1) * 0.02;
        assert!((spring.elastic_torque(q1 + 0.02) / after - 1.0).abs() < 1e-14);
        for i in -300..300 {
            let q = q1 + 1e-4 * f64::from(i);
            let stiffness = (spring.elastic_torque(q + 1e-6) - spring.elastic_torque(q - 1e-6)) / 2e-6;
            // Difference quotient of torques of 1e7: rounding leaves 1e-3 of a stiffness of 6e7.
            assert!(stiffness > k1 - 1.0 && stiffness < k2 + 1.0, "{stiffness} at {q}");
        }
    }

    #[test]
    fn links_obey_virtual_work() {
        let spring = plant(&GRP_OPTIMUM, "link_length_mm = 200.0");
        for q in [-0.1, 0.0, 0.05, 0.1, 0.2] {
            let (w, slope) = spring.geometry.centre(q);
            let difference = (spring.geometry.centre(q + 1e-6).0 - spring.geometry.centre(q - 1e-6).0) / 2e-6;
            // Central difference: error of the order of 1e-12 of the third derivative plus rounding 1e-7.
            assert!(
                (slope - difference).abs() < 1e-5,
                "{slope} against {difference} at {q}"
            );
            let (back, slope_back) = spring.geometry.joint(w, 0.02);
            assert!((back - q).abs() < 1e-12 && (slope_back - slope).abs() < 1e-8);
        }
    }

    #[test]
    fn links_change_the_force_as_their_geometry_says() {
        // Long upright links change nothing; short inclined links soften the spring.
        let force = |structure: &str| sliding_force(&mut plant(&GRP_OPTIMUM, structure), 30.0, 1.0);
        let stand = force("");
        let upright = force("link_length_mm = 100000.0\nlink_angle_rad = 0.0");
        assert!((upright / stand - 1.0).abs() < 1e-3, "{upright} against {stand}");
        assert!(force("link_length_mm = 150.0\nlink_angle_rad = 0.4") < 0.99 * stand);
    }

    #[test]
    fn friction_falls_below_the_switch_velocity_and_is_constant_above() {
        let mut values = GRP_OPTIMUM;
        values[5] = 1e-3;
        let half_width = |speed: f64| {
            let mut spring = plant(&values, "");
            let q = 0.1;
            let w = |q: f64| 400.0 * ((q - 0.1f64).sin() + 0.1f64.sin());
            let dt = 1e-3;
            spring.q = q - speed * dt;
            let up = spring.step(w(q), dt);
            spring.q = q + speed * dt;
            let down = spring.step(w(q), dt);
            (up - down) / (up + down)
        };
        let full = 0.3779 * 0.0951;
        // The step of 1e-7 rad out of 0.1 leaves nine digits of the speed.
        assert!((half_width(2e-3) / full - 1.0).abs() < 1e-9);
        assert!((half_width(0.5e-3) / full - 0.5 * 0.5 * 2.75).abs() < 1e-6);
        assert!(half_width(1e-6) / full < 2e-3);
    }

    #[test]
    fn the_preload_is_the_force_at_the_datum() {
        let mut values = STEEL_OPTIMUM;
        values[3] = 0.0;
        values[7] = 20_000.0;
        let mut spring = plant(&values, "link_length_mm = 200.0");
        assert!((spring.step(0.0, 1e-3) - 20_000.0).abs() < 1e-6);
        values[7] = 1e9;
        assert!(FiniteSegment::new(&values, &toml::Table::new()).is_err());
    }

    #[test]
    fn damping_is_proportional_to_speed() {
        let mut values = GRP_OPTIMUM;
        values[3] = 0.0;
        values[6] = 1e6;
        let mut spring = plant(&values, "");
        let still = {
            spring.step(10.0, 1e-3);
            spring.step(10.0, 1e-3)
        };
        spring.step(9.9, 1e-3);
        let moving = spring.step(10.0, 1e-3);
        let (q, slope) = spring.geometry.joint(10.0, 0.0);
        let (q0, _) = spring.geometry.joint(9.9, 0.0);
        let expected = 2.0 * 1e6 * (q - q0) / 1e-3 / slope;
        assert!(((moving - still) / expected - 1.0).abs() < 1e-9);
    }
}
