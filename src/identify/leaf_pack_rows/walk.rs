//! One pass through all tests of a mounting: the loops of the sines one inside the other, then up to the static peak and back.
//!
//! ```text
//! 0 .. t+S1 .. t .. t+S1 .. t+S2 .. t .. t+S2 .. t+S3 .. t .. t+S3 .. F_static .. 0      t trough, S strokes, rising
//! ```
//! Dry friction remembers its turning points: a closed loop leaves the rising branch unchanged, so that one pass gives four
//! tests. This holds for laws that do not depend on the rate; the unit test compares the pass with the single tests.

use super::Aggregate;
use crate::model::Plant;
use crate::model::leaf_pack::{LeafPack, graded_path};
use crate::units::joules_from_nmm;

/// Result of a pass.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pass {
    /// One pair per stroke.
    pub sines: Vec<Aggregate>,
    /// Figures of the slow ramp.
    pub statics: Aggregate,
    /// Displacement in mm and force in N at every step.
    pub points: Vec<(f64, f64)>,
}

/// Largest number of steps up to a force.
const MOST_STEPS: usize = 400;

struct Walker<'a> {
    pack: &'a mut LeafPack,
    longest_mm: f64,
    points: Vec<(f64, f64)>,
}

impl Walker<'_> {
    fn step(&mut self, to_mm: f64) -> f64 {
        let force_n = self.pack.step(to_mm, 1.0);
        self.points.push((to_mm, force_n));
        force_n
    }

    fn at(&self) -> (f64, f64) {
        self.points.last().copied().unwrap_or((0.0, 0.0))
    }

    /// Straight to a displacement; returns the work done, N mm.
    fn leg(&mut self, to_mm: f64) -> f64 {
        let from = self.points.len() - 1;
        for d in graded_path(&[self.at().0, to_mm], self.longest_mm)
            .into_iter()
            .skip(1)
        {
            self.step(d);
        }
        work_nmm(&self.points[from..])
    }

    /// Up to a force, the last steps shortened to meet it; returns the work done, N mm.
    fn leg_to_force(&mut self, force_n: f64) -> f64 {
        let from = self.points.len() - 1;
        let mut rate = 60.0;
        for _ in 0..MOST_STEPS {
            let (at_mm, at_n) = self.at();
            let missing_n = force_n - at_n;
            if missing_n < 0.2 {
                break;
            }
            let step_mm = (missing_n / rate).min(self.longest_mm);
            let now_n = self.step(at_mm + step_mm);
            rate = ((now_n - at_n) / step_mm).max(5.0);
        }
        work_nmm(&self.points[from..])
    }
}

/// Work by the trapezoidal rule, N mm.
fn work_nmm(points: &[(f64, f64)]) -> f64 {
    points
        .windows(2)
        .map(|w| 0.5 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0))
        .sum()
}

/// Moves a pack at rest through sines of `strokes_mm` (rising) above `trough_mm`, and the slow ramp to `static_n`.
pub(crate) fn walk(
    pack: &mut LeafPack,
    trough_mm: f64,
    strokes_mm: &[f64],
    static_n: f64,
    longest_mm: f64,
) -> Pass {
    let mut walker = Walker {
        pack,
        longest_mm,
        points: Vec::new(),
    };
    walker.step(0.0);
    let mut rising_nmm = 0.0;
    let mut sines = Vec::new();
    for stroke_mm in strokes_mm {
        let top_mm = trough_mm + stroke_mm;
        rising_nmm += walker.leg(top_mm);
        let down_nmm = walker.leg(trough_mm);
        let up_nmm = walker.leg(top_mm);
        sines.push(Aggregate {
            peak_force_n: walker.at().1,
            loop_energy_j: joules_from_nmm(up_nmm + down_nmm),
        });
    }
    rising_nmm += walker.leg_to_force(static_n);
    let peak_force_n = walker.at().1;
    let falling_nmm = walker.leg(0.0);
    Pass {
        sines,
        statics: Aggregate {
            peak_force_n,
            loop_energy_j: joules_from_nmm(rising_nmm + falling_nmm),
        },
        points: walker.points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::targets::TargetMotion;
    use crate::model::leaf_pack::{PackStructure, Values};

    #[test]
    fn one_pass_gives_the_figures_of_the_single_tests() {
        let values = Values {
            interleaf_mu: 0.2,
            rail_mu: 0.2,
            pin_mu: 0.2,
            ..Values::frictionless()
        };
        let pack = LeafPack::new(&PackStructure::default(), &values).expect("valid");
        let pass = walk(&mut pack.clone(), 1.5, &[6.0, 10.0], 1500.0, 1.0);
        let mut plant: Box<dyn Plant> = Box::new(pack);
        let motions = [6.0, 10.0].map(|stroke_mm| TargetMotion::Sine {
            stroke_mm,
            frequency_hz: 1.0,
            valley_mm: 1.5,
        });
        let statics = TargetMotion::ForceRamp {
            force_n: 1500.0,
            duration_s: 120.0,
        };
        let one_by_one = motions
            .into_iter()
            .chain([statics])
            .map(|m| m.measure(&mut plant));
        assert_eq!(pass.sines.len(), 2);
        for (own, pass) in one_by_one.zip(pass.sines.iter().chain([&pass.statics])) {
            let errors = pass.errors(&own);
            // Steps of up to 1 mm against 400 steps per cycle.
            assert!(
                errors[0].abs() < 2e-3 && errors[1].abs() < 0.02,
                "{own:?} against {pass:?}: {errors:?}"
            );
        }
    }
}
