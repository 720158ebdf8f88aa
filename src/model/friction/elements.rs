//! Elastic-plastic elements (Jenkins) side by side, with lengths spread so that the sum turns round as a law says (Iwan 1966).
//!
//! ```text
//! dr_i = dx / l_i held within [-1, 1],  r = mean r_i
//! ```
//! Between two far ends the mean follows `dr/dx = (1 - r d)^shape / length`, d the direction. Shape 1 is Dahl's law (1968)
//! there; below 1 sliding is complete after a finite travel; above 1 the tail is long. In nested loops the elements return to
//! where they turned, as a dry contact does and Dahl's law does not (Masing 1926).

/// Elastic-plastic elements side by side (Jenkins): each follows the travel and slides once it is dragged along its length.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Elements<const N: usize> {
    per_mm: [f64; N],
    drags: [f64; N],
}

impl<const N: usize> Elements<N> {
    /// At rest, by their lengths in mm.
    pub(crate) fn new(lengths_mm: [f64; N]) -> Self {
        Elements {
            per_mm: lengths_mm.map(|length| 1.0 / length),
            drags: [0.0; N],
        }
    }

    /// Back to rest.
    pub(crate) fn reset(&mut self) {
        self.drags = [0.0; N];
    }

    /// Moves by a travel; drags of all, -1 to 1.
    pub(crate) fn advance(&mut self, travel_mm: f64) -> &[f64; N] {
        if travel_mm != 0.0 {
            for (drag, per_mm) in self.drags.iter_mut().zip(&self.per_mm) {
                *drag = (*drag + travel_mm * per_mm).clamp(-1.0, 1.0);
            }
        }
        &self.drags
    }
}

/// Lengths in mm of elements whose mean turns round over `length_mm` in a given shape.
pub(crate) fn spread<const N: usize>(length_mm: f64, shape: f64) -> [f64; N] {
    std::array::from_fn(|i| length_mm * quantile((i as f64 + 0.5) / N as f64, shape))
}

/// Length of an element in units of the law's length, at a share of the distribution.
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
