//! Sign of the channels: a spring that is loaded pushes back harder, and its loop takes up energy. It uses no recordings and no
//! models: input and output are columns of numbers.

use super::smoothing::range;
use crate::diagnose::error::TurnedSign;

/// Correlation of force and displacement from which they rise or fall together. Friction and relaxation stay far from the negative.
const CLEAR: f64 = 0.5;
/// Share of the force range that a force of the right sign does not fall below zero, if all the rest is above.
const BELOW_ZERO: f64 = 0.05;
/// Negative loop energy as a share of stroke times force range, from which the loop runs backwards. Noise stays below 0.001.
const BACKWARDS: f64 = 0.005;

/// The channels whose sign is turned, if that is certain.
pub(super) fn turned(displacement_mm: &[f64], force_n: &[f64]) -> Option<TurnedSign> {
    let together = correlation(displacement_mm, force_n);
    let (low_n, high_n) = force_n
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), f| {
            (l.min(*f), h.max(*f))
        });
    let all_negative = high_n < BELOW_ZERO * (high_n - low_n) && low_n < 0.0;
    if together < -CLEAR {
        Some(if -low_n > high_n {
            TurnedSign::Force
        } else {
            TurnedSign::Displacement
        })
    } else {
        (together > CLEAR && all_negative).then_some(TurnedSign::Both)
    }
}

/// Energy in J that the loops give, if the loop runs backwards although force and displacement rise together: one channel lags.
pub(super) fn energy_given_j(displacement_mm: &[f64], force_n: &[f64], turns: usize) -> Option<f64> {
    let steps = displacement_mm.windows(2).zip(force_n.windows(2));
    let energy_nmm: f64 = steps.map(|(x, f)| 0.5 * (f[0] + f[1]) * (x[1] - x[0])).sum();
    // What a recording that ends elsewhere stores is no loss: only whole cycles, with the chord between the ends taken out.
    let (first, last) = (0, force_n.len() - 1);
    let stored = 0.5 * (force_n[first] + force_n[last]) * (displacement_mm[last] - displacement_mm[first]);
    let cycles = (turns / 2) as f64;
    let least_nmm = BACKWARDS * range(displacement_mm) * range(force_n) * cycles;
    (cycles >= 1.0 && energy_nmm - stored < -least_nmm).then_some(1e-3 * (stored - energy_nmm))
}

/// Correlation coefficient of two columns; 0 if one is constant.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut product, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        product += (a - mean_a) * (b - mean_b);
        square_a += (a - mean_a).powi(2);
        square_b += (b - mean_b).powi(2);
    }
    let scale = (square_a * square_b).sqrt();
    if scale > 0.0 { product / scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spring of 80 N/mm with 20 N of friction over two cycles between 0 and 10 mm.
    fn channels() -> (Vec<f64>, Vec<f64>) {
        let x: Vec<f64> = (0..=800)
            .map(|i| 10.0 - (f64::from(i % 400) * 0.05 - 10.0).abs())
            .collect();
        let force_n = (0..=800)
            .map(|i| 50.0 + 80.0 * x[i] + if i % 400 < 200 { 20.0 } else { -20.0 })
            .collect();
        (x, force_n)
    }

    #[test]
    fn each_turned_sign_is_told_from_the_others() {
        let (x, force_n) = channels();
        let minus = |values: &[f64]| values.iter().map(|v| -v).collect::<Vec<f64>>();
        assert_eq!(turned(&x, &force_n), None);
        assert_eq!(turned(&x, &minus(&force_n)), Some(TurnedSign::Force));
        assert_eq!(turned(&minus(&x), &force_n), Some(TurnedSign::Displacement));
        assert_eq!(turned(&minus(&x), &minus(&force_n)), Some(TurnedSign::Both));
        // A damper pulls as much as it pushes: it has no sign to turn.
        let centred: Vec<f64> = force_n.iter().map(|f| f - 450.0).collect();
        assert_eq!(turned(&x, &centred), None);
    }

    #[test]
    fn a_loop_that_runs_backwards_gives_energy() {
        let (x, force_n) = channels();
        assert_eq!(energy_given_j(&x, &force_n, 3), None);
        let back = |values: &[f64]| values.iter().rev().copied().collect::<Vec<f64>>();
        let given_j = energy_given_j(&back(&x), &back(&force_n), 3).expect("backwards");
        // Two loops of 40 N over 10 mm.
        assert!((given_j - 0.8).abs() < 0.02, "{given_j}");
    }
}
