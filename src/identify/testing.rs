//! Small problems with known solutions, for the tests of the searches.

use super::objective::Residuals;
use crate::model::{BuildError, Parameter};

const fn parameter(name: &'static str, start: f64, bounds: [f64; 2]) -> Parameter {
    Parameter {
        name,
        unit: "",
        start,
        bounds,
        belief: bounds,
        what: "",
    }
}

/// Rosenbrock's valley: residuals 10 (y - x^2) and 1 - x, least at (1, 1).
pub(crate) struct Valley([Parameter; 2]);

impl Valley {
    pub(crate) fn new() -> Self {
        Valley([
            parameter("x", -1.2, [-2.0, 2.0]),
            parameter("y", 1.0, [-2.0, 2.0]),
        ])
    }
}

impl Residuals for Valley {
    fn parameters(&self) -> &[Parameter] {
        &self.0
    }
    fn count(&self) -> usize {
        2
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        out[0] = 10.0 * (values[1] - values[0] * values[0]);
        out[1] = 1.0 - values[0];
        Ok(())
    }
}

/// A minimum about every pi; the lowest is at 13.
pub(crate) struct Waves([Parameter; 1]);

impl Waves {
    pub(crate) fn new() -> Self {
        Waves([parameter("x", 6.9, [0.0, 20.0])])
    }
}

impl Residuals for Waves {
    fn parameters(&self) -> &[Parameter] {
        &self.0
    }
    fn count(&self) -> usize {
        2
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let x = values[0] - 13.0;
        out[0] = 0.5 * x;
        out[1] = 3.0 * x.sin();
        Ok(())
    }
}

/// `y = offset + slope * 0.05 i`.
pub(crate) struct StraightLine {
    parameters: [Parameter; 2],
    y: Vec<f64>,
}

impl StraightLine {
    pub(crate) fn new(y: Vec<f64>) -> Self {
        let parameters = [
            parameter("offset", 0.0, [-100.0, 100.0]),
            parameter("slope", 1.0, [-100.0, 100.0]),
        ];
        StraightLine { parameters, y }
    }
}

impl Residuals for StraightLine {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    fn count(&self) -> usize {
        self.y.len()
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for (i, (place, y)) in out.iter_mut().zip(&self.y).enumerate() {
            *place = y - values[0] - values[1] * 0.05 * i as f64;
        }
        Ok(())
    }
}

/// `y = first * second * x + third`; the data are 6 x + 1 with a zigzag of 0.05.
pub(crate) struct ProductLine([Parameter; 3]);

impl ProductLine {
    pub(crate) fn new() -> Self {
        ProductLine([
            parameter("first", 1.0, [0.1, 10.0]),
            parameter("second", 2.0, [0.1, 10.0]),
            parameter("third", 0.5, [-5.0, 5.0]),
        ])
    }
}

impl Residuals for ProductLine {
    fn parameters(&self) -> &[Parameter] {
        &self.0
    }
    fn count(&self) -> usize {
        20
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for (i, place) in out.iter_mut().enumerate() {
            let x = 0.1 * i as f64;
            let zigzag = if i % 2 == 0 { 0.05 } else { -0.05 };
            *place = 6.0 * x + 1.0 + zigzag - values[0] * values[1] * x - values[2];
        }
        Ok(())
    }
}
