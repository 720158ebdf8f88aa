//! Splits the points of all tracks into what is fitted, what sets are compared on, and what errors are reported on.

use super::track::Track;
use crate::diagnose::course::Split;

/// Fewest cycles of a recording, and fewest recordings, that can be split.
const LEAST: usize = 3;
/// If the travels of the cycles differ by this factor, the cycles are dealt from the largest travel down: small loops are fitted too,
/// and no loop is predicted that is larger than all that were fitted.
const UNEQUAL: f64 = 1.3;
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
    let mut dealt = counted.clone();
    let travels_mm: Vec<f64> = counted.iter().map(|&c| travel_mm(track, c)).collect();
    // The first and the last of many cycles may be cut off.
    let whole = match travels_mm.len() {
        LEAST => &travels_mm[..],
        count => &travels_mm[1..count - 1],
    };
    let [least, most] = whole
        .iter()
        .fold([f64::INFINITY, 0.0f64], |[l, m], t| [l.min(*t), m.max(*t)]);
    if most > UNEQUAL * least {
        let travel = |c: &u32| travels_mm[counted.binary_search(c).unwrap_or(0)];
        dealt.sort_by(|a, b| travel(b).total_cmp(&travel(a)));
    }
    let mut split_of = vec![Split::Fit; counted.len()];
    for (place, cycle) in dealt.iter().enumerate() {
        split_of[counted.binary_search(cycle).unwrap_or(0)] = order[place % order.len()];
    }
    for (split, cycle) in track.split.iter_mut().zip(&track.cycle) {
        *split = split_of[counted.binary_search(cycle).unwrap_or(0)];
    }
    true
}

/// Difference of the largest and the smallest displacement of a cycle, mm.
fn travel_mm(track: &Track, cycle: u32) -> f64 {
    let points = track
        .cycle
        .iter()
        .zip(&track.displacement_mm)
        .filter(|(c, _)| **c == cycle);
    let [low, high] = points.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], (_, x)| {
        [l.min(*x), h.max(*x)]
    });
    high - low
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

#[cfg(test)]
mod tests {
    use super::super::condition::condition;
    use super::*;
    use crate::recording::Recording;

    /// Ten cycles of 1 s between 1 mm and 1 mm plus their amplitudes.
    fn track(amplitude_mm: impl Fn(usize) -> f64) -> Track {
        let time_s: Vec<f64> = (0..10_000).map(|i| 1e-3 * f64::from(i)).collect();
        let displacement_mm: Vec<f64> = time_s
            .iter()
            .map(|t| 1.0 + 0.5 * amplitude_mm(*t as usize) * (1.0 - (std::f64::consts::TAU * t).cos()))
            .collect();
        let recording = Recording {
            force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
            time_s,
            displacement_mm,
            ..Recording::default()
        };
        condition(&[recording], 2000).expect("conditioned").remove(0)
    }

    fn split_of(track: &Track, cycle: u32) -> Split {
        let at = track.cycle.iter().position(|c| *c == cycle).expect("a cycle");
        track.split[at]
    }

    /// Small loops in the second and the fourth of each four cycles were never fitted.
    #[test]
    fn small_loops_are_fitted_too() {
        let mut tracks = [track(|cycle| if cycle % 2 == 1 { 2.0 } else { 10.0 })];
        assign_splits(&mut tracks);
        for cycles in [[2, 4, 6, 8], [3, 5, 7, 9]] {
            let fitted = cycles
                .iter()
                .filter(|&&c| split_of(&tracks[0], c) == Split::Fit)
                .count();
            assert!((1..4).contains(&fitted), "{cycles:?}: {fitted} of 4 fitted");
        }
    }

    /// The largest of the loops was predicted from the smaller ones, which do not reach its forces.
    #[test]
    fn the_largest_loop_is_fitted() {
        let mut tracks = [track(|cycle| 2.0 + cycle as f64)];
        assign_splits(&mut tracks);
        let fitted_mm = |wanted: Split| {
            let of_split =
                (1..=11).filter(|&c| tracks[0].cycle.contains(&c) && split_of(&tracks[0], c) == wanted);
            of_split.map(|c| travel_mm(&tracks[0], c)).fold(0.0, f64::max)
        };
        assert!(fitted_mm(Split::Fit) > fitted_mm(Split::Select).max(fitted_mm(Split::Report)));
    }

    #[test]
    fn equal_cycles_take_turns() {
        let mut tracks = [track(|_| 10.0)];
        assign_splits(&mut tracks);
        let counted = |c: &u32| {
            let points = tracks[0].cycle.iter().zip(&tracks[0].weight);
            points
                .filter(|(cycle, weight)| *cycle == c && **weight > 0.0)
                .count()
                > 0
        };
        let splits: Vec<Split> = (1..=11)
            .filter(counted)
            .map(|c| split_of(&tracks[0], c))
            .collect();
        assert_eq!(
            splits[..4],
            [Split::Fit, Split::Select, Split::Fit, Split::Report]
        );
    }
}
