//! The leaf pack fitted to all tests, with rate-independent presliding friction between leaves, in pins, on rail and board.
//!
//! One set of parameters for all tests of a mounting, and one for both (leaves, interleaf and pins shared), by least squares on
//! peak force over 3 % and loop energy over 5 % (10 % shared), to the eighth power, so that the worst test counts most. Every
//! parameter stays within its range of [`PARAMETERS`]. Where that leaves a test out, a case frees one range: the value shows
//! what the tests need beyond it.

use super::parameters::{
    BOARD, CLAMP, EYE, INTERLEAF, PARAMETERS, PINS, RAIL_CONSTANT, RAIL_MU, RAIL_ONLY, RAIL_TORQUE,
    RAIL_TROUGH, SHACKLE_ANGLE, SHACKLE_ONLY, SHACKLE_TORQUE, SHACKLE_TROUGH, THICKNESS,
};
use super::walk::{Pass, walk};
use super::{
    AMPLITUDES_MM, Aggregate, AmplitudeReading, MOUNTS, RowFitOptions, SINE_OF_TEST, TESTS, TestFigures,
    mount_index, mount_name,
};
use crate::identify::objective::Residuals;
use crate::identify::{Fit, FitControl, FitOptions, IdentifyError, Method, fit, least_squares};
use crate::model::leaf_pack::{LeafPack, MODEL, Mounting, PackStructure, Values};
use crate::model::{BuildError, Parameter};

/// Allowed relative errors of a test, peak force and loop energy, for a set of one mounting.
pub(crate) const ALLOWED: [f64; 2] = [0.03, 0.05];
/// The same for a set that both mountings share.
const ALLOWED_SHARED: [f64; 2] = [0.03, 0.1];
/// Longest step of the pack during the fit, mm.
const FIT_STEP_MM: f64 = 2.0;
/// Longest step of the pack for the reported figures, mm.
const REPORT_STEP_MM: f64 = 0.5;
/// Cost below which the search ends: no test misses more than four fifths of what is allowed (0.8^8).
const ENOUGH: f64 = 0.17;

/// A parameter whose range is widened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FreedRange {
    /// Name of the parameter.
    pub parameter: &'static str,
    /// The parameter in plain words.
    pub words: &'static str,
    /// The wider range.
    pub bounds: [f64; 2],
}

/// Which tests are fitted, and within which ranges.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RowFitCase {
    /// Mountings whose tests count.
    pub mounts: Vec<Mounting>,
    /// The parameter whose range is widened, if any.
    pub freed: Option<FreedRange>,
}

impl RowFitCase {
    /// Name for tables and messages.
    pub(crate) fn name(&self) -> String {
        let mounts = match self.mounts[..] {
            [one] => mount_name(one),
            _ => "both",
        };
        match self.freed {
            None => format!("{mounts}, within the ranges"),
            Some(freed) => format!("{mounts}, {} free", freed.words),
        }
    }

    /// Allowed relative errors of peak force and loop energy.
    pub(crate) fn allowed(&self) -> [f64; 2] {
        if self.mounts.len() > 1 {
            ALLOWED_SHARED
        } else {
            ALLOWED
        }
    }
}

/// One test of a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ModelRow {
    /// Mounting of the test.
    pub mounting: Mounting,
    /// Name of the test.
    pub name: &'static str,
    /// Measured peak force and loop energy.
    pub measured: Aggregate,
    /// Figures of the fitted pack.
    pub ours: Aggregate,
}

impl ModelRow {
    /// Relative errors of peak force and loop energy.
    pub(crate) fn errors(&self) -> [f64; 2] {
        self.ours.errors(&self.measured)
    }
}

/// A fit, with figures from a finer path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RowFit {
    /// Tests and ranges of the fit.
    pub case: RowFitCase,
    /// Values, intervals and warnings.
    pub fit: Fit,
    /// Figures, test by test.
    pub rows: Vec<ModelRow>,
    /// Displacement in mm and force in N along the pass, one curve per mounting.
    pub curves: Vec<Vec<(f64, f64)>>,
}

/// Tests of one or both mountings as residuals.
struct RowProblem {
    parameters: Vec<Parameter>,
    mounts: Vec<Mounting>,
    allowed: [f64; 2],
    reading: AmplitudeReading,
    measured: TestFigures,
}

impl RowProblem {
    /// The tests of `case`, within its ranges.
    fn new(case: &RowFitCase, measured: &TestFigures, reading: AmplitudeReading) -> Self {
        let mut parameters = PARAMETERS.to_vec();
        if let Some(freed) = case.freed {
            for p in parameters.iter_mut().filter(|p| p.name == freed.parameter) {
                p.bounds = freed.bounds;
            }
        }
        RowProblem {
            parameters,
            mounts: case.mounts.clone(),
            allowed: case.allowed(),
            reading,
            measured: *measured,
        }
    }

    /// One pass of a mounting.
    fn pass(&self, mounting: Mounting, values: &[f64], longest_mm: f64) -> Result<Pass, BuildError> {
        let (structure, pack_values, trough_mm) = unpack(mounting, values);
        let mut pack = LeafPack::new(&structure, &pack_values).map_err(|reason| BuildError::Structure {
            model: MODEL.name,
            reason,
        })?;
        let strokes = AMPLITUDES_MM.map(|a| self.reading.stroke_mm(a));
        let static_n = self.measured[0][mount_index(mounting)].peak_force_n;
        Ok(walk(&mut pack, trough_mm, &strokes, static_n, longest_mm))
    }

    fn rows(&self, mounting: Mounting, pass: &Pass) -> Vec<ModelRow> {
        (0..TESTS.len())
            .map(|i| ModelRow {
                mounting,
                name: TESTS[i].name,
                measured: self.measured[i][mount_index(mounting)],
                ours: match TESTS[i].amplitude_mm {
                    None => pass.statics,
                    Some(_) => pass.sines[SINE_OF_TEST[i]],
                },
            })
            .collect()
    }
}

/// Structure, values and trough of a mounting.
fn unpack(mounting: Mounting, values: &[f64]) -> (PackStructure, Values, f64) {
    let on_rail = mounting == Mounting::Rail;
    let rail_only = |value: f64| if on_rail { value } else { 0.0 };
    let structure = PackStructure {
        eye_offset_mm: values[EYE],
        mounting,
        ..PackStructure::default()
    };
    let pack = Values {
        thickness_correction_mm: values[THICKNESS],
        clamp_length_mm: values[CLAMP],
        interleaf_mu: values[INTERLEAF],
        pin_mu: values[PINS] / structure.pin_radius_mm,
        // The bolts are tightened again for each mounting; the coefficient is a property of the pins.
        pivot_torque_nmm: values[if on_rail { RAIL_TORQUE } else { SHACKLE_TORQUE }],
        rail_mu: rail_only(values[RAIL_MU]),
        rail_constant_n: rail_only(values[RAIL_CONSTANT]),
        board_mu: values[BOARD],
        shackle_angle_rad: values[SHACKLE_ANGLE],
        ..Values::frictionless()
    };
    let trough_mm = values[if on_rail { RAIL_TROUGH } else { SHACKLE_TROUGH }];
    (structure, pack, trough_mm)
}

impl Residuals for RowProblem {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    fn count(&self) -> usize {
        2 * TESTS.len() * self.mounts.len()
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for (&mounting, out) in self.mounts.iter().zip(out.chunks_exact_mut(2 * TESTS.len())) {
            let pass = self.pass(mounting, values, FIT_STEP_MM)?;
            for (row, pair) in self.rows(mounting, &pass).iter().zip(out.chunks_exact_mut(2)) {
                for ((place, error), allowed) in pair.iter_mut().zip(row.errors()).zip(self.allowed) {
                    // Its square is the eighth power.
                    let share = error / allowed;
                    *place = -share * share.abs().powi(3);
                }
            }
        }
        Ok(())
    }
}

/// The cases within the ranges: one per mounting, then both mountings together.
pub(crate) fn within_ranges() -> Vec<RowFitCase> {
    [&[Mounting::Shackle][..], &[Mounting::Rail], &MOUNTS]
        .map(|mounts| RowFitCase {
            mounts: mounts.to_vec(),
            freed: None,
        })
        .to_vec()
}

/// Start values of a case: the parameters' own, or the values of the cases before it.
fn starts(case: &RowFitCase, before: &[RowFit]) -> Vec<Vec<f64>> {
    let own = PARAMETERS.map(|p| p.start).to_vec();
    if before.is_empty() {
        return vec![own];
    }
    if case.mounts.len() == 1 {
        let same = before.iter().find(|f| f.case.mounts == case.mounts);
        return vec![same.map_or(own, |f| f.fit.values.clone())];
    }
    let last = |mounts: &[Mounting]| before.iter().rev().find(|f| f.case.mounts == mounts);
    let (Some(shackle), Some(rail)) = (last(&[Mounting::Shackle]), last(&[Mounting::Rail])) else {
        return vec![own];
    };
    // The parameters of one mounting come from its own fit; the shared ones from either fit, or halfway between.
    let (a, b) = (&shackle.fit.values, &rail.fit.values);
    let merged = |share: f64| {
        let value = |i: usize| match i {
            i if RAIL_ONLY.contains(&i) => b[i],
            i if SHACKLE_ONLY.contains(&i) => a[i],
            i => a[i] + share * (b[i] - a[i]),
        };
        (0..PARAMETERS.len()).map(value).collect()
    };
    match last(&MOUNTS) {
        Some(both) => vec![both.fit.values.clone(), merged(1.0)],
        None => vec![merged(1.0), merged(0.5)],
    }
}

/// The fits within the ranges; `progress` as for [`fit_cases`].
pub(crate) fn fit_within_ranges(
    measured: &TestFigures,
    options: &RowFitOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<RowFit>, IdentifyError> {
    fit_cases(within_ranges(), measured, options, progress)
}

/// Fits the cases in order; a freed case is left out where the one within the ranges misses no test.
///
/// `progress` is called with the share of the work that is done.
pub(crate) fn fit_cases(
    cases: Vec<RowFitCase>,
    measured: &TestFigures,
    options: &RowFitOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<RowFit>, IdentifyError> {
    let weight = |case: &RowFitCase| (1 + 3 * usize::from(case.mounts.contains(&Mounting::Shackle))) as f64;
    let total: f64 = cases.iter().map(weight).sum();
    let mut done = 0.0;
    let mut fits = Vec::new();
    for case in cases {
        let share = weight(&case) / total;
        let met = |f: &RowFit| f.case.mounts == case.mounts && f.misses().is_empty();
        if !(case.freed.is_some() && fits.iter().any(met)) {
            let starts = starts(&case, &fits);
            let each = share / starts.len() as f64;
            let mut best: Option<RowFit> = None;
            for (i, start) in starts.into_iter().enumerate() {
                let found = fit_case(&case, start, measured, options, &mut |part| {
                    progress(done + each * (i as f64 + part));
                })?;
                if best.as_ref().is_none_or(|b| found.fit.cost < b.fit.cost) {
                    best = Some(found);
                }
            }
            fits.extend(best);
        }
        done += share;
    }
    Ok(fits)
}

fn fit_case(
    case: &RowFitCase,
    mut start: Vec<f64>,
    measured: &TestFigures,
    options: &RowFitOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<RowFit, IdentifyError> {
    let problem = RowProblem::new(case, measured, options.reading);
    let mut fixed: Vec<usize> = Vec::new();
    if !case.mounts.contains(&Mounting::Rail) {
        fixed.extend(RAIL_ONLY);
    }
    if !case.mounts.contains(&Mounting::Shackle) {
        fixed.extend(SHACKLE_ONLY);
    }
    if let Some(trough_mm) = options.trough_mm {
        for trough in [RAIL_TROUGH, SHACKLE_TROUGH] {
            fixed.push(trough);
            start[trough] = trough_mm;
        }
    }
    let fit_options = FitOptions {
        method: Method::LeastSquares(least_squares::LeastSquaresSettings {
            iterations: 40,
            // Of an eighth power: one thousandth of the worst error.
            cost_tolerance: 1e-2,
            step_tolerance: 1e-4,
            // The steps of the path make the residuals uneven below about 1e-4.
            relative_step: 5e-3,
            ..least_squares::LeastSquaresSettings::default()
        }),
        start: Some(start),
        fixed: fixed.into_iter().map(|i| PARAMETERS[i].name.to_owned()).collect(),
        threads: options.threads,
        ..FitOptions::default()
    };
    let fit = fit(&problem, &fit_options, &mut |p| {
        progress(p.share);
        if p.best_cost > ENOUGH {
            FitControl::Continue
        } else {
            FitControl::Stop
        }
    })?;
    report(case, &problem, fit)
}

/// Figures of a fit on the finer path.
fn report(case: &RowFitCase, problem: &RowProblem, fit: Fit) -> Result<RowFit, IdentifyError> {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for &mounting in &problem.mounts {
        let pass = problem.pass(mounting, &fit.values, REPORT_STEP_MM)?;
        rows.extend(problem.rows(mounting, &pass));
        curves.push(pass.points);
    }
    Ok(RowFit {
        case: case.clone(),
        fit,
        rows,
        curves,
    })
}

impl RowFit {
    /// Largest relative errors of peak force and loop energy, without sign.
    pub(crate) fn worst_errors(&self) -> [f64; 2] {
        [0, 1].map(|k: usize| self.rows.iter().map(|r| r.errors()[k].abs()).fold(0.0, f64::max))
    }

    /// Structure and values of a mounting's pack, as a twin runs it.
    pub(crate) fn pack(&self, mounting: Mounting) -> (PackStructure, Values) {
        let (structure, values, _) = unpack(mounting, &self.fit.values);
        (structure, values)
    }

    /// Tests that miss more than is allowed, in words.
    pub(crate) fn misses(&self) -> Vec<String> {
        let mut out = Vec::new();
        for row in &self.rows {
            for ((error, allowed), what) in row
                .errors()
                .iter()
                .zip(self.case.allowed())
                .zip(["peak force", "loop energy"])
            {
                if error.abs() > allowed {
                    out.push(format!(
                        "{}, {}: {what} {:+.1} %",
                        mount_name(row.mounting),
                        row.name,
                        100.0 * error
                    ));
                }
            }
        }
        out
    }

    /// Free parameters at the end of their range of [`PARAMETERS`], or outside it, in words.
    pub(crate) fn at_bounds(&self) -> Vec<String> {
        let fit = &self.fit;
        (0..PARAMETERS.len())
            .filter(|&i| fit.free[i])
            .filter_map(|i| {
                let ([low, high], value) = (PARAMETERS[i].bounds, fit.values[i]);
                let near = 0.005 * (high - low);
                let name = PARAMETERS[i].name;
                if value > high + near || value < low - near {
                    Some(format!("{name} = {value:.3} (range {low} to {high})"))
                } else if value > high - near || value < low + near {
                    Some(format!("{name} at {value:.3}"))
                } else {
                    None
                }
            })
            .collect()
    }
}
