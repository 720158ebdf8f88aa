//! Polach and Hajzman: the parameters of the finite-segment spring from its force-deformation curve (Tables 1 and 2).
//!
//! The measured curves are not printed. The curve is therefore computed from the published optimum, and the optimum is
//! identified from the published start, with objective (4) on 200 points at equal forces, load at 0.05 Hz. The curve has
//! finer steps than the model that is fitted to it. Nelder-Mead is the paper's method; least squares on the same 200
//! differences is shown for comparison. f and r_f enter as a product, so only their product is compared.

use crate::identify::objective::{DeformationProblem, ForceProgramme};
use crate::identify::{
    FitControl, FitOptions, IdentifyError, Method, Warning, fit, least_squares, nelder_mead, objective,
};
use crate::model::{Model, finite_segment as model};

/// Number of points that are compared; printed.
const POINTS: usize = 200;
/// Frequency of the load; printed.
const FREQUENCY_HZ: f64 = 0.05;
/// Range of the load in N; not printed. 80 kN are beyond the break of both characteristics.
const LOAD_N: [f64; 2] = [2_000.0, 80_000.0];
/// Steps per cycle of the fitted model.
const STEPS: usize = 2000;
/// Steps of the published curve per step of the fitted model.
const FINER: usize = 4;

/// One spring of the paper.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spring {
    /// `GRP` or `steel`.
    pub name: &'static str,
    /// Published start, in the model's order.
    pub start: [f64; 8],
    /// Published optimum, in the model's order.
    pub optimum: [f64; 8],
}

/// The two springs of the paper.
const SPRINGS: [Spring; 2] = [
    Spring {
        name: "GRP",
        start: model::GRP_START,
        optimum: model::GRP_OPTIMUM,
    },
    Spring {
        name: "steel",
        start: model::STEEL_START,
        optimum: model::STEEL_OPTIMUM,
    },
];

/// One parameter of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PrintedFigure {
    /// Name; `f * r_f_mm` for the product.
    pub name: &'static str,
    /// Published start value.
    pub start: f64,
    /// Published optimum, from which the curve was computed.
    pub published: f64,
    /// Value that our fit finds.
    pub identified: f64,
    /// `identified / published - 1`.
    pub error: f64,
}

/// One spring identified by one method.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WagonRow {
    /// Name of the spring.
    pub spring: &'static str,
    /// Name of the method.
    pub method: &'static str,
    /// Evaluations of the curve, those for the intervals included.
    pub evaluations: usize,
    /// Objective (4) at the published start, mean per point in mm.
    pub misfit_start_mm: f64,
    /// Objective (4) at the identified values, mean per point in mm.
    pub misfit_mm: f64,
    /// k1, k2, q1, the product f * r_f, v_eps.
    pub figures: Vec<PrintedFigure>,
    /// Largest relative error of the figures, without sign.
    pub worst: f64,
    /// Warnings of the fit.
    pub warnings: Vec<Warning>,
}

/// Identifies both springs by both methods.
pub(crate) fn rerun(threads: usize) -> Result<Vec<WagonRow>, IdentifyError> {
    let methods = [
        (
            "least squares",
            Method::LeastSquares(least_squares::LeastSquaresSettings::default()),
        ),
        (
            "Nelder-Mead",
            Method::NelderMead(nelder_mead::SimplexSettings::default()),
        ),
    ];
    let mut rows = Vec::new();
    for spring in &SPRINGS {
        for (name, method) in methods {
            rows.push(identify(spring, name, method, threads)?);
        }
    }
    Ok(rows)
}

/// Identifies one spring by one method.
fn identify(
    spring: &Spring,
    name: &'static str,
    method: Method,
    threads: usize,
) -> Result<WagonRow, IdentifyError> {
    let problem = problem(spring)?;
    let options = FitOptions {
        method,
        start: Some(spring.start.to_vec()),
        // The paper's vector (2) has neither material damping nor preload.
        fixed: vec!["b_nmm_s_per_rad".to_owned(), "preload_n".to_owned()],
        threads,
        ..FitOptions::default()
    };
    let fit = fit(&problem, &options, &mut |_| FitControl::Continue)?;
    let mut residuals = vec![0.0; POINTS];
    objective::Residuals::evaluate(&problem, &spring.start, &mut residuals)?;
    let figures = figures(spring, &fit.values);
    Ok(WagonRow {
        spring: spring.name,
        method: name,
        evaluations: fit.evaluations,
        misfit_start_mm: objective::Residuals::cost(&problem, &residuals) / POINTS as f64,
        misfit_mm: fit.cost / POINTS as f64,
        worst: figures.iter().fold(0.0, |worst, f| worst.max(f.error.abs())),
        figures,
        warnings: fit.warnings,
    })
}

/// Objective (4) against the curve of the published optimum. The second cycle is compared.
fn problem(spring: &Spring) -> Result<DeformationProblem<'static>, IdentifyError> {
    let structure = toml::Table::new();
    let programme = |steps| ForceProgramme::sine(LOAD_N[0], LOAD_N[1], FREQUENCY_HZ, 2, steps);
    let mut truth = Model::plant(&model::MODEL, &spring.optimum, &structure)?;
    let measured_mm: Vec<f64> = programme(FINER * STEPS)
        .deformation_mm(&mut truth)
        .into_iter()
        .step_by(FINER)
        .collect();
    let factory = move |values: &[f64]| model::MODEL.plant(values, &structure);
    DeformationProblem::new(
        model::MODEL.parameters.to_vec(),
        Box::new(factory),
        programme(STEPS),
        &measured_mm,
        STEPS,
        POINTS,
    )
}

fn figures(spring: &Spring, identified: &[f64]) -> Vec<PrintedFigure> {
    let pick = |values: &[f64]| [values[0], values[1], values[2], values[3] * values[4], values[5]];
    let names = [
        "k1_nmm_per_rad",
        "k2_nmm_per_rad",
        "q1_rad",
        "f * r_f_mm",
        "v_eps_rad_s",
    ];
    let (start, published, identified) = (pick(&spring.start), pick(&spring.optimum), pick(identified));
    (0..names.len())
        .map(|i| PrintedFigure {
            name: names[i],
            start: start[i],
            published: published[i],
            identified: identified[i],
            error: identified[i] / published[i] - 1.0,
        })
        .collect()
}
