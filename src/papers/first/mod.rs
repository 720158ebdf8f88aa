//! Kadziela, Manka, Uhl, Toso (2015): Tables 2, 3, 6 and 7 run again on the leaf pack.
//!
//! - `walk` one pass through all rows of a mounting · `own_model` the paper's kind of model (tanh friction) and its
//!   optimisation (Tables 6 and 7) · `physics` presliding friction and the rig's own, one set for all rows
//!
//! The paper leaves open whether "amplitude" is half of the stroke or the whole of it, where the troughs lie, and how far the
//! static test travels. [`AmplitudeReading`] is a switch, the trough a parameter (or fixed), and the static travel is the one that meets
//! the printed peak force.

mod own_model;
mod parameters;
mod physics;
mod walk;

pub(crate) use own_model::{OwnModel, OwnRow, OwnStatics, TwoNumbers, own_model, own_statics, two_numbers};
pub(crate) use physics::{ALLOWED, PhysicsFit, believable, physics};
pub(crate) use walk::{Pass, walk};

use crate::identify::IdentifyError;
use crate::model::leaf_pack::{Mounting, PackStructure};

/// Peak force and loop energy of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Two {
    /// N.
    pub peak_n: f64,
    /// J.
    pub loop_j: f64,
}

const fn two(peak_n: f64, loop_j: f64) -> Two {
    Two { peak_n, loop_j }
}

/// One row of Table 2 or 3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Printed {
    /// Name in tables.
    pub name: &'static str,
    /// Printed amplitude in mm; `None` for the static test.
    pub amplitude_mm: Option<f64>,
    /// Hz; the static test takes 120 s.
    pub frequency_hz: f64,
    /// Measured, with shackle and without.
    pub measured: [Two; 2],
    /// The paper's simulation, with shackle and without.
    pub simulated: [Two; 2],
}

/// Tables 2 and 3.
pub(crate) const ROWS: [Printed; 5] = [
    Printed {
        name: "static",
        amplitude_mm: None,
        frequency_hz: 1.0 / STATIC_S,
        measured: [two(2003.0, 8.9074), two(1999.0, 6.0467)],
        simulated: [two(1918.0, 0.1926), two(2105.0, 0.2336)],
    },
    Printed {
        name: "6 mm, 1 Hz",
        amplitude_mm: Some(6.0),
        frequency_hz: 1.0,
        measured: [two(1029.0, 2.4248), two(688.0, 0.6651)],
        simulated: [two(948.0, 1.4216), two(654.0, 0.7501)],
    },
    Printed {
        name: "10 mm, 1 Hz",
        amplitude_mm: Some(10.0),
        frequency_hz: 1.0,
        measured: [two(1479.0, 4.9148), two(1028.0, 1.6087)],
        simulated: [two(1409.0, 2.4739), two(1018.0, 1.3962)],
    },
    Printed {
        name: "15 mm, 1 Hz",
        amplitude_mm: Some(15.0),
        frequency_hz: 1.0,
        measured: [two(1954.0, 8.4890), two(1439.0, 3.3164)],
        simulated: [two(1916.0, 3.8203), two(1468.0, 2.2518)],
    },
    Printed {
        name: "6 mm, 2.5 Hz",
        amplitude_mm: Some(6.0),
        frequency_hz: 2.5,
        measured: [two(1031.0, 2.4895), two(679.0, 0.6625)],
        simulated: [two(963.0, 1.5427), two(653.0, 0.8288)],
    },
];

/// Printed amplitudes that are walked: the 2.5 Hz row moves as the 6 mm row does.
const AMPLITUDES_MM: [f64; 3] = [6.0, 10.0, 15.0];
/// Place of each sine row among them.
const SINE_OF_ROW: [usize; 5] = [0, 0, 1, 2, 0];

/// Up and down of the static test, s.
pub(crate) const STATIC_S: f64 = 120.0;

/// The two mountings, in the order of the tables' columns.
pub(crate) const MOUNTS: [Mounting; 2] = [Mounting::Shackle, Mounting::Rail];

/// Column of a mounting.
pub(crate) fn column(mounting: Mounting) -> usize {
    match mounting {
        Mounting::Shackle => 0,
        Mounting::Rail => 1,
    }
}

/// In words.
pub(crate) fn mount_name(mounting: Mounting) -> &'static str {
    match mounting {
        Mounting::Shackle => "shackle",
        Mounting::Rail => "no shackle",
    }
}

/// What "amplitude" means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AmplitudeReading {
    /// Half of the stroke.
    Half,
    /// The whole stroke, peak to peak.
    Whole,
}

impl AmplitudeReading {
    /// Stroke of a printed amplitude, mm.
    pub(crate) fn stroke_mm(self, amplitude_mm: f64) -> f64 {
        match self {
            AmplitudeReading::Half => 2.0 * amplitude_mm,
            AmplitudeReading::Whole => amplitude_mm,
        }
    }

    /// In words.
    pub(crate) fn name(self) -> &'static str {
        match self {
            AmplitudeReading::Half => "amplitude = half the stroke",
            AmplitudeReading::Whole => "amplitude = the whole stroke",
        }
    }
}

/// What the command line may choose.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Choice {
    /// Readings to run.
    pub readings: Vec<AmplitudeReading>,
    /// Lowest displacement of the sines in mm, the same for both mountings; fitted where `None`.
    pub trough_mm: Option<f64>,
    /// Cores; 0 for all.
    pub threads: usize,
    /// Seed of the evolution.
    pub seed: u64,
}

impl Default for Choice {
    fn default() -> Self {
        Choice {
            readings: vec![AmplitudeReading::Whole, AmplitudeReading::Half],
            trough_mm: None,
            threads: 0,
            seed: 1,
        }
    }
}

/// Everything of the first paper.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeafPackRerun {
    /// What the paper's kind of model runs with.
    pub statics: OwnStatics,
    /// Tables 6 and 7.
    pub two_numbers: Vec<TwoNumbers>,
    /// One a reading.
    pub readings: Vec<ReadingRerun>,
}

/// Everything that hangs on the reading.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReadingRerun {
    /// Which.
    pub reading: AmplitudeReading,
    /// Tables 2 and 3 with the paper's kind of model.
    pub own: OwnModel,
    /// One set a mounting, one for both.
    pub fits: Vec<PhysicsFit>,
}

impl ReadingRerun {
    /// Largest error over what is allowed, of the sets within belief for one mounting: small where the reading holds.
    pub(crate) fn misfit(&self) -> f64 {
        let single = |f: &&PhysicsFit| f.case.lifted.is_none() && f.case.mounts.len() == 1;
        let score = |f: &PhysicsFit| (f.judged.peak / ALLOWED[0]).max(f.judged.energy / ALLOWED[1]);
        self.fits.iter().filter(single).map(score).fold(0.0, f64::max)
    }
}

/// Runs it all. `watch` is told what is done and the share of the way; false stops with what there is.
pub(crate) fn rerun(
    choice: &Choice,
    watch: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<LeafPackRerun, IdentifyError> {
    watch("the paper's kind of model", 0.0);
    let statics = own_statics()?;
    let mut out = LeafPackRerun {
        statics,
        two_numbers: Vec::new(),
        readings: Vec::new(),
    };
    for (i, mounting) in MOUNTS.into_iter().enumerate() {
        if !watch("differential evolution on objective (9)", 0.05 + 0.1 * i as f64) {
            return Ok(out);
        }
        out.two_numbers.push(two_numbers(mounting, &out.statics, choice)?);
    }
    let part = 0.75 / choice.readings.len() as f64;
    for (i, &reading) in choice.readings.iter().enumerate() {
        let done = 0.25 + part * i as f64;
        if !watch(reading.name(), done) {
            break;
        }
        let own = own_model(reading, &out.statics)?;
        let fits = physics(reading, choice, &mut |what, share| {
            watch(what, done + part * share)
        })?;
        out.readings.push(ReadingRerun { reading, own, fits });
    }
    Ok(out)
}

/// The paper's spring on a mounting.
fn structure(mounting: Mounting) -> PackStructure {
    PackStructure {
        mounting,
        ..PackStructure::default()
    }
}
