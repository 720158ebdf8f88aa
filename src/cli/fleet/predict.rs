//! `leafbench fleet predict`: what the next run of a specimen will measure, as limits of its profile.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use jiff::Timestamp;

use super::source::EstimateSource;
use crate::acceptance::{digits, with_unit};
use crate::cli::shared::local::{self, BenchArg, ProfileArgs};
use crate::cli::{CliError, Done, Output};
use crate::config::Bench;
use crate::fleet::estimate::EstimateRow;
use crate::fleet::predict::band::{KEPT, PredictedLimit, limits};
use crate::fleet::predict::loops::ProfileLoops;
use crate::fleet::predict::measured::measured_draws;
use crate::fleet::predict::modelled::{ModelChoice, ModelMisfit};
use crate::fleet::predict::next_run::{NextRun, NextRunWords, PredictError};
use crate::fleet::predict::quantity::{PredictedQuantity, RunDeviations, predict_quantities};
use crate::profile::Profile;
use crate::profile::file::rewritten;

/// Misfit of the model if no archived run shows it: a fit of a leaf spring usually leaves 1 to 2 % of the force range.
const DEFAULT_MISFIT: f64 = 0.015;
/// What the name of a predicted profile ends in, and the most characters of a name.
const ENDING: &str = "-predicted";
const LONGEST_NAME: usize = 64;

/// Predict the next run of a specimen before it runs, and write its profile with the predicted band as limits
#[derive(Debug, Args)]
#[command(
    after_help = "FOLDER gets PROFILE-predicted.toml and prediction.json. A normal run keeps all predicted limits together in 95 % of the cases.\n\
                  Limits that the profile has already stay: a run is judged by both, so the narrower one counts. Run the new profile with\n\
                  `leafbench run FOLDER/PROFILE-predicted.toml`, or write it to the folder profiles of the data folder to have it on the page.\n\
                  If the archive has eight or more runs of this profile by the family, the band comes from their measured loops.\n\
                  Otherwise it comes from the model at the predicted parameters. docs/fleet.md explains both."
)]
pub(super) struct FleetPredictArgs {
    #[command(flatten)]
    source: EstimateSource,
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    bench: BenchArg,
    /// Name of the specimen [default: that of the bench]
    #[arg(long, value_name = "NAME")]
    specimen: Option<String>,
    /// Family of a specimen that has no runs yet
    #[arg(long, value_name = "FAMILY")]
    family: Option<String>,
    /// Batch of a specimen that has no runs yet
    #[arg(long, value_name = "BATCH")]
    batch: Option<String>,
    /// Load cycles that the specimen will have seen [default: as many more as between its last two runs]
    #[arg(long, value_name = "N")]
    age_cycles: Option<f64>,
    /// Start of the run, such as 2026-11-25T14:03:00Z [default: that of the last run known]
    #[arg(long, value_name = "TIME")]
    at: Option<Timestamp>,
    /// Error of the model in percent of the range of the force [default: that in the archived runs of the family; 1.5 for a table]
    #[arg(long, value_name = "PERCENT", value_parser = misfit)]
    misfit: Option<f64>,
    /// Predict with the model, although the archive has runs of this profile
    #[arg(long)]
    from_model: bool,
    /// Folder to write to
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Replace the files if they are there already
    #[arg(long)]
    force: bool,
}

/// A misfit in percent as a share.
fn misfit(text: &str) -> Result<f64, String> {
    let percent = text.parse::<f64>().ok().filter(|p| (0.0..=100.0).contains(p));
    percent
        .map(|p| p / 100.0)
        .ok_or_else(|| "enter a number from 0 to 100".to_owned())
}

/// What the band rests on.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
enum BandBasis {
    /// Loops of so many runs of the same profile by the family.
    Measured { runs: usize },
    /// The model at the predicted parameters, with its misfit.
    Model { misfit: ModelMisfit },
}

/// The content of prediction.json.
#[derive(Debug, serde::Serialize)]
pub(super) struct FleetPrediction {
    profile: String,
    file: PathBuf,
    specimen: String,
    family: String,
    batch: String,
    bench: String,
    started_utc: String,
    age_cycles: f64,
    model: &'static str,
    basis: BandBasis,
    /// Chance that a normal run keeps all limits together.
    kept: f64,
    quantities: Vec<PredictedQuantity>,
    limits: Vec<PredictedLimit>,
    /// Runs of the archive that could not be used, with the reason.
    left_out: Vec<String>,
}

impl FleetPredictArgs {
    pub(super) fn run(self, output: &Output) -> Result<Done, CliError> {
        let (bench, (profile, text)) = (self.bench.load()?, self.profile.load()?);
        let estimates = self.source.load()?;
        let said = NextRunWords {
            specimen: self
                .specimen
                .clone()
                .unwrap_or_else(|| bench.specimen.name.clone()),
            family: self.family.clone(),
            batch: self.batch.clone(),
            bench: bench.name.clone(),
            started_utc: self.at,
            age_cycles: self.age_cycles,
        };
        let next = NextRun::of(&said, &estimates.rows)?;
        let quantities = predict_quantities(&estimates.rows, &next);
        if quantities.is_empty() {
            return Err(PredictError::TooFewRuns { family: next.family }.into());
        }
        let (limits, basis) = self.band(&bench, &profile, &next, &estimates.rows, &quantities)?;
        let name = predicted_name(&profile.name);
        let file_name = format!("{name}.toml");
        let prediction = FleetPrediction {
            profile: profile.name.clone(),
            file: self.out.join(&file_name),
            specimen: next.specimen,
            family: next.family,
            batch: next.batch,
            bench: next.bench,
            started_utc: next.started_utc.to_string(),
            age_cycles: next.age_cycles,
            model: self.source.model()?.name,
            basis,
            kept: KEPT,
            quantities: quantities.into_iter().map(|(quantity, _)| quantity).collect(),
            limits,
            left_out: estimates.left_out,
        };
        let predicted = rewritten(
            &text,
            &name,
            &prediction.description(),
            &prediction.accept_blocks(),
        )?;
        self.write(&prediction, &file_name, &predicted)?;
        output.result(&prediction, || prediction.text())?;
        Ok(Done::Success)
    }

    /// The limits, and what they rest on.
    fn band(
        &self,
        bench: &Bench,
        profile: &Profile,
        next: &NextRun,
        rows: &[EstimateRow],
        quantities: &[(PredictedQuantity, RunDeviations)],
    ) -> Result<(Vec<PredictedLimit>, BandBasis), CliError> {
        let loops = ProfileLoops::of(profile);
        let measured = self.source.measured()?;
        if !self.from_model
            && let Some((draws, runs)) = measured_draws(&loops, profile, &measured, next)
        {
            return Ok((limits(&loops.variables, &draws), BandBasis::Measured { runs }));
        }
        let model = self.source.model()?;
        let of_bench = bench.model.name == model.name;
        let choice = ModelChoice {
            model,
            values: if of_bench {
                bench.model.values()?
            } else {
                model.start_values()
            },
            limits: bench.profile_limits(),
        };
        let misfit = match self.misfit {
            Some(share) => ModelMisfit::assumed(share),
            None => choice
                .misfit(&measured, rows, next)
                .unwrap_or(ModelMisfit::assumed(DEFAULT_MISFIT)),
        };
        let draws = choice.draws(&loops, quantities, &misfit)?;
        Ok((limits(&loops.variables, &draws), BandBasis::Model { misfit }))
    }

    fn write(&self, prediction: &FleetPrediction, file_name: &str, profile: &str) -> Result<(), CliError> {
        let json = serde_json::to_string_pretty(prediction).map_err(|e| CliError::Internal(e.to_string()))?;
        let files = [(file_name, profile), ("prediction.json", &json)];
        local::write_files(&self.out, &files, self.force)
    }
}

/// Name of the predicted profile of a profile, also of one that is predicted already.
fn predicted_name(name: &str) -> String {
    let plain = name.strip_suffix(ENDING).unwrap_or(name);
    let kept: String = plain.chars().take(LONGEST_NAME - ENDING.len()).collect();
    kept + ENDING
}

impl FleetPrediction {
    /// One sentence for the list of profiles.
    fn description(&self) -> String {
        let basis = match self.basis {
            BandBasis::Measured { runs } => format!("{runs} runs of this profile by family {}", self.family),
            BandBasis::Model { .. } => {
                format!("model {} and the estimates of family {}", self.model, self.family)
            }
        };
        format!(
            "{} with the band predicted for specimen {} on bench {}, from {basis}; a normal run keeps all predicted limits in 95 % of the cases.",
            self.profile, self.specimen, self.bench
        )
    }

    /// The limits as accept blocks, one for each stretch of cycles.
    fn accept_blocks(&self) -> String {
        let mut text = String::new();
        let mut last = None;
        for limit in &self.limits {
            if last != Some(limit.cycles) {
                text += "\n# Predicted by leafbench fleet predict.\n[[accept]]\n";
                if let Some([first, end]) = limit.cycles {
                    // A String takes every text.
                    let _ = writeln!(text, "cycles = [{first}, {end}]");
                }
                last = Some(limit.cycles);
            }
            let _ = writeln!(text, "{} = {:?}", limit.key, rounded(limit.limit));
        }
        text
    }

    fn text(&self) -> String {
        let aged = format!("after {} cycles", digits(self.age_cycles));
        let mut text = format!(
            "{} of {} on bench {}, {aged}:\n",
            self.specimen, self.family, self.bench
        );
        for q in &self.quantities {
            let [low, middle, high] = [q.low95, q.predicted, q.high95].map(digits);
            let unit = if q.unit == "1" { "" } else { &q.unit };
            let _ = writeln!(
                text,
                "  {:<24}{middle:>12} {unit:<6} 95 %: {low} to {high}",
                q.quantity
            );
        }
        let basis = match self.basis {
            BandBasis::Measured { runs } => format!("{runs} runs of this profile by the family"),
            BandBasis::Model { misfit } => {
                let shown = match misfit.runs {
                    0 => "given or assumed".to_owned(),
                    n => format!("seen in {n} runs"),
                };
                let largest = misfit.shares.iter().copied().fold(0.0, f64::max);
                let model = self.model;
                format!(
                    "model {model}, misfit up to {:.2} % of the force range, {shown}",
                    100.0 * largest
                )
            }
        };
        let _ = writeln!(
            text,
            "\nA normal run keeps all of these limits in 95 % of the cases ({basis}):"
        );
        for pair in self.limits.chunks(2) {
            text += &pair_words(pair);
        }
        let remarks = self.quantities.iter().flat_map(|q| &q.remarks);
        for remark in each_once(remarks) {
            text += &format!("\nNOTE: {remark}");
        }
        self.left_out
            .iter()
            .for_each(|reason| text += &format!("\nLEFT OUT: {reason}"));
        format!("{text}\nwritten: {}", self.file.display())
    }
}

/// Remarks without those that were made before: most are about every quantity.
fn each_once<'r>(remarks: impl Iterator<Item = &'r String>) -> Vec<&'r str> {
    let mut made = BTreeSet::new();
    remarks.map(String::as_str).filter(|r| made.insert(*r)).collect()
}

/// The lower and the upper limit of one value.
fn pair_words(pair: &[PredictedLimit]) -> String {
    let [low, high] = pair else { return String::new() };
    let unit = low
        .key
        .rsplit_once("_min_")
        .map_or("", |(_, unit)| unit)
        .replace("_per_", "/");
    let unit = unit.replace('n', "N").replace('j', "J");
    let value = low.key.split("_min").next().unwrap_or_default().replace('_', " ");
    let cycles = match low.cycles {
        None => "whole motion".to_owned(),
        Some([first, last]) => format!("cycles {first} to {last}"),
    };
    format!(
        "  {cycles:<20}{value:<22}{} to {}\n",
        digits(low.limit),
        with_unit(high.limit, &unit)
    )
}

/// Six significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remark_is_said_once_wherever_it_was_made_before() {
        let remarks = ["bench", "model", "bench", "model"].map(str::to_owned);
        assert_eq!(each_once(remarks.iter()), ["bench", "model"]);
    }
}
