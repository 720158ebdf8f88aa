//! What a fit minimises: residuals of a plant against measurements, and the objectives of two papers.
//! Recordings are in `curve`, rows of tests (objective 9) in `targets`; the searches use only [`Residuals`].

use super::IdentifyError;
use super::drive::ForceDriver;
use crate::model::{BuildError, Parameter, Plant};

/// Builds a plant from one value per parameter.
pub(crate) type Factory<'a> = dyn Fn(&[f64]) -> Result<Box<dyn Plant>, BuildError> + Sync + 'a;

/// A problem of identification: parameters in, weighted residuals out. The same values give the same bits.
pub(crate) trait Residuals: Sync {
    /// Parameters, in the order of `values`.
    fn parameters(&self) -> &[Parameter];
    /// Number of residuals, the length of `out`.
    fn count(&self) -> usize;
    /// Writes the residuals, measured minus model times weight, into `out`.
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError>;
    /// The number to minimise; the sum of squares unless a paper has another objective.
    fn cost(&self, residuals: &[f64]) -> f64 {
        residuals.iter().map(|r| r * r).sum()
    }
    /// Lengths of the stretches (recordings) within which residuals may be correlated; they sum to `count`.
    fn stretches(&self) -> Vec<usize> {
        vec![self.count()]
    }
}

/// Signed square root of one term of objective (9) of Kadziela et al. (2015), `w (r - t)^2 / s^2` with `s = |t| + 0.001`.
///
/// The 0.001 is in the units of the paper's table: give `target` and `reached` in kN or J.
pub(crate) fn scaled_difference(target: f64, reached: f64, weight: f64) -> f64 {
    weight.sqrt() * (target - reached) / (target.abs() + 0.001)
}

/// A course of forces at a constant time step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ForceProgramme {
    /// Forces in N, one per step.
    pub force_n: Vec<f64>,
    /// Time step in s.
    pub dt_s: f64,
}

impl ForceProgramme {
    /// `cycles` of a sine from `low_n` to `high_n` and back, with `steps` per cycle.
    pub(crate) fn sine(low_n: f64, high_n: f64, frequency_hz: f64, cycles: usize, steps: usize) -> Self {
        let force_n = (0..=cycles * steps)
            .map(|i| {
                let phase = std::f64::consts::TAU * (i % steps) as f64 / steps as f64;
                low_n + 0.5 * (high_n - low_n) * (1.0 - phase.cos())
            })
            .collect();
        ForceProgramme {
            force_n,
            dt_s: 1.0 / (frequency_hz * steps as f64),
        }
    }

    /// Deformation in mm at every step.
    pub(crate) fn deformation_mm(&self, plant: &mut Box<dyn Plant>) -> Vec<f64> {
        plant.reset();
        let mut driver = ForceDriver::new(plant);
        self.force_n
            .iter()
            .map(|&force_n| driver.lead(force_n, self.dt_s))
            .collect()
    }
}

/// Objective (4) of Polach and Hajzman: sum of |measured - calculated deformation| over points at equal forces.
pub(crate) struct DeformationProblem<'a> {
    parameters: Vec<Parameter>,
    factory: Box<Factory<'a>>,
    programme: ForceProgramme,
    /// Step of the programme, and measured deformation there in mm.
    points: Vec<(usize, f64)>,
}

impl<'a> DeformationProblem<'a> {
    /// `measured_mm` has one deformation per step of the programme; `count` points after step `from` are compared.
    pub(crate) fn new(
        parameters: Vec<Parameter>,
        factory: Box<Factory<'a>>,
        programme: ForceProgramme,
        measured_mm: &[f64],
        from: usize,
        count: usize,
    ) -> Result<Self, IdentifyError> {
        let steps = programme.force_n.len();
        if measured_mm.len() != steps || from >= steps || count == 0 || count > steps - from {
            return Err(IdentifyError::TooFewSamples {
                what: "the force programme".to_owned(),
                have: measured_mm.len().min(steps).saturating_sub(from),
                need: count.max(1),
            });
        }
        let last = steps - from - 1;
        let points = (1..=count)
            .map(|i| from + i * last / count)
            .map(|i| (i, measured_mm[i]))
            .collect();
        Ok(DeformationProblem {
            parameters,
            factory,
            programme,
            points,
        })
    }
}

impl Residuals for DeformationProblem<'_> {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn count(&self) -> usize {
        self.points.len()
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let calculated = self.programme.deformation_mm(&mut (self.factory)(values)?);
        for (place, &(step, measured)) in out.iter_mut().zip(&self.points) {
            *place = measured - calculated[step];
        }
        Ok(())
    }

    fn cost(&self, residuals: &[f64]) -> f64 {
        residuals.iter().map(|r| r.abs()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;

    #[test]
    fn objective_9_by_hand() {
        // Table 4 with the initial simulation of Table 2: 1.0 * (1.918 - 2.003)^2 / 2.004^2 + 0.6 * (0.1926 - 8.9)^2 / 8.901^2.
        let sum: f64 = [(2.003, 1.918, 1.0), (8.9, 0.1926, 0.6)]
            .iter()
            .map(|&(t, r, w)| scaled_difference(t, r, w).powi(2))
            .sum();
        let expected = (0.085f64 / 2.004).powi(2) + 0.6 * (8.7074f64 / 8.901).powi(2);
        assert!((sum - expected).abs() < 1e-12);
    }

    #[test]
    fn objective_4_is_the_sum_of_absolute_deformation_differences() {
        let linear = |values: &[f64]| {
            model::find("equivalent")?.plant(&[0.0, values[0], 0.0, 0.1], &toml::Table::new())
        };
        let rate = *model::find("equivalent")
            .expect("listed")
            .parameters
            .get(1)
            .expect("has a rate");
        let programme = ForceProgramme::sine(100.0, 1100.0, 0.05, 1, 400);
        let measured: Vec<f64> = programme.force_n.iter().map(|f| f / 50.0).collect();
        let problem =
            DeformationProblem::new(vec![rate], Box::new(linear), programme.clone(), &measured, 0, 200)
                .expect("enough steps");
        let mut out = vec![0.0; problem.count()];
        problem.evaluate(&[100.0], &mut out).expect("within bounds");
        let expected: f64 = (1..=200)
            .map(|i| programme.force_n[2 * i] * (1.0 / 50.0 - 1.0 / 100.0))
            .sum();
        // The driver finds each force to 1e-9 of itself.
        assert!((problem.cost(&out) / expected - 1.0).abs() < 1e-7);
        assert!(
            DeformationProblem::new(vec![rate], Box::new(linear), programme, &measured, 300, 200).is_err()
        );
    }
}
