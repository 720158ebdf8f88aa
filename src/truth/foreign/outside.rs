//! Physics that the library does not have: warming, local friction, ripple, bump stop, magnetic catch, pinching.

use super::laws::get;
use crate::truth::{Hidden, TruthSpecimen};

/// State of the effects outside the library.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Outside {
    local_friction: Option<Hidden>,
    ripple: Option<Hidden>,
    warming: Option<Hidden>,
    bump_stop: Option<Hidden>,
    catch: Option<Hidden>,
    pinching: Option<Hidden>,
    /// Warmth of the contacts: 1 after the friction work of ten strokes over the whole travel.
    warmth: f64,
    /// Force of the rubber of the bump stop that lags, N.
    rubber_n: f64,
    /// True while the magnet holds.
    caught: bool,
    /// Ends of the last stroke in mm: where it began, and the place of the reversal before.
    stroke_mm: [f64; 2],
    direction: f64,
}

impl Outside {
    pub(super) fn of(hidden: &[Hidden]) -> Outside {
        let get = |code: &str| get(hidden, code).copied();
        Outside {
            local_friction: get("local_friction"),
            ripple: get("ripple"),
            warming: get("warming"),
            bump_stop: get("bump_stop"),
            catch: get("magnetic_catch"),
            pinching: get("pinching"),
            warmth: 0.0,
            rubber_n: 0.0,
            caught: false,
            stroke_mm: [0.0; 2],
            direction: 0.0,
        }
    }

    /// A step to a displacement in mm. `work` is the friction work, in strokes over the whole travel.
    pub(super) fn step(&mut self, x_mm: f64, travel_mm: f64, dt_s: f64, work: f64, specimen: &TruthSpecimen) {
        if let Some(h) = self.warming {
            self.warmth = (self.warmth + 0.1 * work) / (1.0 + dt_s / h.place);
        }
        if let Some(h) = self.bump_stop {
            // Rubber: a third of the force relaxes within half a second.
            let pressed = 0.5 * bump_n(&h, x_mm, specimen.top_mm());
            let before = 0.5 * bump_n(&h, x_mm - travel_mm, specimen.top_mm());
            self.rubber_n = (self.rubber_n + pressed - before) / (1.0 + dt_s / 0.5);
        }
        if let Some(h) = self.catch {
            let away = (x_mm - h.place).abs();
            self.caught = away < if self.caught { h.width } else { 0.2 * h.width };
        }
        if travel_mm * self.direction < 0.0 {
            self.stroke_mm = [x_mm - travel_mm, self.stroke_mm[0]];
        }
        if travel_mm != 0.0 {
            self.direction = travel_mm.signum();
        }
    }

    /// Load in N that the contacts carry as well.
    pub(super) fn carried_n(&self, x_mm: f64, specimen: &TruthSpecimen) -> f64 {
        self.bump_stop
            .map_or(0.0, |h| bump_n(&h, x_mm, specimen.top_mm()))
    }

    /// Force in N beside that of the contacts.
    pub(super) fn force_n(&self, x_mm: f64, specimen: &TruthSpecimen) -> f64 {
        let ripple = self
            .ripple
            .map_or(0.0, |h| h.size * (std::f64::consts::TAU * x_mm / h.place).sin());
        // A magnet pulls back until it lets go.
        let pull = self.catch.filter(|_| self.caught);
        let catch = pull.map_or(0.0, |h| h.size * specimen.top_n() * (x_mm - h.place) / h.width);
        ripple + catch + self.rubber_n
    }

    /// Friction divided by load that is added at a place.
    pub(super) fn added_ratio(&self, x_mm: f64) -> f64 {
        self.local_friction.map_or(0.0, |h| {
            let bump = 1.0 - ((x_mm - h.place) / (0.5 * h.width)).powi(2);
            h.size * bump.max(0.0)
        })
    }

    /// Factor of the friction.
    pub(super) fn friction_factor(&self, x_mm: f64) -> f64 {
        let warm = self
            .warming
            .map_or(1.0, |h| 1.0 - h.size * self.warmth / (1.0 + self.warmth));
        let pinched = self.pinching.map_or(1.0, |h| {
            let [a, b] = self.stroke_mm;
            let from_middle = (x_mm - 0.5 * (a + b)) / (0.5 * (a - b)).abs().max(0.5);
            1.0 - h.size * (-(from_middle / 0.35).powi(2)).exp()
        });
        warm * pinched
    }
}

/// Force in N of a bump stop. Its size is a quarter of the rate of the rubber at the largest displacement.
fn bump_n(h: &Hidden, x_mm: f64, top_mm: f64) -> f64 {
    let span = (top_mm - h.place).max(1e-6);
    let pressed = ((x_mm - h.place) / span).max(0.0);
    h.size * span * pressed.powi(4)
}
