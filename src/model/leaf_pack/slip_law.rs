//! Friction law of every sliding place in the pack: force from slip, with the derivatives that an implicit step needs.
//!
//! ```text
//! presliding  T = T0 + k (s - s0), limited to |T| <= L    elastic-plastic: independent of the rate, holds at rest
//! tanh        T = L tanh(s' / v)                          Kadziela et al. (2015), section 7.5: no force at rest
//! ```
//! T friction force, N (torque, N mm, at a pin); s slip, mm (rad); s' its rate; L friction limit (mu N, or a constant); k
//! tangential stiffness before sliding; v transition velocity; index 0 the last converged step.
//!
//! The laws of [`crate::model::friction`] are another kind: they give a ratio after a known slip. Here Newton's method tries
//! many slips per step, so a law must not change its state before the step has converged, and it must give dT/ds and dT/dL.

/// A friction law with its constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SlipLaw {
    /// Independent of the rate, elastic with this stiffness before sliding (N/mm, or N mm/rad at a pin).
    Presliding(f64),
    /// Regularised by this transition velocity (mm/s, or rad/s at a pin).
    Tanh(f64),
}

/// Stick-slip state of a sliding place. The tangent changes only when this does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum SlipState {
    /// No normal force, or no friction at this place.
    #[default]
    Free,
    /// Elastic, below the friction limit.
    Stick,
    /// Slides towards greater slip.
    SlipUp,
    /// Slides towards smaller slip.
    SlipDown,
    /// On the smooth curve of the tanh law, which has no stick.
    Smooth,
}

impl SlipState {
    /// True if it slid one way and slides the other way `now`.
    #[inline]
    pub(super) fn reversed(self, now: SlipState) -> bool {
        matches!(
            (self, now),
            (SlipState::SlipUp, SlipState::SlipDown) | (SlipState::SlipDown, SlipState::SlipUp)
        )
    }
}

/// Friction force and its derivatives at a trial slip.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SlipResponse {
    pub force: f64,
    /// dT/ds, N/mm (N mm/rad at a pin).
    pub by_slip: f64,
    /// dT/dL, a pure number.
    pub by_limit: f64,
    pub state: SlipState,
    /// The force that stick would need.
    pub trial: f64,
}

impl SlipResponse {
    /// The same place in stick, whatever the limit. After an iteration that jumped from one sliding direction to the other,
    /// Newton's method tries stick; otherwise it would alternate between the two.
    pub(super) fn stuck(self, law: SlipLaw) -> Self {
        match law {
            SlipLaw::Presliding(stiffness) => SlipResponse {
                force: self.trial,
                by_slip: stiffness,
                by_limit: 0.0,
                state: SlipState::Stick,
                trial: self.trial,
            },
            SlipLaw::Tanh(_) => self,
        }
    }
}

/// State of one sliding place at the last converged step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Slider {
    /// Slip, mm (rad at a pin).
    pub slip: f64,
    /// Friction force, N (N mm at a pin).
    pub force: f64,
    /// Energy dissipated since the last reset, N mm.
    pub dissipated_nmm: f64,
}

impl Slider {
    /// Force and derivatives at `slip` under the friction limit `limit`, `dt_s` after the last converged step.
    #[inline]
    pub(super) fn respond(&self, law: SlipLaw, slip: f64, limit: f64, dt_s: f64) -> SlipResponse {
        if limit <= 0.0 {
            return SlipResponse::default();
        }
        match law {
            SlipLaw::Presliding(stiffness) => {
                let trial = self.force + stiffness * (slip - self.slip);
                // A force at the limit is still stick: right after a reversal every place sticks.
                let edge = limit * (1.0 + 1e-9);
                if trial > edge {
                    SlipResponse {
                        force: limit,
                        by_slip: 0.0,
                        by_limit: 1.0,
                        state: SlipState::SlipUp,
                        trial,
                    }
                } else if trial < -edge {
                    SlipResponse {
                        force: -limit,
                        by_slip: 0.0,
                        by_limit: -1.0,
                        state: SlipState::SlipDown,
                        trial,
                    }
                } else {
                    SlipResponse {
                        force: trial,
                        by_slip: stiffness,
                        by_limit: 0.0,
                        state: SlipState::Stick,
                        trial,
                    }
                }
            }
            SlipLaw::Tanh(velocity) => {
                let t = ((slip - self.slip) / (velocity * dt_s)).tanh();
                SlipResponse {
                    force: limit * t,
                    by_slip: limit * (1.0 - t * t) / (velocity * dt_s),
                    by_limit: t,
                    state: SlipState::Smooth,
                    trial: limit * t,
                }
            }
        }
    }

    /// Keeps a converged step and adds the energy that it dissipated.
    #[inline]
    pub(super) fn commit(&mut self, law: SlipLaw, slip: f64, force: f64) {
        let work = match law {
            SlipLaw::Presliding(stiffness) => {
                let stored = (force * force - self.force * self.force) / (2.0 * stiffness);
                0.5 * (force + self.force) * (slip - self.slip) - stored
            }
            SlipLaw::Tanh(_) => force * (slip - self.slip),
        };
        self.dissipated_nmm += work;
        self.slip = slip;
        self.force = force;
    }

    /// Elastic energy before sliding, N mm.
    #[cfg(test)]
    pub(super) fn stored_nmm(&self, law: SlipLaw) -> f64 {
        match law {
            SlipLaw::Presliding(stiffness) => self.force * self.force / (2.0 * stiffness),
            SlipLaw::Tanh(_) => 0.0,
        }
    }

    /// Restarts at `slip` without force and without dissipated energy.
    pub(super) fn release(&mut self, slip: f64) {
        *self = Slider {
            slip,
            ..Slider::default()
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(law: SlipLaw, path: &[(f64, f64)], limit: f64, steps: usize) -> (Slider, f64) {
        let (mut slider, mut work) = (Slider::default(), 0.0);
        for pair in path.windows(2) {
            let ((t0, s0), (t1, s1)) = (pair[0], pair[1]);
            for k in 1..=steps {
                let slip = s0 + (s1 - s0) * k as f64 / steps as f64;
                let force = slider.respond(law, slip, limit, (t1 - t0) / steps as f64).force;
                work += 0.5 * (force + slider.force) * (slip - slider.slip);
                slider.commit(law, slip, force);
            }
        }
        (slider, work)
    }

    /// A closed loop of amplitude a loses 4 L (a - L/k): the parallelogram of an elastic-plastic element.
    #[test]
    fn presliding_loop_is_the_parallelogram() {
        let (limit, stiffness, a) = (30.0, 2e3, 0.1);
        let law = SlipLaw::Presliding(stiffness);
        let path = [(0.0, 0.0), (1.0, a), (2.0, -a), (3.0, a)];
        let (slider, work) = drive(law, &path, limit, 4000);
        let loops = slider.dissipated_nmm;
        let wanted = limit * (a - limit / stiffness) + 4.0 * limit * (a - limit / stiffness);
        // The kink at the limit lies within one step of 5e-5 mm.
        assert!((loops / wanted - 1.0).abs() < 1e-4, "{loops} against {wanted}");
        assert!((work - loops - slider.stored_nmm(law)).abs() < 1e-9);
    }

    /// Presliding keeps its loop at any speed, tanh loses it in a slow test, as in the paper's static test.
    #[test]
    fn only_presliding_keeps_the_slow_loop() {
        let slow = [(0.0, 0.0), (100.0, 0.1), (300.0, -0.1), (500.0, 0.1)];
        let kept = drive(SlipLaw::Presliding(2e5), &slow, 30.0, 500).0.dissipated_nmm;
        let lost = drive(SlipLaw::Tanh(1.0), &slow, 30.0, 500).0.dissipated_nmm;
        assert!((kept / (5.0 * 30.0 * 0.1) - 1.0).abs() < 0.01, "{kept}");
        // tanh(x) = x at x = (0.001 mm/s) / (1 mm/s).
        assert!((lost / kept - 1e-3).abs() < 1e-4, "{lost} of {kept}");
    }
}
