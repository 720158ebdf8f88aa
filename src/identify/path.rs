//! The recorded displacement as a path: its turning points, and the way of a plant from rest to its first sample.

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

/// Displacements from rest at zero to the state before the first sample; with `replay`, through the first cycle.
pub(crate) fn approach(displacement_mm: &[f64], reversals: &[usize], replay: bool) -> Vec<f64> {
    let first = displacement_mm[0];
    let mut path = straight(0.0, first);
    let Some(&turn) = reversals.first() else {
        return path;
    };
    if !replay {
        return path;
    }
    // One cycle ends where the first displacement is passed again in the first direction. Without such a sample the whole
    // recording is replayed, and a straight line leads back.
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

/// Points from `from` (exclusive) to `to`, at most 0.2 mm apart, 200 at most.
fn straight(from: f64, to: f64) -> Vec<f64> {
    let steps = ((to - from).abs() / 0.2).ceil().clamp(1.0, 200.0);
    (1..=steps as usize)
        .map(|i| from + (to - from) * i as f64 / steps)
        .collect()
}

/// Largest value less the smallest one.
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
}
