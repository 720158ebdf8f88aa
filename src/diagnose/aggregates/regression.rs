//! Straight lines through few points, with intervals that say how few they are.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::diagnosis::Value;
use crate::identify::confidence::student_975;

/// Figures are printed with four digits at most: no line through them is surer.
const ROUNDING: f64 = 5e-5;

/// A figure and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Estimate {
    /// Best value.
    pub value: f64,
    /// Standard error.
    pub error: f64,
    /// Points that were spare.
    pub spare: f64,
}

impl Estimate {
    /// 95 % interval (Student).
    pub(crate) fn ci95(&self) -> [f64; 2] {
        let half = student_975(self.spare) * self.error;
        [self.value - half, self.value + half]
    }

    /// The difference of two that know nothing of each other; as few spare points as the poorer has.
    pub(crate) fn minus(&self, other: &Estimate) -> Estimate {
        Estimate {
            value: self.value - other.value,
            error: self.error.hypot(other.error),
            spare: self.spare.min(other.spare),
        }
    }

    /// How sure it is that the value lies above `level`, 0 to 1 (two-sided).
    pub(crate) fn above(&self, level: f64) -> f64 {
        if self.value <= level {
            return 0.0;
        }
        within(
            self.spare,
            (self.value - level) / self.error.max(f64::MIN_POSITIVE),
        )
    }

    /// In other units.
    pub(crate) fn times(&self, factor: f64) -> Estimate {
        Estimate {
            value: factor * self.value,
            error: factor.abs() * self.error,
            ..*self
        }
    }

    /// For `diagnosis.json`.
    pub(crate) fn named(&self, name: impl Into<String>, unit: &str) -> Value {
        Value {
            name: name.into(),
            value: self.value,
            unit: unit.to_owned(),
            ci95: Some(self.ci95()),
        }
    }
}

/// Probability that Student's t with `spare` degrees lies within `-t..t`: with `x = sqrt(spare) tan a` its density is cos^(spare-1).
fn within(spare: f64, t: f64) -> f64 {
    const STEPS: usize = 400;
    let area = |to: f64| -> f64 {
        let at = |i: usize| (to * i as f64 / STEPS as f64).cos().max(0.0).powf(spare - 1.0);
        let sum: f64 = (1..=STEPS).map(|i| 0.5 * (at(i - 1) + at(i))).sum();
        sum * to / STEPS as f64
    };
    area((t / spare.sqrt()).atan()) / area(std::f64::consts::FRAC_PI_2)
}

/// A fit of `y` on the columns of `design`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RegressionLine {
    /// One a column.
    pub columns: Vec<Estimate>,
    /// Standard deviation of what is left.
    pub scatter: f64,
}

/// Least squares; none where no point is spare or the columns are alike.
pub(crate) fn line(design: &[Vec<f64>], y: &[f64]) -> Option<RegressionLine> {
    let (rows, columns) = (y.len(), design.first()?.len());
    if rows <= columns || y.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let x = DMatrix::from_fn(rows, columns, |i, j| design[i][j]);
    let normal = x.transpose() * &x;
    let inverse = normal.clone().try_inverse()?;
    // Columns that are alike leave an inverse of rounding errors.
    let condition: f64 = (0..columns)
        .map(|j| normal[(j, j)] * inverse[(j, j)])
        .fold(0.0, f64::max);
    if !condition.is_finite() || condition > 1e12 {
        return None;
    }
    let b = &inverse * (x.transpose() * DVector::from_column_slice(y));
    let left = DVector::from_column_slice(y) - &x * &b;
    let spare = (rows - columns) as f64;
    let size = y.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let scatter = (left.norm_squared() / spare).sqrt().max(ROUNDING * size);
    let columns = (0..columns).map(|j| Estimate {
        value: b[j],
        error: scatter * inverse[(j, j)].sqrt(),
        spare,
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
    fn probabilities_are_those_of_student_tables() {
        for (spare, t) in [(1.0, 12.706), (2.0, 4.303), (5.0, 2.571), (30.0, 2.042)] {
            assert!(
                (within(spare, t) - 0.95).abs() < 1e-3,
                "{spare}: {}",
                within(spare, t)
            );
        }
    }

    #[test]
    fn a_line_through_points_with_a_spare_one() {
        let design: Vec<Vec<f64>> = [0.0, 1.0, 2.0, 3.0].map(|x| vec![1.0, x]).to_vec();
        let fit = line(&design, &[1.0, 3.1, 4.9, 7.0]).expect("four points, two columns");
        assert!((fit.columns[1].value - 1.98).abs() < 1e-9);
        // Residuals 0.03, -0.05 ...: slope's error = scatter / sqrt(5).
        assert!((fit.columns[1].error * 5f64.sqrt() - fit.scatter).abs() < 1e-12);
        assert!(line(&design[..2], &[1.0, 2.0]).is_none(), "nothing is spare");
        let alike: Vec<Vec<f64>> = (0..4).map(|_| vec![1.0, 1.0]).collect();
        assert!(line(&alike, &[1.0, 2.0, 3.0, 4.0]).is_none());
    }
}
