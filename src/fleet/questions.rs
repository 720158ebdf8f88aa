//! Multiple testing: Holm's procedure over all questions of a report, with weights.
//!
//! Each kind of question has a share of the error, so that hundreds of questions about specimens do not take the power of a few
//! about benches. The procedure holds the family-wise error for any dependence between the questions (Holm 1979, section 3).

use std::collections::BTreeMap;

use super::findings::{PooledValue, QuestionKind};

/// Chance that a report of a lab with no effect at all names one or more.
pub(crate) const FAMILY_WISE_ERROR: f64 = 0.05;

/// Weight of a kind in the shares of the error. The hardest questions have twice the share: a specimen is one of many, and nobody knows the
/// law that it scatters by, while a bench or a batch is judged by the mean of many runs.
fn share(kind: QuestionKind) -> f64 {
    match kind {
        QuestionKind::Specimen => 2.0,
        QuestionKind::Bench
        | QuestionKind::Operator
        | QuestionKind::Group
        | QuestionKind::Batch
        | QuestionKind::Age
        | QuestionKind::Drawing
        | QuestionKind::SpecimenEffect => 1.0,
    }
}

/// Fills in the adjusted p value of each question, and whether it is answered with yes. Returns the number of questions.
pub(super) fn answer(mut asked: Vec<(QuestionKind, &mut PooledValue)>) -> usize {
    asked.retain(|(_, value)| value.p.is_some());
    let mut counts: BTreeMap<QuestionKind, f64> = BTreeMap::new();
    for (kind, _) in &asked {
        *counts.entry(*kind).or_default() += 1.0;
    }
    let all: f64 = counts.keys().map(|kind| share(*kind)).sum();
    let weight = |kind: &QuestionKind| share(*kind) / (all * counts[kind]);
    let mut order: Vec<(f64, f64, usize)> = asked
        .iter()
        .enumerate()
        .map(|(i, (kind, value))| (value.p.unwrap_or(1.0) / weight(kind), weight(kind), i))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left: f64 = 1.0;
    let mut adjusted: f64 = 0.0;
    for (over_weight, weight, i) in order {
        adjusted = adjusted.max(over_weight * left).min(1.0);
        left = (left - weight).max(0.0);
        let value = &mut asked[i].1;
        value.adjusted_p = Some(adjusted);
        value.found = adjusted < FAMILY_WISE_ERROR;
    }
    asked.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(p: Option<f64>) -> PooledValue {
        PooledValue {
            value: 1.0,
            low95: 0.5,
            high95: 1.5,
            degrees: 10.0,
            p,
            adjusted_p: None,
            found: false,
        }
    }

    #[test]
    fn one_kind_is_plain_holm() {
        let mut values = [0.01, 0.04, 0.02, 0.9].map(|p| value(Some(p)));
        let count = answer(values.iter_mut().map(|v| (QuestionKind::Bench, v)).collect());
        assert_eq!(count, 4);
        let adjusted = values.each_ref().map(|v| v.adjusted_p.expect("asked"));
        // 4 * 0.01; 3 * 0.02; 2 * 0.04; 1 * 0.9.
        for (got, expected) in adjusted.iter().zip([0.04, 0.08, 0.06, 0.9]) {
            assert!((got - expected).abs() < 1e-12, "{adjusted:?}");
        }
        assert_eq!(values.map(|v| v.found), [true, false, false, false]);
    }

    #[test]
    fn many_questions_of_one_kind_leave_the_power_of_another() {
        let mut bench = [value(Some(0.02))];
        let mut specimens: Vec<PooledValue> = (0..100).map(|_| value(Some(0.5))).collect();
        specimens.push(value(None));
        let all = bench.iter_mut().map(|v| (QuestionKind::Bench, v));
        let all = all.chain(specimens.iter_mut().map(|v| (QuestionKind::Specimen, v)));
        assert_eq!(answer(all.collect()), 101, "what was not asked does not count");
        // A third for the bench and two thirds for the specimens: 0.02 times 3.
        assert!((bench[0].adjusted_p.expect("asked") - 0.06).abs() < 1e-12);
        assert!(specimens.iter().all(|v| !v.found));
        // One of a hundred would be 200 times p if all questions had the same share.
        specimens[0].p = Some(3e-4);
        let all = bench.iter_mut().map(|v| (QuestionKind::Bench, v));
        let all = all.chain(specimens.iter_mut().map(|v| (QuestionKind::Specimen, v)));
        answer(all.collect());
        assert!((specimens[0].adjusted_p.expect("asked") - 3e-4 * 150.0).abs() < 1e-12);
        assert!(specimens[0].found);
    }
}
