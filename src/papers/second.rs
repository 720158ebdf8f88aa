//! Chula thesis, chapter V: the measured loop of Table 5-1 against the thesis' envelope lines, its model as printed, and the
//! five-link spring fitted to it.
//!
//! Eleven points and five or six parameters: a fit shows what the model can do, not that its values are the spring's. The sixth
//! unloading point is left out, its deflection is not printed. The first point carries 294 N at 0.03 mm: the spring stood
//! under preload when the LVDT was zeroed. The thesis' model has no preload, so it is one more parameter: the travel
//! before the zero, `preload_mm`. Without it every fit spends its parameters on that point; both fits are shown.

use crate::identify::objective::Residuals;
use crate::identify::{Fit, FitControl, FitOptions, IdentifyError, Method, fit, least_squares};
use crate::model::{BuildError, Model, Parameter, five_link};

/// Table 5-1 in mm and N (kgf and cm printed), in the order of the test: six points up, five down.
pub(crate) const TABLE_5_1: [(f64, f64); 11] = [
    (0.034, 293.5228),
    (5.855, 622.4977),
    (13.098, 850.2503),
    (21.493, 1153.9191),
    (32.116, 1470.2424),
    (48.539, 1830.8525),
    (47.701, 1728.3338),
    (37.293, 1131.5354),
    (26.469, 707.1820),
    (19.905, 536.2482),
    (7.700, 210.7547),
];
/// Points of the loading branch.
const LOADING: usize = 6;
/// Steps between two points: the geometry moves by less than 1 mm a step.
const STEPS: usize = 40;

/// One model against the table.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoadDeflectionRow {
    /// Which.
    pub model: &'static str,
    /// Force in N at each point.
    pub force_n: Vec<f64>,
    /// Root mean square of the force error in N.
    pub rms_n: f64,
    /// That over the envelope lines' own.
    pub share_of_envelope: f64,
}

/// The table run again.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FiveLinkRerun {
    /// Envelope lines as printed, model as printed, model fitted, model with preload fitted.
    pub rows: Vec<LoadDeflectionRow>,
    /// The last fit with intervals and warnings.
    pub fit: Fit,
}

/// The five-link spring along the table's points.
struct PrintedTable<'a> {
    points: &'a [(f64, f64)],
}

impl PrintedTable<'_> {
    fn force_n(&self, values: &[f64]) -> Result<Vec<f64>, BuildError> {
        let mut plant = Model::plant(&five_link::MODEL, values, &toml::Table::new())?;
        let mut at = 0.0;
        let forces = self.points.iter().map(|&(to, _)| {
            let mut force_n = 0.0;
            for i in 1..=STEPS {
                // Loaded by hand pump, point by point: a second a step, which the model does not mind.
                force_n = plant.step(at + (to - at) * i as f64 / STEPS as f64, 1.0);
            }
            at = to;
            force_n
        });
        Ok(forces.collect())
    }
}

impl Residuals for PrintedTable<'_> {
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

/// Envelope lines 5-3 and 5-4 at points, the first `loading` of them on the way up, with the printed values.
fn envelope_n(points: &[(f64, f64)], loading: usize) -> Vec<f64> {
    let [a, b, d, e] = [0, 1, 2, 3].map(|i| five_link::MODEL.parameters[i].start);
    let line = |(i, &(u, _)): (usize, &(f64, f64))| if i < loading { a * u + b } else { d * u + e };
    points.iter().enumerate().map(line).collect()
}

/// The four rows; the exponent mu stays at the printed 1.
pub(crate) fn rerun(threads: usize) -> Result<FiveLinkRerun, IdentifyError> {
    rerun_over(&TABLE_5_1, LOADING, threads)
}

/// The same over other points of one loop, the first `loading` of them on the way up.
pub(crate) fn rerun_over(
    points: &[(f64, f64)],
    loading: usize,
    threads: usize,
) -> Result<FiveLinkRerun, IdentifyError> {
    let table = PrintedTable { points };
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
    let bare = fit(&table, &options(&["mu", "preload_mm"]), &mut |_| {
        FitControl::Continue
    })?;
    let fit = fit(&table, &options(&["mu"]), &mut |_| FitControl::Continue)?;
    let printed: Vec<f64> = table.parameters().iter().map(|p| p.start).collect();
    let envelope = envelope_n(points, loading);
    let rms_n = |force_n: &[f64]| rms_n(force_n, points);
    let unit = rms_n(&envelope);
    let row = |model, force_n: Vec<f64>| LoadDeflectionRow {
        model,
        rms_n: rms_n(&force_n),
        share_of_envelope: rms_n(&force_n) / unit,
        force_n,
    };
    let rows = vec![
        row("envelope lines as printed", envelope),
        row("five-link as printed", table.force_n(&printed)?),
        row("five-link fitted", table.force_n(&bare.values)?),
        row("five-link with preload fitted", table.force_n(&fit.values)?),
    ];
    Ok(FiveLinkRerun { rows, fit })
}

fn rms_n(force_n: &[f64], points: &[(f64, f64)]) -> f64 {
    let squares: f64 = force_n
        .iter()
        .zip(points)
        .map(|(model, (_, measured))| (measured - model).powi(2))
        .sum();
    (squares / force_n.len() as f64).sqrt()
}
