//! Rows of tests as input: peak force and loop energy of a motion instead of a recording.
//!
//! Two figures per test do not show the loop's shape; `diagnose` decides what they allow to conclude. `target_table` reads
//! the rows from a file.

use super::drive::ForceDriver;
use super::objective::{Factory, Residuals, scaled_difference};
use crate::model::{BuildError, Parameter, Plant};
use crate::units::joules_from_nmm;

/// Steps per cycle: loop energies of smooth laws are then within 0.1 %.
const STEPS: usize = 400;
/// A ramp to a force ends after this many times its expected travel.
const PATIENCE: usize = 8;
/// Duration of a slow ramp up and down, in s, where a table gives none.
pub(crate) const SLOW_RAMP_S: f64 = 120.0;
/// Weights of objective (9), Table 4 of Kadziela et al. (2015): peak force and loop energy.
pub(crate) const PEAK_WEIGHT: f64 = 1.0;
pub(crate) const ENERGY_WEIGHT: f64 = 0.6;

/// Motion of a test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum TargetMotion {
    /// From rest to a force and back to the start, straight in displacement; the peak force is met by construction.
    ForceRamp {
        /// Force to reach in N.
        force_n: f64,
        /// Time up and down, in s.
        duration_s: f64,
    },
    /// From rest by a stroke and back, straight in displacement.
    Ramp {
        /// Travel in mm.
        stroke_mm: f64,
        /// Time up and down, in s.
        duration_s: f64,
    },
    /// A steady sine; the second cycle is measured.
    Sine {
        /// Peak to peak, in mm.
        stroke_mm: f64,
        /// Frequency in Hz.
        frequency_hz: f64,
        /// Lowest displacement in mm.
        valley_mm: f64,
    },
}

/// One test: its motion and its measured figures.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoopTarget {
    /// Motion of the test.
    pub motion: TargetMotion,
    /// Measured peak force and loop energy.
    pub measured: Aggregate,
}

/// Peak force and loop energy of one test.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Aggregate {
    /// Largest force in N.
    pub peak_force_n: f64,
    /// Energy lost in the loop, in J.
    pub loop_energy_j: f64,
}

impl Aggregate {
    /// Relative errors of peak force and loop energy against `measured`.
    pub(crate) fn errors(&self, measured: &Aggregate) -> [f64; 2] {
        [
            self.peak_force_n / measured.peak_force_n - 1.0,
            self.loop_energy_j / measured.loop_energy_j - 1.0,
        ]
    }
}

/// Measures peak force and trapezoidal area while a plant moves.
struct Meter<'a> {
    plant: &'a mut Box<dyn Plant>,
    at_mm: f64,
    force_n: f64,
    peak_n: f64,
    energy_nmm: f64,
}

impl<'a> Meter<'a> {
    fn new(plant: &'a mut Box<dyn Plant>) -> Self {
        Meter {
            plant,
            at_mm: 0.0,
            force_n: 0.0,
            peak_n: f64::NEG_INFINITY,
            energy_nmm: 0.0,
        }
    }

    /// One step to `x_mm`.
    fn to(&mut self, x_mm: f64, dt_s: f64) {
        let force_n = self.plant.step(x_mm, dt_s);
        self.energy_nmm += 0.5 * (force_n + self.force_n) * (x_mm - self.at_mm);
        self.peak_n = self.peak_n.max(force_n);
        (self.at_mm, self.force_n) = (x_mm, force_n);
    }

    /// Sets the measured figures back; the plant stays where it is.
    fn restart(&mut self) {
        self.peak_n = f64::NEG_INFINITY;
        self.energy_nmm = 0.0;
    }

    fn aggregate(&self) -> Aggregate {
        Aggregate {
            peak_force_n: self.peak_n,
            loop_energy_j: joules_from_nmm(self.energy_nmm),
        }
    }
}

impl TargetMotion {
    /// Moves `plant` from rest through the motion.
    pub(crate) fn measure(&self, plant: &mut Box<dyn Plant>) -> Aggregate {
        plant.reset();
        match *self {
            TargetMotion::ForceRamp { force_n, duration_s } => force_ramp(plant, force_n, duration_s),
            TargetMotion::Ramp {
                stroke_mm,
                duration_s,
            } => ramp(plant, stroke_mm, duration_s),
            TargetMotion::Sine {
                stroke_mm,
                frequency_hz,
                valley_mm,
            } => sine(plant, stroke_mm, frequency_hz, valley_mm),
        }
    }
}

fn ramp(plant: &mut Box<dyn Plant>, stroke_mm: f64, duration_s: f64) -> Aggregate {
    let mut meter = Meter::new(plant);
    let dt_s = duration_s / STEPS as f64;
    meter.to(0.0, dt_s);
    meter.restart();
    for i in (1..=STEPS / 2).chain((0..STEPS / 2).rev()) {
        meter.to(stroke_mm * i as f64 / (STEPS / 2) as f64, dt_s);
    }
    meter.aggregate()
}

fn sine(plant: &mut Box<dyn Plant>, stroke_mm: f64, frequency_hz: f64, valley_mm: f64) -> Aggregate {
    let mut meter = Meter::new(plant);
    let dt_s = 1.0 / (frequency_hz * STEPS as f64);
    let approach = (STEPS / 4).max(1);
    for i in 1..=approach {
        meter.to(valley_mm * i as f64 / approach as f64, dt_s);
    }
    for _cycle in 0..2 {
        meter.restart();
        for i in 1..=STEPS {
            let phase = std::f64::consts::TAU * i as f64 / STEPS as f64;
            meter.to(valley_mm + 0.5 * stroke_mm * (1.0 - phase.cos()), dt_s);
        }
    }
    meter.aggregate()
}

/// Even steps of displacement up to the force, the last one shortened to meet it, and the same steps back.
fn force_ramp(plant: &mut Box<dyn Plant>, force_n: f64, duration_s: f64) -> Aggregate {
    let dt_s = duration_s / STEPS as f64;
    // A copy under force control finds the travel, which sets the step.
    let mut copy = plant.boxed_clone();
    let mut driver = ForceDriver::new(&mut copy);
    let travel_mm = (1..=4).fold(0.0, |_, i| {
        driver.lead(force_n * f64::from(i) / 4.0, 0.125 * duration_s)
    });
    let step_mm = travel_mm / (STEPS / 2) as f64;
    let mut meter = Meter::new(plant);
    meter.to(0.0, dt_s);
    meter.restart();
    let mut path = vec![0.0];
    for _ in 0..PATIENCE * STEPS {
        let (before_mm, before_n) = (meter.at_mm, meter.force_n);
        let trial_n = meter.plant.boxed_clone().step(before_mm + step_mm, dt_s);
        if trial_n >= force_n {
            // One secant inside the last step: the force is smooth there.
            let share = ((force_n - before_n) / (trial_n - before_n)).clamp(0.0, 1.0);
            meter.to(before_mm + share * step_mm, share * dt_s);
            break;
        }
        meter.to(before_mm + step_mm, dt_s);
        path.push(meter.at_mm);
    }
    for &x_mm in path.iter().rev() {
        meter.to(x_mm, dt_s);
    }
    meter.aggregate()
}

/// Tests as residuals of objective (9): peak force in kN and loop energy in J.
pub(crate) struct TargetProblem<'a> {
    parameters: Vec<Parameter>,
    factory: Box<Factory<'a>>,
    targets: Vec<LoopTarget>,
}

impl<'a> TargetProblem<'a> {
    /// `factory` builds the plant that runs all tests.
    pub(crate) fn new(
        parameters: Vec<Parameter>,
        factory: Box<Factory<'a>>,
        targets: Vec<LoopTarget>,
    ) -> Self {
        TargetProblem {
            parameters,
            factory,
            targets,
        }
    }

    /// Figures of the plant, one pair per test.
    pub(crate) fn measure(&self, values: &[f64]) -> Result<Vec<Aggregate>, BuildError> {
        self.targets
            .iter()
            .map(|target| Ok(target.motion.measure(&mut (self.factory)(values)?)))
            .collect()
    }
}

impl Residuals for TargetProblem<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        2 * self.targets.len()
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for ((pair, target), reached) in out
            .chunks_exact_mut(2)
            .zip(&self.targets)
            .zip(self.measure(values)?)
        {
            let kilonewtons = |force_n: f64| 1e-3 * force_n;
            let measured = &target.measured;
            pair[0] = scaled_difference(
                kilonewtons(measured.peak_force_n),
                kilonewtons(reached.peak_force_n),
                PEAK_WEIGHT,
            );
            pair[1] = scaled_difference(measured.loop_energy_j, reached.loop_energy_j, ENERGY_WEIGHT);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::target_table::read_targets;
    use super::super::{FitControl, FitOptions, fit};
    use super::*;
    use crate::model;

    const TRUTH: [f64; 4] = [0.0, 80.0, 0.15, 0.4];

    fn spring(values: &[f64]) -> Result<Box<dyn Plant>, BuildError> {
        model::find("equivalent")?.plant(values, &toml::Table::new())
    }

    #[test]
    fn sine_gives_the_closed_form_of_the_equivalent_spring() {
        let motion = TargetMotion::Sine {
            stroke_mm: 6.0,
            frequency_hz: 1.0,
            valley_mm: 2.0,
        };
        let reached = motion.measure(&mut spring(&TRUTH).expect("within bounds"));
        // Energy: 2 r E_mean (S - 2 p tanh(S / 2p)), from the model's equations; the trapezoid over 400 steps is within 0.1 %.
        let energy_nmm = 2.0 * 0.15 * 400.0 * (6.0 - 0.8 * (6.0f64 / 0.8).tanh());
        assert!((reached.loop_energy_j / (1e-3 * energy_nmm) - 1.0).abs() < 1e-3);
        assert!((reached.peak_force_n - 640.0 * 1.15).abs() < 1e-3);
    }

    #[test]
    fn force_ramp_meets_its_force_and_closes() {
        let motion = TargetMotion::ForceRamp {
            force_n: 2000.0,
            duration_s: 120.0,
        };
        let reached = motion.measure(&mut spring(&TRUTH).expect("within bounds"));
        // One secant inside a step of 0.1 mm, where presliding has ended and the force is linear.
        assert!((reached.peak_force_n - 2000.0).abs() < 0.01, "{reached:?}");
        let peak_mm = 2000.0 / (80.0 * 1.15);
        let ramp = TargetMotion::Ramp {
            stroke_mm: peak_mm,
            duration_s: 120.0,
        };
        let same = ramp.measure(&mut spring(&TRUTH).expect("within bounds"));
        assert!((same.peak_force_n / reached.peak_force_n - 1.0).abs() < 1e-4);
        assert!((same.loop_energy_j / reached.loop_energy_j - 1.0).abs() < 2e-3);
    }

    #[test]
    fn rows_give_the_parameters_back() {
        let text = "profile,motion,stroke_mm,duration_s,frequency_hz,valley_mm,peak_force_n,loop_energy_j\n\
                    static,force-ramp,,120,,,2000,1\nsine 6,sine,6,,1,2,1,1\nsine 10,sine,10,,1,2,1,1\n";
        let mut targets = read_targets(text.as_bytes()).expect("well-formed");
        for target in &mut targets {
            target.measured = target.motion.measure(&mut spring(&TRUTH).expect("within bounds"));
        }
        let parameters = model::find("equivalent").expect("listed").parameters.to_vec();
        let problem = TargetProblem::new(parameters, Box::new(spring), targets);
        let options = FitOptions {
            start: Some(vec![0.0, 60.0, 0.05, 0.2]),
            fixed: vec!["preload_n".to_owned()],
            ..FitOptions::default()
        };
        let fit = fit(&problem, &options, &mut |_| FitControl::Continue).expect("fair");
        for (value, truth) in fit.values.iter().zip(TRUTH).skip(1) {
            assert!((value / truth - 1.0).abs() < 1e-3, "{:?}", fit.values);
        }
    }
}
