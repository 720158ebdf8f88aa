//! What a specimen does to the two channels, in the equations of its world.

use super::{Hidden, Programme, TruthSpecimen, World, foreign};

impl TruthSpecimen {
    /// True force in N at the rising times `times_s` of a motion, before the sensors.
    pub(crate) fn forces(&self, hidden: &[Hidden], motion: &Programme, times_s: &[f64]) -> Vec<f64> {
        if self.world == World::Own {
            return self.own_forces(hidden, motion, times_s);
        }
        let forces = foreign::forces(self, hidden, motion, times_s);
        forces.into_iter().map(|f| self.clipped_n(hidden, f)).collect()
    }

    /// Displacement in mm that the LVDT shows at these times, before its noise.
    pub(super) fn seen_mm(&self, hidden: &[Hidden], motion: &Programme, times_s: &[f64]) -> Vec<f64> {
        if self.world == World::Own {
            return times_s.iter().map(|&t| motion.at_mm(t)).collect();
        }
        foreign::seen_mm(self, hidden, motion, times_s)
    }

    /// Force in N that the amplifier shows, if the channel is saturated.
    pub(super) fn clipped_n(&self, hidden: &[Hidden], force_n: f64) -> f64 {
        match hidden.iter().find(|h| h.code == "sensor_saturation") {
            None => force_n,
            Some(h) if self.world == World::Own => force_n.min(h.limit_n(self.top_n())),
            Some(h) => foreign::clipped_n(h, force_n, self.top_n()),
        }
    }

    /// The forces as a model that is driven by the shown displacement has to explain them: an error of the displacement is an
    /// error of the force of rate times displacement.
    pub(super) fn forces_to_explain(
        &self,
        hidden: &[Hidden],
        motion: &Programme,
        times_s: &[f64],
    ) -> Vec<f64> {
        let mut forces = self.forces(hidden, motion, times_s);
        if self.world != World::Own {
            let seen = self.seen_mm(hidden, motion, times_s);
            for ((force_n, seen_mm), &t) in forces.iter_mut().zip(seen).zip(times_s) {
                *force_n -= self.rate_n_per_mm * (seen_mm - motion.at_mm(t));
            }
        }
        forces
    }
}
