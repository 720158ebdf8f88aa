//! Aggregates as input: rows of a published table (peak force and loop energy of a motion) instead of recordings.
//! Two numbers a row hide the loop's shape; what that allows to conclude is for `diagnose`.

use std::io::Read;

use super::IdentifyError;
use super::drive::ForceDriver;
use super::objective::{Residuals, scaled_difference};
use crate::model::{BuildError, Parameter, Plant};
use crate::units::joules_from_nmm;

/// Steps of a cycle: loop energies of smooth laws are then within 0.1 %.
const STEPS: usize = 400;
/// A ramp that should reach a force gives up after this many times its expected travel.
const PATIENCE: usize = 8;

/// What the rig did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum TargetMotion {
    /// From rest to a force and back to the start, straight in displacement; the peak force is met by construction.
    ForceRamp {
        /// Force to reach in N.
        force_n: f64,
        /// Up and down, in s.
        duration_s: f64,
    },
    /// From rest by a stroke and back, straight.
    Ramp {
        /// Travel in mm.
        stroke_mm: f64,
        /// Up and down, in s.
        duration_s: f64,
    },
    /// A steady sine; the cycle after the first counts.
    Sine {
        /// Peak to peak in mm: twice what some call the amplitude.
        stroke_mm: f64,
        /// Frequency in Hz.
        frequency_hz: f64,
        /// Lowest displacement in mm.
        valley_mm: f64,
    },
}

/// One row of a table.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoopTarget {
    /// Mount or profile, for messages and for whoever builds the plant.
    pub profile: String,
    /// What the rig did.
    pub motion: TargetMotion,
    /// Measured peak force in N.
    pub peak_force_n: f64,
    /// Measured loop energy in J.
    pub loop_energy_j: f64,
}

/// Peak force and loop energy of one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Aggregate {
    /// Largest force in N.
    pub peak_force_n: f64,
    /// Energy lost in the cycle in J.
    pub loop_energy_j: f64,
}

/// Peak force and trapezoidal area while a plant moves.
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

    fn to(&mut self, x_mm: f64, dt_s: f64) {
        let force_n = self.plant.step(x_mm, dt_s);
        self.energy_nmm += 0.5 * (force_n + self.force_n) * (x_mm - self.at_mm);
        self.peak_n = self.peak_n.max(force_n);
        (self.at_mm, self.force_n) = (x_mm, force_n);
    }

    /// Forgets what was measured, keeps where the plant is.
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
    /// Leads `plant` from rest through the motion.
    pub(crate) fn measure(&self, plant: &mut Box<dyn Plant>) -> Aggregate {
        plant.reset();
        match *self {
            TargetMotion::ForceRamp { force_n, duration_s } => force_ramp(plant, force_n, duration_s),
            TargetMotion::Ramp {
                stroke_mm,
                duration_s,
            } => {
                let mut meter = Meter::new(plant);
                let dt_s = duration_s / STEPS as f64;
                meter.to(0.0, dt_s);
                meter.restart();
                for i in (1..=STEPS / 2).chain((0..STEPS / 2).rev()) {
                    meter.to(stroke_mm * i as f64 / (STEPS / 2) as f64, dt_s);
                }
                meter.aggregate()
            }
            TargetMotion::Sine {
                stroke_mm,
                frequency_hz,
                valley_mm,
            } => {
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
        }
    }
}

/// Even steps of displacement until the force is there, the last one cut to meet it, and the same way back.
fn force_ramp(plant: &mut Box<dyn Plant>, force_n: f64, duration_s: f64) -> Aggregate {
    let dt_s = duration_s / STEPS as f64;
    // Where the force will be reached decides the step: asked of a copy under force control, a few strides long.
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
            // One secant step inside the last stride: the force is smooth there.
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

/// Builds the plant for a row: the mount may differ from row to row, the values are shared.
pub(crate) type TargetFactory<'a> =
    dyn Fn(&[f64], &LoopTarget) -> Result<Box<dyn Plant>, BuildError> + Sync + 'a;

/// Rows as residuals of objective (9): peak force in kN and loop energy in J, each over its scale, weighted.
pub(crate) struct TargetProblem<'a> {
    parameters: Vec<Parameter>,
    factory: Box<TargetFactory<'a>>,
    targets: Vec<LoopTarget>,
    peak_weight: f64,
    energy_weight: f64,
}

impl<'a> TargetProblem<'a> {
    /// With the paper's weights (Table 4): 1 for the peak force, 0.6 for the loop energy.
    pub(crate) fn new(
        parameters: Vec<Parameter>,
        factory: Box<TargetFactory<'a>>,
        targets: Vec<LoopTarget>,
    ) -> Self {
        TargetProblem {
            parameters,
            factory,
            targets,
            peak_weight: 1.0,
            energy_weight: 0.6,
        }
    }

    /// What the plant gives, row by row.
    pub(crate) fn measure(&self, values: &[f64]) -> Result<Vec<Aggregate>, BuildError> {
        self.targets
            .iter()
            .map(|target| Ok(target.motion.measure(&mut (self.factory)(values, target)?)))
            .collect()
    }

    /// The rows.
    pub(crate) fn targets(&self) -> &[LoopTarget] {
        &self.targets
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
            pair[0] = scaled_difference(
                kilonewtons(target.peak_force_n),
                kilonewtons(reached.peak_force_n),
                self.peak_weight,
            );
            pair[1] = scaled_difference(target.loop_energy_j, reached.loop_energy_j, self.energy_weight);
        }
        Ok(())
    }
}

/// Reads rows from CSV: `profile, motion (force-ramp | ramp | sine), stroke_mm, duration_s, frequency_hz, valley_mm,
/// peak_force_n, loop_energy_j`, by name, in any order; cells that the motion does not need stay empty.
pub(crate) fn read_targets(reader: impl Read) -> Result<Vec<LoopTarget>, IdentifyError> {
    let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
    let refused = |row: usize, column: &str, reason: String| IdentifyError::Targets {
        row,
        column: column.to_owned(),
        reason,
    };
    let header = csv.headers().map_err(|e| refused(0, "", e.to_string()))?.clone();
    for column in ["profile", "motion", "peak_force_n", "loop_energy_j"] {
        if !header.iter().any(|h| h == column) {
            return Err(refused(
                0,
                column,
                "the column is missing: add it to the header".to_owned(),
            ));
        }
    }
    let mut targets = Vec::new();
    for (index, record) in csv.records().enumerate() {
        let row = index + 1;
        let record = record.map_err(|e| refused(row, "", e.to_string()))?;
        let cell = |column: &str| {
            let place = header.iter().position(|h| h == column);
            place.and_then(|i| record.get(i)).unwrap_or("")
        };
        let number = |column: &str, least: f64| match cell(column).parse::<f64>() {
            Ok(value) if value.is_finite() && value >= least => Ok(value),
            _ => Err(refused(
                row,
                column,
                match least {
                    f64::MIN => format!("\"{}\" is not a finite number: enter one", cell(column)),
                    _ => format!(
                        "\"{}\" is not a number from {least:e} on: enter one",
                        cell(column)
                    ),
                },
            )),
        };
        let peak_force_n = number("peak_force_n", f64::MIN_POSITIVE)?;
        let motion = match cell("motion") {
            "force-ramp" => TargetMotion::ForceRamp {
                force_n: peak_force_n,
                duration_s: number("duration_s", 1e-3)?,
            },
            "ramp" => TargetMotion::Ramp {
                stroke_mm: number("stroke_mm", 1e-6)?,
                duration_s: number("duration_s", 1e-3)?,
            },
            "sine" => TargetMotion::Sine {
                stroke_mm: number("stroke_mm", 1e-6)?,
                frequency_hz: number("frequency_hz", 1e-6)?,
                valley_mm: number("valley_mm", f64::MIN)?,
            },
            other => {
                let reason = format!("\"{other}\" is no motion: use force-ramp, ramp or sine");
                return Err(refused(row, "motion", reason));
            }
        };
        targets.push(LoopTarget {
            profile: cell("profile").to_owned(),
            motion,
            peak_force_n,
            loop_energy_j: number("loop_energy_j", 0.0)?,
        });
    }
    Ok(targets)
}

#[cfg(test)]
mod tests {
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
        // Energy: 2 r E_mean (S - 2 p tanh(S / 2p)), as in the model's own text; trapezoid over 400 steps leaves 0.1 %.
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
        // One secant inside a stride of 0.1 mm; the presliding is over there, so it is straight.
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
            let reached = target.motion.measure(&mut spring(&TRUTH).expect("within bounds"));
            target.peak_force_n = reached.peak_force_n;
            target.loop_energy_j = reached.loop_energy_j;
        }
        let parameters = model::find("equivalent").expect("listed").parameters.to_vec();
        let problem = TargetProblem::new(parameters, Box::new(|values, _| spring(values)), targets);
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

    #[test]
    fn bad_rows_are_named() {
        let head = "profile,motion,stroke_mm,frequency_hz,valley_mm,duration_s,peak_force_n,loop_energy_j\n";
        for (rows, row, column) in [
            ("a,sine,6,1,2,,1,1\nb,sine,6,1,2,,NaN,1\n", 2, "peak_force_n"),
            ("a,wobble,6,1,2,,1,1\n", 1, "motion"),
            ("a,sine,,1,2,,1,1\n", 1, "stroke_mm"),
            ("a,sine,6,1,2,,1,-3\n", 1, "loop_energy_j"),
        ] {
            let error = read_targets(format!("{head}{rows}").as_bytes()).expect_err("bad");
            let IdentifyError::Targets {
                row: at,
                column: named,
                ..
            } = &error
            else {
                panic!("{error}");
            };
            assert_eq!((*at, named.as_str()), (row, column), "{error}");
        }
        assert!(read_targets("profile,motion\n".as_bytes()).is_err());
    }
}
