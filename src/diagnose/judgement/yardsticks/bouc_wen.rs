//! Bouc-Wen hysteresis, a spring and a viscous damper.
//!
//! ```text
//! F = a_0 + a_1 x + c v + R z,   dz/dx = (1 - |z|^n (b sgn(z dx) + 1 - b)) / l
//! ```
//! x: displacement, mm. v: speed, mm/s. z: state, -1 to 1, 0 at the start of a recording. R: N, not negative. c: N s/mm, not
//! negative. l: length of the transition, mm. n: sharpness of the yield. b: 0.5 for a straight return after a reversal.
//! Source: R. Bouc (1967), Y. K. Wen (1976), with A = 1 and gamma = 1 - beta, so that z saturates at 1. b of at least 0.5 is the
//! condition that a closed loop takes energy.
//!
//! a_0, a_1, c and R are linear and solved for inside the residuals (variable projection); l, n and b are searched.

use super::terms::{SPRING_AND_DAMPER, Terms, force_n, spring_and_damper, strengths, stroke_mm};
use super::{FittedYardstick, Yardstick};
use crate::diagnose::course::{Course, Split};
use crate::identify::evaluator::Evaluator;
use crate::identify::least_squares::{LeastSquaresSettings, minimise};
use crate::identify::{FitControl, Residuals};
use crate::model::{BuildError, Parameter};

/// The entry of [`super::YARDSTICKS`].
pub(super) const YARDSTICK: Yardstick = Yardstick {
    name: "Bouc-Wen, spring, viscous damper",
    fit,
};

/// Largest step of the state as a share of its length, and most steps from point to point: after 4 lengths it is saturated.
const STEP: f64 = 0.25;
const MOST_STEPS: f64 = 16.0;

/// The searched parameters. The length is a share of the stroke, so that the same range serves every specimen.
const PARAMETERS: [Parameter; 3] = [
    parameter("length_per_stroke", 0.05, [1e-3, 1.0]),
    parameter("sharpness", 1.0, [0.3, 6.0]),
    parameter("return_shape", 0.6, [0.5, 3.0]),
];

const fn parameter(name: &'static str, start: f64, bounds: [f64; 2]) -> Parameter {
    Parameter {
        name,
        unit: "",
        start,
        bounds,
        belief: bounds,
        what: "shape of the Bouc-Wen loop",
    }
}

fn fit(courses: &[Course], threads: usize) -> Option<FittedYardstick> {
    let problem = BoucWenProblem {
        courses,
        stroke_mm: stroke_mm(courses),
        count: courses.iter().map(|c| c.points(Split::Fit).count()).sum(),
    };
    let settings = LeastSquaresSettings {
        iterations: 12,
        cost_tolerance: 1e-4,
        step_tolerance: 1e-3,
        screened: 12,
        starts: 3,
        ..LeastSquaresSettings::default()
    };
    let start = PARAMETERS.map(|p| p.start);
    let bounds = PARAMETERS.map(|p| p.bounds);
    let mut evaluator = Evaluator::new(&problem, threads);
    let optimum = minimise(&mut evaluator, &start, &bounds, &settings, 1, &mut |_| {
        FitControl::Continue
    });
    let shape = problem.shape(&optimum.values);
    let strengths = problem.strengths(&problem.terms(shape))?;
    Some(Box::new(move |course: &Course| {
        force_n(&terms(course, shape), &strengths)
    }))
}

/// Shape of the loop, with the length in mm.
#[derive(Clone, Copy)]
struct Shape {
    length_mm: f64,
    sharpness: f64,
    return_shape: f64,
}

impl Shape {
    /// Slope of the state over the travel in lengths, moving in the direction `sign`.
    fn slope(&self, state: f64, sign: f64) -> f64 {
        let size = state.abs();
        if size == 0.0 {
            return 1.0;
        }
        let grip = if state * sign > 0.0 {
            1.0
        } else {
            1.0 - 2.0 * self.return_shape
        };
        1.0 - grip * (self.sharpness * size.ln()).exp()
    }

    /// The state after a travel: Heun's method.
    fn moved(&self, mut state: f64, travel_mm: f64) -> f64 {
        let lengths = travel_mm / self.length_mm;
        let steps = (lengths.abs() / STEP).ceil().clamp(1.0, MOST_STEPS);
        // What is beyond the most steps changes nothing: the state is saturated.
        let step = lengths.clamp(-STEP * steps, STEP * steps) / steps;
        let sign = step.signum();
        for _ in 0..steps as usize {
            let here = self.slope(state, sign);
            let there = self.slope((state + step * here).clamp(-1.0, 1.0), sign);
            state = (state + 0.5 * step * (here + there)).clamp(-1.0, 1.0);
        }
        state
    }
}

fn terms(course: &Course, shape: Shape) -> Terms {
    let mut state = 0.0;
    let mut before_mm = course.displacement_mm.first().copied().unwrap_or(0.0);
    let states = course.displacement_mm.iter().map(|&x| {
        state = shape.moved(state, x - before_mm);
        before_mm = x;
        state
    });
    let states = states.collect();
    let mut terms = spring_and_damper(course);
    terms.push(states);
    terms
}

/// The shape as a problem of identification.
struct BoucWenProblem<'a> {
    courses: &'a [Course],
    stroke_mm: f64,
    /// Number of fitted points.
    count: usize,
}

impl BoucWenProblem<'_> {
    fn shape(&self, values: &[f64]) -> Shape {
        Shape {
            length_mm: values[0] * self.stroke_mm,
            sharpness: values[1],
            return_shape: values[2],
        }
    }

    fn terms(&self, shape: Shape) -> Vec<Terms> {
        self.courses.iter().map(|course| terms(course, shape)).collect()
    }

    fn strengths(&self, terms: &[Terms]) -> Option<Vec<f64>> {
        let mut not_negative = SPRING_AND_DAMPER.to_vec();
        not_negative.push(true);
        strengths(self.courses, terms, &not_negative)
    }
}

impl Residuals for BoucWenProblem<'_> {
    fn parameters(&self) -> &[Parameter] {
        &PARAMETERS
    }

    fn count(&self) -> usize {
        self.count
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let terms = self.terms(self.shape(values));
        let Some(strengths) = self.strengths(&terms) else {
            out.fill(f64::NAN);
            return Ok(());
        };
        let mut out = out.iter_mut();
        for (course, terms) in self.courses.iter().zip(&terms) {
            let model_n = force_n(terms, &strengths);
            for (i, place) in course.points(Split::Fit).zip(&mut out) {
                *place = course.force_n[i] - model_n[i];
            }
        }
        Ok(())
    }
}
