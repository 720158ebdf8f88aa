//! Numbers in the sentences about effects.

/// A size that needs more decimals is nothing.
const MOST_DECIMALS: usize = 9;

/// A value with these decimals, or where they would show nothing but zeros, with its first two digits.
pub(super) fn shown(value: f64, decimals: usize) -> String {
    let decimals = decimals_of(value, decimals);
    format!("{value:.decimals$}")
}

/// The same with its sign.
pub(super) fn signed(value: f64, decimals: usize) -> String {
    let decimals = decimals_of(value, decimals);
    format!("{value:+.decimals$}")
}

fn decimals_of(value: f64, decimals: usize) -> usize {
    let shows = |decimals: usize| value.abs() >= 0.5 * 10f64.powi(-(decimals as i32));
    match (decimals..=MOST_DECIMALS).find(|&d| shows(d)) {
        Some(first) if first > decimals => first + 1,
        _ => decimals,
    }
}

#[cfg(test)]
mod tests {
    use super::{shown, signed};

    #[test]
    fn a_small_size_is_not_shown_as_nothing() {
        assert_eq!(shown(2.26, 1), "2.3");
        assert_eq!(shown(0.0, 1), "0.0");
        assert_eq!(shown(0.0424, 1), "0.042");
        assert_eq!(shown(0.0016, 3), "0.002");
        assert_eq!(signed(-0.21, 0), "-0.21");
        assert_eq!(signed(12.4, 0), "+12");
        assert_eq!(shown(1e-12, 2), "0.00");
    }
}
