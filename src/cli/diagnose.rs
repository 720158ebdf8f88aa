//! `leafbench diagnose`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Arg, ArgAction, ArgMatches};

use super::progress::{Progress, ProgressMark};
use super::{CliError, Command, Done, Output, client, local, run_next, targets};
use crate::config::{Bench, EffectConfig, ModelConfig};
use crate::diagnose::diagnosis::{Diagnosis, ImprovedModel};
use crate::diagnose::{Baseline, DiagnoseOptions, Verdict, diagnose};
use crate::model;
use crate::recording::{Recording, csv};
use crate::report::diagnosis::{Context, page};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "diagnose",
    what: "Say which physics the baseline model leaves out of recordings, and write the model with it added",
    arguments,
    run,
};

fn arguments(command: clap::Command) -> clap::Command {
    command
        .arg(
            Arg::new("recordings")
                .value_name("RECORDING.csv")
                .required_unless_present("targets")
                .num_args(1..)
                .action(ArgAction::Append)
                .value_parser(clap::value_parser!(PathBuf))
                .help("Recordings of one specimen on one rig: CSV with time_s, displacement_mm, force_n"),
        )
        .arg(
            Arg::new("targets")
                .long("targets")
                .value_name("CSV")
                .num_args(1..)
                .action(ArgAction::Append)
                .conflicts_with("recordings")
                .value_parser(clap::value_parser!(PathBuf))
                .help(
                    "Tables instead of recordings: tests by peak_force_n (or fmax_kn) and loop_energy_j, with mount, amplitude_mm, \
                     frequency_hz, source; or one loop by branch, displacement_mm, force_n",
                ),
        )
        .arg(local::bench_argument())
        .arg(Arg::new("baseline").long("baseline").value_name("MODEL").help(
            "Model to start from: equivalent, five-link, finite-segment or leaf-pack [default: the bench's]",
        ))
        .arg(
            Arg::new("known")
                .long("known")
                .value_name("CODE,CODE")
                .num_args(1)
                .value_delimiter(',')
                .help(
                    "Physics that the baseline has already (\"\" for none) [default: the bench's list and the model's own]",
                ),
        )
        .arg(
            Arg::new("run-next")
                .long("run-next")
                .value_name("WHERE")
                .num_args(0..=1)
                .require_equals(true)
                .default_missing_value("live")
                .value_parser(["live", "virtual"])
                .conflicts_with("targets")
                .help(
                    "Run the test that the diagnosis asks for, add its recording and diagnose again, until it is settled: \
                     live on the daemon's rig, =virtual on the bench's mock rig in virtual time",
                ),
        )
        .arg(
            Arg::new("rounds")
                .long("rounds")
                .value_name("N")
                .requires("run-next")
                .value_parser(clap::value_parser!(u32).range(1..=20))
                .default_value("4")
                .help("Most tests that --run-next runs"),
        )
        .arg(client::data_argument())
        .arg(
            Arg::new("out")
                .long("out")
                .value_name("DIR")
                .value_parser(clap::value_parser!(PathBuf))
                .default_value("diagnosis")
                .help("Folder for diagnosis.json, report.html and improved.toml"),
        )
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let bench = local::bench(matches)?;
    let baseline = baseline(matches, &bench.model)?;
    if matches.contains_id("targets") {
        return targets::run(matches, &bench, &baseline, output);
    }
    let paths: Vec<&PathBuf> = matches
        .get_many::<PathBuf>("recordings")
        .map(Iterator::collect)
        .unwrap_or_default();
    let recordings = paths
        .iter()
        .map(|path| csv::read_file(path))
        .collect::<Result<Vec<_>, _>>()?;
    recordings.iter().try_for_each(in_mm_and_n)?;
    let case = DiagnoseJob {
        bench: &bench,
        baseline: &baseline,
        output,
    };
    let folder = out_folder(matches);
    if matches.contains_id("run-next") {
        return run_next::run(matches, &case, recordings, &folder);
    }
    let diagnosis = case.diagnose(&recordings, &folder)?;
    output.result(&diagnosis, || text(&diagnosis, &folder))?;
    Ok(Done::Well)
}

/// Between these a secant of force over displacement is a spring's, N/mm; a thousandfold off it is another unit's.
const SPRINGS_N_PER_MM: [f64; 2] = [0.2, 10_000.0];
/// Ranges that a test in the right units exceeds: mm, and N.
const LEAST_RANGE: [f64; 2] = [0.2, 20.0];

/// Refuses columns whose figures are metres or kilonewtons under a header that says mm and N.
fn in_mm_and_n(recording: &Recording) -> Result<(), CliError> {
    let range = |values: &[f64]| {
        let (low, high) = values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(*v), h.max(*v))
            });
        high - low
    };
    let (mm, n) = (range(&recording.displacement_mm), range(&recording.force_n));
    let (column, values, unit, wanted) = match n / mm {
        rate if rate > SPRINGS_N_PER_MM[1] && mm < LEAST_RANGE[0] && n > LEAST_RANGE[1] => {
            ("displacement_mm", &recording.displacement_mm, "metres", "mm")
        }
        rate if rate < SPRINGS_N_PER_MM[0] && n < LEAST_RANGE[1] && mm > LEAST_RANGE[0] => {
            ("force_n", &recording.force_n, "kilonewtons", "N")
        }
        _ => return Ok(()),
    };
    let most = values
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let (index, value) = most.map_or((0, f64::NAN), |(i, v)| (i, *v));
    Err(CliError::Input(format!(
        "{}, row {}, column {column}: the largest value is {value}, while the force moves by {n:.3} and the displacement by {mm:.3}: no spring \
         is like that, it looks like {unit}; convert the column to {wanted}",
        recording.name,
        index + 2
    )))
}

/// What stays the same however many recordings there are.
pub(super) struct DiagnoseJob<'a> {
    /// The rig and its specimen.
    pub bench: &'a Bench,
    /// What the diagnosis starts from.
    pub baseline: &'a Baseline,
    /// Where results go.
    pub output: &'a Output,
}

impl DiagnoseJob<'_> {
    /// Diagnoses and writes the files to `folder`.
    pub(super) fn diagnose(&self, recordings: &[Recording], folder: &Path) -> Result<Diagnosis, CliError> {
        let diagnosis = with_progress(recordings, self.bench, self.baseline, self.output)?;
        let improved = improved_bench(self.bench, &diagnosis.improved);
        write_all(
            folder,
            &diagnosis,
            self.bench,
            self.baseline,
            recordings,
            &improved,
        )?;
        Ok(diagnosis)
    }
}

/// `--out`.
pub(super) fn out_folder(matches: &ArgMatches) -> PathBuf {
    let named = matches.get_one::<PathBuf>("out").cloned();
    named.unwrap_or_else(|| PathBuf::from("diagnosis"))
}

/// The verdict as the terminal has it.
pub(super) fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Adequate => "ADEQUATE",
        Verdict::MissingPhysics => "MISSING PHYSICS",
        Verdict::Unexplained => "UNEXPLAINED",
    }
}

/// What the diagnosis starts from: the bench's model, or the one named; its known physics, or what `--known` says.
fn baseline(matches: &ArgMatches, config: &ModelConfig) -> Result<Baseline, CliError> {
    let name = matches.get_one::<String>("baseline").unwrap_or(&config.name);
    let mut baseline = Baseline::of(model::find(name)?);
    if *name == config.name {
        baseline.structure = config.structure.clone();
        baseline.start = Some(config.values()?);
    }
    let told = matches.get_many::<String>("known").map(|codes| {
        let codes = codes.map(|c| c.trim().to_owned());
        codes.filter(|c| !c.is_empty()).collect::<Vec<String>>()
    });
    let beside: Vec<String> = config
        .known
        .iter()
        .cloned()
        .chain(config.effects.iter().map(|e| e.code.clone()))
        .collect();
    baseline.known = match told {
        Some(codes) => Some(codes),
        None if beside.is_empty() => None,
        None => {
            let own = baseline.model.physics.iter().map(|c| (*c).to_owned());
            let mut codes: Vec<String> = own.chain(beside).collect();
            codes.sort_unstable();
            codes.dedup();
            Some(codes)
        }
    };
    Ok(baseline)
}

fn with_progress(
    recordings: &[Recording],
    bench: &Bench,
    baseline: &Baseline,
    output: &Output,
) -> Result<Diagnosis, CliError> {
    let mut bar = Progress::new("diagnose", output.json);
    let begun = Instant::now();
    let options = DiagnoseOptions {
        limits: Some(bench.profile_limits()),
        ..DiagnoseOptions::default()
    };
    let diagnosis = diagnose(recordings, baseline, &options, &mut |share, _| {
        let elapsed_s = begun.elapsed().as_secs_f64();
        if share > 0.0 {
            bar.show(ProgressMark {
                elapsed_s,
                remaining_s: elapsed_s * (1.0 - share) / share,
                cycles: 0,
                cycles_total: 0,
            });
        }
    });
    bar.finish();
    Ok(diagnosis?)
}

/// The bench with the improved model in its specimen and its twin, so that twin, simulator and mock rig run it.
pub(super) fn improved_bench(bench: &Bench, improved: &ImprovedModel) -> Bench {
    let model = ModelConfig {
        name: improved.model.clone(),
        known: Vec::new(),
        parameters: improved.parameters.iter().cloned().collect(),
        structure: improved.structure.clone(),
        effects: improved
            .effects
            .iter()
            .map(|e| EffectConfig {
                code: e.code.clone(),
                parameters: e.parameters.iter().cloned().collect(),
            })
            .collect(),
    };
    let mut bench = bench.clone();
    bench.specimen.model = model.clone();
    bench.model = model;
    bench
}

fn write_all(
    folder: &Path,
    diagnosis: &Diagnosis,
    bench: &Bench,
    baseline: &Baseline,
    recordings: &[Recording],
    improved: &Bench,
) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "making the folder"))?;
    let json = serde_json::to_string_pretty(diagnosis).map_err(|e| CliError::Internal(e.to_string()))?;
    let context = Context {
        specimen: &bench.specimen.name,
        baseline: baseline.model.name,
        recordings: recordings.iter().map(|r| r.name.clone()).collect(),
    };
    let mut files = vec![
        ("diagnosis.json", json),
        ("report.html", page(diagnosis, &context)),
        ("improved.toml", improved.to_toml()),
    ];
    if let Some(next) = &diagnosis.next_test {
        files.push(("next-test.toml", next.profile_toml.clone()));
    }
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(CliError::file(&path, "writing"))?;
    }
    Ok(())
}

/// What a person reads in the terminal.
pub(super) fn text(d: &Diagnosis, folder: &Path) -> String {
    let mut lines = vec![format!("{}: {}", word(d.verdict), d.summary)];
    for e in &d.effects {
        lines.push(format!(
            "  {} ({:.0} % sure): {}",
            e.code,
            100.0 * e.confidence,
            e.statement
        ));
    }
    for a in &d.alternatives {
        lines.push(format!("  or {} instead of {}: {}", a.code, a.instead_of, a.why));
    }
    for l in &d.location {
        lines.push(format!("  where: {}", l.words));
    }
    let (before, after) = (d.fit.baseline.nrmse_heldout, d.fit.improved.nrmse_heldout);
    lines.push(format!(
        "  error on held-out cycles: {:.3} % before, {:.3} % after, noise floor {:.3} %",
        100.0 * before,
        100.0 * after,
        100.0 * d.fit.noise_floor_nrmse
    ));
    if let Some(next) = &d.next_test {
        lines.push(format!("  next test: {}", next.why));
    }
    lines.push(format!(
        "  {}: report.html, diagnosis.json, improved.toml",
        folder.display()
    ));
    lines.join("\n")
}
