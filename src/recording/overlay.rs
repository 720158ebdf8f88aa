//! Force over displacement of one run, for drawing two runs over each other: the mean loop of its cycles or its whole motion,
//! as a course of points and as two branches, loading and unloading.

use super::cycles::{CycleMeter, CycleSummary, reversals};
use super::export::mean_bins;
use super::metrics::{LoopIntegral, Range};
use super::run_file::{RunFile, Survey};
use super::{Flags, Sample};

/// Most points of a course.
const MOST_POINTS: usize = 2000;
/// Cells of a branch. The travel divided by them is the resolution of a difference.
const CELLS: usize = 120;
/// Share of the travel by which the motion must come back to count as reversed.
const REVERSAL_SHARE: f64 = 0.02;

/// Points of a motion, mm and N.
pub(crate) type PlotPoints = Vec<(f64, f64)>;

/// One run, ready to be drawn over another.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RunOverlay {
    /// Number of complete cycles whose mean the course is; 0 where it is the whole motion.
    pub cycles: usize,
    /// At most 2000 points in the order of time.
    pub course: PlotPoints,
    /// Force over displacement with rising displacement.
    pub loading: LoopBranch,
    /// Force over displacement with falling displacement.
    pub unloading: LoopBranch,
    pub figures: RunFigures,
}

/// Figures of a run. A figure is `None` where the run has no usable sample for it.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub(crate) struct RunFigures {
    /// Highest force of the profile, N.
    pub force_max_n: Option<f64>,
    /// Lowest force of the profile, N.
    pub force_min_n: Option<f64>,
    /// Highest displacement of the profile, mm.
    pub displacement_max_mm: Option<f64>,
    /// Lowest displacement of the profile, mm.
    pub displacement_min_mm: Option<f64>,
    /// Energy that a cycle dissipates, J: the mean over the complete cycles; without cycles that of the whole motion.
    pub energy_j: Option<f64>,
    /// Rate from valley to peak, N/mm: the mean over the complete cycles; without cycles that of the whole motion.
    pub secant_rate_n_per_mm: Option<f64>,
    /// NRMSE of the twin: the mean over the complete cycles.
    pub twin_nrmse: Option<f64>,
}

/// Mean force over displacement in one direction, in the order of displacement.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct LoopBranch(PlotPoints);

impl LoopBranch {
    /// Force in N at a displacement; `None` outside of the branch.
    pub(crate) fn force_n(&self, displacement_mm: f64) -> Option<f64> {
        let after = self.0.partition_point(|(x, _)| *x < displacement_mm);
        let (right, left) = (self.0.get(after)?, self.0.get(after.checked_sub(1)?)?);
        let share = (displacement_mm - left.0) / (right.0 - left.0);
        Some(left.1 + share * (right.1 - left.1))
    }

    /// Lowest and highest displacement, mm.
    pub(crate) fn range_mm(&self) -> Option<(f64, f64)> {
        Some((self.0.first()?.0, self.0.last()?.0))
    }

    /// The mean of the points in each of [`CELLS`] cells of the travel.
    fn of(points: &[(f64, f64)], travel: Range) -> LoopBranch {
        let mut cells = vec![(0u32, 0.0, 0.0); CELLS];
        for (x, f) in points {
            let place = (x - travel.valley) / travel.span() * CELLS as f64;
            let cell = &mut cells[(place as usize).min(CELLS - 1)];
            *cell = (cell.0 + 1, cell.1 + x, cell.2 + f);
        }
        let means = cells.into_iter().filter(|cell| cell.0 > 0);
        LoopBranch(
            means
                .map(|(n, x, f)| (x / f64::from(n), f / f64::from(n)))
                .collect(),
        )
    }
}

impl RunOverlay {
    /// Reads a run. `survey` is that of the same file.
    pub(crate) fn of(run: &RunFile, survey: &Survey) -> RunOverlay {
        let complete = survey.unbroken_cycles().count();
        let (mut points, figures) = motion(run);
        let cycles = if complete > 1 { complete } else { 0 };
        if cycles > 0 {
            points = mean_bins(run, survey)
                .iter()
                .filter(|bin| bin.count > 0)
                .map(|bin| {
                    let count = f64::from(bin.count);
                    (bin.displacement_mm / count, bin.force_n / count)
                })
                .collect();
            // A loop is closed.
            points.extend(points.first().copied());
        }
        let (loading, unloading) = branches(&points);
        RunOverlay {
            cycles,
            course: thinned(&points),
            loading,
            unloading,
            figures,
        }
    }
}

/// The usable points of the profile, and the figures of the run.
fn motion(run: &RunFile) -> (PlotPoints, RunFigures) {
    let usable = |sample: &Sample| sample.segment > 0 && !sample.flags.intersects(Flags::UNUSABLE);
    let (mut points, mut meter, mut integral) =
        (PlotPoints::new(), CycleMeter::default(), LoopIntegral::default());
    let (mut force, mut displacement) = (None, None);
    let mut cycles: Vec<CycleSummary> = Vec::new();
    for sample in run.samples() {
        cycles.extend(meter.add(&sample));
        if usable(&sample) {
            points.push((sample.displacement_mm, sample.force_n));
            integral.add(sample.displacement_mm, sample.force_n);
            force = Some(Range::including(force, sample.force_n));
            displacement = Some(Range::including(displacement, sample.displacement_mm));
        }
    }
    cycles.retain(|cycle| cycle.complete);
    let whole_rate = displacement
        .zip(force)
        .and_then(|(x, f)| super::metrics::secant_rate_n_per_mm(x, f));
    let cyclic = !cycles.is_empty();
    let figures = RunFigures {
        force_max_n: force.map(|range| range.peak),
        force_min_n: force.map(|range| range.valley),
        displacement_max_mm: displacement.map(|range| range.peak),
        displacement_min_mm: displacement.map(|range| range.valley),
        energy_j: match cyclic {
            true => mean(cycles.iter().map(|cycle| Some(cycle.loop_energy_j))),
            false => (points.len() > 2).then(|| integral.energy_j()),
        },
        secant_rate_n_per_mm: match cyclic {
            true => mean(cycles.iter().map(|cycle| cycle.secant_rate_n_per_mm)),
            false => whole_rate,
        },
        twin_nrmse: mean(cycles.iter().map(|cycle| cycle.twin_nrmse)),
    };
    (points, figures)
}

/// The mean of the values that are there.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let (count, sum) = values
        .flatten()
        .fold((0u32, 0.0), |(n, sum), value| (n + 1, sum + value));
    (count > 0).then(|| sum / f64::from(count))
}

/// Splits a motion at its reversals: loading, unloading.
fn branches(points: &[(f64, f64)]) -> (LoopBranch, LoopBranch) {
    let x: Vec<f64> = points.iter().map(|(x, _)| *x).collect();
    let Some(travel) = Range::of(&x).filter(|range| range.span() > 0.0) else {
        return (LoopBranch::default(), LoopBranch::default());
    };
    let (mut loading, mut unloading) = (PlotPoints::new(), PlotPoints::new());
    let (mut from, mut rises) = (0, None);
    for turn in reversals(&x, REVERSAL_SHARE * travel.span()) {
        let branch = if turn.is_peak {
            &mut loading
        } else {
            &mut unloading
        };
        branch.extend(&points[from..=turn.index]);
        (from, rises) = (turn.index, Some(!turn.is_peak));
    }
    let rest = &points[from..];
    // A motion without a reversal goes where its end is.
    let rises = rises.unwrap_or_else(|| x.last() > x.first());
    if rises { &mut loading } else { &mut unloading }.extend(rest);
    (
        LoopBranch::of(&loading, travel),
        LoopBranch::of(&unloading, travel),
    )
}

/// Means of groups of neighbours, so that at most [`MOST_POINTS`] are left.
fn thinned(points: &[(f64, f64)]) -> PlotPoints {
    let group = points.len().div_ceil(MOST_POINTS).max(1);
    let middle = |group: &[(f64, f64)]| {
        let count = group.len() as f64;
        let (x, f) = group.iter().fold((0.0, 0.0), |(x, f), p| (x + p.0, f + p.1));
        (x / count, f / count)
    };
    points.chunks(group).map(middle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Recorder;
    use crate::recording::run_file::test_support::{header, outcome, sample};
    use crate::recording::run_file::{EXTENSION, RunFileWriter};

    /// The run of `test_support::sample`: F = 300 sin(p - 0.2) N over x = 6 sin(p) mm; `segment` and `force_n` are changed.
    fn overlay(ticks: u64, change: impl Fn(&mut Sample)) -> RunOverlay {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run").with_extension(EXTENSION);
        let mut writer = RunFileWriter::create(&path, &header()).unwrap();
        for tick in 0..ticks {
            let mut sample = sample(tick);
            change(&mut sample);
            writer.sample(&sample);
        }
        writer.end(&outcome(ticks));
        drop(writer);
        let run = RunFile::open(&path).unwrap();
        RunOverlay::of(&run, &run.survey())
    }

    #[test]
    fn the_mean_loop_has_two_branches_a_loop_width_apart() {
        let overlay = overlay(5000, |_| ());
        assert_eq!(overlay.cycles, 5);
        let head = header();
        // Offsets and tares of the channels shift the loop.
        let (x0, f0) = (head.displacement_channel.value(0), head.force_channel.value(0));
        // At the middle: 300 sin(0 - 0.2) and 300 sin(pi - 0.2).
        let width_n = 2.0 * 300.0 * 0.2_f64.sin();
        let (up, down) = (overlay.loading.force_n(x0), overlay.unloading.force_n(x0));
        let (up, down) = (up.unwrap() - f0, down.unwrap() - f0);
        // The chord of a cell of 0.1 mm leaves the loop by some 0.01 N; counts have steps of 0.1 N.
        assert!(
            (up + width_n / 2.0).abs() < 0.1 && (down - width_n / 2.0).abs() < 0.1,
            "{up} {down}"
        );
        assert_eq!(overlay.loading.force_n(x0 + 6.1), None);
        // pi a b sin(phase) with a in mm and b in N, in J.
        let energy_j = std::f64::consts::PI * 6.0 * 300.0 * 0.2_f64.sin() * -1e-3;
        assert!((overlay.figures.energy_j.unwrap().abs() / energy_j.abs() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_motion_without_cycles_is_taken_whole_and_points_outside_the_profile_are_left_out() {
        let ramp = overlay(3000, |sample| {
            sample.cycle = 0;
            let up = sample.tick.min(2000 - sample.tick.min(2000)) as i32;
            sample.displacement_counts = 20 * up;
            sample.force_counts = if sample.tick > 2000 { 30_000 } else { 3 * up };
            sample.segment = u32::from(sample.tick <= 2000);
        });
        assert_eq!(ramp.cycles, 0);
        assert!(ramp.course.len() <= MOST_POINTS && ramp.course.len() > 600);
        let head = header();
        assert_eq!(ramp.figures.force_max_n, Some(head.force_channel.value(3000)));
        let (low, high) = ramp.loading.range_mm().unwrap();
        // The ends are means of a cell of 10 mm / 120.
        assert!(low < 0.1 && high > 9.8, "{low} to {high}");
        let rate = ramp.figures.secant_rate_n_per_mm.unwrap();
        assert!((rate - 30.0).abs() < 1e-6, "300 N over 10 mm: {rate}");
    }
}
