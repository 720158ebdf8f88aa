//! Many marks put together: the figures, the calibration of the confidence, the confusion matrix.

use std::collections::BTreeMap;

use super::Mark;
use crate::diagnose::Verdict;
use crate::truth::Family;

/// Bins of the reliability table.
const BINS: usize = 5;

/// One figure against what is asked for.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Figure {
    /// What.
    pub what: &'static str,
    /// Asked for, in words.
    pub asked: &'static str,
    /// Reached; none where no case bears on it.
    pub reached: Option<f64>,
    /// Unit: `%`, `s`, or empty.
    pub unit: &'static str,
    /// Cases or values that it stands on.
    pub count: usize,
    /// Reached what is asked for?
    pub met: bool,
}

/// One bin of the reliability table.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct ConfidenceBin {
    /// Lower and upper edge of the confidence.
    pub range: [f64; 2],
    /// Claims in it.
    pub count: usize,
    /// Their mean confidence.
    pub claimed: f64,
    /// Share of them that is true.
    pub right: f64,
}

/// A share of marks in percent, with the number it stands on.
fn share(flags: impl Iterator<Item = bool>) -> (Option<f64>, usize) {
    let (mut yes, mut all) = (0usize, 0usize);
    for flag in flags {
        all += 1;
        yes += usize::from(flag);
    }
    ((all > 0).then(|| 100.0 * yes as f64 / all as f64), all)
}

fn median(mut values: Vec<f64>) -> (Option<f64>, usize) {
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

/// The table; `look_alikes` count for the rows of `--run-next` alone.
pub(crate) fn figures(marks: &[Mark], look_alikes: &[Mark]) -> Vec<Figure> {
    let one = |m: &&Mark| matches!(m.label.family, Family::Single | Family::Concealed);
    let two = |m: &&Mark| m.label.family == Family::Pair;
    let none = |m: &&Mark| matches!(m.label.family, Family::None | Family::NoneNoisy);
    let outside = |m: &&Mark| m.label.family == Family::Outside;
    let at_least = |s: f64| move |m: &&Mark| m.label.strength >= s;
    let inside = |m: &&Mark| !m.label.hidden.is_empty() && m.label.family != Family::Outside;
    let unknown = |m: &Mark| m.verdict() == Verdict::Unexplained;
    let row = |what, asked, (reached, count): (Option<f64>, usize), unit, good: fn(f64) -> bool| Figure {
        what,
        asked,
        reached,
        unit,
        count,
        met: reached.is_some_and(good),
    };
    let inside_covered = marks
        .iter()
        .filter(inside)
        .filter(at_least(2.0))
        .flat_map(Mark::covered);
    let intervals: Vec<bool> = marks
        .iter()
        .flat_map(Mark::intervals)
        .map(|(_, _, ci95, truth)| ci95.is_some_and(|[low, high]| low <= truth && truth <= high))
        .collect();
    let overlaps = marks
        .iter()
        .filter(at_least(2.0))
        .flat_map(Mark::overlaps)
        .collect();
    let heldout = marks
        .iter()
        .filter(|m| m.exact() && !m.label.hidden.is_empty())
        .filter_map(|m| m.answer.as_ref().map(|a| a.heldout));
    let settling = || marks.iter().chain(look_alikes);
    let settlings = settling().filter_map(|m| m.settling.as_ref());
    let (ece, claims) = calibration_error(marks);
    vec![
        row(
            "exact set, single effect, strength 5 and up",
            "at least 95 %",
            share(marks.iter().filter(one).filter(at_least(5.0)).map(Mark::exact)),
            "%",
            |v| v >= 95.0,
        ),
        row(
            "exact set, two effects, strength 5 and up",
            "at least 80 %",
            share(marks.iter().filter(two).filter(at_least(5.0)).map(Mark::exact)),
            "%",
            |v| v >= 80.0,
        ),
        row(
            "true effect named or an alternative, strength 2 and up",
            "at least 95 %",
            share(inside_covered),
            "%",
            |v| v >= 95.0,
        ),
        row(
            "false alarms on none",
            "at most 2 %",
            share(
                marks
                    .iter()
                    .filter(none)
                    .map(|m| m.verdict() != Verdict::Adequate),
            ),
            "%",
            |v| v <= 2.0,
        ),
        row(
            "`unknown` on effects outside the library, strength 2 and up",
            "at least 90 %",
            share(marks.iter().filter(outside).filter(at_least(2.0)).map(unknown)),
            "%",
            |v| v >= 90.0,
        ),
        row(
            "`unknown` on effects inside the library",
            "at most 5 %",
            share(marks.iter().filter(inside).map(unknown)),
            "%",
            |v| v <= 5.0,
        ),
        row(
            "located interval, intersection over union, median, strength 2 and up",
            "at least 0.7",
            median(overlaps),
            "",
            |v| v >= 0.7,
        ),
        row(
            "95 % intervals that cover the truth",
            "90 to 99 %",
            share(intervals.into_iter()),
            "%",
            |v| (90.0..=99.0).contains(&v),
        ),
        row(
            "held-out error after, in units of the noise floor, named cases, median",
            "at most 1.15",
            median(heldout.collect()),
            "",
            |v| v <= 1.15,
        ),
        row(
            "settled by `--run-next`, one with a look-alike, all strengths",
            "at least 80 %",
            share(settling().filter_map(Mark::settled)),
            "%",
            |v| v >= 80.0,
        ),
        row(
            "expected calibration error of the confidence",
            "at most 0.05",
            (ece, claims),
            "",
            |v| v <= 0.05,
        ),
        row(
            "time of a case on one core, median",
            "at most 10 s (5 s on two cores)",
            median(marks.iter().map(|m| m.seconds).collect()),
            "s",
            |v| v <= 10.0,
        ),
        row(
            "time of all tests and diagnoses of `--run-next` on one core, median",
            "none",
            median(settlings.map(|s| s.seconds).collect()),
            "s",
            |_| true,
        ),
    ]
}

/// Reliability of the confidence, bins that hold a claim.
pub(crate) fn reliability(marks: &[Mark]) -> Vec<ConfidenceBin> {
    let claims: Vec<(f64, bool)> = marks.iter().flat_map(Mark::claims).collect();
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

/// Mean distance between claimed and right over the bins, weighted with their claims.
fn calibration_error(marks: &[Mark]) -> (Option<f64>, usize) {
    let bins = reliability(marks);
    let all: usize = bins.iter().map(|b| b.count).sum();
    let sum: f64 = bins
        .iter()
        .map(|b| b.count as f64 * (b.claimed - b.right).abs())
        .sum();
    ((all > 0).then(|| sum / all as f64), all)
}

/// Truth, answer, count: cases of one hidden effect or none, from a strength on.
pub(crate) fn confusion(marks: &[Mark], strength: f64) -> BTreeMap<(String, String), usize> {
    let mut counts = BTreeMap::new();
    for m in marks {
        if m.label.family == Family::Pair || (!m.label.hidden.is_empty() && m.label.strength < strength) {
            continue;
        }
        let answer = m
            .answer
            .as_ref()
            .map_or("refused".to_owned(), super::Answer::word);
        *counts.entry((m.word(), answer)).or_insert(0) += 1;
    }
    counts
}

/// Share of exact answers by family and strength, with counts: `(family, strength) -> (exact, all)`.
pub(crate) fn by_strength(marks: &[Mark]) -> BTreeMap<(Family, u32), (usize, usize)> {
    let mut counts = BTreeMap::new();
    for m in marks {
        let entry = counts
            .entry((m.label.family, m.label.strength.round() as u32))
            .or_insert((0, 0));
        let right = match m.label.family {
            Family::Outside => m.verdict() == Verdict::Unexplained,
            Family::Confounded => m.covered().iter().all(|c| *c),
            _ => m.exact(),
        };
        entry.0 += usize::from(right);
        entry.1 += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::super::score::tests::mark;
    use super::*;

    #[test]
    fn figures_by_hand() {
        let knee = "progressive_stiffness";
        let marks = [
            mark(&[knee], &[knee], &[]),
            mark(&[knee], &["inertia"], &[]),
            mark(&[], &[], &[]),
            mark(&[], &["inertia"], &[]),
        ];
        let found = figures(&marks, &[]);
        let reached = |what: &str| {
            found
                .iter()
                .find(|f| f.what.starts_with(what))
                .expect("row")
                .reached
        };
        assert_eq!(reached("exact set, single"), Some(50.0));
        assert_eq!(reached("exact set, two"), None);
        assert_eq!(reached("false alarms"), Some(50.0));
        assert_eq!(reached("located interval"), Some(0.8));
        // Three claims of 0.9, one of them true.
        let ece = reached("expected calibration").expect("claims");
        assert!((ece - (0.9 - 1.0 / 3.0)).abs() < 1e-12);
        assert!(found.iter().filter(|f| f.reached.is_none()).all(|f| !f.met));
    }

    /// The control of the scoring itself: with labels swapped, a perfect diagnosis is as bad as a wrong one.
    #[test]
    fn swapped_labels_find_nothing() {
        let codes = ["inertia", "relaxation", "viscous_damping", "backlash"];
        let right: Vec<Mark> = codes.iter().map(|c| mark(&[c], &[c], &[])).collect();
        let swapped: Vec<Mark> = (0..4)
            .map(|i| Mark {
                label: right[(i + 1) % 4].label.clone(),
                ..right[i].clone()
            })
            .collect();
        assert_eq!(figures(&right, &[])[0].reached, Some(100.0));
        assert_eq!(figures(&swapped, &[])[0].reached, Some(0.0));
    }

    #[test]
    fn medians_by_hand() {
        assert_eq!(median(vec![3.0, 1.0, f64::NAN, 2.0]), (Some(2.0), 3));
        assert_eq!(median(vec![1.0, 2.0]), (Some(1.5), 2));
        assert_eq!(median(vec![]), (None, 0));
    }
}
