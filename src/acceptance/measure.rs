//! One pass over the samples of a run: the values of each counted cycle and of the whole motion. `recording/metrics.rs` defines
//! the values.

use super::{CycleRow, RunResult, ValueSummary};
use crate::profile::accept::CycleValue;
use crate::recording::cycles::{CycleMeter, CycleSummary};
use crate::recording::run_file::RunFile;
use crate::recording::{Ending, Flags, Sample};

/// What the samples of a run give.
pub(super) struct Measured {
    pub cycles: Vec<CycleRow>,
    pub whole: Option<CycleRow>,
    /// Samples without a valid reading of a channel.
    pub flagged: u64,
}

/// Reads all samples once.
pub(super) fn measure(run: &RunFile) -> Measured {
    let completed = run.outcome().is_some_and(|o| o.ending == Ending::Completed);
    let (mut counted, mut whole) = (CycleMeter::default(), CycleMeter::default());
    let (mut cycles, mut flagged) = (Vec::new(), 0);
    for sample in run.samples() {
        flagged += u64::from(sample.flags.intersects(Flags::UNUSABLE));
        cycles.extend(counted.add(&sample));
        if is_of_the_profile(&sample) || sample.flags.contains(Flags::NOT_PROFILE) {
            // One loop, whatever the profile counts. It gets the samples of holds too, so that their ticks do not count as lost.
            whole.add(&Sample { cycle: 1, ..sample });
        }
    }
    cycles.extend(counted.finish(completed));
    let whole = whole.finish(completed).map(|summary| CycleRow {
        cycle: 0,
        ..row(&summary)
    });
    Measured {
        cycles: cycles.iter().map(row).collect(),
        whole,
        flagged,
    }
}

/// True for motion that the profile commands: no hold, no unloading.
pub(super) fn is_of_the_profile(sample: &Sample) -> bool {
    sample.segment > 0 && !sample.flags.contains(Flags::NOT_PROFILE)
}

fn row(c: &CycleSummary) -> CycleRow {
    CycleRow {
        cycle: c.cycle,
        complete: c.complete,
        lost: c.lost,
        flagged: c.excluded,
        force_peak_n: c.force_n.peak,
        force_valley_n: c.force_n.valley,
        force_amplitude_n: c.force_n.amplitude(),
        displacement_peak_mm: c.displacement_mm.peak,
        displacement_valley_mm: c.displacement_mm.valley,
        displacement_amplitude_mm: c.displacement_mm.amplitude(),
        travel_mm: c.displacement_mm.span(),
        loop_energy_j: c.loop_energy_j,
        secant_rate_n_per_mm: c.secant_rate_n_per_mm,
        twin_nrmse: c.twin_nrmse,
    }
}

/// Summary of each value over the loops of a result; none for a value that no loop has.
pub(super) fn summaries(result: &RunResult) -> Vec<ValueSummary> {
    let loops = result.loops();
    let of = |value: CycleValue| {
        let points: Vec<(f64, f64)> = points(&loops, value);
        let (first, last) = (points.first()?.1, points.last()?.1);
        let values = || points.iter().map(|(_, v)| *v);
        Some(ValueSummary {
            name: name(value).to_owned(),
            what: value.words().to_owned(),
            unit: value.unit().to_owned(),
            first,
            last,
            min: values().fold(f64::INFINITY, f64::min),
            max: values().fold(f64::NEG_INFINITY, f64::max),
            mean: values().sum::<f64>() / points.len() as f64,
            trend: slope(&points),
            trend_unit: value.trend_unit().to_owned(),
        })
    };
    CycleValue::ALL.into_iter().filter_map(of).collect()
}

/// Name of a value in a [`CycleRow`].
fn name(value: CycleValue) -> &'static str {
    match value {
        CycleValue::ForcePeak => "force_peak_n",
        CycleValue::ForceValley => "force_valley_n",
        CycleValue::ForceAmplitude => "force_amplitude_n",
        CycleValue::DisplacementPeak => "displacement_peak_mm",
        CycleValue::DisplacementValley => "displacement_valley_mm",
        CycleValue::DisplacementAmplitude => "displacement_amplitude_mm",
        CycleValue::Travel => "travel_mm",
        CycleValue::LoopEnergy => "loop_energy_j",
        CycleValue::SecantRate => "secant_rate_n_per_mm",
        CycleValue::TwinNrmse => "twin_nrmse",
    }
}

/// Number of the cycle and value, for the loops that have the value.
pub(super) fn points(loops: &[&CycleRow], value: CycleValue) -> Vec<(f64, f64)> {
    let point = |row: &&CycleRow| Some((f64::from(row.cycle), row.value(value)?));
    loops.iter().filter_map(point).collect()
}

/// Slope of the line of least squares; `None` for fewer than two different abscissas.
pub(super) fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let count = points.len() as f64;
    let mean = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).sum::<f64>() / count;
    let (x_mean, y_mean) = (mean(|p| p.0), mean(|p| p.1));
    let sums = points.iter().fold((0.0, 0.0), |(xx, xy), (x, y)| {
        let dx = x - x_mean;
        (xx + dx * dx, xy + dx * (y - y_mean))
    });
    (sums.0 > 0.0).then(|| sums.1 / sums.0)
}
