//! Statistics over the scores of many cases: shares, medians, calibration of the confidence, confusion matrix.

use std::collections::BTreeMap;

use super::CaseScore;
use crate::diagnose::Verdict;
use crate::identify::confidence::wilson_interval;
use crate::truth::Family;

/// Number of bins of the reliability table.
const BINS: usize = 5;

/// One bin of the reliability table.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct ConfidenceBin {
    /// Lower and upper edge of the confidence.
    pub range: [f64; 2],
    /// Number of named effects with this confidence.
    pub count: usize,
    /// Mean confidence of these effects.
    pub claimed: f64,
    /// Share of these effects that is true.
    pub right: f64,
}

/// A value and the number of values behind it; `None` if there are none.
pub(super) type ReachedValue = (Option<f64>, usize);

/// Share of true flags in percent, and the number of flags.
pub(super) fn share(flags: impl Iterator<Item = bool>) -> ReachedValue {
    let (mut yes, mut all) = (0usize, 0usize);
    for flag in flags {
        all += 1;
        yes += usize::from(flag);
    }
    ((all > 0).then(|| 100.0 * yes as f64 / all as f64), all)
}

/// How many of some cases have a property.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Proportion {
    pub yes: usize,
    pub of: usize,
    /// 95 % interval of the share; `None` without cases.
    pub ci95: Option<[f64; 2]>,
}

impl Proportion {
    /// Counts the true flags. The interval is that of E. B. Wilson (1927).
    pub(crate) fn of(flags: impl Iterator<Item = bool>) -> Proportion {
        let (mut yes, mut of) = (0usize, 0usize);
        for flag in flags {
            of += 1;
            yes += usize::from(flag);
        }
        Proportion {
            yes,
            of,
            ci95: wilson_interval(yes, of),
        }
    }

    /// The share in percent with its interval; empty without cases.
    pub(crate) fn in_percent(self) -> String {
        self.ci95.map_or(String::new(), |[low, high]| {
            let percent = 100.0 * self.yes as f64 / self.of as f64;
            format!("{percent:.0} % ({:.0} to {:.0})", 100.0 * low, 100.0 * high)
        })
    }
}

/// Median of the finite values, and their number.
pub(super) fn median(mut values: Vec<f64>) -> ReachedValue {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let middle = match n {
        0 => None,
        n if n % 2 == 1 => Some(values[n / 2]),
        n => Some(0.5 * (values[n / 2 - 1] + values[n / 2])),
    };
    (middle, n)
}

/// Confidence against truth, one row for each bin that has a named effect.
pub(crate) fn reliability(scores: &[CaseScore]) -> Vec<ConfidenceBin> {
    let claims: Vec<(f64, bool)> = scores.iter().flat_map(CaseScore::claims).collect();
    (0..BINS)
        .filter_map(|b| {
            let range = [b as f64 / BINS as f64, (b + 1) as f64 / BINS as f64];
            let last = b + 1 == BINS;
            let inside: Vec<&(f64, bool)> = claims
                .iter()
                .filter(|(c, _)| *c >= range[0] && (*c < range[1] || last))
                .collect();
            let n = inside.len();
            (n > 0).then(|| ConfidenceBin {
                range,
                count: n,
                claimed: inside.iter().map(|(c, _)| c).sum::<f64>() / n as f64,
                right: inside.iter().filter(|(_, r)| *r).count() as f64 / n as f64,
            })
        })
        .collect()
}

/// Mean difference between mean confidence and share of true effects over the bins, weighted with their number of effects;
/// and the number of all named effects.
pub(super) fn calibration_error(scores: &[CaseScore]) -> ReachedValue {
    let bins = reliability(scores);
    let all: usize = bins.iter().map(|b| b.count).sum();
    let sum: f64 = bins
        .iter()
        .map(|b| b.count as f64 * (b.claimed - b.right).abs())
        .sum();
    ((all > 0).then(|| sum / all as f64), all)
}

/// Number of cases by truth and answer. Cases without an effect, and cases of one effect with at least `strength`.
pub(crate) fn confusion(scores: &[CaseScore], strength: f64) -> BTreeMap<(String, String), usize> {
    let mut counts = BTreeMap::new();
    for s in scores {
        if s.label.family == Family::Pair || (!s.label.hidden.is_empty() && s.label.strength < strength) {
            continue;
        }
        let answer = s
            .answer
            .as_ref()
            .map_or("refused".to_owned(), super::Answer::word);
        *counts.entry((s.word(), answer)).or_insert(0) += 1;
    }
    counts
}

/// Number of right answers and of all cases, by family and strength.
pub(crate) fn by_strength(scores: &[CaseScore]) -> BTreeMap<(Family, u32), (usize, usize)> {
    let mut counts = BTreeMap::new();
    for s in scores {
        let entry = counts
            .entry((s.label.family, s.label.strength.round() as u32))
            .or_insert((0, 0));
        let right = match s.label.family {
            Family::Outside => s.verdict() == Verdict::Unexplained,
            Family::Confounded => s.named_or_alternative().iter().all(|c| *c),
            _ => s.exact(),
        };
        entry.0 += usize::from(right);
        entry.1 += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_intervals_as_published() {
        // R. G. Newcombe (1998), Table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        for (yes, of, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let found = Proportion::of((0..of).map(|k| k < yes)).ci95.expect("cases");
            assert!(
                (found[0] - low).abs() < 1e-4 && (found[1] - high).abs() < 1e-4,
                "{found:?}"
            );
        }
        assert_eq!(Proportion::of(std::iter::empty()).ci95, None);
    }

    #[test]
    fn medians_by_hand() {
        assert_eq!(median(vec![3.0, 1.0, f64::NAN, 2.0]), (Some(2.0), 3));
        assert_eq!(median(vec![1.0, 2.0]), (Some(1.5), 2));
        assert_eq!(median(vec![]), (None, 0));
    }
}
