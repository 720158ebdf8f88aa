//! The result of a run: what its cycles measured, and whether it kept the limits of its profile's `accept` blocks. The same run
//! file gives the same result; showing it is left to page, command line and report.
//!
//! `measure` reads the samples once, `judge` compares with the limits, `trace` picks the loops to draw.

mod judge;
mod measure;
mod trace;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::profile::Profile;
use crate::profile::accept::{CycleValue, LimitSide};
use crate::recording::Ending;
use crate::recording::run_file::RunFile;

pub(crate) use trace::{LoopTrace, traces};

/// The result of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RunResult {
    /// Id of the run.
    pub run_id: String,
    /// Start in UTC, RFC 3339.
    pub started_utc: String,
    /// Name of the specimen.
    pub specimen: String,
    /// Name of the operator; may be empty.
    pub operator: String,
    /// Name of the profile.
    pub profile: String,
    /// How the run ended; `null` as long as it goes on.
    #[schema(value_type = Option<String>)]
    pub ending: Option<Ending>,
    /// Why it ended; empty if it completed.
    pub cause: String,
    /// What of the recording is damaged or not on the disk; empty if it is whole.
    pub problem: String,
    /// The verdict on all limits together.
    pub verdict: RunVerdict,
    /// The verdict as a sentence.
    pub why: String,
    /// One entry for each limit, in the order of the profile.
    pub limits: Vec<LimitResult>,
    /// Summary of each measured value over the complete counted cycles; over the whole motion if the profile counts none.
    pub values: Vec<ValueSummary>,
    /// The counted cycles.
    pub cycles: Vec<CycleRow>,
    /// The whole motion of the profile as one loop; `null` if no sample of it is usable.
    pub whole: Option<CycleRow>,
    /// Number of samples in the file.
    pub samples: u64,
    /// Number of ticks whose sample did not arrive.
    pub lost: u64,
    /// Number of samples that the link delivered too late.
    pub late: u64,
    /// Number of samples without a valid reading of a channel; no value has them in it.
    pub flagged: u64,
    /// Counted cycle at which the run started.
    pub first_cycle: u32,
    /// Counted cycles of the profile.
    pub cycles_planned: u32,
}

/// The verdict on a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RunVerdict {
    /// The run completed and kept every limit.
    Pass,
    /// A limit is broken.
    Fail,
    /// No limit is broken, and not all of them could be judged.
    NotJudged,
    /// The profile has no limits.
    NoLimits,
}

/// One limit, with what was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct LimitResult {
    /// Key of the limit in the profile.
    pub key: String,
    /// What is limited, in words.
    pub what: String,
    /// `min` or `max`.
    pub side: LimitSide,
    /// The limit, in `unit`.
    pub limit: f64,
    /// Unit of limit and measured value; empty for a pure number.
    pub unit: String,
    /// First and last counted cycle that it is about; `null` for the whole run.
    pub cycles: Option<[u32; 2]>,
    /// The value that comes closest to the limit or passes it; `null` if there is none.
    pub measured: Option<f64>,
    /// The cycle that has this value; `null` for a trend, a number of samples and the whole run.
    pub at_cycle: Option<u32>,
    /// Whether the limit is kept.
    pub verdict: LimitVerdict,
    /// Why it could not be judged; empty otherwise.
    pub why: String,
}

/// Whether a limit is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LimitVerdict {
    /// Every cycle keeps it.
    Pass,
    /// At least one cycle breaks it.
    Fail,
    /// Cycles or values are missing, and those that are there keep it.
    NotJudged,
}

/// Summary of one value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct ValueSummary {
    /// Name with its unit, as in the cycles.
    pub name: String,
    /// What people call it.
    pub what: String,
    /// Unit as text; empty for a pure number.
    pub unit: String,
    /// Value of the first cycle.
    pub first: f64,
    /// Value of the last cycle.
    pub last: f64,
    /// Smallest value of a cycle.
    pub min: f64,
    /// Largest value of a cycle.
    pub max: f64,
    /// Mean over the cycles.
    pub mean: f64,
    /// Slope over the number of the cycle, by least squares; `null` for fewer than two cycles.
    pub trend: Option<f64>,
    /// Unit of the trend.
    pub trend_unit: String,
}

/// What one loop measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct CycleRow {
    /// Number of the counted cycle, from 1; 0 for the whole motion.
    pub cycle: u32,
    /// False if the run ended within it.
    pub complete: bool,
    /// Ticks in it without a sample.
    pub lost: u64,
    /// Samples in it without a valid reading.
    pub flagged: u64,
    /// Highest force, N.
    pub force_peak_n: f64,
    /// Lowest force, N.
    pub force_valley_n: f64,
    /// Half of peak minus valley of the force, N.
    pub force_amplitude_n: f64,
    /// Highest displacement, mm.
    pub displacement_peak_mm: f64,
    /// Lowest displacement, mm.
    pub displacement_valley_mm: f64,
    /// Half of peak minus valley of the displacement, mm.
    pub displacement_amplitude_mm: f64,
    /// Peak minus valley of the displacement, mm.
    pub travel_mm: f64,
    /// Energy that the loop dissipates, J.
    pub loop_energy_j: f64,
    /// Rate from valley to peak, N/mm; `null` if nothing moved.
    pub secant_rate_n_per_mm: Option<f64>,
    /// NRMSE of the twin; `null` if the twin was off.
    pub twin_nrmse: Option<f64>,
}

impl CycleRow {
    /// One value of the loop; `None` if it has none.
    pub(crate) fn value(&self, value: CycleValue) -> Option<f64> {
        match value {
            CycleValue::ForcePeak => Some(self.force_peak_n),
            CycleValue::ForceValley => Some(self.force_valley_n),
            CycleValue::ForceAmplitude => Some(self.force_amplitude_n),
            CycleValue::DisplacementPeak => Some(self.displacement_peak_mm),
            CycleValue::DisplacementValley => Some(self.displacement_valley_mm),
            CycleValue::DisplacementAmplitude => Some(self.displacement_amplitude_mm),
            CycleValue::Travel => Some(self.travel_mm),
            CycleValue::LoopEnergy => Some(self.loop_energy_j),
            CycleValue::SecantRate => self.secant_rate_n_per_mm,
            CycleValue::TwinNrmse => self.twin_nrmse,
        }
    }
}

impl RunResult {
    /// The result of a run file, closed or still being written.
    pub(crate) fn of(run: &RunFile) -> RunResult {
        let (header, survey) = (run.header(), run.survey());
        let measured = measure::measure(run);
        let profile = Profile::from_toml(&header.profile_toml, &header.profile_name);
        let outcome = run.outcome();
        let mut result = RunResult {
            run_id: header.run_id.clone(),
            started_utc: header.started_utc.clone(),
            specimen: header.specimen.clone(),
            operator: header.operator.clone(),
            profile: header.profile_name.clone(),
            ending: outcome.map(|o| o.ending),
            cause: outcome.map_or(String::new(), |o| o.cause.clone()),
            problem: survey.incomplete(),
            verdict: RunVerdict::NoLimits,
            why: String::new(),
            limits: Vec::new(),
            values: Vec::new(),
            cycles: measured.cycles,
            whole: measured.whole,
            samples: survey.samples,
            lost: survey.lost,
            late: survey.late,
            flagged: measured.flagged,
            first_cycle: header.first_cycle.max(1),
            cycles_planned: header.cycles_planned,
        };
        result.values = measure::summaries(&result);
        match profile {
            Ok(profile) => {
                result.limits = profile
                    .accept
                    .iter()
                    .map(|limit| judge::judge(limit, &result))
                    .collect();
                (result.verdict, result.why) = judge::verdict(&result);
            }
            Err(error) => {
                result.verdict = RunVerdict::NotJudged;
                result.why = format!("the limits of the profile cannot be read: {error}");
            }
        }
        result
    }

    /// The loops that the values are about: the complete counted cycles, or the whole motion if the profile counts none.
    pub(crate) fn loops(&self) -> Vec<&CycleRow> {
        match self.cycles_planned {
            0 => self.whole.iter().collect(),
            _ => self.cycles.iter().filter(|row| row.complete).collect(),
        }
    }

    /// True unless a limit is broken or could not be judged.
    pub(crate) fn is_accepted(&self) -> bool {
        matches!(self.verdict, RunVerdict::Pass | RunVerdict::NoLimits)
    }
}

impl RunVerdict {
    /// What people read first.
    pub(crate) fn words(self) -> &'static str {
        match self {
            RunVerdict::Pass => "PASS",
            RunVerdict::Fail => "FAIL",
            RunVerdict::NotJudged => "NOT JUDGED",
            RunVerdict::NoLimits => "NO LIMITS",
        }
    }
}

impl LimitVerdict {
    /// What people read first.
    pub(crate) fn words(self) -> &'static str {
        match self {
            LimitVerdict::Pass => "pass",
            LimitVerdict::Fail => "FAIL",
            LimitVerdict::NotJudged => "not judged",
        }
    }
}

impl LimitResult {
    /// The limit with its unit and the cycles that it is about: "peak force at most 1900 N, cycles 2 to 10".
    pub(crate) fn words(&self) -> String {
        let side = match self.side {
            LimitSide::Min => "at least",
            LimitSide::Max => "at most",
        };
        let cycles = match self.cycles {
            None => String::new(),
            Some([first, last]) if first == last => format!(", cycle {first}"),
            Some([first, last]) => format!(", cycles {first} to {last}"),
        };
        format!(
            "{} {side} {}{cycles}",
            self.what,
            with_unit(self.limit, &self.unit)
        )
    }

    /// The measured value with its unit and its cycle; a dash if there is none.
    pub(crate) fn measured_words(&self) -> String {
        let Some(measured) = self.measured else {
            return "\u{2013}".to_owned();
        };
        let cycle = self
            .at_cycle
            .map_or(String::new(), |cycle| format!(" in cycle {cycle}"));
        format!("{}{cycle}", with_unit(measured, &self.unit))
    }
}

/// A value with five significant digits and its unit.
pub(crate) fn with_unit(value: f64, unit: &str) -> String {
    match unit {
        "" => digits(value),
        "samples" => format!("{value} samples"),
        _ => format!("{} {unit}", digits(value)),
    }
}

/// Five significant digits, without zeros at the end of the decimals and without an exponent.
pub(crate) fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    let decimals = (4 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}
