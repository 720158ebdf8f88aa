//! Recordings as a problem: the plant follows the recorded displacement, and its force is compared with the load cell.
//!
//! Every sample is stepped, because the plant has memory; flagged samples are not compared. The state of the hysteresis at
//! the first sample of a recording is unknown: [`Initial`] says how it is made.

use super::IdentifyError;
use super::objective::{Factory, Residuals};
use super::path::{approach, range, reversals};
use crate::model::{BuildError, Model, Parameter, Plant};
use crate::recording::{Flags, Recording};

/// How the plant reaches its state at the first sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Initial {
    /// From rest at zero displacement, straight to the first sample.
    FromRest,
    /// The first cycle is run once before it is compared.
    ReplayFirstCycle,
    /// `FromRest`. If the first sample is loaded, nothing is compared before the second reversal, because the friction of a
    /// loaded spring depends on its earlier motion.
    Unknown,
}

/// A first sample below this share of the force range carries no load.
const UNLOADED: f64 = 0.02;
/// A turning point is one that the displacement leaves by more than this share of its range.
const REVERSAL_BAND: f64 = 0.02;

/// One recording, ready to be compared.
#[derive(Debug, Clone)]
struct PreparedCurve {
    displacement_mm: Vec<f64>,
    dt_s: Vec<f64>,
    force_n: Vec<f64>,
    /// One over the recording's range of force, 1/N: every sample of every recording counts alike.
    weight_per_n: f64,
    /// True for every sample that is compared.
    compared: Vec<bool>,
    /// Displacements from rest to the state before the first sample, and their time step.
    approach_mm: Vec<f64>,
    approach_dt_s: f64,
}

/// Recordings of one specimen, against a plant of `factory`.
pub(crate) struct CurveProblem<'a> {
    parameters: Vec<Parameter>,
    factory: Box<Factory<'a>>,
    curves: Vec<PreparedCurve>,
}

impl<'a> CurveProblem<'a> {
    /// A model of the list, all its parameters.
    pub(crate) fn of_model(
        model: &'static Model,
        structure: &'a toml::Table,
        recordings: &[Recording],
        initial: Initial,
    ) -> Result<Self, IdentifyError> {
        let curves = recordings
            .iter()
            .map(|recording| PreparedCurve::new(recording, initial))
            .collect::<Result<Vec<_>, _>>()?;
        let problem = CurveProblem {
            parameters: model.parameters.to_vec(),
            factory: Box::new(move |values| model.plant(values, structure)),
            curves,
        };
        let (have, need) = (problem.count(), problem.parameters.len().max(1));
        if have < need {
            return Err(IdentifyError::TooFewSamples {
                what: "the recordings".to_owned(),
                have,
                need,
            });
        }
        Ok(problem)
    }
}

impl Residuals for CurveProblem<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        self.stretches().iter().sum()
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let mut plant = (self.factory)(values)?;
        let mut places = out.iter_mut();
        for curve in self.curves.iter().filter(|curve| curve.count() > 0) {
            curve.run(plant.as_mut(), |i, force_n| {
                if curve.compared[i]
                    && let Some(place) = places.next()
                {
                    *place = (curve.force_n[i] - force_n) * curve.weight_per_n;
                }
            });
        }
        Ok(())
    }

    fn stretches(&self) -> Vec<usize> {
        self.curves.iter().map(PreparedCurve::count).collect()
    }
}

impl PreparedCurve {
    fn new(recording: &Recording, initial: Initial) -> Result<Self, IdentifyError> {
        check(recording)?;
        let n = recording.len();
        let mut dt_s: Vec<f64> = recording.time_s.windows(2).map(|t| t[1] - t[0]).collect();
        dt_s.insert(0, dt_s[0]);
        let displacement_mm = recording.displacement_mm.clone();
        let reversals = reversals(&displacement_mm, REVERSAL_BAND * range(&displacement_mm));
        let replay = initial == Initial::ReplayFirstCycle;
        Ok(PreparedCurve {
            weight_per_n: 1.0 / range(&recording.force_n).max(f64::MIN_POSITIVE),
            compared: compared(recording, &reversals, initial),
            approach_mm: approach(&displacement_mm, &reversals, replay),
            approach_dt_s: dt_s.iter().sum::<f64>() / n as f64,
            displacement_mm,
            dt_s,
            force_n: recording.force_n.clone(),
        })
    }

    /// Number of samples that are compared.
    fn count(&self) -> usize {
        self.compared.iter().filter(|&&compared| compared).count()
    }

    /// Leads the plant from rest through all samples.
    fn run(&self, plant: &mut dyn Plant, mut take: impl FnMut(usize, f64)) {
        plant.reset();
        for &x in &self.approach_mm {
            plant.step(x, self.approach_dt_s);
        }
        for (i, (&x, &dt)) in self.displacement_mm.iter().zip(&self.dt_s).enumerate() {
            take(i, plant.step(x, dt));
        }
    }
}

/// Refuses columns that a plant cannot follow.
fn check(recording: &Recording) -> Result<(), IdentifyError> {
    let refused = |reason| {
        Err(IdentifyError::Recording {
            name: recording.name.clone(),
            reason,
        })
    };
    let n = recording.len();
    if recording.displacement_mm.len() != n || recording.force_n.len() != n {
        return refused("the columns differ in length: export the recording again");
    }
    if n < 2 {
        return refused("it has fewer than 2 samples: use a longer recording");
    }
    let columns = [&recording.time_s, &recording.displacement_mm, &recording.force_n];
    if !columns.iter().all(|column| column.iter().all(|x| x.is_finite())) {
        return refused("it has values that are not finite: remove their rows");
    }
    Ok(())
}

/// True for every sample that the rig did not flag and that comes after the stretch that `initial` leaves out.
fn compared(recording: &Recording, reversals: &[usize], initial: Initial) -> Vec<bool> {
    let mut compared = vec![true; recording.len()];
    if let Some(flags) = &recording.flags {
        for (place, &flag) in compared.iter_mut().zip(flags) {
            *place = !Flags::from_bits_retain(flag).intersects(Flags::UNUSABLE);
        }
    }
    let loaded = || recording.force_n[0].abs() > UNLOADED * range(&recording.force_n);
    if initial == Initial::Unknown && loaded() {
        // A single ramp has one reversal only: then up to that.
        let dropped = reversals.get(1).or(reversals.first()).copied().unwrap_or(0);
        compared[..dropped].fill(false);
    }
    compared
}

#[cfg(test)]
mod tests;
