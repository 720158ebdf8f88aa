//! Limits that a normal run keeps all together with a given chance.
//!
//! ```text
//! limit of variable j = m_j +- k d_j        k = 95 % point over the draws i of max over j of +-(y_ij - m_j) / d_j
//! ```
//! m and d are median and half the range of the middle 68 % of the draws; the sign is that of the limit's side. Limits of 95 % each would
//! fail a run that is judged by 24 of them much more often than one time in twenty. Quantities of one run deviate together (a stiff
//! mounting raises peak and rate); the draws have the correlation of the runs of the family, drawn towards 0 where these are few.

use std::collections::BTreeSet;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::loops::LoopVariable;
use super::quantity::RunDeviations;
use crate::identify::confidence::student_quantile;
use crate::profile::accept::{JudgedValue, LimitSide, key_of};

/// Number of draws: the 95 % point of their largest deviation has a relative error of about 1 %.
const DRAWS: usize = 4000;
/// Seed of the draws. The same table gives the same limits.
const SEED: u64 = 1;
/// Runs of a family at which half of the correlation that they show is believed.
const HALF_BELIEVED_RUNS: f64 = 5.0;
/// Chance that a normal run keeps all limits.
pub(crate) const KEPT: f64 = 0.95;

/// A predicted limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PredictedLimit {
    /// Key of an accept block.
    pub key: &'static str,
    /// First and last counted cycle that it is about; `null` for the whole motion.
    pub cycles: Option<[u32; 2]>,
    pub side: LimitSide,
    /// The limit, and the median of what is expected, in the unit of the key.
    pub limit: f64,
    pub expected: f64,
}

/// A quantity that is drawn: mean, standard deviation and degrees of freedom of Student's t.
#[derive(Debug, Clone)]
pub(crate) struct DrawnQuantity {
    pub mean: f64,
    pub deviation: f64,
    pub degrees: f64,
    /// How the runs of the family deviated; it says which quantities deviate together.
    pub runs: RunDeviations,
}

/// Which of the independent streams of random numbers is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    Quantities,
    Misfits,
}

/// Draws of some quantities together, one row a draw. The same input gives the same draws.
pub(crate) fn draws(quantities: &[DrawnQuantity], stream: Stream) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    random.set_stream(stream as u64);
    let normal = Normal::standard();
    let together = run_vectors(quantities);
    let independent = HALF_BELIEVED_RUNS / (HALF_BELIEVED_RUNS + together.len() as f64);
    let draw = |_| {
        let mut z = || normal.inverse_cdf(random.random::<f64>().clamp(1e-12, 1.0 - 1e-12));
        let mut drawn = vec![0.0; quantities.len()];
        for run in &together {
            let weight = z() * (1.0 - independent).sqrt();
            drawn
                .iter_mut()
                .zip(run)
                .for_each(|(sum, deviation)| *sum += weight * deviation);
        }
        for (drawn, quantity) in drawn.iter_mut().zip(quantities) {
            let alone = if together.is_empty() {
                1.0
            } else {
                independent.sqrt()
            };
            let probability = normal.cdf(*drawn + alone * z()).clamp(1e-12, 1.0 - 1e-12);
            *drawn = quantity.mean + quantity.deviation * student_quantile(quantity.degrees, probability);
        }
        drawn
    };
    (0..DRAWS).map(draw).collect()
}

/// Deviations of the runs that have all quantities, so that each quantity has a sum of squares of 1.
fn run_vectors(quantities: &[DrawnQuantity]) -> Vec<Vec<f64>> {
    let Some((first, others)) = quantities.split_first() else {
        return Vec::new();
    };
    let runs: BTreeSet<&String> = first.runs.keys().collect();
    let runs = runs
        .into_iter()
        .filter(|run| others.iter().all(|q| q.runs.contains_key(*run)));
    let mut vectors: Vec<Vec<f64>> = runs
        .map(|run| quantities.iter().map(|q| q.runs[run]).collect())
        .collect();
    for column in 0..quantities.len() {
        let length = vectors.iter().map(|v| v[column].powi(2)).sum::<f64>().sqrt();
        if length.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
            return Vec::new();
        }
        vectors.iter_mut().for_each(|v| v[column] /= length);
    }
    vectors
}

/// Limits that [`KEPT`] of the draws keep all together. `draws[i][j]` is variable j in draw i.
pub(crate) fn limits(variables: &[LoopVariable], draws: &[Vec<f64>]) -> Vec<PredictedLimit> {
    let middle: Vec<[f64; 2]> = (0..variables.len())
        .map(|j| middle(draws.iter().map(|d| d[j])))
        .collect();
    let sign = |side: LimitSide| match side {
        LimitSide::Min => -1.0,
        LimitSide::Max => 1.0,
    };
    let largest = draws.iter().map(|draw| {
        let all = draw.iter().zip(&middle).zip(variables);
        let beyond = all.map(|((y, [m, d]), variable)| sign(variable.side) * (y - m) / d);
        beyond.filter(|z| z.is_finite()).fold(0.0, f64::max)
    });
    let k = quantile(&mut largest.collect::<Vec<f64>>(), KEPT);
    let limit = |(variable, [m, d]): (&LoopVariable, &[f64; 2])| {
        Some(PredictedLimit {
            key: key_of(JudgedValue::Cycle(variable.value), variable.side)?,
            cycles: variable.cycles,
            side: variable.side,
            limit: m + sign(variable.side) * k * d,
            expected: *m,
        })
    };
    variables.iter().zip(&middle).filter_map(limit).collect()
}

/// Median, and half the range of the middle 68 %.
fn middle(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut values: Vec<f64> = values.collect();
    let [low, m, high] = [0.158_655, 0.5, 0.841_345].map(|p| quantile(&mut values, p));
    [m, 0.5 * (high - low)]
}

fn quantile(values: &mut [f64], probability: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => values[((probability * n as f64) as usize).min(n - 1)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::accept::CycleValue;

    fn quantity(mean: f64, degrees: f64, deviations: &[f64]) -> DrawnQuantity {
        let runs = deviations
            .iter()
            .enumerate()
            .map(|(i, d)| (format!("r{i:03}"), *d));
        DrawnQuantity {
            mean,
            deviation: 2.0,
            degrees,
            runs: runs.collect(),
        }
    }

    fn share(draws: &[Vec<f64>], holds: impl Fn(&[f64]) -> bool) -> f64 {
        draws.iter().filter(|d| holds(d)).count() as f64 / draws.len() as f64
    }

    #[test]
    fn draws_have_the_law_of_each_quantity_and_the_correlation_of_the_runs() {
        let wave: Vec<f64> = (0..95).map(|i| f64::from(i).sin()).collect();
        let turned: Vec<f64> = wave.iter().map(|d| -d).collect();
        let drawn = draws(
            &[quantity(10.0, 1e6, &wave), quantity(0.0, 4.0, &turned)],
            Stream::Quantities,
        );
        // 95 % points of the normal law and of Student's t with 4 degrees of freedom; the share has a deviation of 0.35 %.
        let normal = share(&drawn, |d| (d[0] - 10.0).abs() < 2.0 * 1.96);
        let student = share(&drawn, |d| d[1].abs() < 2.0 * 2.776);
        assert!(
            (normal - 0.95).abs() < 0.012 && (student - 0.95).abs() < 0.012,
            "{normal} {student}"
        );
        // 5 / (5 + 95) is drawn independently: the correlation of the signs is 2 / pi asin(0.95).
        let together = share(&drawn, |d| (d[0] > 10.0) == (d[1] < 0.0));
        assert!((together - 0.899).abs() < 0.02, "{together}");
    }

    #[test]
    fn limits_are_kept_together_in_95_percent() {
        let sides = [LimitSide::Min, LimitSide::Max];
        let variables = sides.map(|side| LoopVariable {
            cycles: Some([1, 5]),
            value: CycleValue::ForcePeak,
            side,
        });
        let drawn = draws(
            &[quantity(10.0, 1e6, &[]), quantity(12.0, 1e6, &[])],
            Stream::Quantities,
        );
        let limits = limits(&variables, &drawn);
        let keys: Vec<&str> = limits.iter().map(|l| l.key).collect();
        assert_eq!(keys, ["force_peak_min_n", "force_peak_max_n"]);
        let kept = share(&drawn, |d| d[0] >= limits[0].limit && d[1] <= limits[1].limit);
        assert!((kept - 0.95).abs() < 0.001, "{kept}");
        // Two independent sides of 97.5 % each: 1.95 deviations.
        assert!((limits[1].limit - 12.0 - 2.0 * 1.955).abs() < 0.15, "{limits:?}");
    }
}
