//! The paper's kind of model: interleaf friction of the tanh law alone, and its optimisation on two numbers.
//!
//! Transition velocity and static travel are not printed. They are taken from the paper's own figures: the travel at which
//! mu 0.1 gives its simulated static peak, and the velocity at which the optimum of Table 7 gives its loop energy. The
//! evolution (Table 5) then moves friction coefficient and thickness correction over objective (9), the loop energy rounded
//! to two decimals as printed. Bounds of the coefficient are not printed either: -30 to 30 hold both optima, printed and ours. Only its
//! size acts in the law used here: a negative coefficient that did act as such would drive the spring.
//!
//! At such coefficients leaves lock and let go, and a row costs a hundred times an ordinary one. So the rows are computed on a
//! grid of coefficient and thickness, the evolution runs on the polynomial through them, and its optimum is computed for real.

use super::{AmplitudeReading, Choice, Printed, ROWS, STATIC_S, Two, column, structure, two, walk};
use crate::identify::objective::{Residuals, scaled_difference};
use crate::identify::targets::TargetMotion;
use crate::identify::{Fit, FitControl, FitOptions, IdentifyError, Method, differential_evolution, fit};
use crate::model::leaf_pack::{FrictionChoice, LeafPack, Mounting, PackStructure, Values, graded_path};
use crate::model::{BuildError, Parameter, Plant};
use crate::units::joules_from_nmm;

/// The paper's coefficient.
const MU: f64 = 0.1;
/// Where the search for the transition velocity starts, mm/s.
const START_MM_S: f64 = 0.045;
/// Tables 6 and 7: coefficient and thickness correction in mm, with shackle and without.
const PRINTED: [[f64; 2]; 2] = [[-13.09991, -0.09004], [8.51317, -0.18724]];
/// What they reach.
const PRINTED_REACH: [Two; 2] = [two(2002.15, 8.89817), two(1999.46, 6.04738)];
/// Table 4.
const TARGETS: [Two; 2] = [two(2003.0, 8.9), two(1999.0, 6.05)];
/// Longest step of the static path, mm.
const STEP_MM: f64 = 1.0;
/// Coefficients and thickness corrections (mm) of the grid.
const GRID_MU: [f64; 5] = [0.1, 4.0, 9.0, 18.0, 30.0];
const GRID_MM: [f64; 3] = [-0.4, -0.15, 0.1];
/// Softer than usual, N/mm: forces change by 0.2 %, and the leaves lock less abruptly.
const CONTACT_N_PER_MM: f64 = 2e4;
/// Coarser than usual for the same reason.
const TOLERANCE_N: f64 = 0.05;

/// One row: printed measurement, printed simulation, ours.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OwnRow {
    /// Mounting.
    pub mounting: Mounting,
    /// Row.
    pub name: &'static str,
    /// Measured.
    pub measured: Two,
    /// The paper's simulation.
    pub simulated: Two,
    /// Ours.
    pub ours: Two,
    /// Loop with dry friction of the same coefficient that knows no rate, J: the most that any transition velocity leaves.
    pub at_most_j: f64,
}

/// What the static test of the paper's kind of model runs with, whatever "amplitude" means.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OwnStatics {
    /// mm/s.
    pub transition_velocity_mm_s: f64,
    /// Static travel, with shackle and without, mm.
    pub travel_mm: [f64; 2],
}

/// Tables 2 and 3 with the paper's kind of model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OwnModel {
    /// Trough of the sines, with shackle and without, mm.
    pub trough_mm: [f64; 2],
    /// Both mountings, five rows each.
    pub rows: Vec<OwnRow>,
}

fn values(mu: f64, thickness_correction_mm: f64) -> Values {
    Values {
        interleaf_mu: mu,
        thickness_correction_mm,
        shackle_angle_rad: 26f64.to_radians(),
        ..Values::frictionless()
    }
}

fn tanh(mounting: Mounting, velocity_mm_s: f64) -> PackStructure {
    PackStructure {
        friction_law: FrictionChoice::Tanh,
        transition_velocity_mm_s: velocity_mm_s,
        contact_stiffness_n_per_mm: CONTACT_N_PER_MM,
        ..structure(mounting)
    }
}

fn pack(structure: &PackStructure, values: &Values) -> Result<LeafPack, BuildError> {
    let mut pack = LeafPack::new(structure, values).map_err(|reason| BuildError::Structure {
        model: crate::model::leaf_pack::MODEL.name,
        reason,
    })?;
    pack.set_tolerance_n(TOLERANCE_N);
    Ok(pack)
}

/// Up to `travel_mm` and back in 120 s.
fn static_row(structure: &PackStructure, values: &Values, travel_mm: f64) -> Result<Two, BuildError> {
    let mut pack = pack(structure, values)?;
    let points = pack.static_path(&graded_path(&[0.0, travel_mm, 0.0], STEP_MM), STATIC_S);
    let energy_nmm: f64 = points
        .windows(2)
        .map(|w| 0.5 * (w[0].force_n + w[1].force_n) * (w[1].displacement_mm - w[0].displacement_mm))
        .sum();
    Ok(Two {
        peak_n: points.iter().fold(0.0, |peak, p| p.force_n.max(peak)),
        loop_j: joules_from_nmm(energy_nmm),
    })
}

/// Where a slowly rising load reaches `force_n`, mm.
fn reach_mm(structure: &PackStructure, values: &Values, force_n: f64) -> Result<f64, BuildError> {
    let mut pack = pack(structure, values)?;
    let (mut at_mm, mut rate) = (0.0, 60.0);
    for _ in 0..200 {
        let before_n = pack.force_n();
        let stride_mm = ((force_n - before_n) / rate).min(STEP_MM);
        if stride_mm < 1e-4 {
            break;
        }
        at_mm += stride_mm;
        // About the static test's speed.
        rate = ((pack.step(at_mm, stride_mm) - before_n) / stride_mm).max(5.0);
    }
    Ok(at_mm)
}

fn sine(row: &Printed, reading: AmplitudeReading, trough_mm: f64) -> Option<TargetMotion> {
    row.amplitude_mm.map(|amplitude_mm| TargetMotion::Sine {
        stroke_mm: reading.stroke_mm(amplitude_mm),
        frequency_hz: row.frequency_hz,
        valley_mm: trough_mm,
    })
}

fn rows(
    structure: &PackStructure,
    values: &Values,
    reading: AmplitudeReading,
    travel_mm: f64,
    trough_mm: f64,
) -> Result<Vec<OwnRow>, BuildError> {
    let mount = column(structure.mounting);
    let strokes = super::AMPLITUDES_MM.map(|a| reading.stroke_mm(a));
    let dry = super::structure(structure.mounting);
    let reach_n = ROWS[0].simulated[mount].peak_n;
    let sines = walk(&mut pack(&dry, values)?, trough_mm, &strokes, reach_n, STEP_MM).sines;
    let at_most = |row: &Printed, sine: usize| match row.amplitude_mm {
        None => static_row(&dry, values, travel_mm),
        Some(_) => Ok(sines[sine]),
    };
    ROWS.iter()
        .zip(super::SINE_OF_ROW)
        .map(|(row, sine_of_row)| {
            let ours = match sine(row, reading, trough_mm) {
                None => static_row(structure, values, travel_mm)?,
                Some(motion) => {
                    let mut plant: Box<dyn Plant> = Box::new(pack(structure, values)?);
                    let reached = motion.measure(&mut plant);
                    Two {
                        peak_n: reached.peak_force_n,
                        loop_j: reached.loop_energy_j,
                    }
                }
            };
            Ok(OwnRow {
                mounting: structure.mounting,
                name: row.name,
                measured: row.measured[mount],
                simulated: row.simulated[mount],
                ours,
                at_most_j: at_most(row, sine_of_row)?.loop_j,
            })
        })
        .collect()
}

/// Travel and transition velocity from the paper's own figures.
pub(crate) fn own_statics() -> Result<OwnStatics, IdentifyError> {
    let nominal = values(MU, 0.0);
    // The virgin curve hardly knows the law: any transition velocity serves for the travel.
    let travel = |mounting| {
        let force_n = ROWS[0].simulated[column(mounting)].peak_n;
        reach_mm(&tanh(mounting, START_MM_S), &nominal, force_n)
    };
    let travel_mm = [travel(Mounting::Shackle)?, travel(Mounting::Rail)?];
    let [mu, correction_mm] = PRINTED[1];
    let mut velocity = START_MM_S;
    // Far below the transition the friction is viscous, so the loop goes with 1 / v: two corrections leave a percent.
    for _ in 0..2 {
        let row = static_row(
            &tanh(Mounting::Rail, velocity),
            &values(mu, correction_mm),
            travel_mm[1],
        )?;
        velocity *= row.loop_j / PRINTED_REACH[1].loop_j;
    }
    Ok(OwnStatics {
        transition_velocity_mm_s: velocity,
        travel_mm,
    })
}

/// Tables 2 and 3 with interleaf friction 0.1 of the tanh law.
pub(crate) fn own_model(reading: AmplitudeReading, statics: &OwnStatics) -> Result<OwnModel, IdentifyError> {
    let nominal = values(MU, 0.0);
    let mut trough_mm = [0.0; 2];
    let mut all = Vec::new();
    for mounting in super::MOUNTS {
        let mount = column(mounting);
        let structure = tanh(mounting, statics.transition_velocity_mm_s);
        // The printed simulation of the smallest sine says where its peak lies.
        let peak_mm = reach_mm(&structure, &nominal, ROWS[1].simulated[mount].peak_n)?;
        trough_mm[mount] = (peak_mm - reading.stroke_mm(6.0)).max(0.0);
        all.extend(rows(
            &structure,
            &nominal,
            reading,
            statics.travel_mm[mount],
            trough_mm[mount],
        )?);
    }
    Ok(OwnModel { trough_mm, rows: all })
}

/// Tables 6 and 7: what the evolution makes of two numbers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TwoNumbers {
    /// Mounting.
    pub mounting: Mounting,
    /// Printed friction coefficient and thickness correction (mm).
    pub printed: [f64; 2],
    /// Ours.
    pub found: [f64; 2],
    /// Printed reach of the optimum.
    pub printed_reach: Two,
    /// Ours.
    pub reach: Two,
    /// Targets (Table 4).
    pub target: Two,
    /// What the polynomial says at our optimum; `reach` is the row computed for real.
    pub on_grid: Two,
    /// Static loop with the coefficient at 0.1 and nothing else changed, J.
    pub unfitted_j: f64,
    /// The fit.
    pub fit: Fit,
}

const TWO: [Parameter; 2] = [
    Parameter {
        name: "friction_coefficient",
        unit: "",
        start: MU,
        bounds: [-30.0, 30.0],
        belief: [0.05, 0.3],
        what: "friction coefficient between leaves; its size acts",
    },
    Parameter {
        name: "thickness_correction_mm",
        unit: "mm",
        start: 0.0,
        bounds: [-0.4, 0.1],
        belief: [-0.185, 0.185],
        what: "added to the thickness of every leaf",
    },
];

/// Static rows on the grid, and the polynomial through them.
struct Surface {
    /// `[coefficient][thickness]`.
    rows: [[Two; 3]; 5],
    target: Two,
}

impl Surface {
    fn new(structure: &PackStructure, travel_mm: f64, target: Two) -> Result<Self, BuildError> {
        // One thread a thickness: the evolution itself costs nothing then.
        let columns: Vec<Result<Vec<Two>, BuildError>> = std::thread::scope(|scope| {
            let column = |mm: f64| {
                move || {
                    let row = |mu: &f64| static_row(structure, &values(*mu, mm), travel_mm);
                    GRID_MU.iter().map(row).collect()
                }
            };
            let threads: Vec<_> = GRID_MM.iter().map(|&mm| scope.spawn(column(mm))).collect();
            threads
                .into_iter()
                .map(|t| t.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect()
        });
        let columns: Vec<Vec<Two>> = columns.into_iter().collect::<Result<_, _>>()?;
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
        Ok(Surface { rows, target })
    }

    fn at(&self, found: &[f64]) -> Two {
        let (by_mu, by_mm) = (lagrange(&GRID_MU, found[0].abs()), lagrange(&GRID_MM, found[1]));
        let mut sum = two(0.0, 0.0);
        for (row, a) in self.rows.iter().zip(by_mu) {
            for (cell, b) in row.iter().zip(&by_mm) {
                sum.peak_n += a * b * cell.peak_n;
                sum.loop_j += a * b * cell.loop_j;
            }
        }
        sum
    }
}

/// Weights of the polynomial through `nodes`.
fn lagrange(nodes: &[f64], x: f64) -> Vec<f64> {
    let weight = |i: usize| {
        let others = nodes.iter().enumerate().filter(|(k, _)| *k != i);
        others.map(|(_, n)| (x - n) / (nodes[i] - n)).product()
    };
    (0..nodes.len()).map(weight).collect()
}

impl Residuals for Surface {
    fn parameters(&self) -> &[Parameter] {
        &TWO
    }
    fn count(&self) -> usize {
        2
    }
    fn evaluate(&self, found: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let reach = self.at(found);
        let rounded_j = (100.0 * reach.loop_j).round() / 100.0;
        out[0] = scaled_difference(1e-3 * self.target.peak_n, 1e-3 * reach.peak_n, 1.0);
        out[1] = scaled_difference(self.target.loop_j, rounded_j, 0.6);
        Ok(())
    }
}

/// Differential evolution with the settings of Table 5 on objective (9).
pub(crate) fn two_numbers(
    mounting: Mounting,
    statics: &OwnStatics,
    choice: &Choice,
) -> Result<TwoNumbers, IdentifyError> {
    let mount = column(mounting);
    let structure = tanh(mounting, statics.transition_velocity_mm_s);
    let travel_mm = statics.travel_mm[mount];
    let surface = Surface::new(&structure, travel_mm, TARGETS[mount])?;
    let options = FitOptions {
        method: Method::DifferentialEvolution(differential_evolution::EvolutionSettings::default()),
        seed: choice.seed,
        threads: choice.threads,
        intervals: false,
        ..FitOptions::default()
    };
    let fit = fit(&surface, &options, &mut |_| FitControl::Continue)?;
    let found = [fit.values[0], fit.values[1]];
    let reach = static_row(&structure, &values(found[0].abs(), found[1]), travel_mm)?;
    Ok(TwoNumbers {
        mounting,
        printed: PRINTED[mount],
        found,
        printed_reach: PRINTED_REACH[mount],
        reach,
        target: TARGETS[mount],
        on_grid: surface.at(&found),
        unfitted_j: surface.at(&[GRID_MU[0], 0.0]).loop_j,
        fit,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polynomial_goes_through_its_grid() {
        let cell = |i: usize, j: usize| two((10 * i + j) as f64, (i * j) as f64);
        let surface = Surface {
            rows: std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j))),
            target: TARGETS[0],
        };
        for (i, mu) in GRID_MU.iter().enumerate() {
            for (j, mm) in GRID_MM.iter().enumerate() {
                // The coefficient's sign does not act.
                let got = surface.at(&[-mu, *mm]);
                assert!((got.peak_n - cell(i, j).peak_n).abs() < 1e-9);
                assert!((got.loop_j - cell(i, j).loop_j).abs() < 1e-9);
            }
        }
    }
}
