//! How much of the form errors is not the same on all benches: measured in the table.
//!
//! The error of a model differs from bench to bench, and it differs between families, while an error of a bench is the same for all
//! families. So families that were tested on the same benches tell the two apart:
//!
//! ```text
//! d = bench effect in one family less its mean over families      E(d^2) = e^2 + share^2 f^2
//! share^2 = sum w (d^2 - e^2) / sum w f^2,  w = f^2 / (e^2 + f^2)^2
//! ```
//! e: standard error of d. f: form error of the rows behind d. One quantity has few such differences, so the share is that of all
//! quantities. Without two families that travel nothing is known, and the share is 1.

use super::design::DesignTerm;
use super::outliers::RobustFit;

/// Fewest specimens of a family that were tested on several benches, for a bench effect of that family.
const FEWEST_TRAVELLING: usize = 2;
/// Differences from which a share is measured as it is: with fewer it is drawn towards 1.
const BELIEF: f64 = 5.0;

/// Share of the form errors that counts between benches, 0 to 1, from the fits within benches of all quantities.
pub(super) fn bench_form_share(fits: &[&RobustFit]) -> f64 {
    let (mut excess, mut expected, mut counted) = (0.0, 0.0, 0.0);
    for fit in fits {
        for (d, e2, f2) in differences(fit) {
            if f2 > 0.0 {
                let reliability = f2 / (e2 + f2);
                let w = reliability * reliability / f2;
                excess += w * (d * d - e2);
                expected += w * f2;
                counted += reliability;
            }
        }
    }
    if expected <= 0.0 {
        return 1.0;
    }
    let measured = (excess / expected).clamp(0.0, 1.0);
    ((counted * measured + BELIEF) / (counted + BELIEF)).sqrt()
}

/// Differences between families in the effect of a bench: each with the squares of its standard error and of its form error.
fn differences(fit: &RobustFit) -> Vec<(f64, f64, f64)> {
    let (design, data) = (&fit.design, fit.design.of);
    let travelling = |g: &usize| {
        let members = (0..data.specimens.len()).filter(|s| data.specimens[*s].group == *g);
        members.filter(|s| data.travels(*s)).count() >= FEWEST_TRAVELLING
    };
    let groups: Vec<usize> = (0..data.groups.len()).filter(travelling).collect();
    let mut differences = Vec::new();
    for bench in 0..data.benches.names.len() {
        // Effects of benches sum to 0 over those of the family: only families with the same benches can be compared.
        let alike = |g: &&usize| {
            let benches = &data.groups[**g].benches;
            benches.contains(&bench)
                && groups
                    .iter()
                    .any(|o| o != *g && data.groups[*o].benches == *benches)
        };
        let found: Vec<(f64, f64, f64)> = groups
            .iter()
            .filter(alike)
            .filter_map(|g| {
                let effect = design.contrast(&fit.fit, &[(DesignTerm::BenchOfGroup(*g, bench), 1.0)])?;
                let rows = data.rows_of_group(*g, None);
                let form = data.form_variance_of(&rows);
                Some((effect.estimate, effect.std_error.powi(2), form))
            })
            .collect();
        if found.len() < 2 {
            continue;
        }
        let n = found.len() as f64;
        let mean = found.iter().map(|f| f.0).sum::<f64>() / n;
        // About their mean n differences have (n - 1) / n of the variance of one.
        let stretch = (n / (n - 1.0)).sqrt();
        differences.extend(found.iter().map(|(b, e2, f2)| ((b - mean) * stretch, *e2, *f2)));
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::super::estimate::EstimateRow;
    use super::super::quantity_data::QuantityData;
    use super::super::tests::synthetic::SyntheticLab;
    use super::*;

    /// A lab whose families all travel; each family reads an effect differently on each bench, by `size` form errors.
    fn share(size: f64) -> f64 {
        let lab = SyntheticLab {
            of_five_on_two_benches: 5,
            normal: true,
            bench_compliance: vec![0.3, 0.0, -0.1],
            ..SyntheticLab::default()
        };
        let shares = (0..8).map(|seed| {
            let mut rows: Vec<EstimateRow> = lab.table(seed);
            rows.retain(|row| row.quantity == "series_compliance");
            for row in &mut rows {
                row.form_error = 0.9 * row.std_error;
                // Of either sign, and with a sum over benches of about 0 in each family.
                let sign = match (row.family.as_str(), row.bench.as_str()) {
                    ("F1" | "F4", "B1") | ("F2", "B2") | ("F3", "B3") => 1.0,
                    ("F1" | "F4", "B2") | ("F2", "B3") | ("F3", "B1") => -1.0,
                    _ => 0.0,
                };
                row.estimate += size * 0.25 * sign;
            }
            let data = QuantityData::of(rows.iter().collect());
            let fit = RobustFit::within_benches(&data, false).expect("a fit");
            bench_form_share(&[&fit])
        });
        shares.sum::<f64>() / 8.0
    }

    #[test]
    fn families_that_agree_about_a_bench_leave_little_of_the_form_error() {
        let (agree, differ) = (share(0.0), share(1.5));
        assert!(agree < 0.75, "{agree}");
        assert!(differ > 0.9, "{differ}");
    }

    #[test]
    fn families_that_stay_on_one_bench_leave_all_of_it() {
        let lab = SyntheticLab {
            of_five_on_two_benches: 0,
            ..SyntheticLab::default()
        };
        let rows = lab.table(1);
        let rows = rows.iter().filter(|row| row.quantity == "series_compliance");
        let data = QuantityData::of(rows.collect());
        let fit = RobustFit::within_benches(&data, false).expect("a fit");
        assert_eq!(bench_form_share(&[&fit]), 1.0);
    }
}
