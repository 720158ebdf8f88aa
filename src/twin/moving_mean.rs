//! Mean of the last values of a signal.

use std::collections::VecDeque;

/// Mean over the last values, at most a given number of them.
#[derive(Debug, Clone)]
pub(super) struct MovingMean {
    window: usize,
    recent: VecDeque<f64>,
    sum: f64,
}

impl MovingMean {
    /// Empty, over at most `window` values and at least one.
    pub(super) fn over(window: usize) -> Self {
        MovingMean {
            window: window.max(1),
            recent: VecDeque::new(),
            sum: 0.0,
        }
    }

    /// Takes the next value and returns the mean.
    pub(super) fn take(&mut self, value: f64) -> f64 {
        self.recent.push_back(value);
        self.sum += value;
        if self.recent.len() > self.window {
            self.sum -= self.recent.pop_front().unwrap_or_default();
        }
        self.value()
    }

    /// The mean at present; 0 before the first value.
    pub(super) fn value(&self) -> f64 {
        self.sum / self.recent.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_values_leave_the_mean() {
        let mut mean = MovingMean::over(2);
        assert_eq!([1.0, 3.0, 5.0].map(|value| mean.take(value)), [1.0, 2.0, 4.0]);
    }
}
