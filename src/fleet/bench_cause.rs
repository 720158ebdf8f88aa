//! Which error of gain explains how a bench deviates: that of its force or that of its displacement.
//!
//! A gain of the force multiplies a quantity by the power of N in its unit, a gain of the displacement by the power of mm: the rate
//! (N/mm) goes up with the first and down with the second, a preload (N) moves with the first alone, a presliding (mm) with the second
//! alone, a ratio (1) with neither. So with two such quantities the two errors leave different traces. The rate alone cannot tell them.

use std::collections::BTreeSet;

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::estimate::EstimateScale;
use super::findings::{BenchCause, BenchError, GainFit, QuantityFindings, QuantityRole};
use super::levels::Factor;
use super::outliers::{QuantityFits, RobustFit};
use super::wording::{interval, named};
use crate::identify::confidence::student_975;

/// An error of gain whose misfit has a smaller p value is excluded: the true one is excluded once in a hundred.
const EXCLUDED_AT: f64 = 0.01;
/// 97.5 % point of the normal distribution.
const NORMAL_975: f64 = 1.959_963_984_540_054;

/// How a bench deviates in one quantity.
struct Deviation<'q> {
    quantity: &'q str,
    /// Powers of N and mm in the unit.
    powers: [f64; 2],
    /// Logarithm of what the bench reads over what the others read.
    log_ratio: f64,
    std_error: f64,
}

/// The causes of all benches with a finding in a quantity that a gain moves. Fits and findings belong together one by one.
pub(super) fn bench_causes(
    fits: &[QuantityFits],
    quantities: &[QuantityFindings],
    reference: Option<&str>,
) -> Vec<BenchCause> {
    let moved = quantities.iter().filter(|q| gain_powers(q).is_some());
    let found = moved.flat_map(|q| q.benches.iter().filter(|b| b.effect.found));
    let deviating: BTreeSet<&str> = found.map(|b| b.name.as_str()).collect();
    let cause = |bench: &&str| {
        let against = against(bench, fits, &deviating, reference);
        let pairs = fits.iter().zip(quantities);
        let deviations: Vec<Deviation> = pairs
            .filter(|(_, quantity)| quantity.benches.iter().any(|b| b.effect.p.is_some()))
            .filter_map(|(fit, quantity)| deviation(&fit.lab, quantity, bench, &against))
            .collect();
        judged(bench, against, &deviations)
    };
    deviating.iter().map(cause).collect()
}

/// Powers of N and mm, if a gain moves the quantity.
fn gain_powers(quantity: &QuantityFindings) -> Option<[f64; 2]> {
    let pooled_as_ratio =
        quantity.scale == EstimateScale::Relative && quantity.role == QuantityRole::Parameter;
    unit_powers(&quantity.unit).filter(|powers| pooled_as_ratio && *powers != [0.0; 2])
}

/// Powers of force and of length in a unit such as `N/mm` or `N*mm^2`; `None` for a unit that is not understood.
fn unit_powers(unit: &str) -> Option<[f64; 2]> {
    let mut powers = [0.0; 2];
    for (place, part) in unit.split('/').enumerate() {
        let sign = if place == 0 { 1.0 } else { -1.0 };
        for factor in part
            .split(['*', '\u{b7}', ' ', '(', ')'])
            .filter(|f| !f.is_empty())
        {
            let name = factor.trim_end_matches(|c: char| c.is_ascii_digit() || "^\u{b2}\u{b3}".contains(c));
            let power = match factor[name.len()..].trim_start_matches('^') {
                "" => 1.0,
                "\u{b2}" => 2.0,
                "\u{b3}" => 3.0,
                digits => digits.parse().ok()?,
            };
            let [force, length] = match name {
                "N" | "kN" => [1.0, 0.0],
                "mm" | "m" => [0.0, 1.0],
                "J" | "mJ" => [1.0, 1.0],
                "" | "s" | "ms" | "min" | "h" | "Hz" | "rad" => [0.0, 0.0],
                _ => return None,
            };
            powers[0] += sign * power * force;
            powers[1] += sign * power * length;
        }
    }
    Some(powers)
}

/// The benches to compare with: the reference, or those of the same part that do not deviate, or all of it.
fn against(
    bench: &str,
    fits: &[QuantityFits],
    deviating: &BTreeSet<&str>,
    reference: Option<&str>,
) -> Vec<String> {
    let mut beside = BTreeSet::new();
    for data in fits.iter().map(|fit| fit.lab.design.of) {
        if let Some(number) = data.benches.names.iter().position(|b| *b == bench) {
            let part = data.benches_of_part(data.part_of_bench[number]).into_iter();
            beside.extend(part.map(|b| data.benches.names[b]).filter(|b| *b != bench));
        }
    }
    if let Some(right) = reference.filter(|right| beside.contains(right)) {
        return vec![right.to_owned()];
    }
    let sound: Vec<String> = beside
        .iter()
        .filter(|b| !deviating.contains(*b))
        .map(|b| (*b).to_owned())
        .collect();
    match sound.is_empty() {
        true => beside.into_iter().map(str::to_owned).collect(),
        false => sound,
    }
}

fn deviation<'q>(
    robust: &RobustFit,
    quantity: &'q QuantityFindings,
    bench: &str,
    against: &[String],
) -> Option<Deviation<'q>> {
    let powers = gain_powers(quantity)?;
    let data = robust.design.of;
    let number = |name: &str| data.benches.names.iter().position(|b| *b == name);
    let bench = number(bench)?;
    let others: Option<Vec<usize>> = against.iter().map(|name| number(name)).collect();
    let others = others?;
    let same_part = |other: &usize| data.part_of_bench[*other] == data.part_of_bench[bench];
    if !others.iter().all(same_part) {
        return None;
    }
    let contrast = robust.level_against(Factor::Bench, bench, &others)?;
    Some(Deviation {
        quantity: &quantity.quantity,
        powers,
        log_ratio: contrast.estimate,
        // As wide as a normal law with the same 95 % interval.
        std_error: contrast.std_error * student_975(contrast.degrees) / NORMAL_975,
    })
}

/// The gain that fits the deviations best (weighted least squares), where `of` is the place of its power.
fn gain(deviations: &[Deviation], of: usize) -> Option<GainFit> {
    let weighted = |value: &dyn Fn(&Deviation) -> f64| -> f64 {
        deviations.iter().map(|d| value(d) / d.std_error.powi(2)).sum()
    };
    let weight = weighted(&|d| d.powers[of].powi(2));
    if weight <= 0.0 {
        return None;
    }
    let log_gain = weighted(&|d| d.powers[of] * d.log_ratio) / weight;
    let misfit = weighted(&|d| (d.log_ratio - d.powers[of] * log_gain).powi(2));
    let half = NORMAL_975 / weight.sqrt();
    let left = deviations.len() as f64 - 1.0;
    Some(GainFit {
        error: log_gain.exp_m1(),
        low95: (log_gain - half).exp_m1(),
        high95: (log_gain + half).exp_m1(),
        misfit_p: ChiSquared::new(left).map_or(1.0, |law| law.sf(misfit)),
    })
}

fn judged(bench: &str, against: Vec<String>, deviations: &[Deviation]) -> BenchCause {
    let [force_gain, displacement_gain] = [0, 1].map(|of| gain(deviations, of));
    let fits = |gain: &Option<GainFit>| gain.is_some_and(|g| g.misfit_p >= EXCLUDED_AT);
    let error = match (fits(&force_gain), fits(&displacement_gain)) {
        (true, false) => BenchError::ForceGain,
        (false, true) => BenchError::DisplacementGain,
        (true, true) => BenchError::Either,
        (false, false) => BenchError::Neither,
    };
    let quantities: Vec<String> = deviations.iter().map(|d| d.quantity.to_owned()).collect();
    let by = |gain: &Option<GainFit>| {
        gain.map_or(String::new(), |g| {
            interval(g.error, g.low95, g.high95, EstimateScale::Relative, "")
        })
    };
    let seen_in = named(&quantities);
    let sentence = match error {
        BenchError::ForceGain => format!(
            "Bench {bench}: an error of its force fits ({}), an error of its displacement does not (seen in {seen_in}).",
            by(&force_gain)
        ),
        BenchError::DisplacementGain => format!(
            "Bench {bench}: an error of its displacement fits ({}), an error of its force does not (seen in {seen_in}).",
            by(&displacement_gain)
        ),
        BenchError::Either => format!(
            "Bench {bench}: its force may be wrong ({}) or its displacement ({}); {seen_in} cannot tell which: check both sensors \
             against a reference.",
            by(&force_gain),
            by(&displacement_gain)
        ),
        BenchError::Neither => format!(
            "Bench {bench}: no error of force or displacement alone fits {seen_in}: check both sensors and the mounting."
        ),
    };
    BenchCause {
        bench: bench.to_owned(),
        against,
        quantities,
        error,
        force_gain,
        displacement_gain,
        sentence,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deviation(quantity: &'static str, unit: &str, log_ratio: f64) -> Deviation<'static> {
        Deviation {
            quantity,
            powers: unit_powers(unit).expect("a unit"),
            log_ratio,
            std_error: 0.001,
        }
    }

    #[test]
    fn powers_come_from_the_unit() {
        assert_eq!(unit_powers("N/mm"), Some([1.0, -1.0]));
        assert_eq!(unit_powers("N/mm^2"), Some([1.0, -2.0]));
        assert_eq!(unit_powers("N*s/mm"), Some([1.0, -1.0]));
        assert_eq!(unit_powers("N/(mm s)"), Some([1.0, -1.0]));
        assert_eq!(unit_powers("mm\u{b2}/N"), Some([-1.0, 2.0]));
        assert_eq!(unit_powers("1"), Some([0.0, 0.0]));
        assert_eq!(unit_powers("K"), None);
    }

    #[test]
    fn the_error_that_fits_is_told_from_the_other() {
        let error_of = |deviations: &[Deviation]| judged("B", vec!["A".to_owned()], deviations).error;
        let rate = || deviation("rate_n_per_mm", "N/mm", 0.01);
        assert_eq!(
            error_of(&[rate(), deviation("preload_n", "N", 0.0105)]),
            BenchError::ForceGain
        );
        assert_eq!(
            error_of(&[rate(), deviation("preload_n", "N", 0.0)]),
            BenchError::DisplacementGain
        );
        assert_eq!(
            error_of(&[rate(), deviation("presliding_mm", "mm", -0.0095)]),
            BenchError::DisplacementGain
        );
        assert_eq!(error_of(&[rate()]), BenchError::Either);
        assert_eq!(
            error_of(&[rate(), deviation("preload_n", "N", 0.03)]),
            BenchError::Neither
        );
    }

    #[test]
    fn a_gain_is_the_weighted_mean_of_what_it_moves() {
        let both = [
            deviation("rate_n_per_mm", "N/mm", 0.010),
            deviation("preload_n", "N", 0.012),
        ];
        let force = gain(&both, 0).expect("depends on force");
        assert!((force.error - 0.011f64.exp_m1()).abs() < 1e-12);
        let displacement = gain(&both, 1).expect("depends on displacement");
        assert!((displacement.error - (-0.010f64).exp_m1()).abs() < 1e-12);
        assert!(
            gain(&both[1..], 1).is_none(),
            "a preload says nothing about the displacement"
        );
    }
}
