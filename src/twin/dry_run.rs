//! Runs a profile on the model before it runs on the load frame: forces, travel, speeds and the margin to each limit.
//!
//! A model is always driven by displacement. Where the profile controls force, the displacement that gives the commanded
//! force is searched at every tick. `control` decides what a predicted trip means for a run.

use std::ops::ControlFlow;

use serde::Serialize;

use crate::model::Plant;
use crate::profile::{Extreme, LimitWatch, Player, Profile, ProfileError, ProfileLimits, Slot, Violation};
use crate::units::{Command, joules_from_nmm};

/// Prediction for a whole profile.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct DryRun {
    pub peak_force_n: f64,
    pub valley_force_n: f64,
    pub peak_displacement_mm: f64,
    pub valley_displacement_mm: f64,
    /// Peak minus valley of the displacement.
    pub travel_mm: f64,
    pub peak_velocity_mm_s: f64,
    /// Work done on the specimen from start to end. For a closed path it is the friction loss.
    pub energy_j: f64,
    pub duration_s: f64,
    pub cycles: u32,
    /// Largest difference between commanded and reached force in force control; 0 in displacement control.
    pub force_error_n: f64,
    /// The worst value for each limit.
    pub margins: Vec<Margin>,
    /// Limits that the model exceeds. A profile with any of them must not be armed.
    pub predicted_trips: Vec<Violation>,
}

/// A limit with the margin that is left.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Margin {
    /// The limit, the worst value and its time.
    #[serde(flatten)]
    pub worst: Extreme,
    /// Margin in percent of the limit; negative beyond it.
    pub margin_percent: f64,
}

/// One tick of a dry run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Predicted {
    /// Command, segment and cycle of the profile at this tick.
    pub slot: Slot,
    /// Displacement of the model.
    pub displacement_mm: f64,
    /// Force of the model.
    pub force_n: f64,
}

/// [`dry_run_with`] without a watcher.
#[cfg(test)]
pub(crate) fn dry_run(
    profile: &Profile,
    plant: &dyn Plant,
    limits: &ProfileLimits,
    sample_rate_hz: f64,
) -> Result<DryRun, ProfileError> {
    dry_run_with(profile, plant, limits, sample_rate_hz, &mut |_| {
        ControlFlow::Continue(())
    })
}

/// Plays `profile` from zero displacement on a reset copy of `plant`. A predicted trip is part of the result, not an error.
/// Every tick is passed to `watcher`. Where it breaks off, the result covers the ticks so far.
pub(crate) fn dry_run_with(
    profile: &Profile,
    plant: &dyn Plant,
    limits: &ProfileLimits,
    sample_rate_hz: f64,
    watcher: &mut dyn FnMut(&Predicted) -> ControlFlow<()>,
) -> Result<DryRun, ProfileError> {
    let mut player = Player::new(profile, 0.0, sample_rate_hz)?;
    let mut specimen = Inverse::new(plant.boxed_clone(), limits, sample_rate_hz);
    let mut watch = LimitWatch::new(limits, 0.0, sample_rate_hz);
    let (mut energy_nmm, mut force_error_n) = (0.0, 0.0_f64);
    let (mut force, mut displacement) = (PredictedRange::EMPTY, PredictedRange::EMPTY);
    let mut peak_velocity_mm_s = 0.0_f64;
    while let Some(slot) = player.next() {
        let (from_mm, from_n) = (specimen.displacement_mm, specimen.force_n);
        match slot.command {
            Command::Displacement(mm) => specimen.move_to(mm),
            Command::Force(n) => {
                specimen.load_to(n);
                force_error_n = force_error_n.max((specimen.force_n - n).abs());
            }
        }
        if watcher(&specimen.predicted(slot)).is_break() {
            break;
        }
        let moved_mm = specimen.displacement_mm - from_mm;
        energy_nmm += 0.5 * (from_n + specimen.force_n) * moved_mm;
        peak_velocity_mm_s = peak_velocity_mm_s.max(moved_mm.abs() * sample_rate_hz);
        force.see(specimen.force_n);
        displacement.see(specimen.displacement_mm);
        watch.see(
            slot.segment,
            Some(specimen.force_n),
            Some(specimen.displacement_mm),
        );
    }
    let margins = watch.extremes().into_iter();
    Ok(DryRun {
        peak_force_n: force.high,
        valley_force_n: force.low,
        peak_displacement_mm: displacement.high,
        valley_displacement_mm: displacement.low,
        travel_mm: displacement.high - displacement.low,
        peak_velocity_mm_s,
        energy_j: joules_from_nmm(energy_nmm),
        duration_s: player.duration_s(),
        cycles: player.total_cycles(),
        force_error_n,
        margins: margins
            .map(|worst| Margin {
                worst,
                margin_percent: worst.margin_percent(),
            })
            .collect(),
        predicted_trips: watch.violations(&profile.name),
    })
}

struct PredictedRange {
    low: f64,
    high: f64,
}

impl PredictedRange {
    const EMPTY: PredictedRange = PredictedRange {
        low: f64::INFINITY,
        high: f64::NEG_INFINITY,
    };

    fn see(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }
}

/// A force this close to the command is reached: a tenth of a count of the load cell.
const FORCE_TOLERANCE_N: f64 = 0.01;
/// Most secant steps per tick. Two or three are usual, a reversal needs more.
const MAX_TRIES: usize = 20;
/// Range of the model's stiffness that the secant steps use, N/mm.
const SLOPE_N_PER_MM: [f64; 2] = [0.1, 1e5];

/// A model with its state that can be driven to a force.
struct Inverse {
    plant: Box<dyn Plant>,
    displacement_mm: f64,
    force_n: f64,
    slope_n_per_mm: f64,
    step_max_mm: f64,
    dt_s: f64,
}

impl Inverse {
    fn new(mut plant: Box<dyn Plant>, limits: &ProfileLimits, sample_rate_hz: f64) -> Self {
        let dt_s = 1.0 / sample_rate_hz;
        plant.reset();
        let force_n = plant.step(0.0, dt_s);
        // The first slope is that of a small move. It only affects how many tries the first ticks take.
        let slope_n_per_mm = (plant.boxed_clone().step(0.1, dt_s) - force_n) / 0.1;
        Inverse {
            plant,
            displacement_mm: 0.0,
            force_n,
            slope_n_per_mm: slope_n_per_mm.clamp(SLOPE_N_PER_MM[0], SLOPE_N_PER_MM[1]),
            // Where the force needs a faster motion than the limit allows, the displacement lags behind.
            step_max_mm: limits.velocity_max_mm_s * dt_s,
            dt_s,
        }
    }

    /// The specimen as it is after the command of `slot`.
    fn predicted(&self, slot: Slot) -> Predicted {
        Predicted {
            slot,
            displacement_mm: self.displacement_mm,
            force_n: self.force_n,
        }
    }

    fn move_to(&mut self, displacement_mm: f64) {
        self.displacement_mm = displacement_mm;
        self.force_n = self.plant.step(displacement_mm, self.dt_s);
    }

    fn load_to(&mut self, force_n: f64) {
        let start_mm = self.displacement_mm;
        let (mut x, mut error) = (start_mm, self.force_n - force_n);
        let (mut best_mm, mut best) = (x, error.abs());
        for _ in 0..MAX_TRIES {
            if best <= FORCE_TOLERANCE_N {
                break;
            }
            let wanted = x - error / self.slope_n_per_mm;
            let next = wanted.clamp(start_mm - self.step_max_mm, start_mm + self.step_max_mm);
            if next == x {
                break;
            }
            let next_error = self.plant.boxed_clone().step(next, self.dt_s) - force_n;
            let slope = (next_error - error) / (next - x);
            // Where the pusher has left the spring the slope is 0. The slope from before leads back to contact.
            if slope >= SLOPE_N_PER_MM[0] {
                self.slope_n_per_mm = slope.min(SLOPE_N_PER_MM[1]);
            }
            (x, error) = (next, next_error);
            if error.abs() < best {
                (best_mm, best) = (x, error.abs());
            }
        }
        self.move_to(best_mm);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;

    const LIMITS: ProfileLimits = ProfileLimits::EXAMPLE;

    fn spring() -> Box<dyn Plant> {
        model::find("equivalent")
            .unwrap()
            .plant(&[0.0, 72.0, 0.15, 0.4], &toml::Table::new())
            .unwrap()
    }

    fn shipped(text: &str) -> Profile {
        Profile::from_toml(text, "shipped").unwrap()
    }

    #[test]
    fn the_static_ramp_follows_its_force() {
        let ramp = shipped(include_str!("../../bench-configs/profiles/static-ramp.toml"));
        let run = dry_run(&ramp, spring().as_ref(), &LIMITS, 1000.0).unwrap();
        assert!((run.peak_force_n - 2000.0).abs() <= FORCE_TOLERANCE_N, "{run:?}");
        // 2000 N / (72 N/mm * 1.15): full sliding.
        assert!((run.peak_displacement_mm - 24.155).abs() < 0.01, "{run:?}");
        assert!(run.force_error_n <= FORCE_TOLERANCE_N, "{run:?}");
        assert_eq!((run.duration_s, run.cycles), (120.0, 0));
        assert!(run.predicted_trips.is_empty(), "{:?}", run.predicted_trips);
        let force = run
            .margins
            .iter()
            .find(|m| m.worst.name == "force_max_n")
            .unwrap();
        assert!((force.margin_percent - 37.5).abs() < 0.01);
        // Table 2 of Kadziela et al. gives 6.05 J; the specimen was adjusted to that within a few percent.
        assert!((run.energy_j / 6.05 - 1.0).abs() < 0.05, "{} J", run.energy_j);
    }

    #[test]
    fn a_limit_that_would_trip_is_predicted() {
        let sine = shipped(include_str!("../../bench-configs/profiles/sine-15mm-1hz.toml"));
        let tight = ProfileLimits {
            force_max_n: 2500.0,
            velocity_max_mm_s: 90.0,
            ..LIMITS
        };
        let run = dry_run(&sine, spring().as_ref(), &tight, 1000.0).unwrap();
        let names: Vec<_> = run.predicted_trips.iter().map(|t| t.worst.name).collect();
        assert_eq!(names, ["force_max_n", "velocity_max_mm_s"]);
        // 35 mm * 72 N/mm * 1.15.
        assert!((run.peak_force_n - 2898.0).abs() < 1.0);
        assert!(run.predicted_trips[0].to_string().contains("force_max_n = 2500"));
    }
}
