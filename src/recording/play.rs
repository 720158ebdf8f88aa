//! Play: removes the noise from a displacement without the time lag of a filter.
//!
//! The state of a friction model depends on every reversal. If a ramp moves less per sample than the noise of the sensor,
//! every sample is a reversal, and the friction of a presliding law becomes too small. A play (backlash) of a few standard
//! deviations passes motion on and removes the noise. It shifts a branch by its half width and keeps reversals sharp.

/// A play of a given half width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Play {
    half_width: f64,
    value: Option<f64>,
}

impl Play {
    /// Half width in standard deviations of the noise. One sample in 15 000 is further out and still moves the output.
    pub(crate) const SIGMAS: f64 = 4.0;

    /// A play for a signal with this noise (standard deviation, in the signal's unit).
    pub(crate) fn for_noise(sigma: f64) -> Self {
        Play {
            half_width: Self::SIGMAS * sigma.max(0.0),
            value: None,
        }
    }

    /// Forgets the last output: the next value passes unchanged.
    pub(crate) fn reset(&mut self) {
        self.value = None;
    }

    /// The signal without its noise.
    pub(crate) fn pass(&mut self, input: f64) -> f64 {
        let value = match self.value {
            Some(value) => value.clamp(input - self.half_width, input + self.half_width),
            None => input,
        };
        self.value = Some(value);
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_within_the_play_moves_nothing_and_motion_passes() {
        let mut play = Play::for_noise(0.001);
        assert_eq!(play.pass(1.0), 1.0);
        for i in 0..100 {
            assert_eq!(play.pass(1.0 + if i % 2 == 0 { 0.003 } else { -0.003 }), 1.0);
        }
        assert!((play.pass(1.5) - 1.496).abs() < 1e-12);
        assert!((play.pass(1.4) - 1.404).abs() < 1e-12);
    }

    #[test]
    fn no_noise_is_no_play() {
        let mut play = Play::for_noise(0.0);
        for x in [0.0, 0.3, 0.1] {
            assert_eq!(play.pass(x), x);
        }
    }
}
