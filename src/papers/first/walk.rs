//! One pass through all rows of a mounting: the sines' loops one inside the other, then on to the static peak and back.
//!
//! ```text
//! 0 .. t+S1 .. t .. t+S1 .. t+S2 .. t .. t+S2 .. t+S3 .. t .. t+S3 .. F_static .. 0      t trough, S strokes, rising
//! ```
//! Dry friction remembers its turning points: a closed loop leaves the rising branch as it was, so one pass stands for four
//! tests. It holds for rate-independent laws; the rows are checked one by one with `identify::targets` in the tests.

use super::Two;
use crate::model::Plant;
use crate::model::leaf_pack::{LeafPack, graded_path};
use crate::units::joules_from_nmm;

/// What a pass gives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pass {
    /// One a stroke.
    pub sines: Vec<Two>,
    /// The static row.
    pub statics: Two,
    /// Travel of the static row, mm.
    pub travel_mm: f64,
    /// Displacement and force of every step, mm and N.
    pub points: Vec<(f64, f64)>,
}

/// Steps of a leg that ends at a force: enough for a secant that has long settled.
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

    /// Straight to a displacement; the work done on the way, N mm.
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

    /// Up to a force, the last strides cut to meet it.
    fn leg_to_force(&mut self, force_n: f64) -> f64 {
        let from = self.points.len() - 1;
        let mut rate = 60.0;
        for _ in 0..MOST_STEPS {
            let (at_mm, at_n) = self.at();
            let missing_n = force_n - at_n;
            if missing_n < 0.2 {
                break;
            }
            let stride_mm = (missing_n / rate).min(self.longest_mm);
            let now_n = self.step(at_mm + stride_mm);
            rate = ((now_n - at_n) / stride_mm).max(5.0);
        }
        work_nmm(&self.points[from..])
    }
}

/// Trapezoids.
fn work_nmm(points: &[(f64, f64)]) -> f64 {
    points
        .windows(2)
        .map(|w| 0.5 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0))
        .sum()
}

/// Leads an untouched pack through sines of `strokes_mm` (rising) above `trough_mm` and the static test to `static_n`.
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
        sines.push(Two {
            peak_n: walker.at().1,
            loop_j: joules_from_nmm(up_nmm + down_nmm),
        });
    }
    rising_nmm += walker.leg_to_force(static_n);
    let (travel_mm, peak_n) = walker.at();
    let falling_nmm = walker.leg(0.0);
    Pass {
        sines,
        statics: Two {
            peak_n,
            loop_j: joules_from_nmm(rising_nmm + falling_nmm),
        },
        travel_mm,
        points: walker.points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::targets::TargetMotion;
    use crate::model::leaf_pack::{PackStructure, Values};

    #[test]
    fn one_pass_stands_for_the_tests_one_by_one() {
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
            let errors = [
                pass.peak_n / own.peak_force_n - 1.0,
                pass.loop_j / own.loop_energy_j - 1.0,
            ];
            // Strides of up to 1 mm against 400 steps a cycle; the memory of turning points holds to within that.
            assert!(
                errors[0].abs() < 2e-3 && errors[1].abs() < 0.02,
                "{own:?} against {pass:?}: {errors:?}"
            );
        }
    }
}
