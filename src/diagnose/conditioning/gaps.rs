//! Gaps in time: intervals without samples that are long enough to hide motion. It uses no recordings and no models: input and
//! output are columns of numbers.

use super::smoothing::median;

/// An interval is a gap if it is this many times longer than the intervals on both sides: a change of the sampling rate is none.
const LEAST_RATIO: f64 = 10.0;
/// Number of intervals on either side whose median is the measure.
const AROUND: usize = 10;
/// Share of the stroke that the specimen could travel in a gap at its usual speed, below which the gap hides nothing.
const HARMLESS: f64 = 0.02;
/// The usual speed is exceeded in this share of the time.
const SLOWER: f64 = 0.95;

/// Indices of the last sample before each gap.
pub(super) fn gaps(time_s: &[f64], displacement_mm: &[f64], stroke_mm: f64) -> Vec<usize> {
    let intervals_s: Vec<f64> = time_s.windows(2).map(|w| w[1] - w[0]).collect();
    let typical = |range: &[f64]| (!range.is_empty()).then(|| median(range.to_vec()));
    let long: Vec<usize> = (0..intervals_s.len())
        .filter(|&i| {
            let before = typical(&intervals_s[i.saturating_sub(AROUND)..i]);
            let after = typical(&intervals_s[i + 1..(i + 1 + AROUND).min(intervals_s.len())]);
            let usual_s = before.into_iter().chain(after).fold(0.0, f64::max);
            usual_s > 0.0 && intervals_s[i] > LEAST_RATIO * usual_s
        })
        .collect();
    if long.is_empty() {
        return long;
    }
    let speed_mm_s = usual_speed(time_s, displacement_mm);
    let hides = |i: &usize| intervals_s[*i] * speed_mm_s > HARMLESS * stroke_mm;
    long.into_iter().filter(hides).collect()
}

/// Speed in mm/s that is exceeded seldom, from differences over several samples: those of neighbours are noise.
fn usual_speed(time_s: &[f64], x: &[f64]) -> f64 {
    let wide = (x.len() / 50).clamp(1, AROUND);
    let mut speeds: Vec<f64> = (wide..x.len())
        .map(|i| (x[i] - x[i - wide]).abs() / (time_s[i] - time_s[i - wide]))
        .collect();
    if speeds.is_empty() {
        return 0.0;
    }
    let place = ((speeds.len() - 1) as f64 * SLOWER) as usize;
    *speeds.select_nth_unstable_by(place, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(time_s: &[f64]) -> Vec<f64> {
        time_s
            .iter()
            .map(|t| 5.0 * (std::f64::consts::TAU * t).sin())
            .collect()
    }

    #[test]
    fn a_pause_is_a_gap_and_a_change_of_rate_is_none() {
        let mut time_s: Vec<f64> = (0..1000).map(|i| 0.01 * f64::from(i)).collect();
        for t in &mut time_s[400..] {
            *t += 0.7;
        }
        assert_eq!(gaps(&time_s, &sine(&time_s), 10.0), [399]);
        // 1000 samples per second, then 20.
        let change: Vec<f64> = (0..1000)
            .map(|i: i32| 0.001 * f64::from(i.min(500)) + 0.05 * f64::from((i - 500).max(0)))
            .collect();
        assert_eq!(gaps(&change, &sine(&change), 10.0), [] as [usize; 0]);
    }

    #[test]
    fn missing_samples_that_hide_no_motion_are_no_gap() {
        let time_s: Vec<f64> = (0..12_000)
            .filter(|i| !(6000..6012).contains(i))
            .map(|i| 0.01 * f64::from(i))
            .collect();
        // A ramp of 0.1 mm/s: 12 samples are 12 um.
        let x: Vec<f64> = time_s.iter().map(|t| 0.1 * t).collect();
        assert_eq!(gaps(&time_s, &x, 12.0), [] as [usize; 0]);
    }
}
