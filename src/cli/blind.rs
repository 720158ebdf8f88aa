//! `leafbench blind`.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::blind::by_world::{self, WorldRow};
use crate::blind::requirements::{Requirement, requirements};
use crate::blind::statistics::{ConfidenceBin, reliability};
use crate::blind::{BlindRequest, CaseScore, page, run as run_cases, seal};
use crate::truth::{Family, World, sensors};

/// The row of `--run-next` draws this many times `--cases` further cases and examines those with a look-alike.
const LOOK_ALIKES: u64 = 4;

/// Test the diagnosis on sealed cases with concealed effects and print how often it was right
#[derive(Debug, Args)]
pub(super) struct BlindArgs {
    /// Number of cases; with fewer than 200 the rates are rough
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 400)]
    cases: u64,
    /// The same seed gives the same cases
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Strength of every effect in detection limits, up to 1000 [default: drawn from 1, 2, 5, 10]
    #[arg(long, value_name = "LIMITS", value_parser = strength_in_limits)]
    strength: Option<f64>,
    /// Only the cases of one kind; the numbers of the cases stay the same
    #[arg(long, value_name = "KIND", value_parser = kinds())]
    kind: Option<Family>,
    /// Equations of the truth, and one row for each family; in all worlds but `own` they are not those of the library
    #[arg(long, value_name = "WORLD", value_parser = worlds())]
    world: Option<Worlds>,
    /// Folder for blind.md, the page with the confusion matrix, and blind.json with every case
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only write the recordings of one case as CSV to --out, with its label beside them
    #[arg(long, value_name = "CASE")]
    export: Option<u64>,
}

fn strength_in_limits(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|s| *s > 0.0 && *s <= 1000.0)
        .ok_or_else(|| "enter detection limits above 0 and up to 1000".to_owned())
}

fn kinds() -> impl TypedValueParser<Value = Family> {
    PossibleValuesParser::new(Family::ALL.map(Family::key)).try_map(|key| {
        let family = Family::ALL.into_iter().find(|f| f.key() == key);
        family.ok_or("use one of the kinds listed")
    })
}

/// The worlds of a run.
#[derive(Debug, Clone)]
struct Worlds(Vec<World>);

fn worlds() -> impl TypedValueParser<Value = Worlds> {
    let keys = World::ALL.map(World::key).into_iter().chain(["all"]);
    PossibleValuesParser::new(keys).map(|key| {
        let chosen = World::ALL.into_iter().filter(|w| key == "all" || w.key() == key);
        Worlds(chosen.collect())
    })
}

#[derive(serde::Serialize)]
struct Summary {
    cases: u64,
    seed: u64,
    sealed_sha256: String,
    figures: Vec<Requirement>,
    reliability: Vec<ConfidenceBin>,
}

/// Results of a run with `--world`.
#[derive(serde::Serialize)]
struct WorldSummary {
    cases: u64,
    seed: u64,
    sealed_sha256: Vec<(World, String)>,
    worlds: Vec<WorldRow>,
}

impl CliCommand for BlindArgs {
    const NAME: &'static str = "blind";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench blind --cases 400 --seed 7 --out docs",
        "leafbench blind --seed 7 --export 12 --out case-12",
        "leafbench blind --world all --cases 40 --seed 7",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let request = self.request();
        if let Some(case) = self.export {
            let folder = self.out.as_deref().unwrap_or(Path::new("."));
            return export(&request, case, folder, output);
        }
        if let Some(Worlds(worlds)) = &self.world {
            return self.by_world(worlds, output);
        }
        if request.numbers().is_empty() {
            return Err(no_case(request.cases));
        }
        let (sealed, marks) = examine(&request, output)?;
        if let Some(folder) = &self.out {
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
        Ok(Done::Success)
    }
}

impl BlindArgs {
    fn request(&self) -> BlindRequest {
        BlindRequest {
            cases: self.cases,
            seed: self.seed,
            world: self.world.as_ref().map_or(World::Own, |w| w.0[0]),
            strength: self.strength,
            family: self.kind,
            look_alikes: match (self.kind, &self.world) {
                (None, None) => LOOK_ALIKES * self.cases,
                _ => 0,
            },
            threads: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }

    /// Runs each world, and shows one row for each family.
    fn by_world(&self, worlds: &[World], output: &Output) -> Result<Done, CliError> {
        let all = worlds.iter().map(|&world| BlindRequest {
            world,
            ..self.request()
        });
        // A kind that only some worlds have is left out in the others.
        let requests: Vec<BlindRequest> = all.filter(|r| !r.numbers().is_empty()).collect();
        if requests.is_empty() {
            return Err(no_case(self.cases));
        }
        let mut sealed_sha256 = Vec::new();
        let mut scores = Vec::new();
        for request in &requests {
            let (sealed, of_world) = examine(request, output)?;
            sealed_sha256.push((request.world, sealed));
            scores.extend(of_world);
        }
        if let Some(folder) = &self.out {
            write_pages(
                folder,
                &by_world::markdown(self.seed, &sealed_sha256, &scores),
                &scores,
            )?;
        }
        let result = WorldSummary {
            cases: scores.len() as u64,
            seed: self.seed,
            sealed_sha256,
            worlds: by_world::rows(&scores),
        };
        output.result(&result, || by_world::text(&result.worlds))?;
        Ok(Done::Success)
    }
}

/// The answer to a run without cases.
fn no_case(cases: u64) -> CliError {
    CliError::Input(format!(
        "--cases {cases}: none of these cases is of that kind: enter at least 20, which contain every kind of a world"
    ))
}

/// Seals the labels, diagnoses every case and opens them; the SHA-256 over all seals, and the marks.
fn examine(request: &BlindRequest, output: &Output) -> Result<(String, Vec<CaseScore>), CliError> {
    let examined = request.numbers().len() as u64;
    let progress = Mutex::new(Progress::new("blind", output.json));
    let mut sealed = String::new();
    let marks = run_cases(
        request,
        &mut |seals| {
            sealed = seal::hash_of_all(seals);
            if !output.json {
                eprintln!("{} labels sealed, SHA-256 over all: {sealed}", seals.len());
            }
        },
        &|done| {
            if let Ok(mut bar) = progress.lock() {
                let share = done as f64 / examined as f64;
                bar.show_share(share, &format!("case {done} of {examined}"));
            }
        },
    )
    .map_err(CliError::Internal)?;
    if let Ok(bar) = progress.into_inner() {
        bar.finish();
    }
    Ok((sealed, marks))
}

fn write_results(
    folder: &Path,
    request: &BlindRequest,
    sealed: &str,
    marks: &[CaseScore],
) -> Result<(), CliError> {
    write_pages(folder, &page::markdown(request, sealed, marks), marks)
}

/// Writes blind.md and blind.json.
fn write_pages(folder: &Path, page: &str, marks: &[CaseScore]) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "creating the folder"))?;
    write(&folder.join("blind.md"), page)?;
    let json = serde_json::to_string(marks).map_err(|e| CliError::Internal(e.to_string()))?;
    write(&folder.join("blind.json"), &json)
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    std::fs::write(path, text).map_err(CliError::file(path, "writing"))
}

/// Writes one case as files, so that it can be diagnosed with `leafbench diagnose`.
fn export(request: &BlindRequest, number: u64, folder: &Path, output: &Output) -> Result<Done, CliError> {
    let case = request.case(number);
    std::fs::create_dir_all(folder).map_err(CliError::file(folder, "creating the folder"))?;
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
    Ok(Done::Success)
}
