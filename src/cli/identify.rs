//! `leafbench identify`.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::{Args, ValueEnum};

use super::shared::ctrl_c::ctrl_c_flag;
use super::shared::local::model_names;
use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::config::{ModelConfig, Specimen};
use crate::identify::curve::Initial;
use crate::identify::target_table::read_targets;
use crate::identify::targets::{Aggregate, LoopTarget, TargetProblem};
use crate::identify::{
    CurveProblem, Fit, FitControl, FitEnding, FitOptions, FitProgress, Method, Residuals,
    differential_evolution, fit, least_squares, nelder_mead,
};
use crate::model::{self, Model};
use crate::recording::{Recording, csv};
use crate::regular_file::{self, TABLE_MAX_BYTES};

/// Fit a model's parameters to recordings, or to a table of peak forces and loop energies
#[derive(Debug, Args)]
pub(crate) struct IdentifyArgs {
    /// Recordings of one specimen, fitted together: CSV with time_s, displacement_mm, force_n
    #[arg(value_name = "RECORDING.csv", num_args = 0..)]
    pub recordings: Vec<PathBuf>,
    /// Fit to this table (CSV) of peak forces in N and loop energies in J instead
    #[arg(long, value_name = "FILE", conflicts_with = "recordings")]
    pub targets: Option<PathBuf>,
    #[arg(
        long,
        value_name = "MODEL",
        help = format!("Model to fit: {} [default: from the specimen file]", model_names())
    )]
    pub model: Option<String>,
    /// Specimen file to start from: model, values, geometry
    #[arg(long, value_name = "FILE")]
    pub specimen: Option<PathBuf>,
    /// How to search
    #[arg(long, value_enum, default_value_t = SearchMethod::LeastSquares)]
    pub method: SearchMethod,
    /// Hold a parameter at a value, in the parameter's unit; may be given again
    #[arg(long, value_name = "NAME=VALUE", value_parser = held_value)]
    pub fix: Vec<(String, f64)>,
    /// Fit only these parameters, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub free: Vec<String>,
    /// State of the spring at a recording's first sample
    #[arg(long, value_enum, default_value_t = RecordingStart::Unknown)]
    pub begin: RecordingStart,
    /// Seed of the random draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Write the result as a specimen file
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Methods of `identify`, with the settings that each has by default.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum SearchMethod {
    /// Levenberg-Marquardt: fast, from the start values to the nearest minimum
    LeastSquares,
    /// Simplex without derivatives, from the start values
    NelderMead,
    /// Random search of the whole range of every parameter
    DifferentialEvolution,
}

/// What is known of the spring before a recording begins.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum RecordingStart {
    /// Not loaded before
    Rest,
    /// In a steady cycle
    Cycling,
    /// Leave out the first half cycle, unless the recording begins without load
    Unknown,
}

/// `NAME=VALUE` of `--fix`.
fn held_value(text: &str) -> Result<(String, f64), String> {
    text.split_once('=')
        .and_then(|(name, value)| Some((name.trim().to_owned(), value.trim().parse::<f64>().ok()?)))
        .filter(|(_, value)| value.is_finite())
        .ok_or_else(|| "write NAME=VALUE with a finite number".to_owned())
}

impl CliCommand for IdentifyArgs {
    const NAME: &'static str = "identify";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench identify --model equivalent --fix preload_n=0 loops/RUN.csv",
        "leafbench identify --specimen bench-configs/specimens/samurai-front-equivalent.toml loops/RUN.csv --out found.toml",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let recordings = || {
            let read = self.recordings.iter().map(|path| csv::read_file(path));
            Ok(read.collect::<Result<Vec<_>, _>>()?)
        };
        let stop = ctrl_c_flag();
        let mut progress = Progress::new("identify", output.json);
        // Ctrl-C ends the fit with the best values so far.
        let found = self.identified(recordings, &mut |p| {
            progress.show_share(p.share, "fitting");
            match stop.load(Ordering::Relaxed) {
                true => FitControl::Stop,
                false => FitControl::Continue,
            }
        });
        progress.finish();
        let (identified, specimen) = found?;
        if let Some(path) = &self.out {
            std::fs::write(path, specimen).map_err(CliError::file(path, "writing"))?;
        }
        output.result(&identified, || text(&identified, self.out.as_deref()))?;
        Ok(Done::success_if(identified.converged))
    }
}

impl IdentifyArgs {
    /// Fits to `recordings`, or to the table of `--targets`. The recordings are read when all else is known to be right. Also returns
    /// the text of a specimen file with the values found.
    pub(crate) fn identified(
        &self,
        recordings: impl FnOnce() -> Result<Vec<Recording>, CliError>,
        watch: &mut dyn FnMut(FitProgress) -> FitControl,
    ) -> Result<(Identified, String), CliError> {
        let mut specimen = self.start_specimen()?;
        let model = model::find(&specimen.model.name)?;
        let mut start = specimen.model.values()?;
        let fixed = self.fixed(model, &mut start)?;
        let problem = self.problem(model, &specimen.model.structure, recordings()?)?;
        let options = FitOptions {
            method: self.method.with_default_settings(),
            start: Some(start),
            fixed,
            seed: self.seed,
            ..FitOptions::default()
        };
        let fitted = fit(problem.residuals(), &options, watch)?;
        let errors = problem.errors(&fitted.values)?;
        let identified = Identified::new(model.name, &fitted, errors);
        for (p, value) in fitted.parameters.iter().zip(&fitted.values) {
            specimen.model.parameters.insert(p.name.to_owned(), *value);
        }
        let text = toml::to_string(&specimen).map_err(|e| CliError::Internal(e.to_string()))?;
        Ok((identified, text))
    }

    /// What the fit starts from: the specimen file, or the start values of the model that is named.
    fn start_specimen(&self) -> Result<Specimen, CliError> {
        if let Some(path) = &self.specimen {
            let specimen = Specimen::load(path)?;
            return match &self.model {
                Some(name) if *name != specimen.model.name => Err(CliError::Input(format!(
                    "{} has model {}, but --model says {name}: leave one of the two out",
                    path.display(),
                    specimen.model.name
                ))),
                _ => Ok(specimen),
            };
        }
        let Some(name) = &self.model else {
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
                force_zero_n: 0.0,
                parameters: Default::default(),
                structure: toml::Table::new(),
                effects: Vec::new(),
                law: None,
            },
        })
    }

    /// Names of the parameters that are held; the values of `--fix` go into `start`.
    fn fixed(&self, model: &Model, start: &mut [f64]) -> Result<Vec<String>, CliError> {
        let mut fixed = Vec::new();
        for (name, value) in &self.fix {
            let index = model.parameter_index(name)?;
            if let Some(slot) = start.get_mut(index) {
                *slot = *value;
            }
            fixed.push(name.clone());
        }
        if !self.free.is_empty() {
            let free: Vec<&str> = self.free.iter().map(|name| name.trim()).collect();
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

    fn problem<'a>(
        &self,
        model: &'static Model,
        structure: &'a toml::Table,
        recordings: Vec<Recording>,
    ) -> Result<FitTo<'a>, CliError> {
        if let Some(path) = &self.targets {
            return table_problem(path, model, structure);
        }
        if recordings.is_empty() {
            return Err(CliError::Input(
                "nothing to fit to: give recordings (CSV) or --targets FILE".to_owned(),
            ));
        }
        let problem = CurveProblem::of_model(model, structure, &recordings, self.begin.initial())?;
        Ok(FitTo::Recordings(problem, recordings))
    }
}

impl SearchMethod {
    fn with_default_settings(self) -> Method {
        match self {
            SearchMethod::LeastSquares => {
                Method::LeastSquares(least_squares::LeastSquaresSettings::default())
            }
            SearchMethod::NelderMead => Method::NelderMead(nelder_mead::SimplexSettings::default()),
            SearchMethod::DifferentialEvolution => {
                Method::DifferentialEvolution(differential_evolution::EvolutionSettings::default())
            }
        }
    }
}

impl RecordingStart {
    fn initial(self) -> Initial {
        match self {
            RecordingStart::Rest => Initial::FromRest,
            RecordingStart::Cycling => Initial::ReplayFirstCycle,
            RecordingStart::Unknown => Initial::Unknown,
        }
    }
}

/// What the parameters are fitted to.
enum FitTo<'a> {
    Recordings(CurveProblem<'a>, Vec<Recording>),
    Table(TargetProblem<'a>, Vec<LoopTarget>),
}

/// How far the fitted model is from what was measured.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct FitError {
    /// The recording by its name, or the row of the table.
    of: String,
    /// Root mean square of the difference over the samples that were compared; of a table, the difference of the peak force.
    error_n: f64,
    /// The same in percent of the recording's range of force; of a table, of the measured peak force.
    error_percent: f64,
    /// Difference of the loop energy in J and in percent of the measured one; tables only.
    #[serde(skip_serializing_if = "Option::is_none")]
    energy_error: Option<[f64; 2]>,
}

impl FitTo<'_> {
    fn residuals(&self) -> &dyn Residuals {
        match self {
            FitTo::Recordings(problem, _) => problem,
            FitTo::Table(problem, _) => problem,
        }
    }

    /// The error on each recording or row with these values of the parameters.
    fn errors(&self, values: &[f64]) -> Result<Vec<FitError>, CliError> {
        match self {
            FitTo::Recordings(problem, recordings) => errors_on_recordings(problem, recordings, values),
            FitTo::Table(problem, targets) => {
                let model = problem.measure(values)?;
                Ok(model.iter().zip(targets).enumerate().map(error_on_row).collect())
            }
        }
    }
}

/// The residuals of a recording are shares of its range of force.
fn errors_on_recordings(
    problem: &CurveProblem<'_>,
    recordings: &[Recording],
    values: &[f64],
) -> Result<Vec<FitError>, CliError> {
    let mut residuals = vec![0.0; problem.count()];
    problem.evaluate(values, &mut residuals)?;
    let mut rest = residuals.as_slice();
    let mut errors = Vec::new();
    for (count, recording) in problem.stretches().into_iter().zip(recordings) {
        let (own, others) = rest.split_at(count);
        rest = others;
        if count == 0 {
            continue;
        }
        let force = recording.force_n.iter().copied();
        let range_n = force.clone().fold(f64::NEG_INFINITY, f64::max) - force.fold(f64::INFINITY, f64::min);
        let share = (own.iter().map(|r| r * r).sum::<f64>() / count as f64).sqrt();
        errors.push(FitError {
            of: recording.name.clone(),
            error_n: share * range_n,
            error_percent: 100.0 * share,
            energy_error: None,
        });
    }
    Ok(errors)
}

fn error_on_row((index, (model, target)): (usize, (&Aggregate, &LoopTarget))) -> FitError {
    let measured = &target.measured;
    let [force, energy] = model.errors(measured);
    FitError {
        of: format!("row {}", index + 1),
        error_n: model.peak_force_n - measured.peak_force_n,
        error_percent: 100.0 * force,
        energy_error: Some([model.loop_energy_j - measured.loop_energy_j, 100.0 * energy]),
    }
}

/// The fit to a table of peak forces and loop energies.
fn table_problem<'a>(
    path: &Path,
    model: &'static Model,
    structure: &'a toml::Table,
) -> Result<FitTo<'a>, CliError> {
    let table = regular_file::read(path, TABLE_MAX_BYTES).map_err(CliError::file(path, "reading"))?;
    let targets = read_targets(table.as_slice())?;
    if targets.is_empty() {
        return Err(CliError::Input(format!(
            "{} has no row below its header: add one row for each test",
            path.display()
        )));
    }
    let factory = move |values: &[f64]| model.plant(values, structure);
    let problem = TargetProblem::new(model.parameters.to_vec(), Box::new(factory), targets.clone());
    Ok(FitTo::Table(problem, targets))
}

/// The error on a recording or a row as the terminal shows it.
fn error_line(error: &FitError) -> String {
    let (of, n, percent) = (&error.of, error.error_n, error.error_percent);
    match error.energy_error {
        None => format!("error on {of}: {n:.2} N rms, {percent:.2} % of the range of force"),
        Some([j, energy_percent]) => {
            format!(
                "error on {of}: peak force {n:+.2} N ({percent:+.2} %), loop energy {j:+.3} J ({energy_percent:+.2} %)"
            )
        }
    }
}

fn text(found: &Identified, out: Option<&Path>) -> String {
    let mut text = String::new();
    for p in &found.parameters {
        let note = match (p.free, p.ci95) {
            (false, _) => "held".to_owned(),
            (true, Some([low, high])) => format!("95 %: {low:.6} to {high:.6}"),
            (true, None) => "no interval".to_owned(),
        };
        let _ = writeln!(text, "{:28} {:>14.6} {:6} {note}", p.name, p.value, p.unit);
    }
    let how = match (found.converged, found.stopped) {
        (true, _) => "converged",
        (false, true) => "stopped: the best values so far",
        (false, false) => "not converged: the limit of iterations is reached",
    };
    let _ = writeln!(
        text,
        "{how}, {} evaluations, cost {:.6e}",
        found.evaluations, found.cost
    );
    for error in &found.errors {
        let _ = writeln!(text, "{}", error_line(error));
    }
    for warning in &found.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    if let Some(path) = out {
        let _ = writeln!(text, "written to {}", path.display());
    }
    text
}

/// The result of the command: what `--json` prints.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Identified {
    /// Name of the model.
    model: &'static str,
    /// All parameters, those that were held too.
    parameters: Vec<IdentifiedParameter>,
    /// Cost at these values.
    cost: f64,
    /// How far the model is from each recording or row.
    errors: Vec<FitError>,
    /// Evaluations of the problem, those for the intervals included.
    evaluations: usize,
    /// The search met its tolerances.
    converged: bool,
    /// It was stopped before its end.
    stopped: bool,
    /// Reasons to doubt the result, one sentence each.
    warnings: Vec<String>,
}

/// One parameter of [`Identified`].
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
struct IdentifiedParameter {
    /// Name with its unit at the end.
    name: &'static str,
    /// Unit for people; empty for a pure number.
    unit: &'static str,
    value: f64,
    /// False where it was held.
    free: bool,
    /// 95 % interval; `None` where held, at a bound or not identifiable.
    ci95: Option<[f64; 2]>,
}

impl Identified {
    fn new(model: &'static str, fit: &Fit, errors: Vec<FitError>) -> Identified {
        let parameter = |i: usize| IdentifiedParameter {
            name: fit.parameters[i].name,
            unit: fit.parameters[i].unit,
            value: fit.values[i],
            free: fit.free[i],
            ci95: fit.ci95[i],
        };
        Identified {
            model,
            parameters: (0..fit.parameters.len()).map(parameter).collect(),
            cost: fit.cost,
            errors,
            evaluations: fit.evaluations,
            converged: fit.converged(),
            stopped: fit.ending == FitEnding::Stopped,
            warnings: fit.warnings.iter().map(ToString::to_string).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A recording whose force lies beside that of the model: every other sample above and below it.
    #[test]
    fn the_error_is_in_newtons_and_in_percent_of_the_range() {
        let model = model::find("equivalent").expect("listed");
        let structure = toml::Table::new();
        let values = [0.0, 100.0, 0.0, 0.4];
        let mut plant = model.plant(&values, &structure).expect("built");
        let displacement_mm: Vec<f64> = (0..=200).map(|i| f64::from(i) * 0.05).collect();
        let beside = |(i, x): (usize, &f64)| plant.step(*x, 0.01) + if i % 2 == 0 { 4.0 } else { -4.0 };
        let recording = Recording {
            name: "a.csv".to_owned(),
            time_s: (0..=200).map(|i| f64::from(i) * 0.01).collect(),
            force_n: displacement_mm.iter().enumerate().map(beside).collect(),
            displacement_mm,
            ..Recording::default()
        };
        let recordings = vec![recording];
        let problem =
            CurveProblem::of_model(model, &structure, &recordings, Initial::FromRest).expect("fits");
        let errors = FitTo::Recordings(problem, recordings)
            .errors(&values)
            .expect("evaluated");
        let [error] = errors.as_slice() else {
            panic!("{errors:?}");
        };
        // From 1 N (the second sample, 4 N below 5 N) to 1004 N; a double rounds at 1e-12 of that.
        assert!(
            (error.error_n - 4.0).abs() < 1e-9 && (error.error_percent - 0.4 / 1.003).abs() < 1e-9,
            "{error:?}"
        );
        assert_eq!(
            error_line(error),
            "error on a.csv: 4.00 N rms, 0.40 % of the range of force"
        );
    }

    #[test]
    fn the_error_on_a_row_has_both_figures() {
        let aggregate = |peak_force_n, loop_energy_j| Aggregate {
            peak_force_n,
            loop_energy_j,
        };
        let target = LoopTarget {
            motion: crate::identify::targets::TargetMotion::Ramp {
                stroke_mm: 1.0,
                duration_s: 1.0,
            },
            measured: aggregate(200.0, 2.0),
        };
        let error = error_on_row((0, (&aggregate(210.0, 1.5), &target)));
        assert_eq!(
            error_line(&error),
            "error on row 1: peak force +10.00 N (+5.00 %), loop energy -0.500 J (-25.00 %)"
        );
    }
}
