//! What differs between recordings of one specimen and is no physics: a zero of the force, a zero of the displacement, a delay
//! between the channels, each its own in every recording. Another tare, an LVDT that was moved, clocks that started at other times.
//!
//! They are fitted together with the baseline (Gauss-Newton; their columns are difference quotients). They are taken as real only if
//! they explain nearly all that the baseline leaves above the noise, and no more kinds of them are used than that needs. Then each
//! offset that brings too little is left out. A recording has a zero of its own on one channel at most: along the line of a spring, a
//! zero of the force and one of the displacement cancel, so both together would fit the error of the model. Instruments
//! are the cheaper explanation and the cheaper check, so they win against physics. A delay that is the same in all recordings is
//! left to the candidates.

use nalgebra::{DMatrix, DVector};

use super::baseline::Setup;
use super::context::{FitContext, RunSettings};
use super::data::Data;
use super::fit::converge;
use super::general_law::with_general_law;
use super::node::Node;
use super::structure::ModelStructure;
use crate::diagnose::conditioning::{Track, median, range};
use crate::diagnose::course::Split;
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::identify::Residuals;
use crate::recording::Recording;

/// Mean square of the baseline's residuals, in units of the noise, from which offsets are looked for, and which they may leave.
const LEAST_POWER: f64 = 1.3;
const MOST_POWER_LEFT: f64 = 2.0;
/// Share of the sum of squares above the noise that they must explain.
const LEAST_EXPLAINED: f64 = 0.85;
/// The first step, a linear prediction, must explain this share, or the search ends.
const LEAST_PREDICTED: f64 = 0.5;
/// Physics that explains this share of what the offsets explain has their place: it needs a few parameters, they need some for
/// each recording.
const PHYSICS_SHARE: f64 = 0.8;
/// Log-likelihood that each offset must gain, and all together beside that.
const GAIN_OF_EACH: f64 = 5.0;
const GAIN_OF_ALL: f64 = 15.0;
/// Prior standard deviations: force and displacement as a share of their ranges, delay in s.
const PRIOR_SHARE: f64 = 0.1;
const PRIOR_S: f64 = 3e-3;
/// Steps of the difference quotients, as shares of the priors, and number of Gauss-Newton steps.
const STEP: f64 = 1e-3;
const ROUNDS: usize = 5;
/// An offset that moves by less than this share of its prior has converged.
const CONVERGED: f64 = 1e-4;

/// Offsets of one recording.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct FileOffsets {
    /// What the force channel reads at no force, N.
    pub force_n: f64,
    /// What the displacement channel reads too much, mm.
    pub displacement_mm: f64,
    /// Delay of the force behind the displacement, s.
    pub delay_s: f64,
}

/// One kind of offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OffsetKind {
    Force,
    Displacement,
    Delay,
}

use OffsetKind::{Delay, Displacement, Force};

/// Kinds that are tried, the fewest first.
const SETS: [&[OffsetKind]; 7] = [
    &[Force],
    &[Displacement],
    &[Delay],
    &[Force, Displacement],
    &[Force, Delay],
    &[Displacement, Delay],
    &[Force, Displacement, Delay],
];

impl FileOffsets {
    fn add(&mut self, kind: OffsetKind, by: f64) {
        match kind {
            Force => self.force_n += by,
            Displacement => self.displacement_mm += by,
            Delay => self.delay_s += by,
        }
    }

    fn of(&self, kind: OffsetKind) -> f64 {
        match kind {
            Force => self.force_n,
            Displacement => self.displacement_mm,
            Delay => self.delay_s,
        }
    }
}

/// Index of a recording, and the kind of offset that it has.
type OwnOffset = (usize, OffsetKind);

/// A fit of the baseline with offsets.
pub(super) struct OffsetFit {
    /// The offsets that were fitted; the others are zero.
    own: Vec<OwnOffset>,
    /// One for each recording.
    pub offsets: Vec<FileOffsets>,
    cost: f64,
}

impl OffsetFit {
    fn has(&self, kind: OffsetKind) -> bool {
        self.own.iter().any(|own| own.1 == kind)
    }
}

/// Some kinds of offsets in all recordings.
fn in_all(files: usize, kinds: &[OffsetKind]) -> Vec<OwnOffset> {
    (0..files)
        .flat_map(|file| kinds.iter().map(move |&kind| (file, kind)))
        .collect()
}

/// Offsets of the recordings, if they explain what the baseline leaves.
pub(super) fn find(structure: &ModelStructure<'_>, node: &Node) -> Option<OffsetFit> {
    let data = structure.data;
    let files = data.tracks.len();
    let counted = data.counted() as f64;
    let rough = data.sum(&node.residuals, Split::Fit) + data.sum(&node.residuals, Split::Select);
    if files < 2 || structure.setup.model.slow || rough < LEAST_POWER * counted {
        return None;
    }
    let (node, _) = converge(structure, node.values.clone())?;
    let (node, cost) = (&node, node.cost());
    let explains = |fit: &OffsetFit| {
        fit.cost < MOST_POWER_LEFT * counted
            && cost - fit.cost > LEAST_EXPLAINED * (cost - counted)
            && 0.5 * (cost - fit.cost) > GAIN_OF_ALL + GAIN_OF_EACH * fit.own.len() as f64
    };
    // The fewest kinds that explain it; of as many, the better.
    let mut best = (1..=SETS[SETS.len() - 1].len()).find_map(|kinds| {
        let sets = SETS.iter().filter(|set| set.len() == kinds);
        sets.filter_map(|set| fitted_in_all(structure, node, set))
            .filter(explains)
            .filter_map(|fit| sparse(structure, node, &fit))
            .filter(explains)
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
    })?;
    if best.has(Delay) && !delays_differ(structure, node, &best) {
        best.offsets.iter_mut().for_each(|offset| offset.delay_s = 0.0);
        best.own.retain(|own| own.1 != Delay);
    }
    let any = best
        .offsets
        .iter()
        .any(|offset| *offset != FileOffsets::default());
    any.then_some(best)
}

/// Zero of the displacement in mm that all recordings share, if it alone explains nearly all that the baseline leaves: a spring that
/// carries a load at its lowest point cannot have a line of force over displacement that begins below zero.
pub(super) fn common_zero_mm(run: &RunSettings, setup: &Setup, data: &Data, node: &Node) -> Option<f64> {
    let zero_mm = crossing_mm(data)?;
    let counted = data.counted() as f64;
    let (here, _) = run.context(setup, data).converged(node)?;
    if setup.model.slow || here.cost() < LEAST_POWER * counted {
        return None;
    }
    let offset = FileOffsets {
        displacement_mm: zero_mm,
        ..FileOffsets::default()
    };
    let data = shifted(data, &vec![offset; data.tracks.len()]);
    let context = run.context(setup, &data);
    let (there, _) = context.converged(node)?;
    let cost =
        with_general_law(&context, &there).map_or(there.cost(), |general| general.cost().min(there.cost()));
    let explains = cost < MOST_POWER_LEFT * counted
        && here.cost() - cost > LEAST_EXPLAINED * (here.cost() - counted)
        && 0.5 * (here.cost() - cost) > GAIN_OF_ALL;
    explains.then_some(zero_mm)
}

/// Displacement in mm at which the straight line through all points has no force, if the line has a negative force at zero and all
/// points lie above.
fn crossing_mm(data: &Data) -> Option<f64> {
    let x: Vec<f64> = data
        .tracks
        .iter()
        .flat_map(|t| t.displacement_mm.clone())
        .collect();
    let used: Vec<usize> = (0..data.len()).filter(|&i| data.weight[i] > 0.0).collect();
    let mean = |of: &[f64]| used.iter().map(|&i| of[i]).sum::<f64>() / used.len().max(1) as f64;
    let (mean_mm, mean_n) = (mean(&x), mean(&data.force_n));
    let along: f64 = used
        .iter()
        .map(|&i| (x[i] - mean_mm) * (data.force_n[i] - mean_n))
        .sum();
    let power: f64 = used.iter().map(|&i| (x[i] - mean_mm).powi(2)).sum();
    let crossing_mm = mean_mm - mean_n * power / along;
    // Below it the pusher would have been off the spring: that is lift-off, which is physics.
    let lowest_mm = used.iter().map(|&i| x[i]).fold(f64::INFINITY, f64::min);
    (along > 0.0 && crossing_mm > 0.0 && lowest_mm > crossing_mm).then_some(crossing_mm)
}

/// The note on a zero that all recordings share.
pub(super) fn common_zero_note(name: &str, zero_mm: f64) -> Note {
    let text = format!(
        "at {zero_mm:.2} mm of the displacement the force is zero: taken as the place where the spring is touched; set the zero of \
         the LVDT there"
    );
    Note::new(name, NoteKind::Zero, (zero_mm, "mm"), NoteAction::Corrected, text)
}

/// True if a general friction law or a single effect explains about what the offsets explain.
pub(super) fn physics_suffices(context: &FitContext<'_>, node: &Node, found: &OffsetFit) -> bool {
    let Some(parent) = context.converged(node) else {
        return false;
    };
    let node = parent.0.clone();
    let needed = PHYSICS_SHARE * (node.cost() - found.cost);
    let explains = |other: &Node| node.cost() - other.cost() >= needed;
    with_general_law(context, &node).is_some_and(|general| explains(&general))
        || context.children(&[parent], &[], usize::MAX).iter().any(explains)
}

/// Offsets that are left after a correction: the shift in time is exact only in the recordings themselves.
pub(super) fn refine(structure: &ModelStructure<'_>, node: &Node, found: &mut OffsetFit) {
    if let Some(left) = fitted(structure, node, &found.own, Start::Given) {
        for (offset, left) in found.offsets.iter_mut().zip(&left.offsets) {
            offset.add(Force, left.force_n);
            offset.add(Displacement, left.displacement_mm);
            offset.add(Delay, left.delay_s);
        }
    }
}

/// False if one delay for all recordings does as well: that one is left to the candidates.
fn delays_differ(structure: &ModelStructure<'_>, node: &Node, fit: &OffsetFit) -> bool {
    let files = fit.offsets.len() as f64;
    let delay_s = fit.offsets.iter().map(|o| o.delay_s).sum::<f64>() / files;
    let common: Vec<FileOffsets> = fit
        .offsets
        .iter()
        .map(|o| FileOffsets { delay_s, ..*o })
        .collect();
    let data = shifted(structure.data, &common);
    let here = ModelStructure::new(structure.setup, &data, node.attached.clone());
    let same = converge(&here, node.values.clone());
    same.is_none_or(|(same, _)| 0.5 * (same.cost() - fit.cost) > GAIN_OF_ALL + GAIN_OF_EACH * files)
}

/// How a fit of offsets begins and how it treats what all recordings share.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Start {
    /// All recordings may have each kind. Ends after a first step that is predicted to explain too little.
    InAll,
    /// The recordings that have an offset are known.
    Given,
}

/// Fits the baseline with some kinds of offsets in all recordings; `None` if the first step is predicted to explain too little.
fn fitted_in_all(structure: &ModelStructure<'_>, node: &Node, kinds: &[OffsetKind]) -> Option<OffsetFit> {
    // A zero that all recordings share is no offset: the first recording is the reference until the offsets are centred.
    let mut own = in_all(structure.data.tracks.len(), kinds);
    own.retain(|&(file, kind)| file > 0 || kind == Delay);
    fitted(structure, node, &own, Start::InAll)
}

/// Fits the baseline with offsets of some recordings.
fn fitted(structure: &ModelStructure<'_>, node: &Node, own: &[OwnOffset], start: Start) -> Option<OffsetFit> {
    let counted = structure.data.count(Split::Fit) as f64;
    let mut offsets = vec![FileOffsets::default(); structure.data.tracks.len()];
    let mut values = node.values.clone();
    for round in 0..ROUNDS {
        let line = slopes_beside(structure, &offsets, values, own)?;
        let right = line.columns.tr_mul(&line.residuals);
        let step = line.normal().cholesky()?.solve(&right);
        let explained = right.dot(&step);
        if round == 0 && start == Start::InAll && explained < LEAST_PREDICTED * (line.fit.fit - counted) {
            return None;
        }
        for (&(file, kind), by) in own.iter().zip(&step) {
            offsets[file].add(kind, by * prior(&structure.data.tracks[file], kind));
        }
        if start == Start::InAll {
            centre(&mut offsets, own);
        }
        values = line.fit.values;
        if step.amax() < CONVERGED {
            break;
        }
    }
    let data = shifted(structure.data, &offsets);
    let here = ModelStructure::new(structure.setup, &data, node.attached.clone());
    let (fit, _) = converge(&here, values)?;
    Some(OffsetFit {
        own: own.to_vec(),
        offsets,
        cost: fit.cost(),
    })
}

/// The baseline fitted beside some offsets, with the changes by further ones that it cannot follow.
struct OffsetSlopes {
    fit: Node,
    residuals: DVector<f64>,
    /// One for each further offset, in units of its prior.
    columns: DMatrix<f64>,
}

impl OffsetSlopes {
    /// Normal matrix of the offsets, with their prior.
    fn normal(&self) -> DMatrix<f64> {
        let mut normal = self.columns.tr_mul(&self.columns);
        for k in 0..normal.nrows() {
            normal[(k, k)] += 1.0;
        }
        normal
    }
}

fn slopes_beside(
    structure: &ModelStructure<'_>,
    offsets: &[FileOffsets],
    values: Vec<f64>,
    own: &[OwnOffset],
) -> Option<OffsetSlopes> {
    let data = shifted(structure.data, offsets);
    let here = ModelStructure::new(structure.setup, &data, structure.attached.clone());
    let (fit, tangent) = converge(&here, values)?;
    let residuals = here.fitted(&fit.values)?;
    let mut columns = columns(&here, &fit.values, own)?;
    for mut column in columns.column_iter_mut() {
        let projected = tangent.project(&column.clone_owned());
        column.copy_from(&projected);
    }
    Some(OffsetSlopes {
        fit,
        residuals,
        columns,
    })
}

/// The fit without the offsets that bring too little (backward elimination), and with a zero on one channel of a recording at most;
/// `None` if none is left.
fn sparse(structure: &ModelStructure<'_>, node: &Node, dense: &OffsetFit) -> Option<OffsetFit> {
    let kinds: Vec<OffsetKind> = [Force, Displacement, Delay]
        .into_iter()
        .filter(|&kind| dense.has(kind))
        .collect();
    let all = in_all(dense.offsets.len(), &kinds);
    let line = slopes_beside(structure, &dense.offsets, node.values.clone(), &all)?;
    let covariance = line.normal().cholesky()?.inverse();
    let sizes: Vec<f64> = all
        .iter()
        .map(|&(file, kind)| dense.offsets[file].of(kind) / prior(&structure.data.tracks[file], kind))
        .collect();
    let out = left_out(&all, &sizes, &covariance);
    let own: Vec<OwnOffset> = (0..all.len())
        .filter(|k| !out.contains(k))
        .map(|k| all[k])
        .collect();
    (!own.is_empty()).then(|| fitted(structure, node, &own, Start::Given))?
}

/// Indices of the offsets that bring too little, and of one zero of each recording that has two. `sizes` in units of the priors;
/// `covariance` is theirs.
fn left_out(all: &[OwnOffset], sizes: &[f64], covariance: &DMatrix<f64>) -> Vec<usize> {
    let mut out: Vec<usize> = Vec::new();
    let mut lost = 0.0;
    loop {
        let left: Vec<usize> = (0..all.len()).filter(|k| !out.contains(k)).collect();
        // The rise of the sum of squares without these and one more.
        let rise = |&next: &usize| {
            let without: Vec<usize> = out.iter().copied().chain([next]).collect();
            let size = DVector::from_iterator(without.len(), without.iter().map(|&k| sizes[k]));
            let block = covariance.select_rows(&without).select_columns(&without);
            Some((size.dot(&block.cholesky()?.solve(&size)), next))
        };
        let least = |of: &[usize]| of.iter().filter_map(rise).min_by(|a, b| a.0.total_cmp(&b.0));
        let has = |file: usize, kind: OffsetKind| left.iter().any(|&k| all[k] == (file, kind));
        let of_two = |&&k: &&usize| all[k].1 != Delay && has(all[k].0, Force) && has(all[k].0, Displacement);
        let two_zeros: Vec<usize> = left.iter().filter(of_two).copied().collect();
        let brings_little = |(with, _): &(f64, usize)| 0.5 * (with - lost) < GAIN_OF_EACH;
        let Some((with, next)) = least(&left).filter(brings_little).or_else(|| least(&two_zeros)) else {
            return out;
        };
        out.push(next);
        lost = with;
    }
}

/// Most recordings have no zero of their own: what all have in common is a parameter of the baseline.
fn centre(offsets: &mut [FileOffsets], own: &[OwnOffset]) {
    let has = |kind: OffsetKind| own.iter().any(|o| o.1 == kind);
    let middle = |f: fn(&FileOffsets) -> f64| median(offsets.iter().map(f).collect());
    let (force_n, displacement_mm) = (middle(|o| o.force_n), middle(|o| o.displacement_mm));
    for offset in offsets {
        if has(Force) {
            offset.force_n -= force_n;
        }
        if has(Displacement) {
            offset.displacement_mm -= displacement_mm;
        }
    }
}

/// Prior standard deviation of an offset, in its unit.
fn prior(track: &Track, kind: OffsetKind) -> f64 {
    match kind {
        Force => PRIOR_SHARE * range(&track.force_n),
        Displacement => PRIOR_SHARE * range(&track.displacement_mm),
        Delay => PRIOR_S,
    }
}

/// Fall of the fitted residuals when an offset moves by its prior: one column for each.
fn columns(structure: &ModelStructure<'_>, values: &[f64], own: &[OwnOffset]) -> Option<DMatrix<f64>> {
    let data = structure.data;
    let mut columns = DMatrix::zeros(structure.count(), own.len());
    let mut from = 0;
    for (file, track) in data.tracks.iter().enumerate() {
        let alone = data.one(file);
        let fitted = |data: &Data| -> Option<DVector<f64>> {
            ModelStructure::new(structure.setup, data, structure.attached.clone()).fitted(values)
        };
        let before = fitted(&alone)?;
        for (k, &(_, kind)) in own.iter().enumerate().filter(|(_, o)| o.0 == file) {
            let mut offset = FileOffsets::default();
            offset.add(kind, STEP * prior(track, kind));
            let after = fitted(&shifted(&alone, &[offset]))?;
            for i in 0..track.len() {
                columns[(from + i, k)] = (before[i] - after[i]) / STEP;
            }
        }
        from += track.len();
    }
    Some(columns)
}

/// The data without the offsets.
fn shifted(data: &Data, offsets: &[FileOffsets]) -> Data {
    let mut data = data.clone();
    let mut from = 0;
    for (track, offset) in data.tracks.iter_mut().zip(offsets) {
        let n = track.len();
        let at =
            |values: &[f64], i: usize| interpolated(&track.time_s, values, track.time_s[i] - offset.delay_s);
        if offset.delay_s != 0.0 {
            let x: Vec<f64> = (0..n).map(|i| at(&track.displacement_mm, i)).collect();
            let column =
                |f: fn(&crate::model::Motion) -> f64| track.motion.iter().map(f).collect::<Vec<f64>>();
            let (speeds, accelerations) = (column(|m| m.velocity_mm_s), column(|m| m.acceleration_mm_s2));
            let moved: Vec<[f64; 2]> = (0..n).map(|i| [at(&speeds, i), at(&accelerations, i)]).collect();
            for (motion, [speed, acceleration]) in track.motion.iter_mut().zip(moved) {
                (motion.velocity_mm_s, motion.acceleration_mm_s2) = (speed, acceleration);
            }
            track.displacement_mm = x;
        }
        for i in 0..n {
            track.displacement_mm[i] -= offset.displacement_mm;
            track.force_n[i] -= offset.force_n;
            data.force_n[from + i] -= offset.force_n;
            for reach_mm in &mut track.motion[i].reach_mm {
                *reach_mm -= offset.displacement_mm;
            }
        }
        from += n;
    }
    data
}

/// Linear interpolation in a column over rising times; the ends are constant.
fn interpolated(time_s: &[f64], values: &[f64], at_s: f64) -> f64 {
    let after = time_s.partition_point(|t| *t < at_s);
    if after == 0 || after == time_s.len() {
        return values[after.min(time_s.len() - 1)];
    }
    let share = (at_s - time_s[after - 1]) / (time_s[after] - time_s[after - 1]);
    values[after - 1] + share * (values[after] - values[after - 1])
}

/// The recordings without a zero of the displacement that they share.
pub(super) fn without_zero(recordings: &[Recording], zero_mm: f64) -> Vec<Recording> {
    let offset = FileOffsets {
        displacement_mm: zero_mm,
        ..FileOffsets::default()
    };
    corrected(recordings, &vec![offset; recordings.len()])
}

/// The recordings without their offsets. A sample whose force lies beyond the recording by the delay is left out.
pub(super) fn corrected(recordings: &[Recording], offsets: &[FileOffsets]) -> Vec<Recording> {
    let without = |(recording, offset): (&Recording, &FileOffsets)| {
        let time_s = &recording.time_s;
        let ends_s = [time_s[0], time_s[time_s.len() - 1]];
        let there = |i: &usize| (ends_s[0]..=ends_s[1]).contains(&(time_s[*i] + offset.delay_s));
        let kept: Vec<usize> = (0..time_s.len()).filter(there).collect();
        let force_n = |i: usize| interpolated(time_s, &recording.force_n, time_s[i] + offset.delay_s);
        let pick = |values: &[f64]| kept.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        Recording {
            name: recording.name.clone(),
            time_s: pick(time_s),
            displacement_mm: kept
                .iter()
                .map(|&i| recording.displacement_mm[i] - offset.displacement_mm)
                .collect(),
            force_n: kept.iter().map(|&i| force_n(i) - offset.force_n).collect(),
            command: recording.command.as_deref().map(pick),
            command_mode: recording.command_mode,
            cycle: (recording.cycle.as_ref())
                .map(|c| kept.iter().filter_map(|&i| c.get(i).copied()).collect()),
            flags: (recording.flags.as_ref())
                .map(|f| kept.iter().filter_map(|&i| f.get(i).copied()).collect()),
        }
    };
    recordings.iter().zip(offsets).map(without).collect()
}

/// Notes on the offsets of one recording that were taken out.
pub(super) fn notes(name: &str, offset: &FileOffsets) -> Vec<Note> {
    let sizes = [
        (
            offset.force_n,
            "N",
            NoteKind::Zero,
            "the zero of the force",
            "tare before every test",
        ),
        (
            offset.displacement_mm,
            "mm",
            NoteKind::Zero,
            "the zero of the displacement",
            "do not move the LVDT between tests, or set its zero again",
        ),
        (
            1e3 * offset.delay_s,
            "ms",
            NoteKind::Skew,
            "the delay of the force behind the displacement",
            "sample both channels with one clock; viscous damping cannot be told from such a delay",
        ),
    ];
    // What would be printed as zero is none.
    let different = sizes.into_iter().filter(|(size, ..)| size.abs() >= 5e-4);
    different
        .map(|(size, unit, kind, what, advice)| {
            let text = format!(
                "{what} differs from that of the other recordings by {size:+.3} {unit} and was taken out: {advice}"
            );
            Note::new(name, kind, (size, unit), NoteAction::Corrected, text)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What stays of three recordings with zeros on both channels and a delay each. Their sizes are in units of the priors, their
    /// uncertainty is 0.01, and the two zeros of a recording go together.
    fn kept(sizes: [[f64; 3]; 3]) -> Vec<OwnOffset> {
        let all = in_all(3, &[Force, Displacement, Delay]);
        let sizes = sizes.concat();
        let mut covariance = DMatrix::from_diagonal_element(9, 9, 1e-4);
        for file in 0..3 {
            let (force, displacement) = (3 * file, 3 * file + 1);
            covariance[(force, displacement)] = 0.9e-4;
            covariance[(displacement, force)] = 0.9e-4;
        }
        let out = left_out(&all, &sizes, &covariance);
        (0..9).filter(|k| !out.contains(k)).map(|k| all[k]).collect()
    }

    #[test]
    fn an_offset_that_brings_too_little_is_left_out() {
        let found = kept([[0.5, 0.0, 0.0], [0.01, 0.0, 0.02], [0.0, 0.005, 0.3]]);
        assert_eq!(found, [(0, Force), (2, Delay)]);
    }

    #[test]
    fn a_recording_has_a_zero_on_one_channel_at_most() {
        let found = kept([[0.5, 0.4, 0.0], [0.0, 0.0, 0.0], [-0.2, 0.6, 0.2]]);
        assert_eq!(found, [(0, Force), (2, Displacement), (2, Delay)]);
    }
}
