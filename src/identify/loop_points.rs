//! The five-link spring against the points of one loop: force over displacement, measured at rest point by point.
//!
//! With a dozen points and five or six parameters, a fit shows that the model can follow the loop. It does not identify the
//! values of the spring.

use super::objective::Residuals;
use super::{Fit, FitControl, FitOptions, IdentifyError, Method, fit, least_squares};
use crate::model::{BuildError, Model, Parameter, five_link};

/// Steps between two points: the geometry moves by less than 1 mm per step.
const STEPS: usize = 40;

/// Points of one loop in the order of the test: displacement in mm and force in N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LoopPoints<'a> {
    /// Displacement in mm and force in N.
    pub points: &'a [(f64, f64)],
    /// Number of points on the loading branch; they come first.
    pub loading: usize,
}

/// One model against the points.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoadDeflectionRow {
    /// Name of the model and of its values, in words.
    pub model: &'static str,
    /// Force of the model in N at each point.
    pub force_n: Vec<f64>,
    /// Root mean square of the force error in N.
    pub rms_n: f64,
    /// `rms_n` over that of the envelope lines.
    pub share_of_envelope: f64,
}

/// The models against the points, and the fit of the last one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FiveLinkComparison {
    /// The envelope lines with the printed values.
    pub envelope: LoadDeflectionRow,
    /// The five-link spring with the printed values.
    pub printed: LoadDeflectionRow,
    /// The five-link spring fitted, without preload.
    pub fitted: LoadDeflectionRow,
    /// The five-link spring fitted, with preload.
    pub preloaded: LoadDeflectionRow,
    /// The fit with preload, with intervals and warnings.
    pub fit: Fit,
}

impl FiveLinkComparison {
    /// The four rows, the envelope lines first.
    pub(crate) fn rows(&self) -> [&LoadDeflectionRow; 4] {
        [&self.envelope, &self.printed, &self.fitted, &self.preloaded]
    }
}

impl LoopPoints<'_> {
    /// Force of the five-link spring in N at each point.
    fn force_n(&self, values: &[f64]) -> Result<Vec<f64>, BuildError> {
        let mut plant = Model::plant(&five_link::MODEL, values, &toml::Table::new())?;
        let mut at = 0.0;
        let forces = self.points.iter().map(|&(to, _)| {
            let mut force_n = 0.0;
            for i in 1..=STEPS {
                // One second per step; the five-link spring does not depend on the rate.
                force_n = plant.step(at + (to - at) * i as f64 / STEPS as f64, 1.0);
            }
            at = to;
            force_n
        });
        Ok(forces.collect())
    }

    /// Force of the envelope lines 5-3 and 5-4 in N at each point, with the printed values.
    fn envelope_n(&self) -> Vec<f64> {
        let [a, b, d, e] = [0, 1, 2, 3].map(|i| five_link::MODEL.parameters[i].start);
        let line = |(i, &(u, _)): (usize, &(f64, f64))| {
            if i < self.loading { a * u + b } else { d * u + e }
        };
        self.points.iter().enumerate().map(line).collect()
    }

    fn rms_n(&self, force_n: &[f64]) -> f64 {
        let squares: f64 = force_n
            .iter()
            .zip(self.points)
            .map(|(model, (_, measured))| (measured - model).powi(2))
            .sum();
        (squares / force_n.len() as f64).sqrt()
    }
}

impl Residuals for LoopPoints<'_> {
    fn parameters(&self) -> &[Parameter] {
        five_link::MODEL.parameters
    }

    fn count(&self) -> usize {
        self.points.len()
    }

    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for ((place, model), (_, measured)) in out.iter_mut().zip(self.force_n(values)?).zip(self.points) {
            *place = measured - model;
        }
        Ok(())
    }
}

/// Compares and fits the five-link spring; the exponent `mu` stays at the printed 1.
pub(crate) fn compare_five_link(
    points: &LoopPoints<'_>,
    threads: usize,
) -> Result<FiveLinkComparison, IdentifyError> {
    let options = |fixed: &[&str]| FitOptions {
        method: Method::LeastSquares(least_squares::LeastSquaresSettings {
            screened: 100,
            starts: 5,
            ..least_squares::LeastSquaresSettings::default()
        }),
        fixed: fixed.iter().map(|&name| name.to_owned()).collect(),
        threads,
        ..FitOptions::default()
    };
    let mut watch = |_| FitControl::Continue;
    let without_preload = fit(points, &options(&["mu", "preload_mm"]), &mut watch)?;
    let fit = fit(points, &options(&["mu"]), &mut watch)?;
    let printed: Vec<f64> = points.parameters().iter().map(|p| p.start).collect();
    let envelope_n = points.envelope_n();
    let unit_n = points.rms_n(&envelope_n);
    let row = |model, force_n: Vec<f64>| LoadDeflectionRow {
        model,
        rms_n: points.rms_n(&force_n),
        share_of_envelope: points.rms_n(&force_n) / unit_n,
        force_n,
    };
    Ok(FiveLinkComparison {
        envelope: row("envelope lines as printed", envelope_n),
        printed: row("five-link as printed", points.force_n(&printed)?),
        fitted: row("five-link fitted", points.force_n(&without_preload.values)?),
        preloaded: row("five-link with preload fitted", points.force_n(&fit.values)?),
        fit,
    })
}
