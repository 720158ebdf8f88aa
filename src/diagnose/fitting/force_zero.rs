//! Zero of the force channel that is the same in all recordings: a tare that was forgotten or taken under load, and a device that
//! also pulls.
//!
//! The prior of the zero is narrow, because a free zero imitates constant friction where friction grows with the load. It is
//! widened in two cases that friction cannot imitate: the force falls below zero, where a spring under a pusher has none, or a zero
//! above the true one alone explains nearly all that the baseline leaves.

use super::data::Data;
use super::fit::converge;
use super::node::Node;
use super::structure::ModelStructure;
use crate::diagnose::course::Split;
use crate::diagnose::note::{Note, NoteAction, NoteKind};

/// A force this far below zero, as a share of the largest force, is no wrong tare: the device pulls.
const PULLS: f64 = 0.25;
/// A zero beyond this many standard deviations of its prior is wrong.
const WRONG: f64 = 4.0;
/// Prior standard deviation of a zero that is searched, as a share of the force range.
const WIDE: f64 = 0.1;
/// Share above the noise that the zero alone must explain, the mean square that it may leave in units of the noise, and the gain in
/// log-likelihood that it must bring.
const LEAST_EXPLAINED: f64 = 0.85;
const MOST_POWER_LEFT: f64 = 2.0;
const LEAST_GAIN: f64 = 20.0;

/// Widens the prior of the force zero where the recordings show a wrong zero, and notes it. `node` is the fitted baseline.
pub(super) fn check(structure: &ModelStructure<'_>, node: &Node) -> Option<(f64, Vec<Note>)> {
    let data = structure.data;
    let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    let lowest_n = least(&data.force_n);
    let highest_n = data.force_n.iter().copied().fold(0.0, f64::max);
    if lowest_n < -PULLS * highest_n {
        let notes = data
            .tracks
            .iter()
            .filter(|t| least(&t.force_n) < -PULLS * highest_n);
        return Some((
            data.zero_sigma_n,
            notes.map(|t| device(&t.name, least(&t.force_n))).collect(),
        ));
    }
    let noise_n = data.tracks.iter().map(|t| t.noise_n).fold(0.0, f64::max);
    let zero_n = if lowest_n < -WRONG * data.zero_sigma_n.max(noise_n) {
        lowest_n
    } else {
        explaining_zero_n(structure, node)?
    };
    let note = |name: &str| {
        Note::new(
            name,
            NoteKind::Zero,
            (zero_n, "N"),
            NoteAction::Corrected,
            format!(
                "the force channel reads about {zero_n:.1} N at no force: its zero is fitted with the model; tare before the specimen \
                 touches the pusher"
            ),
        )
    };
    Some((zero_n.abs(), data.tracks.iter().map(|t| note(&t.name)).collect()))
}

fn device(name: &str, lowest_n: f64) -> Note {
    Note::new(
        name,
        NoteKind::Device,
        (lowest_n, "N"),
        NoteAction::Told,
        format!(
            "the force falls to {lowest_n:.0} N: the device also pulls, and a spring under a pusher cannot; do not use what follows \
             as a diagnosis of a leaf spring"
        ),
    )
}

/// A zero above the true one that alone explains nearly all that the baseline leaves, N.
fn explaining_zero_n(structure: &ModelStructure<'_>, node: &Node) -> Option<f64> {
    let data = structure.data;
    let counted = data.counted() as f64;
    let cost = data.sum(&node.residuals, Split::Fit) + data.sum(&node.residuals, Split::Select);
    if structure.setup.model.slow || 0.5 * (cost - counted) < LEAST_GAIN {
        return None;
    }
    let (node, _) = converge(structure, node.values.clone())?;
    let cost = node.cost();
    let free = Data {
        zero_sigma_n: WIDE * data.force_range_n,
        ..data.clone()
    };
    let with_free = ModelStructure::new(structure.setup, &free, node.attached.clone());
    let (fit, _) = converge(&with_free, node.values.clone())?;
    let zero_n = *fit.values.last()?;
    let explains = fit.cost() < MOST_POWER_LEFT * counted
        && cost - fit.cost() > LEAST_EXPLAINED * (cost - counted)
        && 0.5 * (cost - fit.cost()) > LEAST_GAIN;
    (explains && zero_n > WRONG * data.zero_sigma_n).then_some(zero_n)
}
