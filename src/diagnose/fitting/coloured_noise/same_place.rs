//! When two points of a recording are at the same place of the same motion.

use crate::diagnose::conditioning::{Track, median, range};

/// Two points are at the same place if their speeds differ by at most this share of the top speed, and the travel since the reversal and
/// the four reversals before by at most this share of the travel of half a cycle. Otherwise missing physics would differ between them. A
/// random motion has few such points; with the last reversal alone, friction with a memory was noise of 28 N. Other values were not tried.
const SAME_SPEED: f64 = 0.1;
const SAME_TRAVEL: f64 = 0.05;
const SAME_TURNS: usize = 4;

/// Says of two points at one displacement whether the speed, the travel since the reversal and the reversals before are the same, too.
pub(super) fn is_same_place(track: &Track) -> impl Fn(usize, usize) -> bool {
    let speed_mm_s = |i: usize| track.motion[i].velocity_mm_s.abs();
    let most_mm_s = SAME_SPEED * track.top_speed_mm_s();
    let most_mm = SAME_TRAVEL * half_cycle_mm(track);
    let turns_mm = turns_before(track);
    move |i, there| {
        // A reversal that one of the two does not have is not compared.
        let other_turn = |(a, b): (&f64, &f64)| (a - b).abs() > most_mm;
        (speed_mm_s(i) - speed_mm_s(there)).abs() <= most_mm_s
            && (track.since_reversal_mm[i] - track.since_reversal_mm[there]).abs() <= most_mm
            && !turns_mm[i].iter().zip(&turns_mm[there]).any(other_turn)
    }
}

/// Median travel in mm between two reversals; the whole travel where there are not two.
fn half_cycle_mm(track: &Track) -> f64 {
    let turns_mm: Vec<f64> = track.turns().map(|i| track.displacement_mm[i - 1]).collect();
    if turns_mm.len() < 2 {
        return range(&track.displacement_mm);
    }
    median(
        turns_mm
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).abs())
            .collect(),
    )
}

/// Displacement in mm of the last reversals before each point, the last one first; not a number before the first reversals.
fn turns_before(track: &Track) -> Vec<[f64; SAME_TURNS]> {
    let mut turns = track.turns().peekable();
    let mut last_mm = [f64::NAN; SAME_TURNS];
    (0..track.len())
        .map(|i| {
            if turns.next_if_eq(&i).is_some() {
                last_mm.rotate_right(1);
                last_mm[0] = track.displacement_mm[i - 1];
            }
            last_mm
        })
        .collect()
}
