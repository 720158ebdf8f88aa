//! Elastic-plastic elements (Jenkins) in parallel, with lengths such that their sum reverses as a law says (Iwan 1966).
//!
//! ```text
//! dr_i = dx / l_i held within [-1, 1],  r = mean r_i
//! dr/dx = (1 - r d)^shape / length                        the mean between two far ends, d = sgn dx
//! ```
//! x travel, mm; r_i drag ratio of an element; l_i its length, mm. Shape 1 is Dahl's law (1968); below 1 sliding is
//! complete after a finite travel; above 1 the tail is long. In nested loops the elements return to where they turned
//! (Masing 1926). A dry contact does so too. Dahl's differential law does not.

use std::sync::LazyLock;

/// Elastic-plastic elements in parallel: each follows the travel and slides once it is dragged by its length.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Elements<const N: usize> {
    per_mm: [f64; N],
    drags: [f64; N],
}

impl<const N: usize> Elements<N> {
    /// Elements at rest, of these lengths in mm.
    pub(crate) fn new(lengths_mm: [f64; N]) -> Self {
        Elements {
            per_mm: lengths_mm.map(|length| 1.0 / length),
            drags: [0.0; N],
        }
    }

    /// Back to the virgin state.
    pub(crate) fn reset(&mut self) {
        self.drags = [0.0; N];
    }

    /// Moves by a travel and returns the drag ratio of each element, -1 to 1.
    pub(crate) fn advance(&mut self, travel_mm: f64) -> &[f64; N] {
        if travel_mm != 0.0 {
            for (drag, per_mm) in self.drags.iter_mut().zip(&self.per_mm) {
                *drag = (*drag + travel_mm * per_mm).clamp(-1.0, 1.0);
            }
        }
        &self.drags
    }

    /// Moves by a travel and returns the mean drag ratio, -1 to 1. N is a multiple of [`LANES`].
    pub(crate) fn advance_mean(&mut self, travel_mm: f64) -> f64 {
        let drags = self.advance(travel_mm);
        // Several sums beside each other: one sum would wait for each of its additions.
        let mut sums = [0.0; LANES];
        for drags in drags.chunks_exact(LANES) {
            for (sum, drag) in sums.iter_mut().zip(drags) {
                *sum += drag;
            }
        }
        sums.iter().sum::<f64>() / N as f64
    }
}

/// Sums beside each other in a mean.
const LANES: usize = 8;

/// Lengths in mm of elements whose mean reverses over `length_mm` with the given shape.
pub(crate) fn spread<const N: usize>(length_mm: f64, shape: f64) -> [f64; N] {
    if shape == 1.0 {
        // Dahl's law is in every model that a fit builds, and its quantiles never change.
        static OF_DAHL: LazyLock<[f64; 32]> = LazyLock::new(|| quantiles(1.0));
        if let Ok(quantiles) = <[f64; N]>::try_from(&OF_DAHL[..]) {
            return quantiles.map(|quantile| length_mm * quantile);
        }
    }
    quantiles(shape).map(|quantile| length_mm * quantile)
}

/// Quantiles in the middle of N equal shares.
fn quantiles<const N: usize>(shape: f64) -> [f64; N] {
    std::array::from_fn(|i| quantile((i as f64 + 0.5) / N as f64, shape))
}

/// Quantile of the distribution of element lengths, in units of the law's length.
///
/// With `u = 1 - r` after a reversal, `u' = -u^shape`: the share of lengths up to x is `1 + x u'(2x) - u(2x) / 2`, because
/// the second derivative of a branch is the density of the lengths (Iwan 1966).
fn quantile(share: f64, shape: f64) -> f64 {
    let exponent = 1.0 - shape;
    let up_to = |x: f64| {
        let s = 2.0 * x;
        let u = if exponent.abs() < 1e-6 {
            2.0 * (-s).exp()
        } else {
            (2f64.powf(exponent) - exponent * s).max(0.0).powf(1.0 / exponent)
        };
        if u > 0.0 {
            1.0 - x * u.powf(shape) - 0.5 * u
        } else {
            1.0
        }
    };
    let (mut low, mut high) = (0.0, 1.0);
    while up_to(high) < share && high < 1e6 {
        high *= 2.0;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if up_to(middle) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENGTHS_MM: [f64; 8] = [0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5];

    fn moved(travels_mm: &[f64]) -> f64 {
        let mut elements = Elements::new(LENGTHS_MM);
        for travel_mm in travels_mm {
            elements.advance(*travel_mm);
        }
        elements.advance(0.0).iter().sum()
    }

    #[test]
    fn virgin_curve_by_hand() {
        // At 0.3 mm two elements slide: 1 + 1 + 0.3 * (1/.5 + 1/.7 + 1/.9 + 1/1.1 + 1/1.3 + 1/1.5) = 4.065401.
        assert!((moved(&[0.3]) - 4.065_401).abs() < 1e-6, "{}", moved(&[0.3]));
    }

    #[test]
    fn a_nested_loop_closes_and_leaves_no_trace() {
        assert!((moved(&[0.6, -0.4, 0.4]) - moved(&[0.6])).abs() < 1e-12);
        assert!((moved(&[0.6, -0.4, 0.4, 0.3]) - moved(&[0.9])).abs() < 1e-12);
    }

    /// Dahl's law over one branch: r = 1 - exp(-x / length) from the virgin state (2 exp(-x / length) - 1 after a reversal).
    #[test]
    fn shape_1_is_dahls_law_on_a_branch() {
        let mut elements = Elements::<32>::new(spread(0.5, 1.0));
        let mean = |drags: &[f64; 32]| drags.iter().sum::<f64>() / 32.0;
        elements.advance(20.0);
        for k in 1..=20 {
            let found = mean(elements.advance(-0.1));
            let expected = 2.0 * (-0.1 * f64::from(k) / 0.5).exp() - 1.0;
            // Midpoints of 32 equal shares.
            assert!((found - expected).abs() < 4e-3, "{found} against {expected}");
        }
    }
}
