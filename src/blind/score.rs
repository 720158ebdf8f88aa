//! One answer against one label.

use super::settle::Settling;
use crate::diagnose::{Diagnosis, Verdict};
use crate::truth::{Family, Label};

/// What of a diagnosis is judged.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Answer {
    /// In one word.
    pub verdict: Verdict,
    /// Code and confidence of what is named.
    pub effects: Vec<(String, f64)>,
    /// Code, parameter, value and interval of what is named.
    pub parameters: Vec<(String, String, f64, Option<[f64; 2]>)>,
    /// Codes given as alternatives to something named.
    pub alternatives: Vec<String>,
    /// Axis, from, to.
    pub locations: Vec<(String, f64, f64)>,
    /// Held-out error after, in units of the noise floor.
    pub heldout: f64,
    /// The same before.
    pub heldout_before: f64,
}

impl Answer {
    /// From a diagnosis.
    pub(crate) fn of(d: &Diagnosis) -> Answer {
        let floor = d.fit.noise_floor_nrmse.max(1e-12);
        Answer {
            verdict: d.verdict,
            effects: d.effects.iter().map(|e| (e.code.clone(), e.confidence)).collect(),
            parameters: d
                .effects
                .iter()
                .flat_map(|e| {
                    e.parameters
                        .iter()
                        .map(|p| (e.code.clone(), p.name.clone(), p.value, p.ci95))
                })
                .collect(),
            alternatives: d
                .alternatives
                .iter()
                .filter(|a| a.instead_of != "unknown")
                .map(|a| a.code.clone())
                .collect(),
            locations: d
                .location
                .iter()
                .map(|l| (axis_name(l.axis), l.from, l.to))
                .collect(),
            heldout: d.fit.improved.nrmse_heldout / floor,
            heldout_before: d.fit.baseline.nrmse_heldout / floor,
        }
    }

    /// Codes named, sorted.
    pub(crate) fn codes(&self) -> Vec<&str> {
        let mut codes: Vec<&str> = self.effects.iter().map(|(c, _)| c.as_str()).collect();
        codes.sort_unstable();
        codes
    }

    /// Are exactly these effects named, with nothing that it could be instead?
    pub(crate) fn is_just(&self, truth: &[&str]) -> bool {
        self.verdict != Verdict::Unexplained && self.codes() == truth && self.alternatives.is_empty()
    }

    /// What is named, and what it could be instead.
    pub(crate) fn in_words(&self) -> String {
        let named = match (self.verdict, self.codes().as_slice()) {
            (Verdict::MissingPhysics, codes) => codes.join(" and "),
            _ => self.word(),
        };
        match self.alternatives.as_slice() {
            [] => named,
            others => format!("{named} or {}", others.join(", ")),
        }
    }

    /// In one word for the confusion matrix.
    pub(crate) fn word(&self) -> String {
        match (self.verdict, self.codes().as_slice()) {
            (Verdict::Unexplained, _) => "unknown".to_owned(),
            (_, []) => "none".to_owned(),
            (_, [one]) => (*one).to_owned(),
            _ => "several".to_owned(),
        }
    }
}

/// Name of an axis in contracts.md.
fn axis_name(axis: crate::diagnose::diagnosis::Axis) -> String {
    serde_json::to_value(axis)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// A case that was judged.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Mark {
    /// What was true.
    pub label: Label,
    /// What was answered; none where the input was refused.
    pub answer: Option<Answer>,
    /// Why it was refused.
    pub refused: Option<String>,
    /// Time of the diagnosis on one core.
    pub seconds: f64,
    /// The tests that followed, where there was something to settle.
    pub settling: Option<Settling>,
}

impl Mark {
    /// Puts label and answer together.
    pub(crate) fn new(
        label: Label,
        answer: Result<Answer, String>,
        seconds: f64,
        settling: Option<Settling>,
    ) -> Mark {
        let refused = answer.as_ref().err().cloned();
        Mark {
            label,
            answer: answer.ok(),
            refused,
            seconds,
            settling,
        }
    }

    /// True codes, sorted; outsiders too.
    pub(crate) fn truth(&self) -> Vec<&'static str> {
        let mut codes: Vec<_> = self.label.hidden.iter().map(|h| h.code).collect();
        codes.sort_unstable();
        codes
    }

    /// In one word for the confusion matrix.
    pub(crate) fn word(&self) -> String {
        match self.truth().as_slice() {
            [] => "none".to_owned(),
            [one] => (*one).to_owned(),
            _ => "pair".to_owned(),
        }
    }

    /// Verdict, or `Unexplained` where the input was refused.
    pub(crate) fn verdict(&self) -> Verdict {
        self.answer.as_ref().map_or(Verdict::Unexplained, |a| a.verdict)
    }

    /// Were exactly the true effects named?
    pub(crate) fn exact(&self) -> bool {
        self.label.family != Family::Outside
            && self.verdict() != Verdict::Unexplained
            && self.answer.as_ref().is_some_and(|a| a.codes() == self.truth())
    }

    /// Whether the rounds ended with the true effects alone; none where there was nothing to settle.
    pub(crate) fn settled(&self) -> Option<bool> {
        let settling = self.settling.as_ref()?;
        let answer = settling.answer.as_ref();
        Some(answer.is_some_and(|a| a.is_just(&self.truth())))
    }

    /// One entry a true effect: is it named or among the alternatives?
    pub(crate) fn covered(&self) -> Vec<bool> {
        let Some(answer) = &self.answer else {
            return vec![false; self.label.hidden.len()];
        };
        let sound = answer.verdict != Verdict::Unexplained;
        self.truth()
            .iter()
            .map(|t| sound && (answer.codes().contains(t) || answer.alternatives.iter().any(|a| a == t)))
            .collect()
    }

    /// Intersection over union of the best place on the true axis, one a local effect.
    pub(crate) fn overlaps(&self) -> Vec<f64> {
        self.label
            .hidden
            .iter()
            .filter_map(|h| h.interval(self.label.top[0]))
            .map(|(axis, from, to)| {
                let places = self.answer.iter().flat_map(|a| &a.locations);
                places
                    .filter(|l| l.0 == axis)
                    .map(|l| overlap([from, to], [l.1, l.2]))
                    .fold(0.0, f64::max)
            })
            .collect()
    }

    /// Name, value, interval and truth of every parameter that can be compared.
    pub(crate) fn intervals(&self) -> Vec<(&'static str, f64, Option<[f64; 2]>, f64)> {
        let Some(answer) = &self.answer else {
            return Vec::new();
        };
        let mut list = Vec::new();
        for hidden in &self.label.hidden {
            for (name, truth) in hidden.parameters(self.label.top[1]) {
                let found = answer
                    .parameters
                    .iter()
                    .find(|(code, parameter, ..)| code == hidden.code && parameter == name);
                if let Some((_, _, value, ci95)) = found {
                    list.push((name, *value, *ci95, truth));
                }
            }
        }
        list
    }

    /// Confidence of each named effect, and whether it is true.
    pub(crate) fn claims(&self) -> Vec<(f64, bool)> {
        let truth = self.truth();
        let claims = self.answer.iter().flat_map(|a| &a.effects);
        claims
            .map(|(code, c)| (*c, truth.contains(&code.as_str())))
            .collect()
    }
}

fn overlap(a: [f64; 2], b: [f64; 2]) -> f64 {
    let common = (a[1].min(b[1]) - a[0].max(b[0])).max(0.0);
    let union = a[1].max(b[1]) - a[0].min(b[0]);
    if union > 0.0 { common / union } else { 0.0 }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::truth::Hidden;

    /// A case with one knee at 10 of 25 mm, named or not.
    pub(crate) fn mark(truth: &[&'static str], named: &[&str], alternatives: &[&str]) -> Mark {
        let hidden = truth
            .iter()
            .map(|code| Hidden {
                code,
                size: 5.0,
                place: 10.0,
                width: 2.0,
            })
            .collect();
        let label = Label {
            number: 0,
            seed: 1,
            family: match truth.len() {
                0 => Family::None,
                1 => Family::Single,
                _ => Family::Pair,
            },
            hidden,
            strength: 5.0,
            look_alike: None,
            top: [25.0, 2000.0],
            sigma_n: 1.0,
        };
        let answer = Answer {
            verdict: if named.is_empty() {
                Verdict::Adequate
            } else {
                Verdict::MissingPhysics
            },
            effects: named.iter().map(|c| ((*c).to_owned(), 0.9)).collect(),
            parameters: vec![(
                "progressive_stiffness".to_owned(),
                "knee_mm".to_owned(),
                10.1,
                Some([9.8, 10.4]),
            )],
            alternatives: alternatives.iter().map(|c| (*c).to_owned()).collect(),
            locations: vec![("displacement_mm".to_owned(), 13.0, 25.0)],
            heldout: 1.05,
            heldout_before: 3.0,
        };
        Mark::new(label, Ok(answer), 1.0, None)
    }

    #[test]
    fn exact_means_all_and_nothing_else() {
        let knee = "progressive_stiffness";
        assert!(mark(&[knee], &[knee], &[]).exact());
        assert!(!mark(&[knee], &[knee, "inertia"], &[]).exact());
        assert!(!mark(&[knee, "inertia"], &[knee], &["inertia"]).exact());
        assert_eq!(
            mark(&[knee, "inertia"], &["relaxation"], &["inertia"]).covered(),
            [true, false]
        );
        assert!(mark(&[], &[], &[]).exact());
    }

    #[test]
    fn overlap_interval_and_claims_by_hand() {
        let m = mark(&["progressive_stiffness"], &["progressive_stiffness"], &[]);
        // 10..25 against 13..25: 12 of 15.
        assert_eq!(m.overlaps(), [0.8]);
        assert_eq!(m.intervals(), [("knee_mm", 10.1, Some([9.8, 10.4]), 10.0)]);
        assert_eq!(m.claims(), [(0.9, true)]);
        assert_eq!(overlap([0.0, 1.0], [2.0, 3.0]), 0.0);
    }

    #[test]
    fn every_compared_parameter_is_one_of_the_effect_with_that_code() {
        for physics in crate::truth::hidden::PHYSICS.iter().filter(|p| p.in_library) {
            let effect = crate::effect::find(physics.code).expect("a code of the library");
            for name in physics.compared.iter().flatten() {
                assert!(
                    effect.parameters.iter().any(|p| p.name == *name),
                    "effect {} has no parameter {name}",
                    effect.code
                );
            }
        }
    }
}
