//! The friction law of every sliding place in the pack: force from slip, with the derivatives that an implicit step needs.
//!
//! ```text
//! presliding  T = T0 + k (s - s0), cut to |T| <= L     elastic-plastic: rate-independent, holds at rest
//! tanh        T = L tanh(s' / v)                        Kadziela et al. (2015), section 7.5: nothing held at rest
//! ```
//! T friction force, N (torque, N mm); s slip, mm (rad); s' its rate; L limit (mu N, or a constant); k tangential
//! stiffness before sliding; v transition velocity; index 0 the last converged step.

/// Which law, with its constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SlipLaw {
    /// Rate-independent with elastic presliding of this stiffness (N/mm, or N mm/rad at a pin).
    Presliding(f64),
    /// Regularised by this transition velocity (mm/s, or rad/s at a pin).
    Tanh(f64),
}

/// What a sliding place does now: the tangent changes only when this does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Grip {
    /// Nothing pressed together, or no friction there.
    #[default]
    Free,
    /// Elastic, below the limit.
    Stick,
    /// At the limit, sliding to greater slip.
    SlipUp,
    /// At the limit, sliding to lesser slip.
    SlipDown,
    /// On the smooth curve of the tanh law.
    Smooth,
}

impl Grip {
    /// Sliding one way, against sliding the other way now.
    #[inline]
    pub(super) fn reversed(self, now: Grip) -> bool {
        matches!(
            (self, now),
            (Grip::SlipUp, Grip::SlipDown) | (Grip::SlipDown, Grip::SlipUp)
        )
    }
}

/// Force and derivatives of one evaluation.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Response {
    pub force: f64,
    pub by_slip: f64,
    pub by_limit: f64,
    pub grip: Grip,
    /// The force that sticking would need.
    pub trial: f64,
}

impl Response {
    /// As if it stuck, whatever the limit: a place that overshot from one slip to the other tries stick in between, or
    /// Newton's method goes to and fro between the two.
    pub(super) fn stuck(self, law: SlipLaw) -> Self {
        match law {
            SlipLaw::Presliding(stiffness) => Response {
                force: self.trial,
                by_slip: stiffness,
                by_limit: 0.0,
                grip: Grip::Stick,
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
    /// Dissipated since the last reset, N mm.
    pub dissipated_nmm: f64,
}

impl Slider {
    /// Response at `slip` under the friction limit `limit`, `dt_s` after the committed state.
    #[inline]
    pub(super) fn respond(&self, law: SlipLaw, slip: f64, limit: f64, dt_s: f64) -> Response {
        if limit <= 0.0 {
            return Response::default();
        }
        match law {
            SlipLaw::Presliding(stiffness) => {
                let trial = self.force + stiffness * (slip - self.slip);
                // On the limit counts as stuck: right after a reversal everything sticks.
                let edge = limit * (1.0 + 1e-9);
                if trial > edge {
                    Response {
                        force: limit,
                        by_slip: 0.0,
                        by_limit: 1.0,
                        grip: Grip::SlipUp,
                        trial,
                    }
                } else if trial < -edge {
                    Response {
                        force: -limit,
                        by_slip: 0.0,
                        by_limit: -1.0,
                        grip: Grip::SlipDown,
                        trial,
                    }
                } else {
                    Response {
                        force: trial,
                        by_slip: stiffness,
                        by_limit: 0.0,
                        grip: Grip::Stick,
                        trial,
                    }
                }
            }
            SlipLaw::Tanh(velocity) => {
                let t = ((slip - self.slip) / (velocity * dt_s)).tanh();
                Response {
                    force: limit * t,
                    by_slip: limit * (1.0 - t * t) / (velocity * dt_s),
                    by_limit: t,
                    grip: Grip::Smooth,
                    trial: limit * t,
                }
            }
        }
    }

    /// Takes over a converged step and books what it dissipated.
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

    /// Elastic energy held by the presliding spring, N mm.
    pub(super) fn stored_nmm(&self, law: SlipLaw) -> f64 {
        match law {
            SlipLaw::Presliding(stiffness) => self.force * self.force / (2.0 * stiffness),
            SlipLaw::Tanh(_) => 0.0,
        }
    }

    /// Released at `slip`: no force, nothing booked.
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
        println!("friction loop {loops:.6} N mm against {wanted:.6}");
        // The kink at the limit lies within one step of 5e-5 mm.
        assert!((loops / wanted - 1.0).abs() < 1e-4);
        assert!((work - loops - slider.stored_nmm(law)).abs() < 1e-9);
    }

    /// The rate-independent law keeps its loop at any speed, tanh loses it: the trap of the paper's static test.
    #[test]
    fn only_presliding_keeps_the_slow_loop() {
        let slow = [(0.0, 0.0), (100.0, 0.1), (300.0, -0.1), (500.0, 0.1)];
        let kept = drive(SlipLaw::Presliding(2e5), &slow, 30.0, 500).0.dissipated_nmm;
        let lost = drive(SlipLaw::Tanh(1.0), &slow, 30.0, 500).0.dissipated_nmm;
        println!("slow loop: presliding {kept:.3}, tanh {lost:.5} N mm");
        assert!((kept / (5.0 * 30.0 * 0.1) - 1.0).abs() < 0.01);
        // tanh(x) = x at x = (0.001 mm/s) / (1 mm/s).
        assert!((lost / kept - 1e-3).abs() < 1e-4);
    }
}
