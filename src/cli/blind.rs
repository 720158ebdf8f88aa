//! `leafbench blind`.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use clap::{Arg, ArgMatches};

use super::progress::{Progress, ProgressMark};
use super::{CliError, Command, Done, Output};
use crate::blind::requirements::{Requirement, requirements};
use crate::blind::statistics::{ConfidenceBin, reliability};
use crate::blind::{BlindRequest, CaseScore, page, run as run_cases, seal};
use crate::truth::{Case, Family, sensors};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "blind",
    what: "Test the diagnosis on sealed cases with concealed effects and print how often it was right",
    arguments,
    run,
};

fn arguments(command: clap::Command) -> clap::Command {
    command
        .arg(
            Arg::new("cases")
                .long("cases")
                .value_name("N")
                .value_parser(clap::value_parser!(u64).range(1..))
                .default_value("400")
                .help("Number of cases; under 200 is an anecdote"),
        )
        .arg(
            Arg::new("seed")
                .long("seed")
                .value_name("S")
                .value_parser(clap::value_parser!(u64))
                .default_value("1")
                .help("The same seed gives the same cases"),
        )
        .arg(
            Arg::new("strength")
                .long("strength")
                .value_name("LIMITS")
                .value_parser(clap::value_parser!(f64))
                .help("Strength of every effect in detection limits [default: drawn from 1, 2, 5, 10]"),
        )
        .arg(
            Arg::new("kind")
                .long("kind")
                .value_name("KIND")
                .value_parser(clap::builder::PossibleValuesParser::new(
                    Family::ALL.map(Family::key),
                ))
                .help("Only the cases of one kind; they keep their numbers"),
        )
        .arg(
            Arg::new("out")
                .long("out")
                .value_name("DIR")
                .value_parser(clap::value_parser!(PathBuf))
                .help(
                    "Folder for blind.md, the page with the confusion matrix, and blind.json with every case",
                ),
        )
        .arg(
            Arg::new("export")
                .long("export")
                .value_name("CASE")
                .value_parser(clap::value_parser!(u64))
                .help("Only write the recordings of one case as CSV to --out, with its label beside them"),
        )
}

/// Of this many times as many cases those with a look-alike are examined for the row of `--run-next`.
const LOOK_ALIKES: u64 = 4;

#[derive(serde::Serialize)]
struct Summary {
    cases: u64,
    seed: u64,
    sealed_sha256: String,
    figures: Vec<Requirement>,
    reliability: Vec<ConfidenceBin>,
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let number = |name: &str| matches.get_one::<u64>(name).copied();
    let strength = matches.get_one::<f64>("strength").copied();
    if let Some(s) = strength
        && !(s > 0.0 && s <= 1000.0)
    {
        return Err(CliError::Input(format!(
            "--strength {s}: enter detection limits above 0 and up to 1000"
        )));
    }
    let family = matches
        .get_one::<String>("kind")
        .and_then(|key| Family::ALL.into_iter().find(|f| f.key() == key));
    let cases = number("cases").unwrap_or(400);
    let request = BlindRequest {
        cases,
        seed: number("seed").unwrap_or(1),
        strength,
        family,
        look_alikes: if family.is_none() { LOOK_ALIKES * cases } else { 0 },
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    let out = matches.get_one::<PathBuf>("out");
    if let Some(case) = number("export") {
        return export(
            &request,
            case,
            out.map_or(Path::new("."), PathBuf::as_path),
            output,
        );
    }
    let mut sealed = String::new();
    let examined = request.numbers().len() as u64;
    if examined == 0 {
        return Err(CliError::Input(format!(
            "--cases {}: no case of that kind is among so few; every kind comes once in 20",
            request.cases
        )));
    }
    let begun = Instant::now();
    let progress = Mutex::new(Progress::new("blind", output.json));
    let marks = run_cases(
        &request,
        &mut |seals| {
            sealed = seal::hash_of_all(seals);
            if !output.json {
                eprintln!("{} labels sealed, SHA-256 over all: {sealed}", seals.len());
            }
        },
        &|done| {
            let elapsed_s = begun.elapsed().as_secs_f64();
            if let Ok(mut bar) = progress.lock() {
                bar.show(ProgressMark {
                    elapsed_s,
                    remaining_s: elapsed_s * (examined - done) as f64 / done as f64,
                    cycles: 0,
                    cycles_total: 0,
                });
            }
        },
    )
    .map_err(CliError::Internal)?;
    if let Ok(bar) = progress.into_inner() {
        bar.finish();
    }
    if let Some(folder) = out {
        write_results(folder, &request, &sealed, &marks)?;
    }
    let (drawn, look_alikes) = request.split(&marks);
    let result = Summary {
        cases: drawn.len() as u64,
        seed: request.seed,
        sealed_sha256: sealed,
        figures: requirements(drawn, look_alikes),
        reliability: reliability(drawn),
    };
    output.result(&result, || page::text(&request, &marks))?;
    Ok(Done::Well)
}

fn write_results(
    folder: &Path,
    request: &BlindRequest,
    sealed: &str,
    marks: &[CaseScore],
) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "making the folder"))?;
    write(&folder.join("blind.md"), &page::markdown(request, sealed, marks))?;
    let json = serde_json::to_string(marks).map_err(|e| CliError::Internal(e.to_string()))?;
    write(&folder.join("blind.json"), &json)
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    std::fs::write(path, text).map_err(CliError::file(path, "writing"))
}

/// One case as files, so that it can be diagnosed by hand.
fn export(request: &BlindRequest, number: u64, folder: &Path, output: &Output) -> Result<Done, CliError> {
    let case = Case::draw(request.seed, number, request.strength);
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "making the folder"))?;
    let mut written = Vec::new();
    for recording in &case.recordings {
        let path = folder.join(&recording.name);
        write(&path, &sensors::csv(recording))?;
        written.push(path);
    }
    let label = serde_json::json!({ "label": case.label, "told": case.baseline });
    let path = folder.join(format!("case-{number:04}-label.json"));
    write(&path, &format!("{label:#}\n"))?;
    written.push(path);
    output.result(&written, || {
        let names: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
        names.join("\n")
    })?;
    Ok(Done::Well)
}
