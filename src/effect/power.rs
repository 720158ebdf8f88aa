//! Powers with an exponent that is fitted: a general power takes as long as all else that an effect does in a step.

/// A power. Exponents are 1 until a fit frees them, and 0 where nothing follows.
pub(super) fn power_of(base: f64, exponent: f64) -> f64 {
    if exponent == 1.0 {
        base
    } else if exponent == 0.0 {
        1.0
    } else {
        base.powf(exponent)
    }
}

/// A power with a fixed exponent, fast for ratios close to one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Power {
    exponent: f64,
    /// Coefficients of the binomial series after the first, each divided by the one before.
    series: [f64; Power::TERMS],
}

impl Power {
    const TERMS: usize = 7;
    /// Largest distance from one at which the series is exact to rounding.
    const NEAR: f64 = 0.01;

    pub(super) fn new(exponent: f64) -> Power {
        Power {
            exponent,
            series: std::array::from_fn(|k| (exponent - k as f64) / (k + 1) as f64),
        }
    }

    pub(super) fn of(&self, ratio: f64) -> f64 {
        let past = ratio - 1.0;
        let is_free = self.exponent != 0.0 && self.exponent != 1.0;
        if is_free && past.abs() < Power::NEAR {
            self.series
                .iter()
                .rev()
                .fold(1.0, |sum, coefficient| 1.0 + coefficient * past * sum)
        } else {
            power_of(ratio, self.exponent)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_of_one_or_nothing_is_exact() {
        for base in [0.0, 0.3, 7.0] {
            assert_eq!([power_of(base, 1.0), power_of(base, 0.0)], [base, 1.0]);
            assert_eq!(power_of(base, 0.7), base.powf(0.7));
        }
    }

    #[test]
    fn a_power_of_a_ratio_near_one_is_exact_to_rounding() {
        for exponent in [0.0, 0.07, 0.5, 0.93, 1.0] {
            let power = Power::new(exponent);
            for k in -400..=400 {
                let ratio: f64 = 1.0 + 5e-5 * f64::from(k);
                let off = power.of(ratio) / ratio.powf(exponent) - 1.0;
                assert!(off.abs() < 4.0 * f64::EPSILON, "{ratio}^{exponent}: {off}");
            }
        }
    }
}
