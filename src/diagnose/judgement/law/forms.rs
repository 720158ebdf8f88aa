//! The shortest equation within the band of a table. Forms are listed in [`FORMS`]; each is linear in two or three coefficients
//! and is searched over the values of at most two shape parameters.

use std::fmt::Write as _;

use nalgebra::{DMatrix, DVector};

use crate::diagnose::diagnosis::Exponent;
use crate::effect::Axis;
use crate::effect::law::ForceLaw;

/// A table is known to no better than this share of its range, however many cycles were averaged.
const FORM_ERROR: f64 = 0.02;
/// Rise of chi-square at the ends of a 95 % interval of one parameter.
const CHI_SQUARE_95: f64 = 3.84;
/// Values of a shape parameter that are tried, over its range.
const SHAPES: usize = 48;
/// Powers that are tried.
const POWERS: [f64; 2] = [0.1, 4.0];

/// An equation with its place in the order of the forms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Equation {
    pub text: String,
    /// Power of the axis with its interval, where the form has one.
    pub exponent: Option<Exponent>,
}

/// A form of an equation: columns of the coefficients at a place, for the values of its shape parameters.
struct EquationForm {
    /// Number of coefficients.
    coefficients: usize,
    /// Ranges of the shape parameters for places from `low` to `high`.
    shapes: fn(low: f64, high: f64) -> Vec<[f64; 2]>,
    columns: fn(place: f64, shapes: &[f64]) -> Vec<f64>,
    /// The equation as text. Coefficients and shapes are numbers, the axis is a symbol with its unit.
    text: fn(coefficients: &[f64], shapes: &[f64], axis: &Symbol) -> String,
    /// True if the first shape parameter is a power.
    is_power: bool,
}

/// Symbol and unit of an axis, and unit of the values.
struct Symbol {
    z: &'static str,
    unit: &'static str,
    force: &'static str,
}

/// All forms, the shortest first.
static FORMS: &[EquationForm] = &[
    EquationForm {
        coefficients: 1,
        shapes: |_, _| vec![],
        columns: |_, _| vec![1.0],
        text: |c, _, s| format!("{}{}", number(c[0]), s.force),
        is_power: false,
    },
    EquationForm {
        coefficients: 2,
        shapes: |_, _| vec![],
        columns: |z, _| vec![1.0, z],
        text: |c, _, s| format!("{}{} {} {}", number(c[0]), s.force, signed(c[1]), with_unit(s)),
        is_power: false,
    },
    // A power of the axis, through zero.
    EquationForm {
        coefficients: 1,
        shapes: |_, _| vec![POWERS],
        columns: |z, p| vec![z.abs().powf(p[0])],
        text: |c, p, s| format!("{} ({} / {})^{:.2}{}", number(c[0]), s.z, s.unit, p[0], s.force),
        is_power: true,
    },
    // A rise that settles, or a fall.
    EquationForm {
        coefficients: 2,
        shapes: |low, high| vec![[0.02 * (high - low), 3.0 * (high - low)]],
        columns: |z, p| vec![1.0, (-z / p[0]).exp()],
        text: |c, p, s| {
            format!(
                "{}{} {} exp(-{} / {} {})",
                number(c[0]),
                s.force,
                signed(c[1]),
                s.z,
                number(p[0]),
                s.unit
            )
        },
        is_power: false,
    },
    // A step.
    EquationForm {
        coefficients: 2,
        shapes: |low, high| vec![[low, high], [0.01 * (high - low), 0.3 * (high - low)]],
        columns: |z, p| vec![1.0, ((z - p[0]) / p[1]).tanh()],
        text: |c, p, s| {
            format!(
                "{}{} {} tanh(({} - {}) / {} {})",
                number(c[0]),
                s.force,
                signed(c[1]),
                s.z,
                number(p[0]),
                number(p[1]),
                s.unit
            )
        },
        is_power: false,
    },
    // A bump.
    EquationForm {
        coefficients: 2,
        shapes: |low, high| vec![[low, high], [0.02 * (high - low), 0.5 * (high - low)]],
        columns: |z, p| vec![1.0, (-((z - p[0]) / p[1]).powi(2)).exp()],
        text: |c, p, s| {
            format!(
                "{}{} {} exp(-(({} - {}) / {} {})^2)",
                number(c[0]),
                s.force,
                signed(c[1]),
                s.z,
                number(p[0]),
                number(p[1]),
                s.unit
            )
        },
        is_power: false,
    },
    // A contact: a power beyond a place.
    EquationForm {
        coefficients: 2,
        shapes: |low, high| vec![[0.8, POWERS[1]], [low, high]],
        columns: |z, p| vec![1.0, (z - p[1]).max(0.0).powf(p[0])],
        text: |c, p, s| {
            format!(
                "{}{} {} (({} - {}) / {})^{:.2} beyond {} {}",
                number(c[0]),
                s.force,
                signed(c[1]),
                s.z,
                number(p[1]),
                s.unit,
                p[0],
                number(p[1]),
                s.unit
            )
        },
        is_power: true,
    },
    // A ripple.
    EquationForm {
        coefficients: 3,
        shapes: |low, high| vec![[0.08 * (high - low), 1.5 * (high - low)]],
        columns: |z, p| {
            let angle = std::f64::consts::TAU * z / p[0];
            vec![1.0, angle.sin(), angle.cos()]
        },
        text: |c, p, s| {
            format!(
                "{}{} + {} sin(2 pi {} / {} {} {})",
                number(c[0]),
                s.force,
                number(c[1].hypot(c[2])),
                s.z,
                number(p[0]),
                s.unit,
                signed(c[2].atan2(c[1]))
            )
        },
        is_power: false,
    },
];

/// A form at its best shapes.
struct FormFit {
    chi_square: f64,
    coefficients: Vec<f64>,
    shapes: Vec<f64>,
}

/// The form with the lowest Bayesian information criterion; `band` is the standard deviation of each value.
pub(super) fn shortest(law: &ForceLaw, band: &[f64]) -> Equation {
    let table = LawTable::new(law, band);
    let symbol = symbol(law);
    let mut best: Option<(f64, Equation)> = None;
    for form in FORMS {
        let ranges = (form.shapes)(table.low, table.high);
        let Some(fitted) = table.fit(form, &ranges) else {
            continue;
        };
        let parameters = (form.coefficients + ranges.len()) as f64;
        let criterion = fitted.chi_square + parameters * (table.at.len() as f64).ln();
        if best.as_ref().is_none_or(|(least, _)| criterion < *least) {
            let text = (form.text)(&fitted.coefficients, &fitted.shapes, &symbol);
            let exponent = form.is_power.then(|| table.exponent(form, &ranges, &fitted));
            best = Some((criterion, Equation { text, exponent }));
        }
    }
    best.map_or(
        Equation {
            text: "no short equation is within the band: use the table".to_owned(),
            exponent: None,
        },
        |(_, equation)| equation,
    )
}

/// Places, values and standard deviations of a law.
struct LawTable<'a> {
    at: &'a [f64],
    force: &'a [f64],
    sigma: Vec<f64>,
    low: f64,
    high: f64,
}

impl<'a> LawTable<'a> {
    fn new(law: &'a ForceLaw, band: &[f64]) -> LawTable<'a> {
        let (low, high) = law
            .force
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), f| {
                (l.min(*f), h.max(*f))
            });
        let floor = (FORM_ERROR * (high - low)).max(f64::MIN_POSITIVE.sqrt());
        LawTable {
            sigma: band.iter().map(|sigma| sigma.hypot(floor)).collect(),
            low: law.at[0],
            high: law.at[law.at.len() - 1],
            at: &law.at,
            force: &law.force,
        }
    }

    /// The best shapes of a form on a grid, refined once around the best.
    fn fit(&self, form: &EquationForm, ranges: &[[f64; 2]]) -> Option<FormFit> {
        let mut ranges = ranges.to_vec();
        let mut best: Option<FormFit> = None;
        for _ in 0..3 {
            for shapes in grid(&ranges) {
                let found = self.coefficients(form, &shapes);
                if let Some(found) = found
                    && best.as_ref().is_none_or(|b| found.chi_square < b.chi_square)
                {
                    best = Some(found);
                }
            }
            let middle = &best.as_ref()?.shapes;
            ranges = ranges
                .iter()
                .zip(middle)
                .map(|([low, high], at)| {
                    let step = (high - low) / SHAPES as f64;
                    [(at - 2.0 * step).max(*low), (at + 2.0 * step).min(*high)]
                })
                .collect();
        }
        best
    }

    /// Coefficients of a form at fixed shapes by weighted least squares.
    fn coefficients(&self, form: &EquationForm, shapes: &[f64]) -> Option<FormFit> {
        let rows: Vec<Vec<f64>> = self.at.iter().map(|z| (form.columns)(*z, shapes)).collect();
        let matrix = DMatrix::from_fn(rows.len(), form.coefficients, |i, j| rows[i][j] / self.sigma[i]);
        let values = DVector::from_fn(rows.len(), |i, _| self.force[i] / self.sigma[i]);
        let mut normal = matrix.tr_mul(&matrix);
        for j in 0..form.coefficients {
            normal[(j, j)] = normal[(j, j)] * (1.0 + 1e-12) + 1e-300;
        }
        let coefficients = normal.cholesky()?.solve(&matrix.tr_mul(&values));
        let chi_square = (values - matrix * &coefficients).norm_squared();
        chi_square.is_finite().then(|| FormFit {
            chi_square,
            coefficients: coefficients.iter().copied().collect(),
            shapes: shapes.to_vec(),
        })
    }

    /// Profile likelihood interval of the power, which is the first shape parameter.
    fn exponent(&self, form: &EquationForm, ranges: &[[f64; 2]], best: &FormFit) -> Exponent {
        let at = |power: f64| {
            let rest: Vec<[f64; 2]> = ranges[1..].to_vec();
            grid(&rest)
                .filter_map(|others| {
                    let shapes: Vec<f64> = std::iter::once(power).chain(others).collect();
                    Some(self.coefficients(form, &shapes)?.chi_square)
                })
                .fold(f64::INFINITY, f64::min)
        };
        let limit = best.chi_square + CHI_SQUARE_95;
        let end = |sign: f64| {
            let step = 0.01;
            let mut power = best.shapes[0];
            while power + sign * step >= ranges[0][0] && power + sign * step <= ranges[0][1] {
                power += sign * step;
                if at(power) > limit {
                    break;
                }
            }
            power
        };
        Exponent {
            value: best.shapes[0],
            ci95: [end(-1.0), end(1.0)],
        }
    }
}

/// All combinations of values in some ranges: [`SHAPES`] values for one range, half as many for each of two.
fn grid(ranges: &[[f64; 2]]) -> impl Iterator<Item = Vec<f64>> {
    let count = if ranges.len() > 1 { SHAPES / 2 } else { SHAPES };
    let all = count.pow(ranges.len() as u32);
    let ranges = ranges.to_vec();
    (0..all).map(move |mut number| {
        ranges
            .iter()
            .map(|[low, high]| {
                let k = number % count;
                number /= count;
                low + (high - low) * k as f64 / (count - 1) as f64
            })
            .collect()
    })
}

/// An axis in words.
pub(super) fn axis_words(axis: Axis) -> &'static str {
    match axis {
        Axis::DisplacementMm => "the displacement",
        Axis::ForceN => "the load",
        Axis::VelocityMmS => "the speed",
        Axis::AccelerationMmS2 => "the acceleration",
        Axis::TimeS => "the time",
        Axis::Cycle => "the number of the cycle",
        Axis::DistanceFromReversalMm => "the travel since the reversal",
        Axis::FrequencyHz => "the frequency",
    }
}

fn symbol(law: &ForceLaw) -> Symbol {
    let (z, unit) = match law.axis {
        Axis::DisplacementMm => ("x", "mm"),
        Axis::ForceN => ("E", "N"),
        Axis::VelocityMmS => ("|v|", "mm/s"),
        Axis::AccelerationMmS2 => ("|a|", "mm/s2"),
        Axis::TimeS => ("t", "s"),
        Axis::Cycle => ("n", "cycles"),
        Axis::DistanceFromReversalMm => ("s", "mm"),
        Axis::FrequencyHz => ("f", "Hz"),
    };
    Symbol {
        z,
        unit,
        force: if law.per_load { " of the load" } else { " N" },
    }
}

fn with_unit(s: &Symbol) -> String {
    format!("{} / {}", s.z, s.unit)
}

/// A number with three significant digits.
fn number(value: f64) -> String {
    let mut text = String::new();
    let digits = if value == 0.0 {
        0
    } else {
        (2 - value.abs().log10().floor() as i32).clamp(0, 8)
    };
    let _ = write!(text, "{value:.*}", digits as usize);
    text
}

fn signed(value: f64) -> String {
    if value < 0.0 {
        format!("- {}", number(-value))
    } else {
        format!("+ {}", number(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(f: impl Fn(f64) -> f64) -> Equation {
        let at: Vec<f64> = (0..25).map(|k| 30.0 * f64::from(k) / 24.0).collect();
        let law = ForceLaw {
            axis: Axis::DisplacementMm,
            opposes_motion: false,
            per_load: false,
            force: at.iter().map(|z| f(*z)).collect(),
            at,
        };
        shortest(&law, &[0.05; 25])
    }

    #[test]
    fn the_form_that_made_the_table_is_found() {
        assert_eq!(found(|_| 7.0).text, "7.00 N");
        assert_eq!(found(|z| 4.0 - 0.5 * z).text, "4.00 N - 0.500 x / mm");
        let ripple = found(|z| 6.0 * (std::f64::consts::TAU * z / 7.0).sin()).text;
        assert!(ripple.contains("sin(2 pi x / 7.0"), "{ripple}");
        let bump = found(|z| 20.0 * (-((z - 15.0) / 3.0).powi(2)).exp()).text;
        assert!(bump.contains("exp(-((x - 15.0) / 3.0"), "{bump}");
    }

    #[test]
    fn a_power_has_an_interval_around_it() {
        let equation = found(|z| 0.3 * z.powf(1.7));
        let exponent = equation.exponent.expect("a power");
        assert!((exponent.value - 1.7).abs() < 0.05, "{exponent:?}");
        assert!(exponent.ci95[0] < 1.7 && exponent.ci95[1] > 1.7, "{exponent:?}");
        assert!(exponent.ci95[1] - exponent.ci95[0] < 0.4, "{exponent:?}");
    }
}
