//! Cubic spring, Coulomb friction and a viscous damper.
//!
//! ```text
//! F = a_0 + a_1 x + a_2 x^2 + a_3 x^3 + R sgn(v) + c v
//! ```
//! x: displacement, mm. v: speed, mm/s; its sign is that of the branch. a_i: N/mm^i. R: N, not negative. c: N s/mm, not negative.
//! Source: the usual first model of a damper with friction, any textbook.

use super::terms::{Terms, force_n, spring_and_damper, strengths};
use super::{FittedYardstick, Yardstick};
use crate::diagnose::course::Course;

/// The entry of [`super::YARDSTICKS`].
pub(super) const YARDSTICK: Yardstick = Yardstick {
    name: "cubic spring, Coulomb friction, viscous damper",
    fit,
};

/// Which strengths are not negative: those of the damper and of the friction.
const NOT_NEGATIVE: [bool; 6] = [false, false, true, false, false, true];

fn fit(courses: &[Course], _threads: usize) -> Option<FittedYardstick> {
    let of_courses: Vec<Terms> = courses.iter().map(terms).collect();
    let strengths = strengths(courses, &of_courses, &NOT_NEGATIVE)?;
    Some(Box::new(move |course: &Course| {
        force_n(&terms(course), &strengths)
    }))
}

fn terms(course: &Course) -> Terms {
    let power = |n: i32| course.displacement_mm.iter().map(|x| x.powi(n)).collect();
    let mut terms = spring_and_damper(course);
    terms.extend([power(2), power(3), course.direction.clone()]);
    terms
}
