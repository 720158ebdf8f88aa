//! What a set leaves of recordings without a cycle that is held out, such as one slow ramp: they are only fitted, so no comparison with other
//! cycles judges them. A law has few parameters, and they have many points: a right law leaves white noise.

use super::few_points::OUTLIER;
use crate::diagnose::course::Split;
use crate::diagnose::fitting::{Data, Node};

/// Fewest compared points of a recording that is judged: the structure of white noise then has a standard error of 0.1, where 0.45 counts. At
/// half, it is 0.14; at double, 0.07.
const LEAST_POINTS: usize = 100;

/// The recording without a held-out cycle that a set fits worst.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SingleSweep {
    pub recording: String,
    /// Mean square of what is left and not white, in units of the noise.
    pub structure: f64,
}

impl SingleSweep {
    /// `None` where every recording has cycles that are held out.
    pub(super) fn worst(data: &Data, node: &Node) -> Option<SingleSweep> {
        let mut from = 0;
        let mut sweeps = Vec::new();
        for track in &data.tracks {
            let points = from..from + track.len();
            from = points.end;
            let is_fitted = data.split[points.clone()].iter().all(|s| *s == Split::Fit);
            let compared = points.filter(|&i| data.weight[i] > 0.0);
            let residuals: Vec<f64> = compared.map(|i| node.residuals[i]).collect();
            if is_fitted && residuals.len() >= LEAST_POINTS {
                sweeps.push(SingleSweep {
                    recording: track.name.clone(),
                    structure: structure(&residuals),
                });
            }
        }
        sweeps
            .into_iter()
            .max_by(|a, b| a.structure.total_cmp(&b.structure))
    }

    /// What is said of a recording that is not explained, as the end of a summary.
    pub(super) fn in_words(&self) -> String {
        format!(
            " {} is a single sweep: no second cycle of it checks the fit. The fit misses it by {:.1} times the noise, and not at random.",
            self.recording,
            (1.0 + self.structure).sqrt()
        )
    }
}

/// Mean square of the part of some residuals that is not white, in units of the noise, 0 at least. Neighbours in white noise have a mean
/// product of zero. Slow noise that the weights know is no structure: with it, the mean square is 1.
fn structure(residuals: &[f64]) -> f64 {
    let bounded: Vec<f64> = residuals.iter().map(|r| r.clamp(-OUTLIER, OUTLIER)).collect();
    let of_neighbours: f64 = bounded.windows(2).map(|r| r[0] * r[1]).sum();
    let squares: f64 = bounded.iter().map(|r| r * r).sum();
    let count = bounded.len() as f64;
    (of_neighbours / (count - 1.0))
        .min(squares / count - 1.0)
        .max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::conditioning::noisy;

    /// White noise of 1.
    fn white(count: usize) -> Vec<f64> {
        (0..count).map(|i| 3f64.sqrt() * noisy(i)).collect()
    }

    #[test]
    fn a_ripple_is_structure_and_noise_is_not() {
        let noise = white(LEAST_POINTS);
        assert!(structure(&noise) < 0.15, "{}", structure(&noise));
        let rippled: Vec<f64> = noise
            .iter()
            .enumerate()
            .map(|(i, r)| r + 1.4 * (0.3 * i as f64).sin())
            .collect();
        let found = structure(&rippled);
        assert!((0.6..1.2).contains(&found), "{found}");
        // A white noise that was estimated too low is no structure, and one bad point is none.
        let louder: Vec<f64> = noise.iter().map(|r| 1.5 * r).collect();
        assert!(structure(&louder) < 0.3, "{}", structure(&louder));
        let mut spiked = noise;
        (spiked[40], spiked[41]) = (40.0, 40.0);
        assert!(structure(&spiked) < 0.45, "{}", structure(&spiked));
    }

    #[test]
    fn slow_noise_that_the_weights_know_is_no_structure() {
        // White noise of 0.5 and slow noise, together 1.
        let mut slow = 0.0;
        let both: Vec<f64> = white(20_000)
            .into_iter()
            .zip(0..)
            .map(|(white, i): (f64, usize)| {
                slow = 0.95 * slow
                    + (1.0f64 - 0.95 * 0.95).sqrt() * (0.75f64).sqrt() * 3f64.sqrt() * noisy(i + 50_000);
                0.5 * white + slow
            })
            .collect();
        assert!(structure(&both) < 0.2, "{}", structure(&both));
    }
}
