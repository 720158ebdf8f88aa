//! What a diagnosis says, as `diagnosis.json` has it (contracts.md) and with all that the report draws beside it.

use serde::Serialize;

pub(crate) use crate::effect::{Axis, Branch};

/// The answer in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// The baseline explains the recordings down to the noise.
    Adequate,
    /// Named effects are missing.
    MissingPhysics,
    /// There is structure above the noise that nothing in the library explains.
    Unexplained,
}

/// A value with its interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Value {
    /// Name with its unit at the end.
    pub name: String,
    /// Identified value.
    pub value: f64,
    /// Unit for people; empty for a pure number.
    pub unit: String,
    /// 95 % interval; `null` where the data give none.
    pub ci95: Option<[f64; 2]>,
}

/// A missing effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Finding {
    /// Code of contracts.md.
    pub code: String,
    /// 0 to 1.
    pub confidence: f64,
    /// A sentence that a technician understands.
    pub statement: String,
    /// Its parameters.
    pub parameters: Vec<Value>,
    /// Gain in log-likelihood of effective samples that it brings; none where there are no samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
}

/// What could stand in place of a finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Alternative {
    /// Code of contracts.md.
    pub code: String,
    /// Finding that it could replace.
    pub instead_of: String,
    /// Why the two could not be told apart.
    pub why: String,
    /// The test that would tell.
    pub test: String,
}

/// A place on the loop where model and recordings differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Location {
    /// Axis.
    pub axis: Axis,
    /// From, in the axis' unit.
    pub from: f64,
    /// To, in the axis' unit.
    pub to: f64,
    /// Branch.
    pub direction: Branch,
    /// Share of the residual's energy above the noise that falls in it.
    pub share: f64,
    /// In words.
    pub words: String,
}

/// Errors of one model. `E` is an option, `null` in the file, where the input is not whole curves.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Errors<E = f64> {
    /// rms(measured - model) / (max - min of measured force) on what was fitted.
    pub nrmse_train: E,
    /// The same on whole cycles or recordings that no parameter was fitted on and nothing was chosen by.
    pub nrmse_heldout: E,
    /// Relative error of the largest force.
    pub peak_force_error: E,
    /// Relative error of the loop energy.
    pub loop_energy_error: E,
}

/// Before and after.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct FitErrors<E = f64> {
    /// The baseline, its own parameters identified anew.
    pub baseline: Errors<E>,
    /// With the effects.
    pub improved: Errors<E>,
    /// What no model can get below.
    pub noise_floor_nrmse: E,
    /// Nominal, refitted, then one effect after the other.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ladder: Vec<Rung>,
}

/// One step of the ladder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Rung {
    /// What was added.
    pub what: String,
    /// The errors then.
    pub errors: Errors,
}

/// The profile to run next.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct NextTest {
    /// Profile file's text.
    pub profile_toml: String,
    /// What it separates and why.
    pub why: String,
    /// Difference of the two explanations over the profile, in units of the noise (root of the sum of squares).
    pub separation_sigma: f64,
    /// Length in s.
    pub duration_s: f64,
}

/// One line of the table of candidates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct CandidateRow {
    /// Codes of the set.
    pub codes: Vec<String>,
    /// Gain over the refitted baseline on fitted and selecting cycles, log-likelihood of effective samples.
    pub gain: f64,
    /// The same on selecting cycles alone.
    pub gain_heldout: f64,
    /// Chosen.
    pub chosen: bool,
}

/// An effect that these recordings cannot show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct NotTestable {
    /// Code.
    pub code: String,
    /// Share of its signature that the baseline cannot imitate.
    pub surviving: f64,
    /// Why.
    pub why: String,
}

/// A recording for the report, thinned out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Curve {
    /// Name.
    pub name: String,
    /// Columns of equal length.
    pub time_s: Vec<f64>,
    /// Displacement.
    pub displacement_mm: Vec<f64>,
    /// Measured.
    pub measured_n: Vec<f64>,
    /// Refitted baseline.
    pub baseline_n: Vec<f64>,
    /// Improved model.
    pub improved_n: Vec<f64>,
    /// Remarks of the conditioning.
    pub remarks: Vec<String>,
    /// Errors on this recording before and after.
    pub nrmse_baseline: f64,
    /// After.
    pub nrmse_improved: f64,
}

/// Mean residual over one axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Map {
    /// Axis.
    pub axis: Axis,
    /// Edges of the bins, one more than values.
    pub edges: Vec<f64>,
    /// Mean residual of the refitted baseline on the loading branch, N.
    pub loading_n: Vec<Option<f64>>,
    /// On the unloading branch.
    pub unloading_n: Vec<Option<f64>>,
    /// The same of the improved model.
    pub improved_loading_n: Vec<Option<f64>>,
    /// The same of the improved model.
    pub improved_unloading_n: Vec<Option<f64>>,
}

/// An effect of the improved model, ready for a config file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct AttachedEffect {
    /// Code, or the name of a form.
    pub code: String,
    /// Parameters by name.
    pub parameters: Vec<(String, f64)>,
}

/// The model with what was missing: twin, simulator and mock rig run it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct ImprovedModel {
    /// Model's name.
    pub model: String,
    /// Its parameters by name.
    pub parameters: Vec<(String, f64)>,
    /// Structure table.
    pub structure: toml::Table,
    /// Effects, specimen first.
    pub effects: Vec<AttachedEffect>,
    /// Zero of the force channel that the fit found, N; not part of the model.
    pub force_zero_n: f64,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Diagnosis {
    /// In one word.
    pub verdict: Verdict,
    /// In one sentence.
    pub summary: String,
    /// What is missing.
    pub effects: Vec<Finding>,
    /// What it could be instead.
    pub alternatives: Vec<Alternative>,
    /// Where.
    pub location: Vec<Location>,
    /// How good.
    pub fit: FitErrors,
    /// The test to run next.
    pub next_test: Option<NextTest>,
    /// Parameters of the improved baseline.
    pub baseline_parameters: Vec<Value>,
    /// Parameters at bounds, outside belief, not identifiable: findings in themselves.
    pub alarms: Vec<String>,
    /// Candidates compared, best first.
    pub candidates: Vec<CandidateRow>,
    /// What these recordings cannot show.
    pub not_testable: Vec<NotTestable>,
    /// Share of what the baseline leaves above the noise that nothing explains.
    pub unexplained_share: f64,
    /// Recordings before and after.
    pub curves: Vec<Curve>,
    /// Residual maps.
    pub maps: Vec<Map>,
    /// The improved model.
    pub improved: ImprovedModel,
}

impl Diagnosis {
    /// Why no further test is asked for, where none is.
    pub(crate) fn settled(&self) -> Option<&'static str> {
        match self.verdict {
            Verdict::Adequate => Some("the baseline explains all recordings"),
            Verdict::MissingPhysics if self.alternatives.is_empty() => Some("no alternative is left"),
            _ => None,
        }
    }

    /// The next test, or why there is none. It may be one that was run before: as much evidence again.
    pub(crate) fn next(&self) -> Result<&NextTest, &'static str> {
        let next = self.next_test.as_ref();
        next.ok_or("no admissible profile tells the rest apart")
    }
}

impl ImprovedModel {
    /// Builds the plant, effects attached.
    pub(crate) fn plant(&self) -> Result<Box<dyn crate::model::Plant>, crate::effect::EffectError> {
        let model = crate::model::find(&self.model).map_err(crate::effect::EffectError::Value)?;
        let values: Vec<f64> = self.parameters.iter().map(|p| p.1).collect();
        let plant = model
            .plant(&values, &self.structure)
            .map_err(crate::effect::EffectError::Value)?;
        let effects = self
            .effects
            .iter()
            .map(|e| {
                Ok((
                    crate::effect::find(&e.code)?,
                    e.parameters.iter().map(|p| p.1).collect(),
                ))
            })
            .collect::<Result<Vec<_>, crate::effect::EffectError>>()?;
        crate::effect::attach_all(&effects, plant)
    }
}
