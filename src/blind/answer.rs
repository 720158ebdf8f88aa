//! The answer of one diagnosis: the parts that `score` compares with the label.

use crate::diagnose::note::NoteKind;
use crate::diagnose::{Diagnosis, Verdict};

/// The parts of a diagnosis that are scored.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Answer {
    pub verdict: Verdict,
    /// Code and confidence of each named effect.
    pub effects: Vec<(String, f64)>,
    /// Gain of each named effect in log-likelihood, and the relative spread of its size over parts of the recordings.
    pub gains: Vec<(Option<f64>, Option<f64>)>,
    /// Share of the friction and of the curve that was left to the shape of a law in doubt; `None` where none was.
    pub shape_shares: [Option<f64>; 2],
    /// Gain of the free shape of the laws, in log-likelihood.
    pub free_laws_gain: f64,
    /// Code, parameter, value and 95 % interval of each parameter of the named effects.
    pub parameters: Vec<(String, String, f64, Option<[f64; 2]>)>,
    /// Codes of the alternatives to the named effects.
    pub alternatives: Vec<String>,
    /// Axis, lower end and upper end of each location.
    pub locations: Vec<(String, f64, f64)>,
    /// What is imperfect about the recordings, in their order.
    pub notes: Vec<NoteKind>,
    /// Held-out error of the improved model divided by the noise floor.
    pub heldout: f64,
    /// Held-out error of the baseline divided by the noise floor.
    pub heldout_before: f64,
}

impl Answer {
    pub(crate) fn of(d: &Diagnosis) -> Answer {
        let floor = d.fit.noise_floor_nrmse.max(1e-12);
        Answer {
            verdict: d.verdict,
            effects: d.effects.iter().map(|e| (e.code.clone(), e.confidence)).collect(),
            gains: d.effects.iter().map(|e| (e.gain, e.size_spread)).collect(),
            shape_shares: [d.friction_shape_share, d.curve_shape_share],
            free_laws_gain: d.free_laws_gain,
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
            notes: d.notes.iter().map(|note| note.kind).collect(),
            heldout: d.fit.improved.nrmse_heldout / floor,
            heldout_before: d.fit.baseline.nrmse_heldout / floor,
        }
    }

    /// Codes of the named effects, sorted.
    pub(crate) fn codes(&self) -> Vec<&str> {
        let mut codes: Vec<&str> = self.effects.iter().map(|(c, _)| c.as_str()).collect();
        codes.sort_unstable();
        codes
    }

    /// True if exactly these effects are named and there is no alternative.
    pub(crate) fn is_exactly(&self, truth: &[&str]) -> bool {
        self.verdict != Verdict::Unexplained && self.codes() == truth && self.alternatives.is_empty()
    }

    /// The named effects and their alternatives.
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

    /// The answer in one word, for the confusion matrix.
    pub(crate) fn word(&self) -> String {
        match (self.verdict, self.codes().as_slice()) {
            (Verdict::Unexplained, _) => "unknown".to_owned(),
            (_, []) => "none".to_owned(),
            (_, [one]) => (*one).to_owned(),
            _ => "several".to_owned(),
        }
    }
}

/// Name of an axis, as in `docs/formats.md`.
fn axis_name(axis: crate::diagnose::diagnosis::Axis) -> String {
    serde_json::to_value(axis)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}
