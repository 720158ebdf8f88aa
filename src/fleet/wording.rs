//! Figures and lists of names as the sentences of the findings print them.

use super::estimate::EstimateScale;

/// A value with its 95 % interval, with two digits of half the interval. A relative one is printed in percent, without `unit`.
pub(super) fn interval(value: f64, low95: f64, high95: f64, scale: EstimateScale, unit: &str) -> String {
    let (factor, unit) = match scale {
        EstimateScale::Relative => (100.0, "%"),
        EstimateScale::Absolute => (1.0, if unit == "1" { "" } else { unit }),
    };
    let half = 0.5 * factor * (high95 - low95);
    let digits = match half.is_finite() && half > 0.0 {
        true => (1 - half.log10().floor() as i32).clamp(0, 9) as usize,
        false => 4,
    };
    let printed = |x: f64| format!("{:.digits$}", factor * x);
    let text = format!(
        "{} {unit}, 95 % interval {} to {} {unit}",
        printed(value),
        printed(low95),
        printed(high95)
    );
    text.replace(" ,", ",").trim_end().to_owned()
}

/// A value with four digits, without zeros behind them: "55", "0.0923".
pub(super) fn rounded(value: f64) -> String {
    let digits = (3 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// "A", "A and B" or "A, B and C".
pub(super) fn named<S: AsRef<str>>(names: &[S]) -> String {
    match names {
        [] => String::new(),
        [one] => one.as_ref().to_owned(),
        [others @ .., last] => {
            let others: Vec<&str> = others.iter().map(AsRef::as_ref).collect();
            format!("{} and {}", others.join(", "), last.as_ref())
        }
    }
}

/// The noun, with an s unless there is one.
pub(super) fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_sets_the_digits() {
        assert_eq!(
            interval(0.01019, 0.0081, 0.0123, EstimateScale::Relative, "N/mm"),
            "1.02 %, 95 % interval 0.81 to 1.23 %"
        );
        assert_eq!(
            interval(80.256, 60.0, 100.0, EstimateScale::Absolute, "N"),
            "80 N, 95 % interval 60 to 100 N"
        );
        assert_eq!(
            interval(0.5, 0.25, 0.75, EstimateScale::Absolute, "1"),
            "0.50, 95 % interval 0.25 to 0.75"
        );
    }

    #[test]
    fn a_value_is_rounded_to_four_digits() {
        for (value, text) in [
            (55.0, "55"),
            (62.5, "62.5"),
            (0.092_341, "0.09234"),
            (1234.56, "1235"),
            (0.0, "0"),
        ] {
            assert_eq!(rounded(value), text);
        }
    }

    #[test]
    fn names_are_listed() {
        assert_eq!(named(&["A"]), "A");
        assert_eq!(named(&["A", "B", "C"]), "A, B and C");
        assert_eq!(counted(1, "run"), "1 run");
        assert_eq!(counted(2, "run"), "2 runs");
    }
}
