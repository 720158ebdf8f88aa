//! The requirements of the blind test: for each one, the required and the reached value.

use super::CaseScore;
use super::statistics::{ReachedValue, calibration_error, median, share};
use crate::diagnose::Verdict;
use crate::truth::Family;

/// One requirement, and whether it is met.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Requirement {
    /// What is measured, in words.
    pub what: &'static str,
    /// Required value, in words.
    #[serde(rename = "asked")]
    pub required: &'static str,
    /// Reached value; `None` if no case counts for it.
    pub reached: Option<f64>,
    /// Unit of the reached value: `%`, `s` or empty.
    pub unit: &'static str,
    /// Number of cases or values behind the reached value.
    pub count: usize,
    pub met: bool,
}

/// Compares all scores with the requirements. `look_alikes` count only for the rows of `--run-next`.
pub(crate) fn requirements(scores: &[CaseScore], look_alikes: &[CaseScore]) -> Vec<Requirement> {
    ROWS.iter()
        .map(|row| {
            let (reached, count) = (row.reached)(scores, look_alikes);
            Requirement {
                what: row.what,
                required: row.required,
                reached,
                unit: row.unit,
                count,
                met: reached.is_some_and(row.met),
            }
        })
        .collect()
}

/// A requirement before it is evaluated.
struct Row {
    what: &'static str,
    required: &'static str,
    unit: &'static str,
    met: fn(f64) -> bool,
    /// The reached value, from the scores of all cases and those of the further cases with a look-alike.
    reached: fn(&[CaseScore], &[CaseScore]) -> ReachedValue,
}

static ROWS: &[Row] = &[
    Row {
        what: "exact set, single effect, strength 5 and up",
        required: "at least 95 %",
        unit: "%",
        met: |v| v >= 95.0,
        reached: |scores, _| {
            share(
                from_strength(5.0, scores)
                    .filter(one_effect)
                    .map(CaseScore::exact),
            )
        },
    },
    Row {
        what: "exact set, two effects, strength 5 and up",
        required: "at least 80 %",
        unit: "%",
        met: |v| v >= 80.0,
        reached: |scores, _| {
            share(
                from_strength(5.0, scores)
                    .filter(two_effects)
                    .map(CaseScore::exact),
            )
        },
    },
    Row {
        what: "true effect named or an alternative, strength 2 and up",
        required: "at least 95 %",
        unit: "%",
        met: |v| v >= 95.0,
        reached: |scores, _| {
            let known = from_strength(2.0, scores).filter(in_library);
            share(known.flat_map(CaseScore::named_or_alternative))
        },
    },
    Row {
        what: "false alarms, nothing hidden",
        required: "at most 2 %",
        unit: "%",
        met: |v| v <= 2.0,
        reached: |scores, _| {
            let empty = scores.iter().filter(nothing_hidden);
            share(empty.map(|s| s.verdict() != Verdict::Adequate))
        },
    },
    Row {
        what: "`unknown` for effects outside the library, strength 2 and up",
        required: "at least 90 %",
        unit: "%",
        met: |v| v >= 90.0,
        reached: |scores, _| share(from_strength(2.0, scores).filter(outside).map(unknown)),
    },
    Row {
        what: "`unknown` for effects inside the library",
        required: "at most 5 %",
        unit: "%",
        met: |v| v <= 5.0,
        reached: |scores, _| share(scores.iter().filter(in_library).map(unknown)),
    },
    Row {
        what: "located interval, intersection over union, median, strength 2 and up",
        required: "at least 0.7",
        unit: "",
        met: |v| v >= 0.7,
        reached: |scores, _| median(from_strength(2.0, scores).flat_map(CaseScore::overlaps).collect()),
    },
    Row {
        what: "95 % intervals that contain the true value",
        required: "90 to 99 %",
        unit: "%",
        met: |v| (90.0..=99.0).contains(&v),
        reached: |scores, _| {
            let compared = scores.iter().flat_map(CaseScore::compared_parameters);
            share(compared.map(|p| {
                p.ci95
                    .is_some_and(|[low, high]| low <= p.truth && p.truth <= high)
            }))
        },
    },
    Row {
        what: "held-out error with the effects, divided by the noise floor, exact cases, median",
        required: "at most 1.15",
        unit: "",
        met: |v| v <= 1.15,
        reached: |scores, _| {
            let exact = scores.iter().filter(|s| s.exact() && !s.label.hidden.is_empty());
            median(
                exact
                    .filter_map(|s| s.answer.as_ref().map(|a| a.heldout))
                    .collect(),
            )
        },
    },
    Row {
        what: "settled by `--run-next`, cases with a look-alike, all strengths",
        required: "at least 80 %",
        unit: "%",
        met: |v| v >= 80.0,
        reached: |scores, look_alikes| share(scores.iter().chain(look_alikes).filter_map(CaseScore::settled)),
    },
    Row {
        what: "expected calibration error of the confidence",
        required: "at most 0.05",
        unit: "",
        met: |v| v <= 0.05,
        reached: |scores, _| calibration_error(scores),
    },
    Row {
        what: "time of a case on one core, median",
        required: "at most 10 s (5 s on two cores)",
        unit: "s",
        met: |v| v <= 10.0,
        reached: |scores, _| median(scores.iter().map(|s| s.seconds).collect()),
    },
    Row {
        what: "time of all tests and diagnoses of `--run-next` on one core, median",
        required: "no requirement",
        unit: "s",
        met: |_| true,
        reached: |scores, look_alikes| {
            let all = scores.iter().chain(look_alikes);
            median(
                all.filter_map(|s| s.settling.as_ref().map(|n| n.seconds))
                    .collect(),
            )
        },
    },
];

fn from_strength(strength: f64, scores: &[CaseScore]) -> impl Iterator<Item = &CaseScore> {
    scores.iter().filter(move |s| s.label.strength >= strength)
}

fn one_effect(score: &&CaseScore) -> bool {
    matches!(score.label.family, Family::Single | Family::Concealed)
}

fn two_effects(score: &&CaseScore) -> bool {
    score.label.family == Family::Pair
}

fn nothing_hidden(score: &&CaseScore) -> bool {
    matches!(score.label.family, Family::None | Family::NoneNoisy)
}

fn outside(score: &&CaseScore) -> bool {
    score.label.family == Family::Outside
}

fn in_library(score: &&CaseScore) -> bool {
    score.label.family.is_in_library()
}

fn unknown(score: &CaseScore) -> bool {
    score.verdict() == Verdict::Unexplained
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::score;
    use super::*;

    #[test]
    fn reached_values_by_hand() {
        let knee = "progressive_stiffness";
        let scores = [
            score(&[knee], &[knee], &[]),
            score(&[knee], &["inertia"], &[]),
            score(&[], &[], &[]),
            score(&[], &["inertia"], &[]),
        ];
        let found = requirements(&scores, &[]);
        let reached = |what: &str| {
            found
                .iter()
                .find(|r| r.what.starts_with(what))
                .expect("row")
                .reached
        };
        assert_eq!(reached("exact set, single"), Some(50.0));
        assert_eq!(reached("exact set, two"), None);
        assert_eq!(reached("false alarms"), Some(50.0));
        assert_eq!(reached("located interval"), Some(0.8));
        // Three claims with a confidence of 0.9, one of them true.
        let ece = reached("expected calibration").expect("claims");
        assert!((ece - (0.9 - 1.0 / 3.0)).abs() < 1e-12);
        assert!(found.iter().filter(|r| r.reached.is_none()).all(|r| !r.met));
    }

    /// A control of the scoring: with swapped labels, a perfect diagnosis scores as badly as a wrong one.
    #[test]
    fn swapped_labels_give_no_exact_set() {
        let codes = ["inertia", "relaxation", "viscous_damping", "backlash"];
        let right: Vec<CaseScore> = codes.iter().map(|c| score(&[c], &[c], &[])).collect();
        let swapped: Vec<CaseScore> = (0..4)
            .map(|i| CaseScore {
                label: right[(i + 1) % 4].label.clone(),
                ..right[i].clone()
            })
            .collect();
        assert_eq!(requirements(&right, &[])[0].reached, Some(100.0));
        assert_eq!(requirements(&swapped, &[])[0].reached, Some(0.0));
    }
}
