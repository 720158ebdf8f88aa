//! Friction operators of the leaf contacts: friction force from travel and limiting friction.
//!
//! ```text
//! Prandtl-Ishlinskii   T = L sum w_i (x - p_i) / r_i,   p_i = min(max(p_i, x - r_i), x + r_i)
//! Bouc-Wen             dT/dx = L / l (1 - |T / L|^n (gamma + beta sgn(T dx)))
//! LuGre                dz/dx = 1 - a s |z| / L,   T = s z + d dz/dt,   a = 0 where z dx < 0 or s |z| < b L, rising to 1 at L
//! ```
//! T: friction force, N. L: limiting friction, N. x: displacement, mm. p_i, r_i, w_i: positions in mm, thresholds in mm and
//! weights of the plays. l: travel, mm. beta + gamma = 1. z: deflection of the bristles, mm. s: their stiffness, N/mm.
//! d: their damping, N s/mm. a, b: elastic up to a share b of the limit (P. Dupont et al., Single state elastoplastic friction models,
//! IEEE Trans. Automatic Control 47, 2002, equations 8 to 12), so that small loops close and larger ones do not.

use crate::truth::{TruthSpecimen, World};

/// Number of play operators.
const PLAYS: usize = 40;
/// Smallest limiting friction in N; below it a contact is open and has no friction.
const OPEN_N: f64 = 1e-9;
/// Largest sub-step of a differential equation, as a share of its travel.
const SUB_STEP: f64 = 0.1;
/// Range of the share of the limit up to which bristles are elastic.
const LEAST_ELASTIC: f64 = 0.1;
const MOST_ELASTIC: f64 = 0.8;
/// Share of the limit above which a contact slides.
const SLIDING: f64 = 1.0 - 1e-7;

/// State of the leaf contacts. It is copied for each trial of a joint, so it holds no pointer to its plays.
#[expect(clippy::large_enum_variant, reason = "a copy without an allocation")]
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FrictionOperator {
    /// Prandtl-Ishlinskii: displacement in mm, and threshold in mm, weight and position in mm of each play.
    Plays { x_mm: f64, plays: [[f64; 3]; PLAYS] },
    /// Bouc-Wen: friction in N, travel l in mm, exponent n and beta.
    Endochronic {
        friction_n: f64,
        travel_mm: f64,
        exponent: f64,
        beta: f64,
    },
    /// LuGre: deflection z, stiffness s, damping d, share b and friction T.
    Bristles {
        deflection_mm: f64,
        stiffness_n_per_mm: f64,
        damping_n_s_per_mm: f64,
        /// Share of the limit up to which they are elastic.
        elastic: f64,
        friction_n: f64,
    },
}

impl FrictionOperator {
    /// Contacts at rest that reverse over about `travel_mm`. `typical_n` is the limiting friction at half of the load, N.
    pub(super) fn at_rest(specimen: &TruthSpecimen, travel_mm: f64, typical_n: f64) -> FrictionOperator {
        let shape = specimen.power;
        match specimen.world {
            // The pack has its own contacts, see `stack`.
            World::Own | World::Pack | World::PrandtlIshlinskii => plays(travel_mm, shape),
            World::BoucWen => FrictionOperator::Endochronic {
                friction_n: 0.0,
                travel_mm,
                exponent: shape,
                beta: 0.5 + 0.12 * shape.min(3.0),
            },
            World::Lugre => {
                let stiffness_n_per_mm = typical_n.max(OPEN_N) / travel_mm;
                FrictionOperator::Bristles {
                    deflection_mm: 0.0,
                    stiffness_n_per_mm,
                    damping_n_s_per_mm: 1e-3 * shape * stiffness_n_per_mm,
                    elastic: LEAST_ELASTIC + (MOST_ELASTIC - LEAST_ELASTIC) * specimen.build,
                    friction_n: 0.0,
                }
            }
        }
    }

    /// The contacts after a travel in mm within `dt_s`, with the limiting friction `limit_n` in N.
    pub(super) fn moved(mut self, travel_mm: f64, dt_s: f64, limit_n: f64) -> FrictionOperator {
        match &mut self {
            FrictionOperator::Plays { x_mm, plays } => {
                *x_mm += travel_mm;
                for [threshold_mm, _, at_mm] in plays {
                    *at_mm = at_mm.clamp(*x_mm - *threshold_mm, *x_mm + *threshold_mm);
                }
            }
            FrictionOperator::Endochronic {
                friction_n,
                travel_mm: length_mm,
                exponent,
                beta,
            } => *friction_n = endochronic(*friction_n, travel_mm, limit_n, *length_mm, *exponent, *beta),
            FrictionOperator::Bristles {
                deflection_mm,
                stiffness_n_per_mm,
                damping_n_s_per_mm,
                elastic,
                friction_n,
            } => {
                let before_mm = *deflection_mm;
                if limit_n <= OPEN_N {
                    *deflection_mm = 0.0;
                } else if travel_mm != 0.0 {
                    let end_mm = limit_n / *stiffness_n_per_mm;
                    let along = travel_mm.signum() * before_mm / end_mm;
                    let bent = bristles(along, travel_mm.abs() / end_mm, *elastic);
                    *deflection_mm = travel_mm.signum() * end_mm * bent;
                }
                let speed = (*deflection_mm - before_mm) / dt_s.max(1e-6);
                *friction_n = *stiffness_n_per_mm * *deflection_mm + *damping_n_s_per_mm * speed;
            }
        }
        self
    }

    /// Friction force in N at the limiting friction `limit_n`.
    pub(super) fn force_n(&self, limit_n: f64) -> f64 {
        match self {
            FrictionOperator::Plays { x_mm, plays } => {
                let drag: f64 = plays.iter().map(|[r, w, p]| w * (x_mm - p) / r).sum();
                limit_n * drag
            }
            FrictionOperator::Endochronic { friction_n, .. }
            | FrictionOperator::Bristles { friction_n, .. } => *friction_n,
        }
    }
}

/// Plays with thresholds that are spaced in proportion, with weights of a Weibull density of the exponent `shape`.
fn plays(travel_mm: f64, shape: f64) -> FrictionOperator {
    let mut plays = [[0.0; 3]; PLAYS];
    for (k, play) in plays.iter_mut().enumerate() {
        let share = 0.02 * 300f64.powf((k as f64 + 0.5) / PLAYS as f64);
        // Density times threshold, because the spacing is in proportion to the threshold.
        *play = [
            0.5 * travel_mm * share,
            share.powf(shape) * (-share.powf(shape)).exp(),
            0.0,
        ];
    }
    let sum: f64 = plays.iter().map(|p| p[1]).sum();
    plays.iter_mut().for_each(|p| p[1] /= sum);
    FrictionOperator::Plays { x_mm: 0.0, plays }
}

/// Deflection of the bristles along the motion after a travel, both in units of the deflection at full sliding, by the method of
/// Runge and Kutta. They are elastic up to `elastic`, or where they are bent against the motion.
fn bristles(from: f64, travel: f64, elastic: f64) -> f64 {
    let slope = |z: f64| {
        let plastic = match z {
            z if z < elastic => 0.0,
            z if z < 1.0 => {
                let place = (z - 0.5 * (1.0 + elastic)) / (1.0 - elastic);
                0.5 * (std::f64::consts::PI * place).sin() + 0.5
            }
            _ => 1.0,
        };
        1.0 - plastic * z
    };
    let (mut z, mut left) = (from, travel);
    while left > 0.0 && (1.0 - z).abs() > 1.0 - SLIDING {
        let h = left.min(SUB_STEP);
        let a = slope(z);
        let b = slope(z + 0.5 * h * a);
        let c = slope(z + 0.5 * h * b);
        let d = slope(z + h * c);
        z += h / 6.0 * (a + 2.0 * b + 2.0 * c + d);
        left -= h;
    }
    z
}

/// Friction force in N after a travel in mm, by the method of Runge and Kutta.
fn endochronic(from_n: f64, travel_mm: f64, limit_n: f64, length_mm: f64, exponent: f64, beta: f64) -> f64 {
    if limit_n <= OPEN_N {
        return 0.0;
    }
    let sign = travel_mm.signum();
    // In units of the limit, positive along the travel.
    let slope = |z: f64| {
        let factor = if z >= 0.0 { 1.0 } else { 1.0 - 2.0 * beta };
        (1.0 - z.abs().powf(exponent) * factor) / length_mm
    };
    let mut z = sign * from_n / limit_n;
    let mut left_mm = travel_mm.abs();
    while left_mm > 0.0 {
        if z >= SLIDING {
            return sign * limit_n;
        }
        let h = left_mm.min(SUB_STEP * length_mm);
        let a = slope(z);
        let b = slope(z + 0.5 * h * a);
        let c = slope(z + 0.5 * h * b);
        let d = slope(z + h * c);
        z += h / 6.0 * (a + 2.0 * b + 2.0 * c + d);
        left_mm -= h;
    }
    sign * limit_n * z
}
