//! How runs scatter: the standard errors of a table are scaled in each family to the scatter that is seen, and runs far from the others get
//! less weight.
//!
//! ```text
//! variance of a run = phi^2 (sigma^2 + s^2) h      h = max(1, (|e| / (2.5 phi sqrt(sigma^2 + s^2)))^2)
//! ```
//! s: standard error of the row. sigma: scatter from run to run of a parameter; 0 for an effect, which no mounting changes. e: residual
//! within the specimen. phi: median of |e| / sqrt(sigma^2 + s^2) over that of a normal law, for each family, drawn towards that of all. h: weight of
//! a run that lies far out (P. J. Huber 1964): an instrument that failed, or a fit that ended elsewhere. Without it one run with a tiny
//! standard error decides about its specimen.

use super::design::DesignChoice;
use super::findings::QuantityRole;
use super::outliers::{RobustFit, SIGMA_OF_MEDIAN, median};
use super::quantity_data::QuantityData;

/// Standard deviations from which the weight of a run falls (Huber's constant is 1.345; a normal law loses 0.3 % of its information with
/// this one).
const FAR_OUT: f64 = 2.5;
/// The phi of a family is a weighted mean of its own and that of all families, which counts like this many runs. From 30 residuals a
/// median is known to 20 %; an own phi of fewer runs would only add noise to the weights.
const RUNS_OF_ALL: f64 = 30.0;
/// Rounds of residuals and weights. The weights of the third differ little from those of the second.
const ROUNDS: usize = 3;

/// The quantity with variances of its runs in place of those that the table says, for comparisons within benches. An effect scatters in
/// the unit of its standard errors, so that is the unit of its groups.
pub(super) fn calibrated<'r>(data: &QuantityData<'r>, operators: bool) -> QuantityData<'r> {
    let is_parameter = QuantityRole::of(&data.rows[0].quantity) == QuantityRole::Parameter;
    let mut calibrated = data.clone();
    let mut base: Vec<f64> = data.known_variance.clone();
    if !is_parameter {
        base.iter_mut()
            .zip(&data.form_variance)
            .for_each(|(v, f)| *v += f);
        calibrated.unit_of_group = units(data, &base);
    }
    for round in 0..ROUNDS {
        let choice = DesignChoice {
            operators,
            bench_of_each_group: true,
            ..DesignChoice::default()
        };
        let Some(fit) = RobustFit::with(&calibrated, choice) else {
            return calibrated;
        };
        if is_parameter && round == 0 {
            base.iter_mut().for_each(|v| *v += fit.fit.variances.y);
        }
        let residuals = residuals(&fit);
        let scale = scale_of_rows(data, &residuals, &base);
        calibrated.known_variance = residuals
            .iter()
            .zip(&base)
            .zip(&scale)
            .map(|((e, base), scale)| {
                let variance = scale * scale * base;
                variance.max(e * e / (FAR_OUT * FAR_OUT))
            })
            .collect();
    }
    calibrated
}

/// Median standard error of each group.
fn units(data: &QuantityData, variances: &[f64]) -> Vec<f64> {
    let groups = data.group_of_row();
    let of_group = |group: usize| {
        let rows = (0..groups.len()).filter(|i| groups[*i] == group);
        median(rows.map(|i| variances[i].sqrt()).collect())
    };
    (0..data.groups.len()).map(of_group).collect()
}

/// What each row differs by from its specimen at its place, in the unit of `y`.
fn residuals(robust: &RobustFit) -> Vec<f64> {
    let (data, design) = (robust.design.of, &robust.design.data);
    let units = data.unit_of_row();
    let mut residuals = vec![0.0; design.y.len()];
    for (number, rows) in design.blocks.iter().enumerate() {
        let own = robust.fit.specimen(design, number).predicted.estimate;
        for i in rows.clone() {
            let expected: f64 = design.rows[i]
                .iter()
                .map(|&(c, x)| x * robust.fit.effects[c])
                .sum();
            residuals[i] = units[i] * (design.y[i] - expected - own);
        }
    }
    residuals
}

/// phi of each row: that of its family, or of all rows.
fn scale_of_rows(data: &QuantityData, residuals: &[f64], base: &[f64]) -> Vec<f64> {
    let groups = data.group_of_row();
    let of_rows = |rows: &[usize], taken: usize| {
        let ratios = rows.iter().map(|i| residuals[*i].abs() / base[*i].sqrt());
        // Means of specimens and benches have taken a part of the scatter out.
        let left = rows.len().saturating_sub(taken).max(1) as f64;
        SIGMA_OF_MEDIAN * median(ratios.collect()) * (rows.len() as f64 / left).sqrt()
    };
    let taken = |group: usize| {
        let members = data.specimens.iter().filter(|s| s.group == group).count();
        members + data.groups[group].benches.len() - 1
    };
    let all: Vec<usize> = (0..groups.len()).collect();
    let of_all = of_rows(&all, (0..data.groups.len()).map(taken).sum());
    let of_group = |group: usize| {
        let rows: Vec<usize> = all.iter().copied().filter(|i| groups[*i] == group).collect();
        let own = of_rows(&rows, taken(group));
        if own <= 0.0 || of_all <= 0.0 {
            return of_all;
        }
        let weight = rows.len() as f64 / (rows.len() as f64 + RUNS_OF_ALL);
        (weight * own.ln() + (1.0 - weight) * of_all.ln()).exp()
    };
    let scales: Vec<f64> = (0..data.groups.len()).map(of_group).collect();
    // A table in which most runs agree to the last digit has no scatter to measure: its standard errors stand.
    let scale = |group: &usize| Some(scales[*group]).filter(|s| *s > 0.0).unwrap_or(1.0);
    groups.iter().map(scale).collect()
}

#[cfg(test)]
mod tests {
    use super::super::estimate::EstimateRow;
    use super::super::tests::synthetic::SyntheticLab;
    use super::*;

    fn effect_rows(seed: u64) -> Vec<EstimateRow> {
        let lab = SyntheticLab {
            normal: true,
            ..SyntheticLab::default()
        };
        let mut rows = lab.table(seed);
        rows.retain(|row| row.quantity == "series_compliance");
        rows
    }

    #[test]
    fn standard_errors_that_are_too_large_in_one_family_are_made_smaller_there() {
        let plain = effect_rows(3);
        let mut wide = plain.clone();
        wide.iter_mut()
            .filter(|row| row.family == "F2")
            .for_each(|row| row.std_error *= 5.0);
        let variance = |rows: &[EstimateRow], family: &str| {
            let data = calibrated(&QuantityData::of(rows.iter().collect()), false);
            let of_family = data.rows.iter().zip(&data.known_variance);
            let of_family: Vec<f64> = of_family
                .filter(|(row, _)| row.family == family)
                .map(|(_, v)| *v)
                .collect();
            median(of_family)
        };
        for family in ["F1", "F2"] {
            let ratio = variance(&wide, family) / variance(&plain, family);
            // 100 runs of 130 decide: 5^(2 * 30 / 130) would be left of 25, and less as the other families take part.
            assert!((0.5..2.5).contains(&ratio), "{family}: {ratio}");
        }
    }

    #[test]
    fn a_run_far_out_with_a_tiny_standard_error_does_not_decide_about_its_specimen() {
        let mut rows = effect_rows(4);
        (rows[8].estimate, rows[8].std_error) = (5.0, 1e-4);
        let data = calibrated(&QuantityData::of(rows.iter().collect()), false);
        let place = data.rows.iter().position(|row| row.estimate == 5.0);
        let variance = data.known_variance[place.expect("the row")];
        assert!(variance > 2.0, "{variance}");
        let specimen = rows[8].specimen.clone();
        let fit = RobustFit::within_benches(&data, false).expect("a fit");
        let number = data.specimens.iter().position(|s| s.name == specimen);
        let deletion = fit.specimen(number.expect("the specimen")).deletion;
        assert!(
            (deletion.estimate / deletion.std_error).abs() < 3.5,
            "{deletion:?}"
        );
    }
}
