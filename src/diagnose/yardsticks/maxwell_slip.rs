//! Ten Maxwell-slip elements in parallel, a spring and a viscous damper.
//!
//! ```text
//! F = a_0 + a_1 x + c v + sum s_i z_i,   dz_i = dx / l_i held within [-1, 1]
//! ```
//! x: displacement, mm. v: speed, mm/s. z_i: state of an element (spring and Coulomb slider in series, Jenkins), 0 at the start of a
//! recording. l_i: travel until it slides, mm, spaced by a constant factor. s_i: force at which it slides, N, not negative.
//! c: N s/mm, not negative.
//! Source: W. D. Iwan (1966); F. Al-Bender, V. Lampaert, J. Swevers (2005) for the name. The force is linear in the strengths, so the
//! fit has one minimum.

use super::super::course::Course;
use super::terms::{SPRING_AND_DAMPER, Terms, force_n, spring_and_damper, strengths, stroke_mm};
use super::{FittedYardstick, Yardstick};
use crate::model::friction::elements::Elements;

/// The entry of [`super::YARDSTICKS`].
pub(super) const YARDSTICK: Yardstick = Yardstick {
    name: "ten Maxwell-slip elements, spring, viscous damper",
    fit,
};

/// Number of elements.
const ELEMENTS: usize = 10;
/// Shortest and longest length as a share of the stroke: an element longer than half of it is a spring in every closed loop.
const SHORTEST: f64 = 0.002;
const LONGEST: f64 = 0.5;

fn fit(courses: &[Course], _threads: usize) -> Option<FittedYardstick> {
    let stroke_mm = stroke_mm(courses);
    let lengths_mm: [f64; ELEMENTS] = std::array::from_fn(|i| {
        let share = i as f64 / (ELEMENTS - 1) as f64;
        stroke_mm * SHORTEST * (LONGEST / SHORTEST).powf(share)
    });
    let terms = move |course: &Course| terms(course, lengths_mm);
    let mut not_negative = SPRING_AND_DAMPER.to_vec();
    not_negative.extend([true; ELEMENTS]);
    let of_courses: Vec<Terms> = courses.iter().map(terms).collect();
    let strengths = strengths(courses, &of_courses, &not_negative)?;
    Some(Box::new(move |course: &Course| {
        force_n(&terms(course), &strengths)
    }))
}

fn terms(course: &Course, lengths_mm: [f64; ELEMENTS]) -> Terms {
    let mut elements = Elements::new(lengths_mm);
    let mut states = vec![Vec::new(); ELEMENTS];
    let mut before_mm = course.displacement_mm.first().copied().unwrap_or(0.0);
    for &x in &course.displacement_mm {
        for (column, state) in states.iter_mut().zip(elements.advance(x - before_mm)) {
            column.push(*state);
        }
        before_mm = x;
    }
    let mut terms = spring_and_damper(course);
    terms.append(&mut states);
    terms
}
