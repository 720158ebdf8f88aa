//! `leafbench identify`.

use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use clap::{Arg, ArgAction, ArgMatches, value_parser};

use super::progress::{Progress, ProgressMark};
use super::{CliError, Command, Done, Output, stop_on_ctrl_c};
use crate::config::{ModelConfig, Specimen};
use crate::identify::curve::Initial;
use crate::identify::target_table::read_targets;
use crate::identify::targets::TargetProblem;
use crate::identify::{
    CurveProblem, Fit, FitControl, FitEnding, FitOptions, IdentifyError, Method, Residuals,
    differential_evolution, fit, least_squares, nelder_mead,
};
use crate::model::{self, Model};
use crate::recording::csv;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "identify",
    what: "Fit a model's parameters to recordings, or to a table of peak forces and loop energies",
    arguments: |command| {
        let path = |name: &'static str, help: &'static str| {
            Arg::new(name)
                .long(name)
                .value_name("FILE")
                .value_parser(value_parser!(PathBuf))
                .help(help)
        };
        command
            .arg(
                Arg::new("recordings")
                    .value_name("RECORDING.csv")
                    .num_args(0..)
                    .value_parser(value_parser!(PathBuf))
                    .help("Recordings of one specimen, fitted at once"),
            )
            .arg(
                path(
                    "targets",
                    "Fit to this table of peak forces and loop energies instead",
                )
                .conflicts_with("recordings"),
            )
            .arg(
                Arg::new("model")
                    .long("model")
                    .value_name("MODEL")
                    .help("Model to fit [default: the specimen's]"),
            )
            .arg(path(
                "specimen",
                "Specimen file to start from: model, values, geometry",
            ))
            .arg(
                Arg::new("method")
                    .long("method")
                    .value_parser(["least-squares", "nelder-mead", "differential-evolution"])
                    .default_value("least-squares")
                    .help("How to search"),
            )
            .arg(
                Arg::new("fix")
                    .long("fix")
                    .value_name("NAME=VALUE")
                    .action(ArgAction::Append)
                    .help("Hold a parameter at a value; may be given again"),
            )
            .arg(
                Arg::new("free")
                    .long("free")
                    .value_name("NAMES")
                    .value_delimiter(',')
                    .help("Fit these alone, with commas between"),
            )
            .arg(
                Arg::new("begin")
                    .long("begin")
                    .value_parser(["rest", "cycling", "unknown"])
                    .default_value("unknown")
                    .help("The spring at a recording's first sample: untouched before, or in a steady cycle; unknown: leave out the first half cycle unless it begins without load"),
            )
            .arg(
                Arg::new("seed")
                    .long("seed")
                    .value_parser(value_parser!(u64))
                    .default_value("1")
                    .help("Seed of the random draws"),
            )
            .arg(path("out", "Write the result as a specimen file"))
    },
    run,
};

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let mut specimen = specimen(matches)?;
    let model = model::find(&specimen.model.name)?;
    let mut start = specimen.model.values()?;
    let fixed = fixed(matches, model, &mut start)?;
    let problem = problem(matches, model, &specimen.model.structure)?;
    let options = FitOptions {
        method: method(matches),
        start: Some(start),
        fixed,
        seed: matches.get_one::<u64>("seed").copied().unwrap_or(1),
        ..FitOptions::default()
    };
    let fitted = watched_fit(problem.as_ref(), &options, output)?;
    for (p, value) in fitted.parameters.iter().zip(&fitted.values) {
        specimen.model.parameters.insert(p.name.to_owned(), *value);
    }
    let out = matches.get_one::<PathBuf>("out");
    if let Some(path) = out {
        let text = toml::to_string(&specimen).map_err(|e| CliError::Internal(e.to_string()))?;
        std::fs::write(path, text).map_err(CliError::file(path, "writing"))?;
    }
    output.result(&json(&specimen.model.name, &fitted), || text(&fitted, out))?;
    Ok(match fitted.ending {
        FitEnding::Converged => Done::Well,
        FitEnding::Exhausted | FitEnding::Stopped => Done::Otherwise,
    })
}

/// What to start from: a specimen file, a model's own start, or a file's geometry with another model refused.
fn specimen(matches: &ArgMatches) -> Result<Specimen, CliError> {
    let asked = matches.get_one::<String>("model");
    if let Some(path) = matches.get_one::<PathBuf>("specimen") {
        let specimen = Specimen::load(path)?;
        return match asked {
            Some(name) if *name != specimen.model.name => Err(CliError::Input(format!(
                "{} is of model {}, --model asks for {name}: leave one of the two out",
                path.display(),
                specimen.model.name
            ))),
            _ => Ok(specimen),
        };
    }
    let Some(name) = asked else {
        return Err(CliError::Input(
            "no model to fit: give --model NAME or --specimen FILE".to_owned(),
        ));
    };
    model::find(name)?;
    Ok(Specimen {
        name: format!("identified {name}"),
        source: "leafbench identify".to_owned(),
        model: ModelConfig {
            name: name.clone(),
            known: Vec::new(),
            parameters: Default::default(),
            structure: toml::Table::new(),
            effects: Vec::new(),
        },
    })
}

/// Names that stay; values of `--fix` go into `start`.
fn fixed(matches: &ArgMatches, model: &Model, start: &mut [f64]) -> Result<Vec<String>, CliError> {
    let mut fixed = Vec::new();
    for pair in matches.get_many::<String>("fix").into_iter().flatten() {
        let parsed = pair
            .split_once('=')
            .and_then(|(name, value)| Some((name.trim(), value.trim().parse::<f64>().ok()?)))
            .filter(|(_, value)| value.is_finite());
        let Some((name, value)) = parsed else {
            return Err(CliError::Input(format!(
                "--fix {pair}: write NAME=VALUE with a finite number"
            )));
        };
        let index = model.parameter_index(name)?;
        if let Some(slot) = start.get_mut(index) {
            *slot = value;
        }
        fixed.push(name.to_owned());
    }
    if let Some(free) = matches.get_many::<String>("free") {
        let free: Vec<&str> = free.map(|name| name.trim()).collect();
        for name in &free {
            model.parameter_index(name)?;
        }
        let held = model.parameters.iter().filter(|p| !free.contains(&p.name));
        fixed.extend(held.map(|p| p.name.to_owned()));
    }
    if model.parameters.iter().all(|p| fixed.iter().any(|f| f == p.name)) {
        return Err(CliError::Input(
            "every parameter is fixed: leave at least one free".to_owned(),
        ));
    }
    Ok(fixed)
}

fn method(matches: &ArgMatches) -> Method {
    match matches.get_one::<String>("method").map(String::as_str) {
        Some("nelder-mead") => Method::NelderMead(nelder_mead::SimplexSettings::default()),
        Some("differential-evolution") => {
            Method::DifferentialEvolution(differential_evolution::EvolutionSettings::default())
        }
        _ => Method::LeastSquares(least_squares::LeastSquaresSettings::default()),
    }
}

fn problem<'a>(
    matches: &ArgMatches,
    model: &'static Model,
    structure: &'a toml::Table,
) -> Result<Box<dyn Residuals + 'a>, CliError> {
    if let Some(path) = matches.get_one::<PathBuf>("targets") {
        let file = std::fs::File::open(path).map_err(CliError::file(path, "opening"))?;
        let targets = read_targets(file)?;
        if targets.is_empty() {
            return Err(CliError::Input(format!(
                "{} has no rows: give one a test",
                path.display()
            )));
        }
        let factory = move |values: &[f64]| model.plant(values, structure);
        return Ok(Box::new(TargetProblem::new(
            model.parameters.to_vec(),
            Box::new(factory),
            targets,
        )));
    }
    let paths: Vec<_> = matches
        .get_many::<PathBuf>("recordings")
        .into_iter()
        .flatten()
        .collect();
    if paths.is_empty() {
        return Err(CliError::Input(
            "nothing to fit to: give recordings (CSV) or --targets FILE".to_owned(),
        ));
    }
    let recordings = paths
        .into_iter()
        .map(|path| csv::read_file(path))
        .collect::<Result<Vec<_>, _>>()?;
    let initial = match matches.get_one::<String>("begin").map(String::as_str) {
        Some("rest") => Initial::FromRest,
        Some("cycling") => Initial::ReplayFirstCycle,
        _ => Initial::Unknown,
    };
    let problem = CurveProblem::of_model(model, structure, &recordings, initial)?;
    Ok(Box::new(problem))
}

/// Fits with a progress bar; Ctrl-C ends it with the best so far.
fn watched_fit(problem: &dyn Residuals, options: &FitOptions, output: &Output) -> Result<Fit, IdentifyError> {
    let stop = Arc::new(AtomicBool::new(false));
    stop_on_ctrl_c(Arc::clone(&stop));
    let start = Instant::now();
    let mut progress = Progress::new("identify", output.json);
    let fitted = fit(problem, options, &mut |p| {
        let elapsed_s = start.elapsed().as_secs_f64();
        let remaining_s = elapsed_s * (1.0 - p.share) / p.share.max(1e-3);
        progress.show(ProgressMark {
            elapsed_s,
            remaining_s,
            cycles: 0,
            cycles_total: 0,
        });
        if stop.load(Ordering::Relaxed) {
            FitControl::Stop
        } else {
            FitControl::Continue
        }
    });
    progress.finish();
    fitted
}

fn text(fit: &Fit, out: Option<&PathBuf>) -> String {
    let mut text = String::new();
    for (i, p) in fit.parameters.iter().enumerate() {
        let note = match (fit.free[i], fit.ci95[i]) {
            (false, _) => "held".to_owned(),
            (true, Some([low, high])) => format!("95 %: {low:.6} to {high:.6}"),
            (true, None) => "no interval".to_owned(),
        };
        let _ = writeln!(text, "{:28} {:>14.6} {:6} {note}", p.name, fit.values[i], p.unit);
    }
    let how = match fit.ending {
        FitEnding::Converged => "settled",
        FitEnding::Exhausted => "not settled: the allowed work is done",
        FitEnding::Stopped => "stopped: the best so far",
    };
    let _ = writeln!(
        text,
        "{how}, {} evaluations, cost {:.6e}",
        fit.evaluations, fit.cost
    );
    for warning in &fit.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    if let Some(path) = out {
        let _ = writeln!(text, "written to {}", path.display());
    }
    text
}

fn json(model: &str, fit: &Fit) -> serde_json::Value {
    let parameters: Vec<_> = (0..fit.parameters.len())
        .map(|i| {
            serde_json::json!({ "name": fit.parameters[i].name, "unit": fit.parameters[i].unit, "value": fit.values[i],
                                "free": fit.free[i], "ci95": fit.ci95[i] })
        })
        .collect();
    let warnings: Vec<String> = fit.warnings.iter().map(ToString::to_string).collect();
    serde_json::json!({ "model": model, "parameters": parameters, "cost": fit.cost, "evaluations": fit.evaluations,
                        "converged": fit.converged(), "stopped": fit.ending == FitEnding::Stopped, "warnings": warnings })
}
