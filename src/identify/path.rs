//! The recorded displacement as a path: turning points, smoothing, and how a plant is brought to its beginning.

/// Indices of turning points that the signal leaves by more than `band`.
pub(crate) fn reversals(signal: &[f64], band: f64) -> Vec<usize> {
    let mut found = Vec::new();
    let (mut high, mut low) = (0, 0);
    let mut direction = 0.0;
    for (i, &x) in signal.iter().enumerate() {
        if x > signal[high] {
            high = i;
        }
        if x < signal[low] {
            low = i;
        }
        if direction >= 0.0 && signal[high] - x > band {
            if direction > 0.0 {
                found.push(high);
            }
            (direction, low) = (-1.0, i);
        } else if direction <= 0.0 && x - signal[low] > band {
            if direction < 0.0 {
                found.push(low);
            }
            (direction, high) = (1.0, i);
        }
    }
    found
}

/// Displacements from rest at zero to the state before the first sample; with `replay` the first cycle is run through once.
pub(crate) fn approach(displacement_mm: &[f64], reversals: &[usize], replay: bool) -> Vec<f64> {
    let first = displacement_mm[0];
    let mut path = straight(0.0, first);
    let Some(&turn) = reversals.first() else {
        return path;
    };
    if !replay {
        return path;
    }
    // One cycle: until the first displacement is passed again in the first direction, or all there is and straight back.
    let direction = (displacement_mm[turn] - first).signum();
    let after = reversals.get(1).copied().unwrap_or(displacement_mm.len() - 1);
    let closes = |&i: &usize| direction * (displacement_mm[i] - first) >= 0.0;
    let end = (after..displacement_mm.len())
        .find(closes)
        .unwrap_or(displacement_mm.len() - 1);
    path.extend_from_slice(&displacement_mm[..end]);
    path.extend(straight(displacement_mm[end.saturating_sub(1)], first));
    path
}

/// Points from `from` (left out) to `to` at most 0.2 mm apart, 200 at most.
fn straight(from: f64, to: f64) -> Vec<f64> {
    let steps = ((to - from).abs() / 0.2).ceil().clamp(1.0, 200.0);
    (1..=steps as usize)
        .map(|i| from + (to - from) * i as f64 / steps)
        .collect()
}

/// Zero-phase smoothing by a least-squares parabola over `half` samples to either side (Savitzky and Golay 1964); fewer
/// towards the ends, whose last samples stay as they are.
pub(crate) fn smoothed(signal: &[f64], half: usize) -> Vec<f64> {
    let weights = |m: f64, k: f64| {
        3.0 * (3.0 * m * m + 3.0 * m - 1.0 - 5.0 * k * k)
            / ((2.0 * m + 3.0) * (2.0 * m + 1.0) * (2.0 * m - 1.0))
    };
    (0..signal.len())
        .map(|i| {
            let m = half.min(i).min(signal.len() - 1 - i);
            if m < 2 {
                return signal[i];
            }
            (0..=2 * m)
                .map(|j| weights(m as f64, j as f64 - m as f64) * signal[i + j - m])
                .sum()
        })
        .collect()
}

/// Largest less smallest.
pub(crate) fn range(signal: &[f64]) -> f64 {
    let low = signal.iter().copied().fold(f64::INFINITY, f64::min);
    let high = signal.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    high - low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_points_with_a_band() {
        let signal = [0.0, 2.0, 1.9, 3.0, 1.0, 1.1, 0.0, 4.0];
        assert_eq!(reversals(&signal, 0.5), vec![3, 6]);
        assert_eq!(reversals(&signal, 0.05), vec![1, 2, 3, 4, 5, 6]);
        assert_eq!(reversals(&[1.0; 5], 0.0), Vec::<usize>::new());
    }

    #[test]
    fn smoothing_keeps_parabolas_and_quiets_noise() {
        let parabola: Vec<f64> = (0..50).map(|i| 0.1 * f64::from(i * i) - f64::from(i)).collect();
        let same = smoothed(&parabola, 6);
        assert!(parabola.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-9));
        let zigzag: Vec<f64> = (0..50).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert!(smoothed(&zigzag, 6)[20..30].iter().all(|x| x.abs() < 0.25));
    }
}
