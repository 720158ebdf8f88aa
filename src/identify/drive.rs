//! Force control of a plant whose input is displacement: finds, step by step, the displacement that gives the force.

use crate::model::Plant;

/// Tolerance of the force: relative, and at least this many N.
const RELATIVE: f64 = 1e-10;
const ABSOLUTE_N: f64 = 1e-7;
/// Longest step of the search, in mm, before the force is bracketed.
const LARGEST_MOVE_MM: f64 = 5.0;

/// Moves a plant along a course of forces. The plant keeps the state after the last step.
pub(crate) struct ForceDriver<'a> {
    plant: &'a mut Box<dyn Plant>,
    displacement_mm: f64,
    /// Speed of the last step, mm/s: the next search starts from it.
    speed_mm_s: f64,
    rate_n_per_mm: f64,
}

impl<'a> ForceDriver<'a> {
    /// Takes a plant that is at zero displacement.
    pub(crate) fn new(plant: &'a mut Box<dyn Plant>) -> Self {
        ForceDriver {
            plant,
            displacement_mm: 0.0,
            speed_mm_s: 0.0,
            rate_n_per_mm: 100.0,
        }
    }

    /// One step of `dt_s` to `target_n`; returns the displacement in mm. A force that the plant cannot reach is approached.
    pub(crate) fn lead(&mut self, target_n: f64, dt_s: f64) -> f64 {
        let tolerance = ABSOLUTE_N.max(RELATIVE * target_n.abs());
        let start = self.displacement_mm;
        let mut x = start + self.speed_mm_s * dt_s;
        let mut misfit = self.misfit(x, dt_s, target_n);
        // Bracket the force: step by the last stiffness, twice as far each time.
        let mut other = (x, misfit);
        let mut reach = 1.0;
        for _ in 0..60 {
            if misfit.abs() <= tolerance || (other.1 > 0.0) != (misfit > 0.0) {
                break;
            }
            other = (x, misfit);
            let step = -1.1 * reach * misfit / self.rate_n_per_mm;
            x += step.clamp(-LARGEST_MOVE_MM, LARGEST_MOVE_MM);
            reach *= 2.0;
            misfit = self.misfit(x, dt_s, target_n);
        }
        if (other.1 > 0.0) != (misfit > 0.0) {
            x = self.close_in((x, misfit), other, dt_s, target_n, tolerance);
        }
        self.plant.step(x, dt_s);
        if dt_s > 0.0 {
            self.speed_mm_s = (x - start) / dt_s;
        }
        self.displacement_mm = x;
        x
    }

    /// Force less target after a step to `x`; the plant itself does not move.
    fn misfit(&self, x: f64, dt_s: f64, target_n: f64) -> f64 {
        self.plant.boxed_clone().step(x, dt_s) - target_n
    }

    /// False position within a bracket (Illinois algorithm), with bisection after 30 steps.
    fn close_in(
        &mut self,
        mut newest: (f64, f64),
        mut other: (f64, f64),
        dt_s: f64,
        target_n: f64,
        tolerance: f64,
    ) -> f64 {
        let mut best = newest;
        for i in 0..80 {
            if best.1.abs() <= tolerance || newest.0 == other.0 {
                break;
            }
            let rate = (newest.1 - other.1) / (newest.0 - other.0);
            let mut x = newest.0 - newest.1 / rate;
            if i > 30 || !x.is_finite() {
                x = 0.5 * (newest.0 + other.0);
            }
            let misfit = self.misfit(x, dt_s, target_n);
            if rate.is_finite() && rate > 0.0 {
                self.rate_n_per_mm = rate;
            }
            if (misfit > 0.0) == (newest.1 > 0.0) {
                other.1 *= 0.5;
            } else {
                other = newest;
            }
            newest = (x, misfit);
            if misfit.abs() < best.1.abs() {
                best = newest;
            }
        }
        best.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{self, finite_segment};

    #[test]
    fn reaches_every_force_of_a_loop_with_sharp_reversals() {
        let mut plant = model::find("finite-segment")
            .and_then(|m| m.plant(&finite_segment::GRP_OPTIMUM, &toml::Table::new()))
            .expect("published values are within bounds");
        let mut beside = plant.boxed_clone();
        let mut driver = ForceDriver::new(&mut plant);
        let mut worst: f64 = 0.0;
        for i in 1..=800 {
            let force_n = 2000.0 + 40_000.0 * (1.0 - (f64::from(i) * std::f64::consts::TAU / 400.0).cos());
            let x = driver.lead(force_n, 0.05);
            worst = worst.max((beside.step(x, 0.05) / force_n - 1.0).abs());
        }
        // Twice the driver's tolerance.
        assert!(worst < 2e-10, "worst {worst:e}");
    }
}
