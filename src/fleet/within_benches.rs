//! Comparisons within benches: the data by which batches, specimens and ageing are judged.
//!
//! tau is the scatter of specimens. For a parameter, in percent, all families share one tau. For the amplitude of an effect they cannot:
//! it depends on how well the model fits the family. With one tau for all, a batch of a family with little scatter would not be found,
//! and specimens of a family with much scatter would be findings. A tau of each family alone would rest on few specimens. So the
//! variance of each family is drawn towards that of all, the more so the more alike the families are over all effects (empirical Bayes;
//! G. K. Smyth 2004, section 6.2):
//!
//! ```text
//! variance of a family = (d0 s0^2 + d m) / (d0 + d)
//! ```
//! m: mean square of its specimens' deviations, d: its degrees of freedom. s0^2, d0: of the law from which families draw theirs.

use statrs::function::gamma::digamma;

use super::findings::QuantityRole;
use super::outliers::RobustFit;
use super::quantity_data::QuantityData;
use super::run_scatter::calibrated;

/// Degrees of freedom that stand for "families are alike".
const ALIKE: f64 = 1e6;

/// Standard errors of the excess at its upper limit.
const LIMIT: f64 = 2.0;

/// How the specimens of one group scatter in one quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
struct GroupScatter {
    quantity: usize,
    group: usize,
    /// Mean square of the deviations in standard errors that hold for all groups.
    mean_square: f64,
    degrees: f64,
}

/// The quantities with calibrated runs and with units of the groups, for fits within benches.
pub(super) fn comparisons<'r>(data: &[QuantityData<'r>], operators: bool) -> Vec<QuantityData<'r>> {
    let mut compared: Vec<QuantityData> = data.iter().map(|data| calibrated(data, operators)).collect();
    let is_effect = |data: &QuantityData| QuantityRole::of(&data.rows[0].quantity) != QuantityRole::Parameter;
    let scatters: Vec<GroupScatter> = compared
        .iter()
        .enumerate()
        .filter(|(_, data)| is_effect(data))
        .filter_map(|(q, data)| Some((q, RobustFit::within_benches(data, operators)?)))
        .flat_map(|(q, fit)| scatter_of_groups(q, &fit))
        .collect();
    let prior = prior_degrees(&scatters);
    for data in compared.iter_mut().filter(|data| is_effect(data)) {
        data.degrees_of_group.fill(prior);
    }
    for (scatter, factor) in scatters.iter().zip(moderated(&scatters, prior)) {
        let data = &mut compared[scatter.quantity];
        data.unit_of_group[scatter.group] *= factor.sqrt();
        data.degrees_of_group[scatter.group] = prior + scatter.degrees;
    }
    compared
}

/// The scatter of the groups in which two specimens or more are free, without those that are set aside.
fn scatter_of_groups(quantity: usize, fit: &RobustFit) -> Vec<GroupScatter> {
    let data = fit.design.of;
    let of_group = |group: usize| {
        let members = (0..data.specimens.len()).filter(|s| data.specimens[*s].group == group);
        let members = members.filter(|s| !fit.choice.outliers.contains(s));
        let squares = members.clone().filter_map(|s| {
            let deletion = fit.specimen(s).deletion;
            let t = deletion.estimate / deletion.std_error;
            deletion.std_error.is_finite().then_some(t * t)
        });
        let squares: Vec<f64> = squares.collect();
        // Specimens that stay on one bench are compared with those on the same bench alone.
        let mut homes: Vec<usize> = members
            .filter(|s| !data.travels(*s))
            .map(|s| data.benches.of_row[data.specimens[s].rows.start])
            .collect();
        homes.sort_unstable();
        homes.dedup();
        let taken = data.groups[group].batches.len() + homes.len().saturating_sub(1);
        let degrees = squares.len().saturating_sub(taken) as f64;
        let mean_square = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        (degrees >= 2.0 && mean_square > 0.0).then_some(GroupScatter {
            quantity,
            group,
            mean_square,
            degrees,
        })
    };
    (0..data.groups.len()).filter_map(of_group).collect()
}

/// Logarithm of a mean square without the bias that few degrees of freedom give it.
fn centred_log(scatter: &GroupScatter) -> f64 {
    let half = 0.5 * scatter.degrees;
    scatter.mean_square.ln() - digamma(half) + half.ln()
}

/// Mean of the centred logarithms of a quantity.
fn log_of_quantity(scatters: &[GroupScatter], quantity: usize) -> f64 {
    let of_quantity = scatters.iter().filter(|s| s.quantity == quantity);
    let logs: Vec<f64> = of_quantity.map(centred_log).collect();
    logs.iter().sum::<f64>() / logs.len().max(1) as f64
}

/// d0, from how much more the logarithms of the mean squares differ between the groups of a quantity than chance explains. Of this
/// excess the upper limit is taken, so that families are not taken for more alike than the table shows.
fn prior_degrees(scatters: &[GroupScatter]) -> f64 {
    let squares = scatters
        .iter()
        .map(|s| (centred_log(s) - log_of_quantity(scatters, s.quantity)).powi(2));
    let squares: f64 = squares.sum();
    let mut quantities: Vec<usize> = scatters.iter().map(|s| s.quantity).collect();
    quantities.dedup();
    let free = scatters.len() - quantities.len();
    if free == 0 {
        return ALIKE;
    }
    let chance = scatters.iter().map(|s| trigamma(0.5 * s.degrees)).sum::<f64>() / scatters.len() as f64;
    let found = squares / free as f64;
    let excess = found - chance + LIMIT * chance.max(found) * (2.0 / free as f64).sqrt();
    match excess > 0.0 {
        true => (2.0 * inverse_trigamma(excess)).min(ALIKE),
        false => ALIKE,
    }
}

/// The moderated variance of each group.
fn moderated(scatters: &[GroupScatter], prior: f64) -> Vec<f64> {
    let of_group = |s: &GroupScatter| {
        if prior >= ALIKE {
            return 1.0;
        }
        let half = 0.5 * prior;
        let typical = (log_of_quantity(scatters, s.quantity) + digamma(half) - half.ln()).exp();
        (prior * typical + s.degrees * s.mean_square) / (prior + s.degrees)
    };
    scatters.iter().map(of_group).collect()
}

/// Derivative of digamma for x above 0: recurrence up to 10, then the asymptotic series (Abramowitz & Stegun 6.4.12).
fn trigamma(mut x: f64) -> f64 {
    let mut sum = 0.0;
    while x < 10.0 {
        sum += 1.0 / (x * x);
        x += 1.0;
    }
    let square = 1.0 / (x * x);
    sum + 1.0 / x + 0.5 * square + square / x * (1.0 / 6.0 - square * (1.0 / 30.0 - square / 42.0))
}

/// The argument above 0 at which trigamma has a value, by bisection of its logarithm.
fn inverse_trigamma(value: f64) -> f64 {
    let (mut low, mut high) = (1e-6f64.ln(), ALIKE.ln());
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if trigamma(middle.exp()) > value {
            low = middle;
        } else {
            high = middle;
        }
    }
    low.exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{ChiSquared, Distribution};

    /// Forty quantities of four groups with 7 degrees of freedom; the variances of the groups follow the law of d0 and s0 = 1.
    fn drawn(prior: Option<f64>) -> Vec<GroupScatter> {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let mut mean_square = |degrees: f64| {
            let law = ChiSquared::new(degrees).expect("a law");
            law.sample(&mut random) / degrees
        };
        let mut scatters = Vec::new();
        for quantity in 0..40 {
            for group in 0..4 {
                let own = prior.map_or(1.0, |d0| 1.0 / mean_square(d0));
                scatters.push(GroupScatter {
                    quantity,
                    group,
                    mean_square: own * mean_square(7.0),
                    degrees: 7.0,
                });
            }
        }
        scatters
    }

    #[test]
    fn trigamma_has_its_known_values() {
        // pi^2 / 6 and pi^2 / 2.
        assert!((trigamma(1.0) - std::f64::consts::PI.powi(2) / 6.0).abs() < 1e-9);
        assert!((trigamma(0.5) - std::f64::consts::PI.powi(2) / 2.0).abs() < 1e-9);
        assert!((inverse_trigamma(trigamma(3.7)) - 3.7).abs() < 1e-6);
    }

    #[test]
    fn families_that_are_alike_share_their_scatter_and_others_keep_theirs() {
        let alike = prior_degrees(&drawn(None));
        assert!(alike > 10.0, "{alike}");
        let unlike = drawn(Some(4.0));
        let prior = prior_degrees(&unlike);
        // 120 free logarithms: their variance is known to 13 %, and its upper limit means fewer degrees of freedom.
        assert!((2.0..5.0).contains(&prior), "{prior}");
        let factors = moderated(&unlike, prior);
        let loudest = (0..unlike.len()).max_by(|a, b| {
            let [a, b] = [a, b].map(|i| unlike[*i].mean_square);
            a.total_cmp(&b)
        });
        let loudest = loudest.expect("groups");
        assert!(factors[loudest] > 0.5 * unlike[loudest].mean_square);
        assert!(factors[loudest] < unlike[loudest].mean_square);
    }
}
