//! The result of a diagnosis: the fields of `diagnosis.json` (`docs/formats.md`), and what the report draws besides.

use serde::Serialize;

use super::course::Course;
pub(crate) use super::note::Note;
use crate::effect::law::ForceLaw;
pub(crate) use crate::effect::{Axis, Branch};

/// Share by which two errors differ before one of them is called worse: the written model repeats the error of the fit to 2 %.
const WORSE_BY: f64 = 0.02;

/// True if an error is larger than another by more than chance and rounding.
pub(crate) fn is_worse(error: f64, other: f64) -> bool {
    error > (1.0 + WORSE_BY) * other
}

/// The answer of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The baseline explains the recordings down to the noise.
    Adequate,
    /// Effects of the library are missing, and they explain the recordings.
    MissingPhysics,
    /// There is structure above the noise that no effect in the library explains.
    Unexplained,
}

/// A value with its confidence interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Value {
    /// Name with its unit at the end.
    pub name: String,
    pub value: f64,
    /// Unit as text; empty for a pure number.
    pub unit: String,
    /// 95 % interval; `null` where the data give none.
    pub ci95: Option<[f64; 2]>,
}

/// A missing effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Code of physics (`docs/formats.md`).
    pub code: String,
    /// From 0 to 0.99.
    pub confidence: f64,
    /// Codes that the recordings cannot tell apart, this one first; empty where they can. The confidence is shared among them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub group: Vec<String>,
    /// Standard deviation of its size between recordings and branches, as a share of the size: 0 for a law that holds everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_spread: Option<f64>,
    /// A sentence for a technician.
    pub statement: String,
    /// Identified parameters of the effect, with 95 % intervals.
    pub parameters: Vec<Value>,
    /// Gain in log-likelihood of effective samples that it brings; `None` for tables, which have no samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
}

/// An effect that could replace a finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alternative {
    /// Code of physics (`docs/formats.md`).
    pub code: String,
    /// Code of the finding that it could replace, or `unknown`.
    pub instead_of: String,
    /// Why the recordings do not separate the two.
    pub why: String,
    /// The test that would separate them.
    pub test: String,
}

/// A place on the loop where model and recordings differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Location {
    pub axis: Axis,
    /// Lower end, in the unit of the axis.
    pub from: f64,
    /// Upper end, in the unit of the axis.
    pub to: f64,
    pub direction: Branch,
    /// Share of the residual's sum of squares above the noise that lies in it, 0 to 1.
    pub share: f64,
    /// The same as a sentence.
    pub words: String,
}

/// Errors of one model. For tables `E` is an option, because some errors need whole curves.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Errors<E = f64> {
    /// rms(measured - model) / (max - min of measured force) on fitted cycles.
    pub nrmse_train: E,
    /// The same on reporting cycles or recordings: no parameter was fitted to them and no set chosen by them.
    pub nrmse_heldout: E,
    /// Relative error of the largest force.
    pub peak_force_error: E,
    /// Relative error of the loop energy.
    pub loop_energy_error: E,
}

/// Errors before and after the diagnosis.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FitErrors<E = f64> {
    /// The baseline with its own parameters refitted.
    pub baseline: Errors<E>,
    /// The baseline with the missing effects.
    pub improved: Errors<E>,
    /// NRMSE of the noise: no model can have less.
    pub noise_floor_nrmse: E,
    /// Nominal, refitted, then with one effect after the other.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ladder: Vec<Rung>,
}

/// One step of the ladder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rung {
    /// What was added in this step.
    pub what: String,
    /// The errors after this step.
    pub errors: Errors,
}

/// The profile to run next.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextTest {
    /// Text of the profile file.
    pub profile_toml: String,
    /// What the test separates.
    pub why: String,
    /// Difference of the two explanations over the profile: root of the sum of squares in units of the noise. `None` for a test
    /// that separates axes, not explanations.
    pub separation_sigma: Option<f64>,
    /// Duration in s.
    pub duration_s: f64,
}

/// One line of the table of candidates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CandidateRow {
    /// Codes of the effects in the set.
    pub codes: Vec<String>,
    /// Gain over the refitted baseline on fitted and selecting cycles, in log-likelihood of effective samples.
    pub gain: f64,
    /// The same on selecting cycles alone.
    pub gain_heldout: f64,
    /// True for the chosen set.
    pub chosen: bool,
}

/// An effect that these recordings cannot show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NotTestable {
    /// Code of physics (`docs/formats.md`).
    pub code: String,
    /// Share of its signature that the baseline cannot imitate, 0 to 1.
    pub surviving: f64,
    /// Why the recordings cannot show it.
    pub why: String,
}

/// A recording for the report: columns of equal length, thinned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    /// Name of the recording.
    pub name: String,
    pub time_s: Vec<f64>,
    pub displacement_mm: Vec<f64>,
    pub measured_n: Vec<f64>,
    /// Force of the refitted baseline in N.
    pub baseline_n: Vec<f64>,
    /// Force of the improved model in N.
    pub improved_n: Vec<f64>,
    /// Indices of points before which points are missing or masked: no line leads to them. Rising.
    pub breaks: Vec<usize>,
    /// What was masked or noticed in the recording.
    pub remarks: Vec<String>,
    /// NRMSE of the refitted baseline on all compared points of this recording.
    pub nrmse_baseline: f64,
    /// NRMSE of the improved model on the same points.
    pub nrmse_improved: f64,
}

/// Mean residual over one axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Map {
    pub axis: Axis,
    /// Edges of the bins, in the unit of the axis; one more than bins.
    pub edges: Vec<f64>,
    /// Mean residual of the refitted baseline on the loading branch, N; `None` for an empty bin.
    pub loading_n: Vec<Option<f64>>,
    /// The same on the unloading branch.
    pub unloading_n: Vec<Option<f64>>,
    /// Mean residual of the improved model on the loading branch, N.
    pub improved_loading_n: Vec<Option<f64>>,
    /// The same on the unloading branch.
    pub improved_unloading_n: Vec<Option<f64>>,
}

/// An effect of the improved model, ready for a config file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AttachedEffect {
    /// Code, or the name of a form.
    pub code: String,
    /// Names and values of its parameters.
    pub parameters: Vec<(String, f64)>,
}

/// The model with the missing effects, for twin, simulator and mock rig.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImprovedModel {
    /// Name of the model.
    pub model: String,
    /// Names and values of its parameters.
    pub parameters: Vec<(String, f64)>,
    /// Structure table of the model.
    pub structure: toml::Table,
    /// Effects in the order in which they are attached, specimen first.
    pub effects: Vec<AttachedEffect>,
    /// A law that was read off the recordings, around the model.
    pub law: Option<ForceLaw>,
    /// Fitted zero of the force channel, N.
    pub force_zero_n: f64,
}

/// Error of a simple model of hysteresis that knows nothing of springs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct YardstickError {
    /// What the yardstick is made of.
    pub name: String,
    /// NRMSE on the points of [`Errors::nrmse_heldout`]; it was fitted to those of [`Errors::nrmse_train`].
    pub nrmse_leftout: f64,
}

/// What the written model does when it is simulated, on points that no parameter was fitted to and no set chosen by.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proof {
    /// Which points were left out, in words.
    pub left_out: String,
    /// NRMSE of the improved model, read back from its file and stepped at the sampling rate along the motion without its noise;
    /// `None` if the file is refused.
    pub simulated_nrmse: Option<f64>,
    /// The same over the samples of the displacement with all their noise, as a twin beside a run sees them.
    pub twin_nrmse: Option<f64>,
    /// NRMSE of the refitted baseline, written, read and stepped in the same way.
    pub baseline_nrmse: Option<f64>,
    /// True if `improved.toml` was written.
    pub written: bool,
    /// What follows, as a sentence.
    pub words: String,
}

/// Errors of all models on a recording that nothing was fitted to. The NRMSE is over the force range of that recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOutRecording {
    /// Name of the recording.
    pub recording: String,
    /// NRMSE of the refitted baseline.
    pub baseline: Option<f64>,
    /// NRMSE of the improved model, as it is written.
    pub improved: Option<f64>,
    /// NRMSE of each yardstick.
    pub yardsticks: Vec<YardstickError>,
}

/// A power with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Exponent {
    pub value: f64,
    pub ci95: [f64; 2],
}

/// A law that no effect in the library has, read off the recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiscoveredLaw {
    /// Axis, branches and table.
    #[serde(flatten)]
    pub law: ForceLaw,
    /// Standard deviation of each value of the table.
    pub band: Vec<f64>,
    /// The shortest equation within the band.
    pub equation: String,
    /// Power of the axis, where the equation has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exponent: Option<Exponent>,
    /// Share of the baseline's error above the noise that it takes away on cycles that were not fitted.
    pub explained_share: f64,
    /// NRMSE on held-out cycles before and after.
    pub nrmse_leftout: [f64; 2],
    /// The law as a sentence.
    pub statement: String,
}

/// The result of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Whether physics is missing, and whether it could be named.
    pub verdict: Verdict,
    /// The verdict as a sentence.
    pub summary: String,
    /// The missing effects.
    pub effects: Vec<Finding>,
    /// Effects that could replace them.
    pub alternatives: Vec<Alternative>,
    /// The law that was read off the recordings, where no effect explains them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<DiscoveredLaw>,
    /// Where on the loop the baseline and the recordings differ.
    pub location: Vec<Location>,
    /// Errors before and after.
    pub fit: FitErrors,
    /// The test to run next; `None` if none would tell more.
    pub next_test: Option<NextTest>,
    /// Why there is no next test although a question is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_next_test: Option<String>,
    /// Parameters of the improved baseline.
    pub baseline_parameters: Vec<Value>,
    /// Parameters that are at bounds, implausible or not identifiable, and remarks on the recordings.
    pub alarms: Vec<String>,
    /// What is imperfect about the recordings, and what was done about it.
    pub notes: Vec<Note>,
    /// Fitted sets of effects, best first.
    pub candidates: Vec<CandidateRow>,
    /// Effects that these recordings cannot show.
    pub not_testable: Vec<NotTestable>,
    /// Share of the baseline's residual above the noise that no effect explains, 0 to 1.
    pub unexplained_share: f64,
    /// True where the budget of the search was spent before sets of all sizes were compared; absent otherwise.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub search_cut_short: bool,
    /// Name of the recording without a cycle to hold out that alone is not explained; a next test then repeats it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub single_sweep: Option<String>,
    /// RMS of what has the shape of the friction law and got no name, as a share of the RMS friction; `None` where no such doubt was
    /// needed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction_shape_share: Option<f64>,
    /// The same of the spring's curve, as a share of the force range; `None` where the curve is not in doubt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curve_shape_share: Option<f64>,
    /// Gain in log-likelihood of the free shape of the friction law and the curve, before any effect is named; 0 where the baseline's own
    /// laws are as good.
    pub free_laws_gain: f64,
    /// The recordings with the forces before and after.
    pub curves: Vec<Curve>,
    /// Mean residuals along every axis.
    pub maps: Vec<Map>,
    /// The baseline with the missing effects, all parameters identified.
    pub improved: ImprovedModel,
    /// Simple models on the same points, to compare with.
    pub yardsticks: Vec<YardstickError>,
    /// What the written model does; `None` until it is written.
    pub proof: Option<Proof>,
    /// Recordings that nothing was fitted to.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOutRecording>,
    /// Steps of the model that the diagnosis took: its work, the same on every machine.
    #[serde(skip)]
    pub(crate) model_steps: u64,
    /// The baseline with its own parameters refitted.
    #[serde(skip)]
    pub(crate) refitted: ImprovedModel,
    /// The recordings as models are driven over them.
    #[serde(skip)]
    pub(crate) courses: Vec<Course>,
}

impl Diagnosis {
    /// Why no further test is needed; `None` if one is.
    pub(crate) fn settled(&self) -> Option<&'static str> {
        match self.verdict {
            Verdict::Adequate => Some("the baseline explains all recordings"),
            Verdict::MissingPhysics
                if self.alternatives.is_empty() && self.effects.iter().all(|e| e.group.is_empty()) =>
            {
                Some("no alternative is left")
            }
            _ => None,
        }
    }

    /// The yardstick with the smallest error on the points left out.
    pub(crate) fn best_yardstick(&self) -> Option<&YardstickError> {
        let errors = self.yardsticks.iter();
        errors.min_by(|a, b| a.nrmse_leftout.total_cmp(&b.nrmse_leftout))
    }

    /// What it means that a yardstick predicts the points left out better than the improved model; `None` if none does.
    pub(crate) fn yardstick_warning(&self) -> Option<String> {
        let improved = self.fit.improved.nrmse_heldout;
        let best = self
            .best_yardstick()
            .filter(|y| is_worse(improved, y.nrmse_leftout))?;
        Some(format!(
            "A model that knows nothing of springs predicts better: {} has an error of {:.2} % on the points left out, the improved \
             model {:.2} %. The form of the model does not suit this device: what is named is not the whole cause, and the improved \
             model should not be its twin.",
            best.name,
            100.0 * best.nrmse_leftout,
            100.0 * improved
        ))
    }

    /// The next test, or why there is none. It may be a test that was run before, because a repetition also adds information.
    pub(crate) fn next(&self) -> Result<&NextTest, &str> {
        let why = self.no_next_test.as_deref();
        let next = self.next_test.as_ref();
        next.ok_or(why.unwrap_or("no profile within the limits separates the rest"))
    }
}

#[cfg(test)]
impl ImprovedModel {
    /// Builds the plant with its effects attached.
    pub(crate) fn plant(&self) -> Result<Box<dyn crate::model::Plant>, crate::effect::EffectError> {
        let model = crate::model::find(&self.model)?;
        let values: Vec<f64> = self.parameters.iter().map(|p| p.1).collect();
        let mut plant = model.plant(&values, &self.structure)?;
        if let Some(law) = &self.law {
            plant = law.attached(plant).expect("a law that was fitted can be stepped");
        }
        let effects = self
            .effects
            .iter()
            .map(|e| {
                let effect = crate::effect::find(&e.code)?;
                let written = |name| e.parameters.iter().find(|p| p.0 == name).map(|p| p.1);
                let values = effect
                    .parameters
                    .iter()
                    .map(|p| written(p.name).unwrap_or(p.start));
                Ok((effect, values.collect()))
            })
            .collect::<Result<Vec<_>, crate::effect::EffectError>>()?;
        crate::effect::attach_all(&effects, self.force_zero_n, plant)
    }
}
