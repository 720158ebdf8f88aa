//! Travel, speed, acceleration, reversals and drag, calculated from a noisy displacement.
//!
//! No effect uses the sign of a raw difference, because 5 um of noise at 1 kHz is 3.5 mm/s, ten times the speed of the static
//! ramp. Travel reverses only beyond [`BAND_MM`]. Speed and acceleration pass two low-pass filters of [`LAG_S`] each.

use crate::model::Motion;
use crate::model::friction::elements::{Elements, spread};

/// Largest travel in mm against the direction of motion that counts as noise of the LVDT.
pub(crate) const BAND_MM: f64 = 0.02;
/// Time constant in s of each of the two low-pass filters.
pub(crate) const LAG_S: f64 = 0.002;
/// Smallest travel in mm that counts as a branch between two reversals.
pub(crate) const REVERSAL_MM: f64 = 0.2;

/// Travel without noise. Steps in the direction of motion count at once. Steps against it count when together they are
/// longer than [`BAND_MM`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct BandedTravel {
    at_mm: f64,
    direction: f64,
    free_of_noise: bool,
}

impl BandedTravel {
    /// Tells that the next displacement is smoothed and has no noise, so that every reversal counts.
    pub(crate) fn tell(&mut self) {
        self.free_of_noise = true;
    }

    /// Moves to `displacement_mm` and returns the travel in mm since the last call.
    pub(crate) fn advance(&mut self, displacement_mm: f64) -> f64 {
        let travel_mm = displacement_mm - self.at_mm;
        let trusted = std::mem::take(&mut self.free_of_noise);
        if !trusted && travel_mm * self.direction < 0.0 && travel_mm.abs() <= BAND_MM {
            return 0.0;
        }
        if travel_mm != 0.0 {
            self.direction = travel_mm.signum();
        }
        self.at_mm = displacement_mm;
        travel_mm
    }
}

/// Number of elements of a [`Drag`].
const DRAG_ELEMENTS: usize = 32;

/// Drag of a contact: its friction divided by its full sliding friction, -1 to 1. The mean of
/// [`elements`](crate::model::friction::elements) with a length and a shape, moved by the travel without noise.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Drag {
    elements: Elements<DRAG_ELEMENTS>,
    travel: BandedTravel,
}

impl Drag {
    /// A contact at rest; `length_mm` is the travel over which it reverses.
    pub(crate) fn new(length_mm: f64, shape: f64) -> Drag {
        Drag {
            elements: Elements::new(spread(length_mm, shape)),
            travel: BandedTravel::default(),
        }
    }

    /// Tells that the next displacement has no noise, see [`BandedTravel::tell`].
    pub(crate) fn tell(&mut self) {
        self.travel.tell();
    }

    /// Back to rest at zero displacement.
    pub(crate) fn reset(&mut self) {
        self.travel = BandedTravel::default();
        self.elements.reset();
    }

    /// Moves to `displacement_mm` and returns the mean drag.
    pub(crate) fn step(&mut self, displacement_mm: f64) -> f64 {
        let travel_mm = self.travel.advance(displacement_mm);
        self.elements.advance_mean(travel_mm)
    }
}

/// Speed and acceleration after two low-pass filters. The lag of the speed is corrected to first order.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Rates {
    displacement_mm: Option<f64>,
    told: Option<Motion>,
    /// Speed after the first filter.
    once_mm_s: f64,
    /// Speed after both filters.
    twice_mm_s: f64,
    /// Speed in mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration in mm/s2.
    pub acceleration_mm_s2: f64,
}

impl Rates {
    /// Gives speed and acceleration of the next step, known from the whole recording.
    pub(crate) fn tell(&mut self, motion: &Motion) {
        self.told = Some(*motion);
    }

    /// Moves to `displacement_mm` within `dt_s`. The first call only sets the position, because a recording starts at rest.
    pub(crate) fn step(&mut self, displacement_mm: f64, dt_s: f64) {
        if let Some(motion) = self.told.take() {
            self.velocity_mm_s = motion.velocity_mm_s;
            self.acceleration_mm_s2 = motion.acceleration_mm_s2;
            self.displacement_mm = Some(displacement_mm);
            return;
        }
        let Some(from_mm) = self.displacement_mm.replace(displacement_mm) else {
            return;
        };
        if dt_s <= 0.0 {
            return;
        }
        let raw_mm_s = (displacement_mm - from_mm) / dt_s;
        let part = -(-dt_s / LAG_S).exp_m1();
        let before = self.twice_mm_s;
        self.once_mm_s += part * (raw_mm_s - self.once_mm_s);
        self.twice_mm_s += part * (self.once_mm_s - self.twice_mm_s);
        self.acceleration_mm_s2 = (self.twice_mm_s - before) / dt_s;
        // The filtered speed lags by the two filters and by half a step of the difference.
        let lag_s = 2.0 * dt_s * (1.0 - part) / part + 0.5 * dt_s;
        self.velocity_mm_s = self.twice_mm_s + lag_s * self.acceleration_mm_s2;
    }
}

/// Counts reversals of the motion. A reversal counts after [`REVERSAL_MM`] of the new branch, or at once if the turning
/// points are known.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Reversals {
    extreme_mm: Option<f64>,
    turned_mm: f64,
    direction: f64,
    /// Turning points in mm before and after the next displacement, known from the whole recording; the lower first.
    reach_mm: Option<[f64; 2]>,
    /// Number of reversals so far.
    pub count: u32,
}

impl Reversals {
    /// Gives the turning points before and after the next displacement, known from the whole recording.
    pub(crate) fn tell(&mut self, motion: &Motion) {
        self.reach_mm = Some(motion.reach_mm);
    }

    /// Moves to `displacement_mm`.
    pub(crate) fn step(&mut self, displacement_mm: f64) {
        if self.extreme_mm.is_none() {
            self.turned_mm = displacement_mm;
        }
        let extreme_mm = self.extreme_mm.get_or_insert(displacement_mm);
        let past = displacement_mm - *extreme_mm;
        if let Some([low_mm, high_mm]) = self.reach_mm.take() {
            if past * self.direction < 0.0 {
                let back_to_mm = if self.direction > 0.0 { low_mm } else { high_mm };
                if (back_to_mm - *extreme_mm).abs() < BAND_MM {
                    // Creep within the noise band at the turning point is not a new branch.
                    return;
                }
                // A branch shorter than REVERSAL_MM does not end in a reversal.
                self.count += u32::from((*extreme_mm - self.turned_mm).abs() >= REVERSAL_MM);
                self.turned_mm = *extreme_mm;
            }
            if past != 0.0 {
                self.direction = past.signum();
            }
            *extreme_mm = displacement_mm;
        } else if self.direction == 0.0 {
            if past.abs() >= REVERSAL_MM {
                self.direction = past.signum();
                *extreme_mm = displacement_mm;
            }
        } else if past * self.direction >= 0.0 {
            *extreme_mm = displacement_mm;
        } else if past.abs() >= REVERSAL_MM {
            self.direction = -self.direction;
            self.count += 1;
            *extreme_mm = displacement_mm;
        }
    }

    /// Travel since the last reversal in mm, at a displacement of this branch.
    pub(crate) fn since_mm(&self, displacement_mm: f64) -> f64 {
        (displacement_mm - self.turned_mm).abs()
    }

    /// Number of cycles so far; a cycle has two reversals.
    pub(crate) fn cycles(&self) -> f64 {
        0.5 * f64::from(self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drag_by_hand_for_three_shapes() {
        // From full sliding one way (left = 2) by one length the other way:
        // shape 1: 2 exp(-1); shape 0.5: (sqrt 2 - 0.5)^2; shape 0: 2 - 1. 32 elements: polygons with 32 corners.
        for (shape, left) in [
            (1.0, 2.0 * (-1.0f64).exp()),
            (0.5, (2.0f64.sqrt() - 0.5).powi(2)),
            (0.0, 1.0),
        ] {
            let mut drag = Drag::new(0.5, shape);
            drag.step(100.0);
            let ratio = drag.step(99.5);
            assert!((ratio - (left - 1.0)).abs() < 2e-3, "shape {shape}: {ratio}");
        }
    }

    #[test]
    fn a_nested_loop_closes() {
        let mut drag = Drag::new(0.5, 1.0);
        drag.step(100.0);
        drag.step(99.6);
        let before = drag.step(99.5);
        drag.step(99.7);
        // Back at its turning point: the elements have their old state.
        assert!((drag.step(99.5) - before).abs() < 1e-12);
    }

    #[test]
    fn noise_within_the_band_is_no_travel() {
        let mut drag = Drag::new(0.05, 1.0);
        drag.step(3.0);
        let before = drag.step(2.999);
        for i in 0..10_000 {
            let noise = 0.4 * BAND_MM * f64::from(i).sin();
            assert!((drag.step(2.99 + noise) - before).abs() < 1e-6);
        }
    }

    #[test]
    fn rates_of_a_sine_are_right_to_second_order_of_the_lag() {
        for (dt_s, tolerance) in [(0.0005, 0.01), (0.001, 0.01), (0.01, 0.02)] {
            let omega = std::f64::consts::TAU * 2.5;
            let mut rates = Rates::default();
            let mut worst: f64 = 0.0;
            for i in 0..(2.0 / dt_s) as usize {
                let t = i as f64 * dt_s;
                rates.step(6.0 * (omega * t).sin(), dt_s);
                if t > 0.5 {
                    worst = worst.max((rates.velocity_mm_s - 6.0 * omega * (omega * t).cos()).abs());
                }
            }
            // (omega * lag)^2 with a lag of 4 ms plus half a step: 0.4 % to 2 %.
            assert!(worst < tolerance * 6.0 * omega, "{dt_s}: {worst}");
        }
    }

    #[test]
    fn reversals_are_counted_through_noise() {
        let mut reversals = Reversals::default();
        for i in 0..10_000 {
            let t = f64::from(i) * 1e-3;
            let x = 3.0 * (std::f64::consts::TAU * t).sin() + 0.05 * (f64::from(i) * 1.7).sin();
            reversals.step(x);
        }
        assert_eq!(reversals.count, 20);
    }

    /// 10 mm up, 5 um of creep during a dwell, then back in steps of 1 um: only the first step back counts.
    #[test]
    fn a_reversal_with_known_turning_points_counts_at_once_and_a_dwell_does_not() {
        let mut reversals = Reversals::default();
        let mut go = |to_mm: f64, reach_mm: [f64; 2]| {
            reversals.tell(&Motion {
                velocity_mm_s: 0.0,
                acceleration_mm_s2: 0.0,
                reach_mm,
            });
            reversals.step(to_mm);
            reversals.count
        };
        let counts = [
            go(0.0, [f64::NEG_INFINITY, 10.0]),
            go(10.0, [f64::NEG_INFINITY, 10.0]),
            go(9.995, [9.995, 10.0]),
            go(10.0, [9.995, 10.0]),
            go(9.999, [2.0, 10.0]),
            go(9.998, [2.0, 10.0]),
        ];
        assert_eq!(counts, [0, 0, 0, 0, 1, 1]);
    }
}
