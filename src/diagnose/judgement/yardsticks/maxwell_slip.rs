//! Ten Maxwell-slip elements in parallel, a spring and a viscous damper.
//!
//! ```text
//! F = a_0 + a_1 x + c v + sum s_i z_i,   dz_i = dx / l_i held within [-1, 1]
//! ```
//! x: displacement, mm. v: speed, mm/s. z_i: state of an element (spring and Coulomb slider in series, Jenkins), 0 at the start of a
//! recording. l_i: travel until it slides, mm, spaced by a constant factor. s_i: force at which it slides, N, not negative.
//! a_1, N/mm, and c, N s/mm: not negative.
//! Source: W. D. Iwan (1966); F. Al-Bender, V. Lampaert, J. Swevers (2005) for the name. The force is linear in the strengths, so the
//! fit has one minimum.

use super::terms::{Terms, force_n, spring_and_damper, strengths, stroke_mm};
use super::{FittedYardstick, Yardstick};
use crate::diagnose::course::Course;
use crate::model::friction::elements::Elements;
use crate::model::two_sided::{ELEMENTS, lengths_mm};

/// The entry of [`super::YARDSTICKS`].
pub(super) const YARDSTICK: Yardstick = Yardstick {
    name: "ten Maxwell-slip elements, spring, viscous damper",
    fit,
};

/// Shortest and longest length as a share of the stroke: an element longer than half of it is a spring in every closed loop.
const SHORTEST: f64 = 0.002;
const LONGEST: f64 = 0.5;

/// A fitted device.
pub(in super::super) struct FittedDevice {
    pub shortest_mm: f64,
    pub longest_mm: f64,
    /// Offset in N, rate in N/mm, damping in N s/mm, slip forces in N: the parameters of the model `two-sided`.
    pub strengths: Vec<f64>,
}

/// Fits the device to the points of the courses that are fitted.
pub(in super::super) fn device(courses: &[Course]) -> Option<FittedDevice> {
    let stroke_mm = stroke_mm(courses);
    let (shortest_mm, longest_mm) = (SHORTEST * stroke_mm, LONGEST * stroke_mm);
    let lengths_mm = lengths_mm(shortest_mm, longest_mm);
    // The longest element hardly slides in the recordings. A spring with a negative rate could cancel a large force of this element there,
    // but not on a longer stroke.
    let mut not_negative = vec![false, true, true];
    not_negative.extend([true; ELEMENTS]);
    let terms: Vec<Terms> = courses.iter().map(|course| terms(course, lengths_mm)).collect();
    Some(FittedDevice {
        shortest_mm,
        longest_mm,
        strengths: strengths(courses, &terms, &not_negative)?,
    })
}

fn fit(courses: &[Course], _threads: usize) -> Option<FittedYardstick> {
    let device = device(courses)?;
    Some(Box::new(move |course: &Course| {
        let lengths_mm = lengths_mm(device.shortest_mm, device.longest_mm);
        force_n(&terms(course, lengths_mm), &device.strengths)
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
