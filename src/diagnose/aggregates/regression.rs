//! Least squares on few points, with Student's intervals.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::diagnosis::Value;
use crate::identify::confidence::{student_975, student_within};

/// Relative rounding of printed figures (four digits): the smallest scatter that is used.
const ROUNDING: f64 = 5e-5;

/// A value with its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Estimate {
    pub value: f64,
    /// Standard error of the value.
    pub error: f64,
    /// Degrees of freedom of the standard error.
    pub degrees: f64,
}

impl Estimate {
    /// 95 % interval (Student).
    pub(crate) fn ci95(&self) -> [f64; 2] {
        let half = student_975(self.degrees) * self.error;
        [self.value - half, self.value + half]
    }

    /// Difference of two independent estimates, with the smaller number of degrees of freedom.
    pub(crate) fn minus(&self, other: &Estimate) -> Estimate {
        Estimate {
            value: self.value - other.value,
            error: self.error.hypot(other.error),
            degrees: self.degrees.min(other.degrees),
        }
    }

    /// Two-sided confidence that the value is above `level`, 0 to 1.
    pub(crate) fn above(&self, level: f64) -> f64 {
        if self.value <= level {
            return 0.0;
        }
        let t = (self.value - level) / self.error.max(f64::MIN_POSITIVE);
        student_within(self.degrees, t)
    }

    /// The estimate times a factor.
    pub(crate) fn times(&self, factor: f64) -> Estimate {
        Estimate {
            value: factor * self.value,
            error: factor.abs() * self.error,
            ..*self
        }
    }

    /// The estimate as a value of `diagnosis.json`.
    pub(crate) fn named(&self, name: impl Into<String>, unit: &str) -> Value {
        Value {
            name: name.into(),
            value: self.value,
            unit: unit.to_owned(),
            ci95: Some(self.ci95()),
        }
    }
}

/// Coefficients of `y` on the columns of a design.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RegressionLine {
    /// One coefficient per column.
    pub columns: Vec<Estimate>,
    /// Standard deviation of the residuals.
    pub scatter: f64,
}

/// Least squares; `None` without a degree of freedom or where columns are collinear.
pub(crate) fn line(design: &[Vec<f64>], y: &[f64]) -> Option<RegressionLine> {
    let (rows, columns) = (y.len(), design.first()?.len());
    if rows <= columns || y.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let x = DMatrix::from_fn(rows, columns, |i, j| design[i][j]);
    let normal = x.transpose() * &x;
    let inverse = normal.clone().try_inverse()?;
    // The inverse of collinear columns consists of rounding errors.
    let condition: f64 = (0..columns)
        .map(|j| normal[(j, j)] * inverse[(j, j)])
        .fold(0.0, f64::max);
    if !condition.is_finite() || condition > 1e12 {
        return None;
    }
    let b = &inverse * (x.transpose() * DVector::from_column_slice(y));
    let left = DVector::from_column_slice(y) - &x * &b;
    let degrees = (rows - columns) as f64;
    let size = y.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let scatter = (left.norm_squared() / degrees).sqrt().max(ROUNDING * size);
    let columns = (0..columns).map(|j| Estimate {
        value: b[j],
        error: scatter * inverse[(j, j)].sqrt(),
        degrees,
    });
    Some(RegressionLine {
        columns: columns.collect(),
        scatter,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn confidences_are_those_of_student_tables() {
        for (degrees, t) in [(1.0, 12.706), (2.0, 4.303), (5.0, 2.571), (30.0, 2.042)] {
            let estimate = Estimate {
                value: 1.0 + 0.2 * t,
                error: 0.2,
                degrees,
            };
            let sure = estimate.above(1.0);
            assert!((sure - 0.95).abs() < 1e-3, "{degrees}: {sure}");
            assert!((estimate.ci95()[0] - 1.0).abs() < 1e-3 * t);
        }
    }

    #[test]
    fn a_line_through_four_points() {
        let design: Vec<Vec<f64>> = [0.0, 1.0, 2.0, 3.0].map(|x| vec![1.0, x]).to_vec();
        let fit = line(&design, &[1.0, 3.1, 4.9, 7.0]).expect("four points, two columns");
        assert!((fit.columns[1].value - 1.98).abs() < 1e-9);
        // Residuals 0.03, -0.05 ...: slope's error = scatter / sqrt(5).
        assert!((fit.columns[1].error * 5f64.sqrt() - fit.scatter).abs() < 1e-12);
        assert!(line(&design[..2], &[1.0, 2.0]).is_none(), "no degree of freedom");
        let collinear: Vec<Vec<f64>> = (0..4).map(|_| vec![1.0, 1.0]).collect();
        assert!(line(&collinear, &[1.0, 2.0, 3.0, 4.0]).is_none());
    }
}
