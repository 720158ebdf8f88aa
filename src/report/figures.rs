//! Figures and codes as the reports print them.

use crate::diagnose::diagnosis::Value;

/// Four significant digits, without an exponent.
pub(super) fn figure(v: f64) -> String {
    let size = v.abs();
    let digits = match size {
        _ if size == 0.0 || size >= 1000.0 => 0,
        _ => (3 - size.log10().floor() as i32).clamp(0, 8) as usize,
    };
    format!("{v:.digits$}")
}

/// A fraction in percent.
pub(super) fn percent(fraction: f64, digits: usize) -> String {
    format!("{:.digits$} %", 100.0 * fraction)
}

/// An error in percent with its sign.
pub(super) fn signed_percent(fraction: f64) -> String {
    format!("{:+.2} %", 100.0 * fraction)
}

/// The 95 % interval of a parameter, in the parameter's unit.
pub(super) fn interval(value: &Value) -> String {
    value
        .ci95
        .map_or("not determined by these data".to_owned(), |[low, high]| {
            format!("{} to {}", figure(low), figure(high))
        })
}

/// A code such as `load_dependent_friction` as words.
pub(super) fn spaced(code: &str) -> String {
    code.replace('_', " ")
}

/// The summary with the percent signs kept on the line of their figure.
pub(super) fn unbroken(summary: &str) -> String {
    summary.replace(" %", "\u{a0}%")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_significant_digits() {
        assert_eq!(figure(81.23456), "81.23");
        assert_eq!(figure(0.0123456), "0.01235");
        assert_eq!(figure(12345.6), "12346");
        assert_eq!(figure(0.0), "0");
    }
}
