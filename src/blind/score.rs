//! Compares the answer of one diagnosis with the label of its case.

use super::answer::Answer;
use super::settle::Settling;
use crate::diagnose::Verdict;
use crate::diagnose::note::NoteKind;
use crate::truth::{Family, Hidden, Label, World};

/// Confidence from which an answer counts as sure.
const SURE: f64 = 0.9;

/// A parameter of a named effect, compared with its true value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ComparedParameter {
    /// Lower and upper end of the 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// The true value.
    pub truth: f64,
}

/// A case with its label and its answer.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct CaseScore {
    /// World of the case; the label of a case in `own` does not name it.
    pub world: World,
    pub label: Label,
    /// The answer; `None` if the recordings were refused.
    pub answer: Option<Answer>,
    /// Error text if the recordings were refused.
    pub refused: Option<String>,
    /// Duration of the diagnosis on one core, s.
    pub seconds: f64,
    /// The further tests of a case that needs them.
    pub settling: Option<Settling>,
}

impl CaseScore {
    pub(crate) fn new(
        label: Label,
        answer: Result<Answer, String>,
        seconds: f64,
        settling: Option<Settling>,
    ) -> CaseScore {
        let refused = answer.as_ref().err().cloned();
        CaseScore {
            world: label.world,
            label,
            answer: answer.ok(),
            refused,
            seconds,
            settling,
        }
    }

    /// Codes of all hidden effects, sorted.
    pub(crate) fn truth(&self) -> Vec<&'static str> {
        let mut codes: Vec<_> = self.label.hidden.iter().map(|h| h.code).collect();
        codes.sort_unstable();
        codes
    }

    /// The truth in one word, for the confusion matrix.
    pub(crate) fn word(&self) -> String {
        match self.truth().as_slice() {
            [] => "none".to_owned(),
            [one] => (*one).to_owned(),
            _ => "pair".to_owned(),
        }
    }

    /// Verdict of the answer; `Unexplained` if the recordings were refused.
    pub(crate) fn verdict(&self) -> Verdict {
        self.answer.as_ref().map_or(Verdict::Unexplained, |a| a.verdict)
    }

    /// True if exactly the hidden effects are named, or beside them only what is not wrong.
    pub(crate) fn exact(&self) -> bool {
        let truth = self.truth();
        self.label.family != Family::Outside
            && self.verdict() != Verdict::Unexplained
            && self.answer.as_ref().is_some_and(|a| {
                let codes = a.codes();
                truth.iter().all(|t| codes.contains(t)) && codes.iter().all(|c| self.is_right(c))
            })
    }

    /// True if an effect is hidden or it is not wrong to name it.
    fn is_right(&self, code: &str) -> bool {
        self.label.hidden.iter().any(|h| h.code == code) || self.label.also.contains(&code)
    }

    /// True if the answer says what is imperfect about the recordings, or nothing is.
    pub(crate) fn says_its_nuisance(&self) -> bool {
        let said = |kind| self.answer.as_ref().is_some_and(|a| a.notes.contains(&kind));
        self.label
            .nuisance
            .is_none_or(|name| note_kind(name).is_some_and(said))
    }

    /// True if the last answer after the further tests is exactly the truth; `None` without further tests.
    pub(crate) fn settled(&self) -> Option<bool> {
        let settling = self.settling.as_ref()?;
        let answer = settling.answer.as_ref();
        Some(answer.is_some_and(|a| a.is_exactly(&self.truth())))
    }

    /// For each hidden effect: true if it is named or an alternative.
    pub(crate) fn named_or_alternative(&self) -> Vec<bool> {
        let Some(answer) = &self.answer else {
            return vec![false; self.label.hidden.len()];
        };
        let explained = answer.verdict != Verdict::Unexplained;
        self.truth()
            .iter()
            .map(|t| explained && (answer.codes().contains(t) || answer.alternatives.iter().any(|a| a == t)))
            .collect()
    }

    /// For each local effect: largest intersection over union of a location on the true axis.
    pub(crate) fn overlaps(&self) -> Vec<f64> {
        self.label
            .hidden
            .iter()
            .filter_map(|h| h.interval(self.label.top[0]))
            .map(|(axis, from, to)| {
                let locations = self.answer.iter().flat_map(|a| &a.locations);
                locations
                    .filter(|l| l.0 == axis)
                    .map(|l| overlap([from, to], [l.1, l.2]))
                    .fold(0.0, f64::max)
            })
            .collect()
    }

    /// The named parameters whose true value is known.
    pub(crate) fn compared_parameters(&self) -> Vec<ComparedParameter> {
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
                if let Some(&(.., ci95)) = found {
                    list.push(ComparedParameter { ci95, truth });
                }
            }
        }
        list
    }

    /// Confidence of each named effect, and true if it is right to name it.
    pub(crate) fn claims(&self) -> Vec<(f64, bool)> {
        let claims = self.answer.iter().flat_map(|a| &a.effects);
        claims.map(|(code, c)| (*c, self.is_right(code))).collect()
    }

    /// True if an effect that is not there is named with a high confidence, whatever the verdict.
    pub(crate) fn is_wrong_and_sure(&self) -> bool {
        self.claims()
            .iter()
            .any(|(confidence, right)| *confidence >= SURE && !right)
    }

    /// True if nothing is named, or only what is not wrong.
    pub(crate) fn is_adequate(&self) -> bool {
        self.verdict() == Verdict::Adequate || self.exact()
    }

    /// True if the recordings were understood and not explained. A library that has gained the code may also name it.
    pub(crate) fn is_unknown(&self) -> bool {
        let answer = self.answer.as_ref();
        answer.is_some_and(|a| a.verdict == Verdict::Unexplained || a.codes() == self.truth())
    }

    /// Also true if the effect of the library with the same mechanism is named for each hidden law, and nothing wrong beside it. A bump stop
    /// has the mechanism of progressive stiffness.
    pub(crate) fn is_unknown_or_its_mechanism(&self) -> bool {
        let answer = self.answer.as_ref();
        let named = answer.is_some_and(|a| {
            let codes = a.codes();
            let mechanism = |h: &Hidden| h.also().iter().any(|code| codes.contains(code));
            self.label.hidden.iter().all(mechanism) && codes.iter().all(|code| self.is_right(code))
        });
        self.is_unknown() || named
    }
}

/// The note that an imperfection of `truth` must lead to.
fn note_kind(nuisance: &str) -> Option<NoteKind> {
    let kind = match nuisance {
        "flicker_noise" | "correlated_noise" => NoteKind::Colour,
        "vibration" => NoteKind::Hum,
        "spikes" => NoteKind::Spike,
        "gaps" => NoteKind::Gap,
        "start_in_mid_cycle" => NoteKind::Start,
        "tare" | "displacement_zero" => NoteKind::Zero,
        "skew" => NoteKind::Skew,
        "polarity" => NoteKind::Polarity,
        _ => return None,
    };
    Some(kind)
}

/// Intersection over union of two intervals.
fn overlap(a: [f64; 2], b: [f64; 2]) -> f64 {
    let common = (a[1].min(b[1]) - a[0].max(b[0])).max(0.0);
    let union = a[1].max(b[1]) - a[0].min(b[0]);
    if union > 0.0 { common / union } else { 0.0 }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A score with the hidden effects `truth`, each at 10 of 25 mm, and an answer with these named effects and alternatives.
    pub(crate) fn score(truth: &[&'static str], named: &[&str], alternatives: &[&str]) -> CaseScore {
        let hidden = truth
            .iter()
            .map(|code| Hidden {
                code,
                size: 5.0,
                place: 10.0,
                width: 2.0,
                law: None,
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
            world: World::Own,
            nuisance: None,
            also: Vec::new(),
        };
        let answer = Answer {
            verdict: if named.is_empty() {
                Verdict::Adequate
            } else {
                Verdict::MissingPhysics
            },
            effects: named.iter().map(|c| ((*c).to_owned(), 0.9)).collect(),
            gains: Vec::new(),
            shape_shares: [None; 2],
            free_laws_gain: 0.0,
            parameters: vec![(
                "progressive_stiffness".to_owned(),
                "knee_mm".to_owned(),
                10.1,
                Some([9.8, 10.4]),
            )],
            alternatives: alternatives.iter().map(|c| (*c).to_owned()).collect(),
            locations: vec![("displacement_mm".to_owned(), 13.0, 25.0)],
            notes: Vec::new(),
            heldout: 1.05,
            heldout_before: 3.0,
        };
        CaseScore::new(label, Ok(answer), 1.0, None)
    }

    #[test]
    fn an_imperfection_is_said_by_a_note_of_its_kind() {
        assert!(crate::truth::imperfections().all(|name| note_kind(name).is_some()));
        let mut vibrating = score(&[], &[], &[]);
        assert!(vibrating.says_its_nuisance(), "there is none");
        vibrating.label.nuisance = Some("vibration");
        let answer = vibrating.answer.as_mut().expect("an answer");
        answer.notes = vec![NoteKind::Colour];
        assert!(!vibrating.says_its_nuisance());
        let answer = vibrating.answer.as_mut().expect("an answer");
        answer.notes.push(NoteKind::Hum);
        assert!(vibrating.says_its_nuisance());
    }

    #[test]
    fn exact_means_all_hidden_effects_and_no_other() {
        let knee = "progressive_stiffness";
        assert!(score(&[knee], &[knee], &[]).exact());
        assert!(!score(&[knee], &[knee, "inertia"], &[]).exact());
        assert!(!score(&[knee, "inertia"], &[knee], &["inertia"]).exact());
        assert_eq!(
            score(&[knee, "inertia"], &["relaxation"], &["inertia"]).named_or_alternative(),
            [true, false]
        );
        assert!(score(&[], &[], &[]).exact());
    }

    #[test]
    fn a_law_outside_the_library_may_be_named_by_its_mechanism() {
        let counts = |hidden, named: &[&str]| {
            let mut s = score(&[hidden], named, &[]);
            s.label.also = s.label.hidden[0].also().to_vec();
            [s.is_unknown(), s.is_unknown_or_its_mechanism()]
        };
        assert_eq!(counts("bump_stop", &["progressive_stiffness"]), [false, true]);
        assert_eq!(
            counts("bump_stop", &["progressive_stiffness", "inertia"]),
            [false, false]
        );
        assert_eq!(counts("ripple", &["progressive_stiffness"]), [false, false]);
        assert_eq!(counts("ripple", &[]), [false, false], "adequate");
        assert_eq!(counts("warming", &["warming"]), [true, true]);
    }

    #[test]
    fn overlaps_parameters_and_claims_by_hand() {
        let s = score(&["progressive_stiffness"], &["progressive_stiffness"], &[]);
        // 10..25 against 13..25: 12 of 15.
        assert_eq!(s.overlaps(), [0.8]);
        let knee = ComparedParameter {
            ci95: Some([9.8, 10.4]),
            truth: 10.0,
        };
        assert_eq!(s.compared_parameters(), [knee]);
        assert_eq!(s.claims(), [(0.9, true)]);
        assert_eq!(overlap([0.0, 1.0], [2.0, 3.0]), 0.0);
    }

    #[test]
    fn every_compared_parameter_is_one_of_the_effect_with_that_code() {
        for physics in crate::truth::catalogue::PHYSICS.iter().filter(|p| p.in_library) {
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
