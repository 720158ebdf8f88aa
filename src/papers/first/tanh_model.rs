//! The paper's kind of model: interleaf friction of the tanh law alone, and its optimisation on two numbers.
//!
//! Transition velocity and static travel are not printed. They follow from the paper's own figures: the travel at which mu 0.1
//! gives its simulated static peak, and the velocity at which the optimum of Table 7 gives its loop energy. The evolution
//! (Table 5) then varies friction coefficient and thickness correction to minimise objective (9), with the loop energy rounded
//! to two decimals as printed. The bounds of the coefficient are not printed either: -30 to 30 contain both optima, the
//! printed one and ours. The law uses the absolute value of the coefficient, because negative friction would add energy.
//!
//! At such coefficients leaves stick and slip, and a row takes a hundred times as long as an ordinary one. The rows are
//! therefore computed on a grid of coefficient and thickness, the evolution runs on the polynomial through them, and its
//! optimum is computed with the model.

use super::{PrintedRow, ROWS, STATIC_S, pair, structure};
use crate::identify::evaluator::parallel_map;
use crate::identify::leaf_pack_rows::{
    AMPLITUDES_MM, AmplitudeReading, MOUNTS, SINE_OF_TEST, mount_index, walk,
};
use crate::identify::objective::{Residuals, scaled_difference};
use crate::identify::targets::{Aggregate, ENERGY_WEIGHT, PEAK_WEIGHT, TargetMotion};
use crate::identify::{FitControl, FitOptions, IdentifyError, Method, differential_evolution, fit};
use crate::model::leaf_pack::{FrictionChoice, LeafPack, Mounting, PackStructure, Values, graded_path};
use crate::model::{BuildError, Parameter, Plant};
use crate::units::joules_from_nmm;

/// The paper's friction coefficient.
const MU: f64 = 0.1;
/// Where the search for the transition velocity starts, mm/s.
const START_MM_S: f64 = 0.045;
/// Tables 6 and 7: coefficient and thickness correction in mm, with shackle and without.
const PRINTED: [[f64; 2]; 2] = [[-13.09991, -0.09004], [8.51317, -0.18724]];
/// Figures that the paper prints for them.
const PRINTED_REACH: [Aggregate; 2] = [pair(2002.15, 8.89817), pair(1999.46, 6.04738)];
/// Targets of Table 4.
const TARGETS: [Aggregate; 2] = [pair(2003.0, 8.9), pair(1999.0, 6.05)];
/// Longest step of the static path, mm.
const STEP_MM: f64 = 1.0;
/// Coefficients and thickness corrections (mm) of the grid.
const GRID_MU: [f64; 5] = [0.1, 4.0, 9.0, 18.0, 30.0];
const GRID_MM: [f64; 3] = [-0.4, -0.15, 0.1];
/// Softer than the default, N/mm: forces change by 0.2 %, and the leaves lock less abruptly.
const CONTACT_N_PER_MM: f64 = 2e4;
/// Tolerance of the equilibrium, N; coarser than the default for the same reason.
const TOLERANCE_N: f64 = 0.05;

/// One row of Table 2 or 3 with the paper's kind of model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TanhRow {
    /// Mounting of the test.
    pub mounting: Mounting,
    /// Name of the test.
    pub name: &'static str,
    /// Measured figures as printed.
    pub measured: Aggregate,
    /// Simulated figures as printed.
    pub simulated: Aggregate,
    /// Figures of our model.
    pub ours: Aggregate,
    /// Loop energy of rate-independent friction with the same coefficient, J: the upper limit for any transition velocity.
    pub at_most_j: f64,
}

/// Settings of the paper's kind of model that do not depend on the meaning of "amplitude".
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TanhSettings {
    /// Transition velocity of the tanh law, mm/s.
    pub transition_velocity_mm_s: f64,
    /// Static travel, with shackle and without, mm.
    pub travel_mm: [f64; 2],
}

/// Tables 2 and 3 with the paper's kind of model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TanhTables {
    /// Trough of the sines, with shackle and without, mm.
    pub trough_mm: [f64; 2],
    /// Both mountings, five rows each.
    pub rows: Vec<TanhRow>,
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

/// The slow ramp up to `travel_mm` and back.
fn static_row(structure: &PackStructure, values: &Values, travel_mm: f64) -> Result<Aggregate, BuildError> {
    let mut pack = pack(structure, values)?;
    let points = pack.static_path(&graded_path(&[0.0, travel_mm, 0.0], STEP_MM), STATIC_S);
    let energy_nmm: f64 = points
        .windows(2)
        .map(|w| 0.5 * (w[0].force_n + w[1].force_n) * (w[1].displacement_mm - w[0].displacement_mm))
        .sum();
    Ok(Aggregate {
        peak_force_n: points.iter().fold(0.0, |peak, p| p.force_n.max(peak)),
        loop_energy_j: joules_from_nmm(energy_nmm),
    })
}

/// Displacement at which a slowly rising load reaches `force_n`, mm.
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
        // One second per mm is about the speed of the static test.
        rate = ((pack.step(at_mm, stride_mm) - before_n) / stride_mm).max(5.0);
    }
    Ok(at_mm)
}

fn sine(row: &PrintedRow, reading: AmplitudeReading, trough_mm: f64) -> Option<TargetMotion> {
    row.test.amplitude_mm.map(|amplitude_mm| TargetMotion::Sine {
        stroke_mm: reading.stroke_mm(amplitude_mm),
        frequency_hz: row.test.frequency_hz,
        valley_mm: trough_mm,
    })
}

fn rows(
    structure: &PackStructure,
    values: &Values,
    reading: AmplitudeReading,
    travel_mm: f64,
    trough_mm: f64,
) -> Result<Vec<TanhRow>, BuildError> {
    let mount = mount_index(structure.mounting);
    let strokes = AMPLITUDES_MM.map(|a| reading.stroke_mm(a));
    let dry = super::structure(structure.mounting);
    let reach_n = ROWS[0].simulated[mount].peak_force_n;
    let sines = walk(&mut pack(&dry, values)?, trough_mm, &strokes, reach_n, STEP_MM).sines;
    let at_most = |row: &PrintedRow, sine: usize| match row.test.amplitude_mm {
        None => static_row(&dry, values, travel_mm),
        Some(_) => Ok(sines[sine]),
    };
    ROWS.iter()
        .zip(SINE_OF_TEST)
        .map(|(row, sine_of_row)| {
            let ours = match sine(row, reading, trough_mm) {
                None => static_row(structure, values, travel_mm)?,
                Some(motion) => {
                    let mut plant: Box<dyn Plant> = Box::new(pack(structure, values)?);
                    motion.measure(&mut plant)
                }
            };
            Ok(TanhRow {
                mounting: structure.mounting,
                name: row.test.name,
                measured: row.measured[mount],
                simulated: row.simulated[mount],
                ours,
                at_most_j: at_most(row, sine_of_row)?.loop_energy_j,
            })
        })
        .collect()
}

/// Static travel and transition velocity from the paper's own figures.
pub(crate) fn tanh_settings() -> Result<TanhSettings, IdentifyError> {
    let nominal = values(MU, 0.0);
    // The first loading hardly depends on the law: any transition velocity gives the travel.
    let travel = |mounting| {
        let force_n = ROWS[0].simulated[mount_index(mounting)].peak_force_n;
        reach_mm(&tanh(mounting, START_MM_S), &nominal, force_n)
    };
    let travel_mm = [travel(Mounting::Shackle)?, travel(Mounting::Rail)?];
    let [mu, correction_mm] = PRINTED[1];
    let mut velocity = START_MM_S;
    // Far below the transition the friction is viscous and the loop energy is proportional to 1 / v: two corrections give 1 %.
    for _ in 0..2 {
        let row = static_row(
            &tanh(Mounting::Rail, velocity),
            &values(mu, correction_mm),
            travel_mm[1],
        )?;
        velocity *= row.loop_energy_j / PRINTED_REACH[1].loop_energy_j;
    }
    Ok(TanhSettings {
        transition_velocity_mm_s: velocity,
        travel_mm,
    })
}

/// Tables 2 and 3 with interleaf friction 0.1 of the tanh law.
pub(crate) fn tanh_tables(
    reading: AmplitudeReading,
    statics: &TanhSettings,
) -> Result<TanhTables, IdentifyError> {
    let nominal = values(MU, 0.0);
    let mut trough_mm = [0.0; 2];
    let mut all = Vec::new();
    for mounting in MOUNTS {
        let mount = mount_index(mounting);
        let structure = tanh(mounting, statics.transition_velocity_mm_s);
        // The printed simulation of the smallest sine gives the displacement of its peak.
        let peak_mm = reach_mm(&structure, &nominal, ROWS[1].simulated[mount].peak_force_n)?;
        trough_mm[mount] = (peak_mm - reading.stroke_mm(6.0)).max(0.0);
        all.extend(rows(
            &structure,
            &nominal,
            reading,
            statics.travel_mm[mount],
            trough_mm[mount],
        )?);
    }
    Ok(TanhTables { trough_mm, rows: all })
}

/// Tables 6 and 7: the evolution on peak force and loop energy of the static test.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TwoNumbers {
    /// Mounting of the test.
    pub mounting: Mounting,
    /// Printed optimum: friction coefficient and thickness correction (mm).
    pub printed: [f64; 2],
    /// Our optimum: friction coefficient and thickness correction (mm).
    pub found: [f64; 2],
    /// Printed figures of the printed optimum.
    pub printed_reach: Aggregate,
    /// Figures of our optimum, computed with the model.
    pub reach: Aggregate,
    /// Targets (Table 4).
    pub target: Aggregate,
    /// Static loop energy with the coefficient at 0.1 and nominal thickness, J.
    pub unfitted_j: f64,
}

const PARAMETERS: [Parameter; 2] = [
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
    /// Figures at each point of the grid: `[coefficient][thickness]`.
    rows: [[Aggregate; 3]; 5],
    target: Aggregate,
}

impl Surface {
    fn new(
        structure: &PackStructure,
        travel_mm: f64,
        target: Aggregate,
        threads: usize,
    ) -> Result<Self, BuildError> {
        let columns: Vec<Vec<Aggregate>> = parallel_map(&GRID_MM, threads, |&mm| {
            let row = |mu: &f64| static_row(structure, &values(*mu, mm), travel_mm);
            GRID_MU.iter().map(row).collect::<Result<_, _>>()
        })
        .into_iter()
        .collect::<Result<_, _>>()?;
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
        Ok(Surface { rows, target })
    }

    fn at(&self, found: &[f64]) -> Aggregate {
        let (by_mu, by_mm) = (lagrange(&GRID_MU, found[0].abs()), lagrange(&GRID_MM, found[1]));
        let mut sum = pair(0.0, 0.0);
        for (row, a) in self.rows.iter().zip(by_mu) {
            for (cell, b) in row.iter().zip(&by_mm) {
                sum.peak_force_n += a * b * cell.peak_force_n;
                sum.loop_energy_j += a * b * cell.loop_energy_j;
            }
        }
        sum
    }
}

/// Weights at `x` of the polynomial through `nodes` (Lagrange).
fn lagrange(nodes: &[f64], x: f64) -> Vec<f64> {
    let weight = |i: usize| {
        let others = nodes.iter().enumerate().filter(|(k, _)| *k != i);
        others.map(|(_, n)| (x - n) / (nodes[i] - n)).product()
    };
    (0..nodes.len()).map(weight).collect()
}

impl Residuals for Surface {
    fn parameters(&self) -> &[Parameter] {
        &PARAMETERS
    }
    fn count(&self) -> usize {
        2
    }
    fn evaluate(&self, found: &[f64], out: &mut [f64]) -> Result<(), BuildError> {
        let reach = self.at(found);
        let rounded_j = (100.0 * reach.loop_energy_j).round() / 100.0;
        out[0] = scaled_difference(
            1e-3 * self.target.peak_force_n,
            1e-3 * reach.peak_force_n,
            PEAK_WEIGHT,
        );
        out[1] = scaled_difference(self.target.loop_energy_j, rounded_j, ENERGY_WEIGHT);
        Ok(())
    }
}

/// Differential evolution with the settings of Table 5 on objective (9).
pub(crate) fn two_numbers(
    mounting: Mounting,
    statics: &TanhSettings,
    threads: usize,
) -> Result<TwoNumbers, IdentifyError> {
    let mount = mount_index(mounting);
    let structure = tanh(mounting, statics.transition_velocity_mm_s);
    let travel_mm = statics.travel_mm[mount];
    let surface = Surface::new(&structure, travel_mm, TARGETS[mount], threads)?;
    let options = FitOptions {
        method: Method::DifferentialEvolution(differential_evolution::EvolutionSettings::default()),
        threads,
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
        unfitted_j: surface.at(&[GRID_MU[0], 0.0]).loop_energy_j,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polynomial_goes_through_its_grid() {
        let cell = |i: usize, j: usize| pair((10 * i + j) as f64, (i * j) as f64);
        let surface = Surface {
            rows: std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j))),
            target: TARGETS[0],
        };
        for (i, mu) in GRID_MU.iter().enumerate() {
            for (j, mm) in GRID_MM.iter().enumerate() {
                // The coefficient's sign does not act.
                let got = surface.at(&[-mu, *mm]);
                assert!((got.peak_force_n - cell(i, j).peak_force_n).abs() < 1e-9);
                assert!((got.loop_energy_j - cell(i, j).loop_energy_j).abs() < 1e-9);
            }
        }
    }
}
