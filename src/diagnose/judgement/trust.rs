//! Confidence in a named effect.

use super::alternatives::JudgedEffect;
use super::rest::Rest;
use super::varying_coefficient::{Variation, variation};
use crate::diagnose::fitting::FitContext;
use crate::diagnose::search::SearchResult;

/// Exponent that corrects the odds of a confidence. Of 188 names of five worlds (seeds 1211132179 and 910159277), 25 had no alternative and
/// less than 40 % without it: 22 % in the mean, but 52 % of them were right. The likeliest exponent was 0.7; it was 0.78 for the first seed
/// alone. At half, names of 99 % get 96 %, and names of 10 % get 63 %. At double it is above 1, and doubtful names get even less.
const ODDS_EXPONENT: f64 = 0.75;
/// Confidence that the exponent does not change. Of 85 names with at least that, 81 were right. From here a wrong name counts as sure.
const FIXED_CONFIDENCE: f64 = 0.9;
/// Highest confidence that is reported.
const MOST_CONFIDENCE: f64 = 0.99;

/// Confidence in an effect of the chosen set, 0 to 1.
pub(super) struct Trust {
    /// In this effect.
    pub in_effect: f64,
    /// In this effect or one of its rivals.
    pub in_any: f64,
}

impl Trust {
    /// `all` are the effects of the set.
    pub(super) fn of(
        context: &FitContext<'_>,
        search: &SearchResult,
        judged: &JudgedEffect,
        all: &[JudgedEffect],
        rest: &Rest,
    ) -> Trust {
        let node = &search.nodes[search.chosen];
        let variation = variation(context, search.likelihood, node, judged.place);
        let size = variation.map_or(1.0, Variation::trust);
        let beside_laws = judged.trust_beside(all, rest.free_laws_gain);
        let beside_rest = 1.0 - rest.share.powi(2);
        let beside = |rivals: f64| calibrated(against_all([rivals, size, beside_laws, beside_rest]));
        Trust {
            // Names with an alternative are right as often as they say: of 18 with 24 % in the mean, 28 %. The correction is not for them.
            in_effect: beside(judged.confidence)
                .min(judged.confidence)
                .min(MOST_CONFIDENCE),
            in_any: beside(1.0),
        }
    }
}

/// Confidence, 0 to 1, in an effect. Each number is the confidence that one other explanation alone would leave; their odds against the
/// effect add up, because only one explanation is true.
fn against_all(alone: [f64; 4]) -> f64 {
    let odds = alone.map(|c| 1.0 / c.max(f64::MIN_POSITIVE) - 1.0);
    1.0 / (1.0 + odds.iter().sum::<f64>())
}

/// Corrects a confidence by what blind runs showed: its odds get the exponent [`ODDS_EXPONENT`], and [`FIXED_CONFIDENCE`] stays.
fn calibrated(confidence: f64) -> f64 {
    let odds = |c: f64| c / (1.0 - c).max(f64::MIN_POSITIVE);
    let fixed = odds(FIXED_CONFIDENCE);
    let calibrated = fixed * (odds(confidence) / fixed).powf(ODDS_EXPONENT);
    calibrated / (1.0 + calibrated)
}

#[cfg(test)]
mod tests {
    use super::{against_all, calibrated};

    #[test]
    fn a_doubtful_name_is_right_more_often_than_its_doubts_say() {
        for (before, after) in [
            (0.0, 0.0),
            (0.2, 0.380),
            (0.5, 0.634),
            (0.9, 0.9),
            (0.99, 0.982),
            (1.0, 1.0),
        ] {
            let found = calibrated(before);
            assert!((found - after).abs() < 0.001, "{before}: {found}");
        }
    }

    #[test]
    fn other_explanations_exclude_each_other() {
        assert_eq!(against_all([1.0; 4]), 1.0);
        assert_eq!(against_all([0.5, 1.0, 1.0, 1.0]), 0.5);
        // One of three equal explanations, not the half of a half.
        assert!((against_all([0.5, 0.5, 1.0, 1.0]) - 1.0 / 3.0).abs() < 1e-12);
        assert!(against_all([0.0, 1.0, 1.0, 1.0]) < 1e-300);
    }
}
