//! The loops of a profile from a model at the predicted parameters, with what the model itself is wrong by.
//!
//! ```text
//! y_ij = F_j(mean) + sum over q of D_jq z_iq + misfit_j        D_jq = (F_j(+1 deviation of q) - F_j(-1 deviation)) / 2
//! ```
//! z are the draws of the parameters in standard deviations (Student's t, with the correlation of the runs of the family). The misfit of
//! a value is normal, and independent from value to value; the largest and the smallest value of some cycles share it.

use super::band::{DrawnQuantity, Stream, draws};
use super::loops::{ProfileLoops, VALUES};
use super::measured::MeasuredRun;
use super::next_run::{NextRun, PredictError};
use super::quantity::{PredictedQuantity, RunDeviations};
use crate::effect::attach_all;
use crate::fleet::estimate::EstimateRow;
use crate::fleet::outliers::median;
use crate::model::{BuildError, Model};
use crate::profile::ProfileLimits;

/// Name of the zero of the force channel, which a diagnosis estimates beside the parameters of the model.
const FORCE_ZERO: &str = "force_zero_n";
/// Most runs of the archive over which the misfit is averaged.
const MISFIT_RUNS: usize = 30;
/// Fewest runs of the archive that say what the misfit is.
const FEWEST_MISFIT_RUNS: usize = 3;

/// A model with values for the parameters that the table does not have.
#[derive(Clone)]
pub(crate) struct ModelChoice {
    pub model: &'static Model,
    pub values: Vec<f64>,
    /// Limits of the bench; only that of the speed acts.
    pub limits: ProfileLimits,
}

/// Error of a model in each value of a loop: a standard deviation, as a share of the change that a force error of the whole range would
/// cause in that value.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct ModelMisfit {
    /// One for each value of a loop, in the order of the limits.
    pub shares: [f64; VALUES],
    /// Runs in which it was seen; 0 if it is given or assumed.
    pub runs: usize,
}

impl ModelMisfit {
    /// A misfit that is given or assumed.
    pub(crate) fn assumed(share: f64) -> ModelMisfit {
        ModelMisfit {
            shares: [share; VALUES],
            runs: 0,
        }
    }
}

/// A parameter of the model, or the force zero, with what is predicted of it.
struct PredictedParameter<'q> {
    /// `None` for the force zero.
    index: Option<usize>,
    quantity: &'q PredictedQuantity,
    runs: &'q RunDeviations,
}

impl ModelChoice {
    /// Each variable of a profile and its change by a full misfit, at some values of the parameters.
    fn play(&self, loops: &ProfileLoops, values: &[f64], zero_n: f64) -> Result<Vec<[f64; 2]>, PredictError> {
        let bounds = self.model.parameters.iter().map(|p| p.bounds);
        let values: Vec<f64> = values
            .iter()
            .zip(bounds)
            .map(|(v, [low, high])| v.clamp(low, high))
            .collect();
        let plant = self.model.plant(&values, &toml::Table::new())?;
        let plant = attach_all(&[], zero_n, plant).map_err(|error| {
            PredictError::Model(BuildError::Structure {
                model: self.model.name,
                reason: error.to_string(),
            })
        })?;
        loops.played(plant.as_ref(), &self.limits)
    }

    fn parameters<'q>(
        &self,
        quantities: &'q [(PredictedQuantity, RunDeviations)],
    ) -> Result<Vec<PredictedParameter<'q>>, PredictError> {
        let parameter = |(quantity, runs): &'q (PredictedQuantity, RunDeviations)| {
            let mut names = self.model.parameters.iter();
            let index = names.position(|p| p.name == quantity.quantity);
            (index.is_some() || quantity.quantity == FORCE_ZERO).then_some(PredictedParameter {
                index,
                quantity,
                runs,
            })
        };
        let found: Vec<PredictedParameter> = quantities.iter().filter_map(parameter).collect();
        match found.iter().any(|p| p.index.is_some()) {
            true => Ok(found),
            false => Err(PredictError::NoParameter {
                model: self.model.name,
            }),
        }
    }

    /// Draws of the variables of a profile.
    pub(crate) fn draws(
        &self,
        loops: &ProfileLoops,
        quantities: &[(PredictedQuantity, RunDeviations)],
        misfit: &ModelMisfit,
    ) -> Result<Vec<Vec<f64>>, PredictError> {
        let parameters = self.parameters(quantities)?;
        let at = |moved: Option<(usize, f64)>| {
            let (mut values, mut zero_n) = (self.values.clone(), 0.0);
            for (q, parameter) in parameters.iter().enumerate() {
                let by = moved.filter(|(m, _)| *m == q).map_or(0.0, |(_, by)| by);
                let quantity = parameter.quantity;
                let value = quantity.in_unit(quantity.pooled_mean + by * quantity.pooled_deviation);
                match parameter.index {
                    Some(index) => values[index] = value,
                    None => zero_n = value,
                }
            }
            self.play(loops, &values, zero_n)
        };
        let middle = at(None)?;
        let mut derivatives = Vec::new();
        for q in 0..parameters.len() {
            let (up, down) = (at(Some((q, 1.0)))?, at(Some((q, -1.0)))?);
            let half = up.iter().zip(&down).map(|(up, down)| 0.5 * (up[0] - down[0]));
            derivatives.push(half.collect::<Vec<f64>>());
        }
        let of_parameters = parameters.iter().map(|p| DrawnQuantity {
            mean: 0.0,
            deviation: 1.0,
            degrees: p.quantity.degrees,
            runs: p.runs.clone(),
        });
        let z = draws(&of_parameters.collect::<Vec<_>>(), Stream::Quantities);
        let errors = misfits(middle.len() / 2);
        let drawn = z.iter().zip(&errors).map(|(z, errors)| {
            let value = |j: usize| {
                let of_parameters: f64 = derivatives.iter().zip(z).map(|(d, z)| d[j] * z).sum();
                // Variables come in pairs, the smallest and the largest of a value.
                middle[j][0] + of_parameters + misfit.shares[value_of(j)] * middle[j][1] * errors[j / 2]
            };
            (0..middle.len()).map(value).collect()
        });
        Ok(drawn.collect())
    }

    /// Misfit of the model in runs of the family, each at its own estimates; on the bench of the next run if enough were there, because
    /// benches have errors of their own. `None` if there are too few.
    pub(crate) fn misfit(
        &self,
        runs: &[MeasuredRun],
        rows: &[EstimateRow],
        next: &NextRun,
    ) -> Option<ModelMisfit> {
        let of_family = runs
            .iter()
            .rev()
            .filter(|run| run.placed.member.family == next.family);
        let of_family: Vec<&MeasuredRun> = of_family.collect();
        let on_bench = of_family
            .iter()
            .copied()
            .filter(|run| run.placed.bench == next.bench);
        let squares = |runs: &mut dyn Iterator<Item = &MeasuredRun>| -> Vec<[f64; VALUES]> {
            runs.filter_map(|run| self.misfit_of(run, rows))
                .take(MISFIT_RUNS)
                .collect()
        };
        let there = squares(&mut on_bench.into_iter());
        let found = match there.len() >= FEWEST_MISFIT_RUNS {
            true => there,
            false => squares(&mut of_family.into_iter()),
        };
        // The middle run: a recording with a fault does not count for the model.
        let middle = |value: usize| median(found.iter().map(|run| run[value]).collect()).sqrt();
        (found.len() >= FEWEST_MISFIT_RUNS).then(|| ModelMisfit {
            shares: std::array::from_fn(middle),
            runs: found.len(),
        })
    }

    /// Mean squared misfit of each value in one run; `None` if its loops are not whole or it has no estimates.
    fn misfit_of(&self, run: &MeasuredRun, rows: &[EstimateRow]) -> Option<[f64; VALUES]> {
        let (mut values, mut zero_n, mut found) = (self.values.clone(), 0.0, 0);
        for row in rows.iter().filter(|row| row.run_id == run.placed.run_id) {
            if row.quantity == FORCE_ZERO {
                zero_n = row.estimate;
            }
            if let Some(index) = self.model.parameters.iter().position(|p| p.name == row.quantity) {
                values[index] = row.estimate;
                found += 1;
            }
        }
        let loops = ProfileLoops::of(&run.profile);
        let measured = loops.measured(&run.loops)?;
        let played = self.play(&loops, &values, zero_n).ok().filter(|_| found > 0)?;
        let mut squares = [0.0; VALUES];
        let of_each = measured.len() as f64 / VALUES as f64;
        for (j, (measured, [value, full])) in measured.iter().zip(&played).enumerate() {
            squares[value_of(j)] += ((measured - value) / full).powi(2) / of_each;
        }
        Some(squares)
    }
}

/// Number of the value, within those of a loop, that variable `j` is about.
fn value_of(j: usize) -> usize {
    j / 2 % VALUES
}

/// Independent standard normal draws.
fn misfits(count: usize) -> Vec<Vec<f64>> {
    let one = DrawnQuantity {
        mean: 0.0,
        deviation: 1.0,
        degrees: f64::INFINITY,
        runs: RunDeviations::new(),
    };
    draws(&vec![one; count], Stream::Misfits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::estimate::EstimateScale;
    use crate::fleet::predict::band::limits;
    use crate::model;
    use crate::profile::Profile;

    fn predicted(quantity: &str, mean: f64, deviation: f64) -> (PredictedQuantity, RunDeviations) {
        let predicted = PredictedQuantity {
            quantity: quantity.to_owned(),
            unit: String::new(),
            scale: EstimateScale::Relative,
            predicted: mean,
            low95: mean,
            high95: mean,
            pooled_mean: mean.ln(),
            pooled_deviation: deviation,
            degrees: 1e6,
            runs_of_specimen: 3,
            runs_of_family: 9,
            remarks: Vec::new(),
        };
        (predicted, RunDeviations::new())
    }

    fn choice() -> ModelChoice {
        ModelChoice {
            model: model::find("equivalent").expect("there"),
            values: vec![0.0, 50.0, 0.1, 0.1],
            limits: ProfileLimits::EXAMPLE,
        }
    }

    fn loops() -> ProfileLoops {
        let text = "name = \"p\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"sine\"\nmean_mm = 0.0\n\
                    amplitude_mm = 10.0\nfrequency_hz = 1.0\ncycles = 3\n";
        ProfileLoops::of(&Profile::from_toml(text, "p").expect("a profile"))
    }

    #[test]
    fn the_scatter_of_a_rate_becomes_that_of_the_peak_force() {
        let quantities = [predicted("rate_n_per_mm", 80.0, 0.01)];
        let scatter = |misfit: f64| {
            let drawn = choice()
                .draws(&loops(), &quantities, &ModelMisfit::assumed(misfit))
                .expect("played");
            let peaks: Vec<f64> = drawn.iter().map(|d| d[1]).collect();
            let mean = peaks.iter().sum::<f64>() / peaks.len() as f64;
            let square = peaks.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / peaks.len() as f64;
            (mean, square.sqrt())
        };
        // 80 N/mm over 10 mm, 10 % friction; 4000 draws have a standard deviation within 1.1 %.
        let (mean, deviation) = scatter(0.0);
        assert!(
            (mean - 880.0).abs() < 1.0 && (deviation / 8.8 - 1.0).abs() < 0.05,
            "{mean} {deviation}"
        );
        // 1 % of the range of the force, which the model says itself.
        let (_, with_misfit) = scatter(0.01);
        let range_n = 880.0
            - choice()
                .draws(&loops(), &quantities, &ModelMisfit::assumed(0.0))
                .expect("played")[0][2];
        let expected = (deviation.powi(2) + (0.01 * range_n).powi(2)).sqrt();
        assert!(
            (with_misfit / expected - 1.0).abs() < 0.05,
            "{with_misfit} {expected}"
        );
    }

    #[test]
    fn limits_lie_about_what_is_expected() {
        let quantities = [predicted("rate_n_per_mm", 80.0, 0.01)];
        let loops = loops();
        let drawn = choice()
            .draws(&loops, &quantities, &ModelMisfit::assumed(0.01))
            .expect("played");
        let found = limits(&loops.variables, &drawn);
        assert_eq!(found.len(), 8);
        for pair in found.chunks(2) {
            assert!(
                pair[0].limit < pair[0].expected && pair[1].expected < pair[1].limit,
                "{pair:?}"
            );
        }
    }

    #[test]
    fn a_table_without_a_parameter_of_the_model_is_refused() {
        let refused = choice().draws(
            &loops(),
            &[predicted("backlash", 1.0, 0.1)],
            &ModelMisfit::assumed(0.0),
        );
        let said = refused.expect_err("no parameter").to_string();
        assert!(
            said.contains("no parameter of model equivalent") && said.contains("--baseline"),
            "{said}"
        );
    }
}
