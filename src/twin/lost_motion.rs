//! Force by which a twin is off because a play hides the small motions of the displacement from it.
//!
//! ```text
//! shift = max(h k, 2 h k - h k_before) + sigma k + b k_turn
//! ```
//! h: half width of the play, mm. sigma: displacement noise, mm. k: stiffness of the twin along its branch, N/mm; within a band
//! after a turn the largest about its present state. k_before: stiffness along the branch before. b: way back of the measured
//! displacement that the play hides, at most 2 h, mm. k_turn: stiffness of the twin if it turns where it is, N/mm.
//!
//! The play holds the twin back by h along a branch. At a turn the twin starts 2 h too late, and just after a turn a spring with
//! friction is many times as stiff as later. At rest the servo moves the piston back and forth by less than the play: the specimen
//! turns and the twin does not.

use crate::model::Plant;
use crate::recording::play::Play;

use super::moving_mean::MovingMean;

/// Share of the stiffness along the branch that is kept from step to step: the high stiffness after a turn fades slowly.
const FADE: f64 = 0.9;
/// Time in which the twin goes back through the play to find its stiffness, s: that of a servo that settles.
const SETTLING_S: f64 = 0.1;

/// A displacement before and after the play, with the force of the twin.
#[derive(Debug, Clone, Copy)]
pub(super) struct TwinStep {
    /// Displacement as measured, mm.
    pub measured_mm: f64,
    /// Displacement that the twin got, mm.
    pub twin_mm: f64,
    /// Force of the twin, N.
    pub twin_n: f64,
}

/// What the play hides at present.
#[derive(Debug, Clone)]
pub(super) struct LostMotion {
    noise_mm: f64,
    half_width_mm: f64,
    band_mm: f64,
    /// Direction in which the twin moved last: 1 loading, -1 unloading, 0 before the first motion.
    direction: f64,
    /// Displacement of the twin at its last turn, mm.
    turned_mm: f64,
    /// Measured displacement, mean over the window, and the farthest in this direction, mm.
    mean_mm: MovingMean,
    farthest_mm: f64,
    last_mm: Option<f64>,
    /// Stiffness along the branch, N/mm: that of the last step, or a larger one before it, faded.
    branch: f64,
    /// The same at the last turn.
    branch_before: f64,
    /// Displacement and force of the twin where that step began.
    step_from: Option<(f64, f64)>,
    around: Option<Around>,
}

/// Stiffness of the twin about one of its states, N/mm.
#[derive(Debug, Clone, Copy)]
struct Around {
    at_mm: f64,
    /// Further in the direction of motion.
    forth: f64,
    /// If it turns.
    back: f64,
}

/// The error of the twin's force and what it is scaled by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ShiftError {
    /// Largest error of the twin's force, N.
    pub shift_n: f64,
    /// Stiffness that turns displacement noise into force, N/mm.
    pub stiffness: f64,
}

impl LostMotion {
    /// Before the first sample. Motion within `band_mm` of a turn counts as near it; the mean is over `window` samples.
    pub(super) fn new(noise_mm: f64, band_mm: f64, window: usize) -> Self {
        LostMotion {
            noise_mm,
            half_width_mm: Play::SIGMAS * noise_mm,
            band_mm,
            direction: 0.0,
            turned_mm: 0.0,
            mean_mm: MovingMean::over(window),
            farthest_mm: 0.0,
            last_mm: None,
            branch: 0.0,
            branch_before: 0.0,
            step_from: None,
            around: None,
        }
    }

    /// Takes the next sample.
    pub(super) fn take(&mut self, step: &TwinStep) {
        let mean_mm = self.mean_mm.take(step.measured_mm);
        let last_mm = *self.last_mm.get_or_insert(step.twin_mm);
        let moved_mm = step.twin_mm - last_mm;
        self.last_mm = Some(step.twin_mm);
        if moved_mm * self.direction < 0.0 || self.step_from.is_none() || self.direction == 0.0 {
            self.direction = if moved_mm == 0.0 { 0.0 } else { moved_mm.signum() };
            self.turned_mm = last_mm;
            self.branch_before = self.branch;
            self.farthest_mm = mean_mm;
            self.step_from = Some((step.twin_mm, step.twin_n));
            self.around = None;
        }
        if self.direction * (mean_mm - self.farthest_mm) > 0.0 {
            self.farthest_mm = mean_mm;
        }
        self.follow_branch(step);
    }

    fn follow_branch(&mut self, step: &TwinStep) {
        let Some((from_mm, from_n)) = self.step_from else {
            return;
        };
        let travel_mm = (step.twin_mm - from_mm).abs();
        if travel_mm > self.band_mm {
            let here = (step.twin_n - from_n).abs() / travel_mm;
            self.branch = here.max(FADE * self.branch);
            self.step_from = Some((step.twin_mm, step.twin_n));
        }
    }

    /// The error along the branch, if the specimen has not turned.
    pub(super) fn along_branch(&self) -> ShiftError {
        self.error(self.branch, 0.0)
    }

    /// The error where the specimen may have turned without the twin, or the twin has just turned; `None` elsewhere. `plant` is
    /// the twin in its present state.
    pub(super) fn at_a_turn(&mut self, plant: &dyn Plant) -> Option<ShiftError> {
        let twin_mm = self.last_mm?;
        let back_mm = self.direction * (self.farthest_mm - self.mean_mm.value());
        let near = (twin_mm - self.turned_mm).abs() < self.band_mm;
        if !near && back_mm < self.noise_mm {
            return None;
        }
        let around = self.around(plant, twin_mm);
        let stiffness = if near {
            around.forth.max(around.back).max(self.branch)
        } else {
            self.branch
        };
        let back_n = around.back * back_mm.clamp(0.0, 2.0 * self.half_width_mm);
        Some(self.error(stiffness, back_n))
    }

    fn error(&self, stiffness: f64, back_n: f64) -> ShiftError {
        let late = stiffness.max(2.0 * stiffness - self.branch_before);
        ShiftError {
            shift_n: self.half_width_mm * late + self.noise_mm * stiffness + back_n,
            stiffness,
        }
    }

    /// Stiffness of the twin over the width of the play, in its direction and back. The copies of the twin take the same time, so
    /// that relaxation cancels.
    fn around(&mut self, plant: &dyn Plant, twin_mm: f64) -> Around {
        if let Some(around) = self.around
            && (twin_mm - around.at_mm).abs() <= self.half_width_mm
        {
            return around;
        }
        let width_mm = 2.0 * self.half_width_mm;
        let force_n = |mm: f64| plant.boxed_clone().step(mm, SETTLING_S);
        let here_n = force_n(twin_mm);
        let secant = |by_mm: f64| (force_n(twin_mm + by_mm) - here_n).abs() / width_mm.max(f64::MIN_POSITIVE);
        let around = Around {
            at_mm: twin_mm,
            forth: secant(self.direction * width_mm),
            back: secant(-self.direction * width_mm),
        };
        self.around = Some(around);
        around
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::equivalent::Equivalent;

    const NOISE_MM: f64 = 0.001;
    const BAND_MM: f64 = 0.02;

    /// A spring and its twin behind the play, without noise.
    struct Pair {
        spring: Equivalent,
        twin: Equivalent,
        play: Play,
        lost: LostMotion,
        at_mm: f64,
        error_n: f64,
    }

    impl Pair {
        fn new() -> Self {
            let spring = Equivalent::new(&[0.0, 72.0, 0.15, 0.4], 0.0).expect("four values");
            Pair {
                twin: spring.clone(),
                spring,
                play: Play::for_noise(NOISE_MM),
                lost: LostMotion::new(NOISE_MM, BAND_MM, 1),
                at_mm: 0.0,
                error_n: 0.0,
            }
        }

        /// Goes to a displacement in steps of 0.5 um.
        fn go_to(&mut self, to_mm: f64) {
            let (from_mm, steps) = (self.at_mm, ((to_mm - self.at_mm).abs() / 5e-4).ceil());
            for k in 1..=steps as u32 {
                let measured_mm = from_mm + (to_mm - from_mm) * f64::from(k) / steps;
                let twin_mm = self.play.pass(measured_mm);
                let twin_n = self.twin.step(twin_mm, 1e-3);
                self.error_n = self.spring.step(measured_mm, 1e-3) - twin_n;
                self.lost.take(&TwinStep {
                    measured_mm,
                    twin_mm,
                    twin_n,
                });
            }
            self.at_mm = to_mm;
        }

        fn at_a_turn(&mut self) -> Option<ShiftError> {
            self.lost.at_a_turn(&self.twin)
        }
    }

    /// Along the branch the twin is behind by the half width of the play: 4 um times 82.8 N/mm.
    #[test]
    fn along_a_branch_the_shift_is_small_and_no_turn_is_assumed() {
        let mut pair = Pair::new();
        pair.go_to(20.0);
        assert!((pair.error_n - 0.33).abs() < 0.01, "{}", pair.error_n);
        let along = pair.lost.along_branch();
        // The first branch counts as one after a turn, because the motion before the run is not known: 9 um times 82.8 N/mm.
        assert!(along.shift_n > pair.error_n && along.shift_n < 0.75, "{along:?}");
        assert_eq!(pair.at_a_turn(), None);
    }

    /// The servo goes back 7 um and the twin stays: 1100 N/mm, not 83.
    #[test]
    fn a_way_back_inside_the_play_counts_with_the_stiffness_of_a_turn() {
        let mut pair = Pair::new();
        pair.go_to(20.0);
        pair.go_to(19.993);
        assert!(pair.error_n < -6.0, "{}", pair.error_n);
        assert!(pair.lost.along_branch().shift_n < 0.75);
        let turned = pair.at_a_turn().expect("a way back");
        assert!(
            turned.shift_n > -pair.error_n && turned.shift_n < 9.5,
            "{} N against {turned:?}",
            pair.error_n
        );
        // It comes back and goes on: the inner loop has closed.
        pair.go_to(20.1);
        assert_eq!(pair.at_a_turn(), None);
        assert!(pair.error_n.abs() < pair.lost.along_branch().shift_n);
    }

    /// After a turn the twin has gone 8 um less than the spring.
    #[test]
    fn just_after_a_turn_of_the_twin_the_stiffness_is_that_of_a_turn() {
        let mut pair = Pair::new();
        pair.go_to(20.0);
        pair.go_to(19.99);
        let turned = pair.at_a_turn().expect("a turn");
        assert!(
            turned.stiffness > 900.0 && turned.shift_n > pair.error_n.abs(),
            "{turned:?}"
        );
        pair.go_to(19.9);
        assert_eq!(pair.at_a_turn(), None);
        // 0.1 of 0.4 mm after the turn.
        let along = pair.lost.along_branch();
        assert!(along.stiffness > 700.0 && along.stiffness < 1100.0, "{along:?}");
    }
}
