//! Kadziela, Manka, Uhl, Toso (2015): Tables 2, 3, 6 and 7 run again on the leaf pack.
//!
//! - `tanh_model` the paper's kind of model (tanh friction) and its optimisation (Tables 6 and 7) · `physics` the leaf pack
//!   with the friction of leaves, pins, rail and board (`identify::leaf_pack_rows`), one set for all rows
//!
//! The paper leaves open whether "amplitude" is half of the stroke or the whole of it, where the troughs are, and how far the
//! static test travels: `identify::leaf_pack_rows` says how each is chosen.

mod physics;
mod tanh_model;

pub(crate) use tanh_model::{TanhRow, TanhSettings, TanhTables, TwoNumbers};

use physics::physics;
use tanh_model::{tanh_settings, tanh_tables, two_numbers};

use crate::identify::IdentifyError;
use crate::identify::leaf_pack_rows::{
    ALLOWED, AmplitudeReading, MOUNTS, MountTest, RowFit, RowFitOptions, TESTS,
};
use crate::identify::targets::Aggregate;
use crate::model::leaf_pack::{Mounting, PackStructure};

const fn pair(peak_force_n: f64, loop_energy_j: f64) -> Aggregate {
    Aggregate {
        peak_force_n,
        loop_energy_j,
    }
}

/// One row of Table 2 or 3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PrintedRow {
    /// Amplitude and frequency of the test.
    pub test: MountTest,
    /// Measured figures, with shackle and without.
    pub measured: [Aggregate; 2],
    /// Figures of the paper's simulation, with shackle and without.
    pub simulated: [Aggregate; 2],
}

/// Tables 2 and 3, in the order of [`TESTS`].
pub(crate) const ROWS: [PrintedRow; 5] = [
    PrintedRow {
        test: TESTS[0],
        measured: [pair(2003.0, 8.9074), pair(1999.0, 6.0467)],
        simulated: [pair(1918.0, 0.1926), pair(2105.0, 0.2336)],
    },
    PrintedRow {
        test: TESTS[1],
        measured: [pair(1029.0, 2.4248), pair(688.0, 0.6651)],
        simulated: [pair(948.0, 1.4216), pair(654.0, 0.7501)],
    },
    PrintedRow {
        test: TESTS[2],
        measured: [pair(1479.0, 4.9148), pair(1028.0, 1.6087)],
        simulated: [pair(1409.0, 2.4739), pair(1018.0, 1.3962)],
    },
    PrintedRow {
        test: TESTS[3],
        measured: [pair(1954.0, 8.4890), pair(1439.0, 3.3164)],
        simulated: [pair(1916.0, 3.8203), pair(1468.0, 2.2518)],
    },
    PrintedRow {
        test: TESTS[4],
        measured: [pair(1031.0, 2.4895), pair(679.0, 0.6625)],
        simulated: [pair(963.0, 1.5427), pair(653.0, 0.8288)],
    },
];

/// Time up and down of the static test, s.
const STATIC_S: f64 = 120.0;

/// Options of the command line.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Choice {
    /// Readings of "amplitude" to run.
    pub readings: Vec<AmplitudeReading>,
    /// Lowest displacement of the sines in mm, the same for both mountings; fitted where `None`.
    pub trough_mm: Option<f64>,
    /// Cores to use; 0 for all.
    pub threads: usize,
}

/// The first paper run again.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeafPackRerun {
    /// Transition velocity and static travel of the paper's kind of model.
    pub statics: TanhSettings,
    /// Tables 6 and 7, one entry per mounting.
    pub two_numbers: Vec<TwoNumbers>,
    /// Tables 2 and 3, one entry per reading of "amplitude".
    pub readings: Vec<ReadingRerun>,
}

/// Tables 2 and 3 with one reading of "amplitude".
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReadingRerun {
    /// Meaning of "amplitude".
    pub reading: AmplitudeReading,
    /// The paper's kind of model.
    pub tanh: TanhTables,
    /// The leaf pack fitted: one set per mounting, and one for both.
    pub fits: Vec<RowFit>,
}

impl ReadingRerun {
    /// Largest error over what is allowed, of the sets within the ranges for one mounting: small where the reading holds.
    pub(crate) fn misfit(&self) -> f64 {
        let single = |f: &&RowFit| f.case.freed.is_none() && f.case.mounts.len() == 1;
        let score = |f: &RowFit| {
            let [peak, energy] = f.worst_errors();
            (peak / ALLOWED[0]).max(energy / ALLOWED[1])
        };
        self.fits.iter().filter(single).map(score).fold(0.0, f64::max)
    }
}

/// Runs all tables; `progress` is called with the share of the work that is done.
pub(crate) fn rerun(choice: &Choice, progress: &mut dyn FnMut(f64)) -> Result<LeafPackRerun, IdentifyError> {
    progress(0.0);
    let statics = tanh_settings()?;
    let mut pairs = Vec::new();
    for (i, mounting) in MOUNTS.into_iter().enumerate() {
        progress(0.05 + 0.1 * i as f64);
        pairs.push(two_numbers(mounting, &statics, choice.threads)?);
    }
    let part = 0.75 / choice.readings.len() as f64;
    let mut readings = Vec::new();
    for (i, &reading) in choice.readings.iter().enumerate() {
        let done = 0.25 + part * i as f64;
        progress(done);
        let tanh = tanh_tables(reading, &statics)?;
        let options = RowFitOptions {
            reading,
            trough_mm: choice.trough_mm,
            threads: choice.threads,
        };
        let fits = physics(&options, &mut |share| progress(done + part * share))?;
        readings.push(ReadingRerun { reading, tanh, fits });
    }
    Ok(LeafPackRerun {
        statics,
        two_numbers: pairs,
        readings,
    })
}

/// The paper's spring on a mounting.
fn structure(mounting: Mounting) -> PackStructure {
    PackStructure {
        mounting,
        ..PackStructure::default()
    }
}
