//! The same tables with physics switched on: rate-independent presliding friction between leaves, in pins, on rail and board.
//!
//! One set of parameters for all rows of a mounting, and one for both (leaves, interleaf and pins shared), by least squares on
//! peak force over 3 % and loop energy over 5 % (10 % shared), to the eighth power so that the worst row counts most. Every
//! parameter stays within belief; where that leaves a row out, one bound is lifted, and what that parameter goes to is what
//! the rows demand beyond belief.

pub(crate) use super::parameters::PARAMETERS;
use super::{
    AMPLITUDES_MM, AmplitudeReading, Choice, MOUNTS, Pass, Printed, ROWS, SINE_OF_ROW, Two, column,
    mount_name, structure, walk,
};
use crate::identify::objective::Residuals;
use crate::identify::{Fit, FitControl, FitOptions, IdentifyError, Method, fit, least_squares};
use crate::model::leaf_pack::{LeafPack, MODEL, Mounting, PackStructure, Values};
use crate::model::{BuildError, Parameter};

/// What a row of one mounting may miss: peak force and loop energy.
pub(crate) const ALLOWED: [f64; 2] = [0.03, 0.05];
/// The same where both mountings share leaves, interleaf and pins.
const ALLOWED_SHARED: [f64; 2] = [0.03, 0.1];
/// Longest step of the fits and of the judged rows, mm.
const STEP_MM: [f64; 2] = [2.0, 0.5];

const RAIL_ONLY: [&str; 4] = [
    "rail_mu",
    "rail_constant_n",
    "rail_trough_mm",
    "rail_pivot_torque_nmm",
];
const SHACKLE_ONLY: [&str; 4] = [
    "shackle_pivot_torque_nmm",
    "board_mu",
    "shackle_angle_rad",
    "shackle_trough_mm",
];

/// Cost at which no row can miss more than four fifths of what is allowed (0.8^8): further search shows nothing more.
const ENOUGH: f64 = 0.17;

/// What is fitted to what.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FitCase {
    /// In words.
    pub name: &'static str,
    /// Mountings whose rows count.
    pub mounts: Vec<Mounting>,
    /// A parameter whose bounds are lifted beyond belief, and to where.
    pub lifted: Option<(&'static str, [f64; 2])>,
}

impl FitCase {
    /// What a row may miss: peak force and loop energy.
    pub(crate) fn allowed(&self) -> [f64; 2] {
        if self.mounts.len() > 1 {
            ALLOWED_SHARED
        } else {
            ALLOWED
        }
    }
}

/// One row of a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ModelRow {
    /// Mounting.
    pub mounting: Mounting,
    /// Row.
    pub name: &'static str,
    /// Measured.
    pub measured: Two,
    /// Ours.
    pub ours: Two,
}

impl ModelRow {
    /// Relative errors of peak force and loop energy.
    pub(crate) fn errors(&self) -> [f64; 2] {
        [
            self.ours.peak_n / self.measured.peak_n - 1.0,
            self.ours.loop_j / self.measured.loop_j - 1.0,
        ]
    }
}

/// A fit, judged on a finer path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PhysicsFit {
    /// What was fitted to what.
    pub case: FitCase,
    /// The fit.
    pub fit: Fit,
    /// Row by row.
    pub rows: Vec<ModelRow>,
    /// Largest errors.
    pub judged: Judged,
    /// Static travel of each mounting, mm.
    pub travel_mm: Vec<f64>,
    /// Displacement and force along the judged pass, one curve a mounting.
    pub curves: Vec<Vec<(f64, f64)>>,
}

/// Largest errors, without sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Judged {
    /// Of a peak force.
    pub peak: f64,
    /// Of a loop energy.
    pub energy: f64,
}

/// Rows of one or both mountings as residuals.
pub(crate) struct RowProblem {
    parameters: Vec<Parameter>,
    mounts: Vec<Mounting>,
    allowed: [f64; 2],
    reading: AmplitudeReading,
    printed: [Printed; 5],
}

impl RowProblem {
    /// Rows of `mounts`, with the bounds of `case`; `printed` stands for Tables 2 and 3.
    pub(crate) fn new(case: &FitCase, printed: &[Printed; 5], reading: AmplitudeReading) -> Self {
        let mut parameters = PARAMETERS.to_vec();
        if let Some((name, bounds)) = case.lifted {
            for p in parameters.iter_mut().filter(|p| p.name == name) {
                p.bounds = bounds;
            }
        }
        RowProblem {
            parameters,
            mounts: case.mounts.clone(),
            allowed: case.allowed(),
            reading,
            printed: *printed,
        }
    }

    /// One pass of a mounting.
    pub(crate) fn pass(
        &self,
        mounting: Mounting,
        values: &[f64],
        longest_mm: f64,
    ) -> Result<Pass, BuildError> {
        let (structure, pack_values, trough_mm) = unpack(mounting, values);
        let mut pack = LeafPack::new(&structure, &pack_values).map_err(|reason| BuildError::Structure {
            model: MODEL.name,
            reason,
        })?;
        let strokes = AMPLITUDES_MM.map(|a| self.reading.stroke_mm(a));
        let static_n = self.printed[0].measured[column(mounting)].peak_n;
        Ok(walk(&mut pack, trough_mm, &strokes, static_n, longest_mm))
    }

    fn rows(&self, mounting: Mounting, pass: &Pass) -> Vec<ModelRow> {
        self.printed
            .iter()
            .zip(SINE_OF_ROW)
            .map(|(row, sine)| ModelRow {
                mounting,
                name: row.name,
                measured: row.measured[column(mounting)],
                ours: match row.amplitude_mm {
                    None => pass.statics,
                    Some(_) => pass.sines[sine],
                },
            })
            .collect()
    }
}

/// Structure, values and trough of a mounting.
fn unpack(mounting: Mounting, values: &[f64]) -> (PackStructure, Values, f64) {
    let on_rail = mounting == Mounting::Rail;
    let own = |value: f64| if on_rail { value } else { 0.0 };
    let structure = PackStructure {
        eye_offset_mm: values[2],
        ..structure(mounting)
    };
    let pack = Values {
        thickness_correction_mm: values[0],
        clamp_length_mm: values[1],
        interleaf_mu: values[3],
        pin_mu: values[4] / structure.pin_radius_mm,
        // Bolts are tightened anew with every mounting; the coefficient is the pins' own.
        pivot_torque_nmm: values[if on_rail { 12 } else { 5 }],
        rail_mu: own(values[6]),
        rail_constant_n: own(values[7]),
        board_mu: values[9],
        shackle_angle_rad: values[10],
        ..Values::frictionless()
    };
    (structure, pack, values[if on_rail { 8 } else { 11 }])
}

impl Residuals for RowProblem {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    fn count(&self) -> usize {
        2 * ROWS.len() * self.mounts.len()
    }
    fn evaluate(&self, values: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        for (&mounting, out) in self.mounts.iter().zip(out.chunks_exact_mut(2 * ROWS.len())) {
            let pass = self.pass(mounting, values, STEP_MM[0])?;
            for (row, pair) in self.rows(mounting, &pass).iter().zip(out.chunks_exact_mut(2)) {
                for ((place, error), allowed) in pair.iter_mut().zip(row.errors()).zip(self.allowed) {
                    // Its square is the eighth power: what is judged is the worst row.
                    let share = error / allowed;
                    *place = -share * share.abs().powi(3);
                }
            }
        }
        Ok(())
    }
}

/// Within belief, then with the bound lifted that the reading's rows push against.
fn cases(reading: AmplitudeReading) -> Vec<FitCase> {
    let case = |name, mounts: &[Mounting], lifted| FitCase {
        name,
        mounts: mounts.to_vec(),
        lifted,
    };
    let (rail, shackle) = ([Mounting::Rail], [Mounting::Shackle]);
    let (names, lifted) = match reading {
        AmplitudeReading::Whole => (
            [
                "shackle, rail friction free",
                "no shackle, rail friction free",
                "both, rail friction free",
            ],
            ("rail_mu", [0.0, 2.0]),
        ),
        // Twice the stroke needs a softer pack: no friction gives that.
        AmplitudeReading::Half => (
            [
                "shackle, thickness free",
                "no shackle, thickness free",
                "both, thickness free",
            ],
            ("thickness_correction_mm", [-1.5, 0.185]),
        ),
    };
    vec![
        case("shackle, within belief", &shackle, None),
        case("no shackle, within belief", &rail, None),
        case("both, within belief", &MOUNTS, None),
        case(names[0], &shackle, Some(lifted)),
        case(names[1], &rail, Some(lifted)),
        case(names[2], &MOUNTS, Some(lifted)),
    ]
}

/// Where a case starts: at the parameters' own, or where the cases before it ended.
fn starts(case: &FitCase, before: &[PhysicsFit]) -> Vec<Vec<f64>> {
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
    // What each mounting has for itself from its own fit; what they share from one of the two, or halfway.
    let (a, b) = (&shackle.fit.values, &rail.fit.values);
    let merged = |share: f64| {
        let value = |i: usize| match i {
            0..=4 => a[i] + share * (b[i] - a[i]),
            6..=8 | 12 => b[i],
            _ => a[i],
        };
        (0..PARAMETERS.len()).map(value).collect()
    };
    match last(&MOUNTS) {
        Some(both) => vec![both.fit.values.clone(), merged(1.0)],
        None => vec![merged(1.0), merged(0.5)],
    }
}

/// All cases of a reading. `watch` as in [`super::rerun`].
pub(crate) fn physics(
    reading: AmplitudeReading,
    choice: &Choice,
    watch: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<Vec<PhysicsFit>, IdentifyError> {
    fit_cases(cases(reading), &ROWS, reading, choice, watch)
}

/// The sets within belief alone, for rows like those of Tables 2 and 3: one a mounting, then the one that both share.
pub(crate) fn believable(
    printed: &[Printed; 5],
    reading: AmplitudeReading,
    choice: &Choice,
    watch: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<Vec<PhysicsFit>, IdentifyError> {
    let mut within = cases(reading);
    within.retain(|case| case.lifted.is_none());
    fit_cases(within, printed, reading, choice, watch)
}

fn fit_cases(
    cases: Vec<FitCase>,
    printed: &[Printed; 5],
    reading: AmplitudeReading,
    choice: &Choice,
    watch: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<Vec<PhysicsFit>, IdentifyError> {
    let weight = |case: &FitCase| (1 + 3 * usize::from(case.mounts.contains(&Mounting::Shackle))) as f64;
    let total: f64 = cases.iter().map(weight).sum();
    let mut done = 0.0;
    let mut fits = Vec::new();
    for case in cases {
        let share = weight(&case) / total;
        done += share;
        let met = |f: &PhysicsFit| f.case.mounts == case.mounts && f.misses().is_empty();
        if case.lifted.is_some() && fits.iter().any(met) {
            continue;
        }
        let mut go_on = true;
        let starts = starts(&case, &fits);
        let each = share / starts.len() as f64;
        let mut best: Option<PhysicsFit> = None;
        for (i, start) in starts.into_iter().enumerate() {
            let found = fit_case(&case, start, printed, reading, choice, &mut |part| {
                go_on = watch(case.name, done - share + each * (i as f64 + part));
                go_on
            })?;
            if best.as_ref().is_none_or(|b| found.fit.cost < b.fit.cost) {
                best = Some(found);
            }
            if !go_on {
                break;
            }
        }
        fits.extend(best);
        if !go_on {
            break;
        }
    }
    Ok(fits)
}

fn fit_case(
    case: &FitCase,
    mut start: Vec<f64>,
    printed: &[Printed; 5],
    reading: AmplitudeReading,
    choice: &Choice,
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<PhysicsFit, IdentifyError> {
    let problem = RowProblem::new(case, printed, reading);
    let mut fixed: Vec<&str> = Vec::new();
    if !case.mounts.contains(&Mounting::Rail) {
        fixed.extend(RAIL_ONLY);
    }
    if !case.mounts.contains(&Mounting::Shackle) {
        fixed.extend(SHACKLE_ONLY);
    }
    if let Some(trough_mm) = choice.trough_mm {
        fixed.extend(["rail_trough_mm", "shackle_trough_mm"]);
        (start[8], start[11]) = (trough_mm, trough_mm);
    }
    let options = FitOptions {
        method: Method::LeastSquares(least_squares::LeastSquaresSettings {
            iterations: 40,
            // An eighth power: a thousandth of the worst row's error.
            cost_tolerance: 1e-2,
            step_tolerance: 1e-4,
            // The path's strides make residuals uneven below some 1e-4.
            relative_step: 5e-3,
            ..least_squares::LeastSquaresSettings::default()
        }),
        start: Some(start),
        fixed: fixed.into_iter().map(str::to_owned).collect(),
        seed: choice.seed,
        threads: choice.threads,
        ..FitOptions::default()
    };
    let fit = fit(&problem, &options, &mut |p| {
        if watch(p.share) && p.best_cost > ENOUGH {
            FitControl::Continue
        } else {
            FitControl::Stop
        }
    })?;
    judge(case, &problem, fit)
}

fn judge(case: &FitCase, problem: &RowProblem, fit: Fit) -> Result<PhysicsFit, IdentifyError> {
    let (mut rows, mut travel_mm, mut curves) = (Vec::new(), Vec::new(), Vec::new());
    for &mounting in &problem.mounts {
        let pass = problem.pass(mounting, &fit.values, STEP_MM[1])?;
        rows.extend(problem.rows(mounting, &pass));
        travel_mm.push(pass.travel_mm);
        curves.push(pass.points);
    }
    let worst = |k: usize| rows.iter().map(|r| r.errors()[k].abs()).fold(0.0, f64::max);
    let judged = Judged {
        peak: worst(0),
        energy: worst(1),
    };
    Ok(PhysicsFit {
        case: case.clone(),
        fit,
        rows,
        judged,
        travel_mm,
        curves,
    })
}

impl PhysicsFit {
    /// Structure and values of a mounting's pack, as a twin runs it.
    pub(crate) fn pack(&self, mounting: Mounting) -> (PackStructure, Values) {
        let (structure, values, _) = unpack(mounting, &self.fit.values);
        (structure, values)
    }

    /// Rows that miss more than is allowed, in words.
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

    /// Free parameters that stand at the end of what is believed, or beyond it, in words.
    pub(crate) fn at_bounds(&self) -> Vec<String> {
        let fit = &self.fit;
        (0..PARAMETERS.len())
            .filter(|&i| fit.free[i])
            .filter_map(|i| {
                let ([low, high], value) = (PARAMETERS[i].belief, fit.values[i]);
                let near = 0.005 * (high - low);
                let name = PARAMETERS[i].name;
                if value > high + near || value < low - near {
                    Some(format!("{name} = {value:.3} (believed {low} to {high})"))
                } else if value > high - near || value < low + near {
                    Some(format!("{name} at {value:.3}"))
                } else {
                    None
                }
            })
            .collect()
    }
}
