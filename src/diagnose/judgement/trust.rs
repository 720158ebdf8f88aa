//! Confidence in a named effect.

use super::alternatives::JudgedEffect;
use super::error_of_form::{FreeLaws, trust_beside};
use super::rest::Rest;
use super::varying_coefficient::{Variation, variation};
use crate::diagnose::fitting::FitContext;
use crate::diagnose::search::SearchResult;

/// Exponent that corrects the odds of a confidence. Of 312 names in 400 cases of five worlds (seed 1427208227), 119 had 20 to 70 % with an
/// exponent of 0.75 where there was no alternative and 1 where there was: 46 % in the mean, but 63 % of them were right. The calibration error
/// was 0.09; with this exponent for all it is 0.04. At half, names of 99 % get 95 %, and names of 10 % get 71 %. At double it is above 1, and
/// doubtful names get even less.
const ODDS_EXPONENT: f64 = 0.6;
/// Confidence that the exponent does not change. Of 121 names with at least that, 116 were right. From here a wrong name counts as sure.
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
        (laws, rest): (FreeLaws, &Rest),
    ) -> Trust {
        let node = &search.nodes[search.chosen];
        let variation = variation(context, search.likelihood, node, judged.place);
        let size = variation.map_or(1.0, Variation::trust);
        let beside_laws = trust_beside(judged, all, laws);
        let beside_rest = 1.0 - rest.share.powi(2);
        let beside = |rivals: f64| calibrated(against_all([rivals, size, beside_laws, beside_rest]));
        // The effects of a group share one confidence, because one of them is true.
        let most = match judged.group.is_empty() {
            true => 1.0,
            false => judged.confidence,
        };
        Trust {
            in_effect: beside(judged.confidence).min(most).min(MOST_CONFIDENCE),
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
            (0.2, 0.512),
            (0.5, 0.707),
            (0.9, 0.9),
            (0.99, 0.974),
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
