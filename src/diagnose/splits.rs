//! Splits the points of all tracks into what is fitted, what sets are compared on, and what errors are reported on.

use super::condition::Track;

/// What a point is used for. No parameter is ever fitted to `Select` or `Report`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Split {
    /// Parameters are fitted to these points.
    Fit,
    /// Sets of effects are compared on these points.
    Select,
    /// Errors on held-out data are computed on these points.
    Report,
}

/// Fewest cycles of a recording, and fewest recordings, that can be split.
const LEAST: usize = 3;
/// Number of pieces that a track without cycles is cut into; two in four are fitted.
const PIECES: usize = 24;

/// Splits whole cycles: of four, two are fitted, one selects, one reports. Recordings with fewer than three cycles are fitted. If
/// no recording has three cycles, whole recordings are held out; if there are fewer than three, pieces of the travel.
pub(super) fn assign_splits(tracks: &mut [Track]) {
    let mut by_cycle = false;
    for track in tracks.iter_mut() {
        by_cycle |= split_cycles(track);
    }
    if by_cycle {
        return;
    }
    let n = tracks.len();
    if n >= LEAST {
        tracks[n - 1].split.fill(Split::Report);
        tracks[n - 2].split.fill(Split::Select);
    } else {
        tracks.iter_mut().for_each(split_travel);
    }
}

/// Splits a track by its cycles; false if it has too few.
fn split_cycles(track: &mut Track) -> bool {
    let mut counted: Vec<u32> = track
        .cycle
        .iter()
        .zip(&track.weight)
        .filter(|(_, w)| **w > 0.0)
        .map(|(c, _)| *c)
        .collect();
    counted.sort_unstable();
    counted.dedup();
    let order: &[Split] = match counted.len() {
        0..LEAST => return false,
        LEAST => &[Split::Fit, Split::Select, Split::Report],
        _ => &[Split::Fit, Split::Select, Split::Fit, Split::Report],
    };
    for (split, cycle) in track.split.iter_mut().zip(&track.cycle) {
        let place = counted.binary_search(cycle).unwrap_or(0);
        *split = order[place % order.len()];
    }
    true
}

/// Splits a track of one or two ramps: a quarter of the pieces selects, a quarter reports.
fn split_travel(track: &mut Track) {
    let n = track.len();
    for (i, split) in track.split.iter_mut().enumerate() {
        *split = match i * PIECES / n % 4 {
            1 => Split::Select,
            3 => Split::Report,
            _ => Split::Fit,
        };
    }
}
