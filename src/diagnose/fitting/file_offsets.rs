//! What differs between recordings of one specimen and is no physics: a zero of the force, a zero of the displacement, a delay
//! between the channels, each its own in every recording. Another tare, an LVDT that was moved, clocks that started at other times.
//!
//! They are taken as real if they explain nearly all that the baseline leaves above the noise, and no more kinds of them are used than that
//! needs. Each offset that brings too little is left out. If no offsets explain so much, zeros that bring the mean curves of the recordings
//! together are taken as real. A recording has a zero of its own on one channel at most: a zero of the force and one of the displacement
//! together can move it along the line of the spring, where little changes, and then take up the error of the model. Instruments are the
//! cheaper explanation and the cheaper check, so they win against physics. A delay that is the same in all recordings is left to the
//! candidates.
//!
//! | file | what it does |
//! |---|---|
//! | `found_by` | looks for offsets: beside friction laws, then in the mean curves |
//! | `mean_curves` | the curve of the spring as each recording shows it, without a model |
//! | `offsets` | the offsets of a recording, and their kinds |
//! | `offset_fit` | fits the baseline with offsets, and leaves out those that bring too little |
//! | `shift` | takes offsets out of data and recordings |

mod found_by;
mod mean_curves;
mod offset_fit;
mod offsets;
mod shift;

pub(super) use found_by::{FoundBy, mean_curves_disagree, offsets_of_recordings, seen_in_mean_curves};
pub(super) use shift::{corrected, without_zero};

pub(super) use offset_fit::OffsetFit;
use offset_fit::{GAIN_OF_EACH, OffsetsOf, fitted, fitted_in_all, sparse};
use offsets::OffsetKind::{Delay, Displacement, Force};
use offsets::{FileOffsets, OffsetKind};
use shift::shifted;

use super::baseline::Setup;
use super::context::{FitContext, RunSettings};
use super::data::Data;
use super::fit::converge;
use super::general_law::with_general_law;
use super::node::Node;
use super::structure::ModelStructure;
use crate::diagnose::course::Split;
use crate::diagnose::note::{Note, NoteAction, NoteKind};
use crate::recording::Recording;

/// Mean square of the baseline's residuals, in units of the noise, from which offsets are looked for, and which they may leave.
const LEAST_POWER: f64 = 1.3;
const MOST_POWER_LEFT: f64 = 2.0;
/// Share of the sum of squares above the noise that they must explain.
const LEAST_EXPLAINED: f64 = 0.85;
/// Physics that explains this share of what the offsets explain has their place: it needs a few parameters, they need some for
/// each recording.
const PHYSICS_SHARE: f64 = 0.8;
/// Log-likelihood that all offsets together must gain, beside what each must.
const GAIN_OF_ALL: f64 = 15.0;
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

/// True for a fit that leaves too little to look for offsets.
fn fits(data: &Data, node: &Node) -> bool {
    let rough = data.sum(&node.residuals, Split::Fit) + data.sum(&node.residuals, Split::Select);
    rough < LEAST_POWER * data.counted() as f64
}

/// Offsets of the recordings, if they explain what the baseline leaves.
fn find(structure: &ModelStructure<'_>, node: &Node) -> Option<OffsetFit> {
    let data = structure.data;
    let files = data.tracks.len();
    let counted = data.counted() as f64;
    if files < 2 || structure.setup.model.slow || fits(data, node) {
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
    let x = displacement_mm(data);
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

/// The displacement of all points in mm.
fn displacement_mm(data: &Data) -> Vec<f64> {
    let tracks = data.tracks.iter();
    tracks.flat_map(|t| t.displacement_mm.clone()).collect()
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
fn physics_suffices(context: &FitContext<'_>, node: &Node, found: &OffsetFit) -> bool {
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
fn refine(structure: &ModelStructure<'_>, node: &Node, found: &mut OffsetFit) {
    if let Some(left) = fitted(structure, node, &found.own, OffsetsOf::Known) {
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

/// Adds the notes on the offsets that were taken out of these recordings.
pub(super) fn add_notes(data: &mut Data, recordings: &[Recording], found: &OffsetFit) {
    for (recording, offset) in recordings.iter().zip(&found.offsets) {
        data.add_notes(notes(&recording.name, offset));
    }
}

/// Notes on the offsets of one recording that were taken out.
fn notes(name: &str, offset: &FileOffsets) -> Vec<Note> {
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
            "do not move the LVDT between tests, or set its zero again; if nothing was moved, the spring has taken a set",
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
