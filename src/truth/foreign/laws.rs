//! Laws without memory: load, seat, joint, clipping, damping and fading over displacement, force and speed.
//!
//! Each function takes a [`Hidden`] of one code and does what the law of that number in `catalogue` says. Sizes and places have
//! the units of the catalogue. `top_mm` is the largest displacement and `top_n` the largest force.

use crate::truth::Hidden;
use crate::truth::world::Law;

/// Speed in mm/s at which every damping law has the force of linear damping of the same size.
const DAMPING_MM_S: f64 = 30.0;

/// The effect with a code.
pub(super) fn get<'a>(hidden: &'a [Hidden], code: &str) -> Option<&'a Hidden> {
    hidden.iter().find(|h| h.code == code)
}

/// The law of an effect; the first one if none was drawn.
pub(super) fn law(h: &Hidden) -> Law {
    h.law.unwrap_or(Law {
        number: 0,
        name: "",
        shape: 0.5,
    })
}

/// Rises from 0 with a smooth corner of width `w`, then in proportion to `u`.
fn soft_corner(u: f64, w: f64) -> f64 {
    let p = u / w.max(1e-12);
    if p > 30.0 { u } else { w * p.exp().ln_1p() }
}

/// Added load in N of a stiffness that rises beyond a knee.
pub(super) fn progressive_n(h: &Hidden, x_mm: f64, top_mm: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let u = x_mm - h.place;
    let span = (top_mm - h.place).max(1e-6);
    let above = u.max(0.0);
    h.size
        * match number {
            0 => soft_corner(u, (0.02 + 0.06 * shape) * top_mm),
            1 => {
                let power = 1.5 + 1.5 * shape;
                span * (above / span).powf(power) / power
            }
            2 => 0.5 * (above + (u - (0.2 + 0.4 * shape) * span).max(0.0)),
            _ => {
                let w = (0.1 + 0.3 * shape) * span;
                above - w * (1.0 - (-above / w).exp())
            }
        }
}

/// Added load in N of a link whose geometry changes the rate.
pub(super) fn geometric_n(h: &Hidden, x_mm: f64, top_mm: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let link = (1.2 + 1.8 * shape) * top_mm;
    let y = x_mm / link;
    h.size
        * link
        * link
        * match number {
            0 => y.exp() - 1.0 - y,
            1 => 0.5 * y.tan().powi(2),
            2 => 1.0 - (1.0 - y * y).max(0.0).sqrt(),
            _ => y - (1.0 + y).ln(),
        }
}

/// Displacement in mm of a specimen whose board touches it softly from `size` on.
pub(super) fn seated_mm(h: &Hidden, x_mm: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let u = x_mm - h.size;
    let w = (0.2 + 0.5 * shape) * h.size.abs();
    let above = u.max(0.0);
    match number {
        0 => soft_corner(u, 0.25 * w),
        1 => above * above / (above + w).max(1e-12),
        2 => 0.5 * (above + (u - w).max(0.0)),
        _ => {
            let points = [0.0, 0.25, 1.0, 2.25];
            points.iter().map(|p| (u - p * w).max(0.0)).sum::<f64>() / 4.0
        }
    }
}

/// Deformation in mm of a joint that stiffens under a force in N.
pub(super) fn joint_mm(h: &Hidden, force_n: f64, top_n: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let f = force_n.abs() / top_n;
    let bent = match number {
        0 => f / (1.0 + (1.0 + 2.0 * shape) * f),
        1 => f.powf(0.6 + 0.2 * shape),
        2 => {
            let closed = 0.2 + 0.3 * shape;
            closed * (1.0 - (-f / closed).exp())
        }
        _ => {
            let knee = 0.2 + 0.3 * shape;
            f.min(knee) + 0.2 * (f - knee).max(0.0)
        }
    };
    1e-3 * h.size * top_n * bent * force_n.signum()
}

/// Force in N that a saturated channel shows.
pub(in crate::truth) fn clipped_n(h: &Hidden, force_n: f64, top_n: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let limit = h.limit_n(top_n);
    let over = force_n - limit;
    match number {
        0 => force_n - soft_corner(over, (0.003 + 0.01 * shape) * limit),
        1 => {
            let power = 25.0 + 50.0 * shape;
            force_n / (1.0 + (force_n.max(0.0) / limit).powf(power)).powf(1.0 / power)
        }
        2 => force_n - (0.7 + 0.2 * shape) * over.max(0.0),
        _ => {
            let w = (0.005 + 0.02 * shape) * limit;
            match over {
                o if o < -w => force_n,
                o if o < w => limit - (w - o).powi(2) / (4.0 * w),
                _ => limit,
            }
        }
    }
}

/// Error of a LVDT over its reading `u`, 0 at both ends of the range (0 and 1), 1 where it is largest.
pub(super) fn bow(h: &Hidden, u: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    match number {
        0 => (std::f64::consts::PI * u).sin(),
        1 => {
            let corner = 0.3 + 0.4 * shape;
            (u / corner).min((1.0 - u) / (1.0 - corner))
        }
        2 => {
            let k = 2.0 + 6.0 * shape;
            let error = |u: f64| (k * u.max(0.0)).ln_1p() / k.ln_1p() - u;
            error(u) / error(1.0 / k.ln_1p() - 1.0 / k)
        }
        _ => {
            let power = 1.3 + 0.4 * shape;
            let error = |u: f64| u - u.max(0.0).powf(power);
            error(u) / error(power.powf(-1.0 / (power - 1.0)))
        }
    }
}

/// Damping force in N at a speed.
pub(super) fn damping_n(h: &Hidden, speed_mm_s: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let v = speed_mm_s.abs() / DAMPING_MM_S;
    let force = match number {
        0 => v.powf(0.5 + 0.3 * shape),
        1 => v.powf(1.3 + 0.7 * shape),
        2 => v.powf(0.3),
        _ => v * (1.0 + 1.0 / (0.5 + shape)) / (1.0 + v / (0.5 + shape)),
    };
    h.size * DAMPING_MM_S * force * speed_mm_s.signum()
}

/// Share of the added friction that is left at a speed.
pub(super) fn fading(h: &Hidden, speed_mm_s: f64) -> f64 {
    let v = speed_mm_s.abs() / h.place;
    match law(h).number {
        0 => 1.0 / (1.0 + v),
        1 => 1.0 / (1.0 + v * v),
        2 => (1.0 - 0.25 * (10.0 * v).ln_1p()).clamp(0.0, 1.0),
        _ => (1.0 - 0.5 * v).max(0.0),
    }
}

/// Limiting friction divided by load, relative to that at the largest force: friction grows with a power of the load.
pub(super) fn load_exponent(h: &Hidden) -> f64 {
    [0.8, 0.9, 1.1, 1.25][law(h).number.min(3)]
}

/// Zero of the load cell in N after a time in s.
pub(super) fn drift_n(h: &Hidden, time_s: f64) -> f64 {
    let Law { number, shape, .. } = law(h);
    let t = time_s.max(0.0);
    h.size / 60.0
        * match number {
            0 => {
                let constant = 20.0 + 40.0 * shape;
                constant * (1.0 - (-t / constant).exp())
            }
            1 => wander(t, shape),
            2 => {
                let period = 60.0 + 140.0 * shape;
                let turn = std::f64::consts::TAU / period;
                (turn * t).sin() / turn
            }
            _ => (60.0 * t).sqrt(),
        }
}

/// A path in s of the spectrum of a random walk: sines of random phase with an amplitude in proportion to their period. The
/// shape is the seed.
fn wander(time_s: f64, shape: f64) -> f64 {
    let mut seed = shape;
    let sines = (0..12).map(|k| {
        // Multiples of an irrational number are spread evenly over a turn.
        seed = (seed * 29.7 + 0.618_034).fract();
        let (phase, turn) = (seed * std::f64::consts::TAU, 0.03 * 1.5f64.powi(k));
        ((turn * time_s + phase).sin() - phase.sin()) * 0.4 / turn
    });
    sines.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hidden(number: usize, size: f64, place: f64) -> Hidden {
        Hidden {
            code: "",
            size,
            place,
            width: 2.0,
            law: Some(Law {
                number,
                name: "",
                shape: 0.5,
            }),
        }
    }

    #[test]
    fn a_rate_that_rises_is_zero_below_the_knee_and_no_more_than_its_size_above() {
        for number in 0..4 {
            let h = hidden(number, 10.0, 12.0);
            let load = |x: f64| progressive_n(&h, x, 20.0);
            // A soft corner reaches below the knee, by much less than the load at the top.
            assert!(load(8.0) < 0.05 * load(20.0) && load(20.0) > 0.0, "{number}");
            let rate = (load(20.0) - load(19.9)) / 0.1;
            assert!(rate > 4.0 && rate < 10.1, "{number}: {rate}");
        }
    }

    #[test]
    fn a_bow_is_zero_at_both_ends_and_one_where_it_is_largest() {
        for number in 0..4 {
            let h = hidden(number, 0.01, 0.0);
            assert!(
                bow(&h, 0.0).abs() < 1e-12 && bow(&h, 1.0).abs() < 1e-12,
                "{number}"
            );
            let most = (0..=1000)
                .map(|k| bow(&h, 1e-3 * f64::from(k)))
                .fold(0.0, f64::max);
            assert!((most - 1.0).abs() < 1e-3, "{number}: {most}");
        }
    }

    #[test]
    fn links_have_their_curvature_at_the_datum() {
        for number in 0..4 {
            let h = hidden(number, 0.5, 0.0);
            let load = |x: f64| geometric_n(&h, x, 20.0);
            // Second difference over 0.1 mm; the third derivative adds less than 1 %.
            let curvature = (load(0.2) - 2.0 * load(0.1)) / 0.01;
            assert!((curvature / 0.5 - 1.0).abs() < 0.02, "{number}: {curvature}");
        }
    }

    #[test]
    fn damping_laws_meet_at_one_speed_and_oppose_the_motion() {
        for number in 0..4 {
            let h = hidden(number, 0.2, 0.0);
            assert!((damping_n(&h, DAMPING_MM_S) - 6.0).abs() < 1e-9, "{number}");
            assert!((damping_n(&h, -7.0) + damping_n(&h, 7.0)).abs() < 1e-12 && damping_n(&h, 7.0) > 0.0);
        }
    }

    #[test]
    fn clipping_changes_nothing_far_below_and_holds_the_limit_above() {
        for number in 0..4 {
            let h = hidden(number, 0.1, 0.0);
            assert!((clipped_n(&h, 1200.0, 2000.0) - 1200.0).abs() < 0.5, "{number}");
            let shown = clipped_n(&h, 2000.0, 2000.0);
            assert!(shown < 1850.0 && shown > 1700.0, "{number}: {shown}");
        }
    }

    #[test]
    fn seats_and_joints_are_monotonic_and_start_at_zero() {
        for number in 0..4 {
            let h = hidden(number, 3.0, 0.0);
            let seat: Vec<f64> = (0..200).map(|k| seated_mm(&h, 0.1 * f64::from(k))).collect();
            assert!(
                seat[0] < 0.05 && seat.windows(2).all(|w| w[1] >= w[0]),
                "{number}"
            );
            let joint: Vec<f64> = (0..200)
                .map(|k| joint_mm(&h, 10.0 * f64::from(k), 2000.0))
                .collect();
            assert!(
                joint[0] == 0.0 && joint.windows(2).all(|w| w[1] > w[0]),
                "{number}"
            );
        }
    }
}
