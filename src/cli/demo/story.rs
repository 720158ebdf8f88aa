//! The second part of the demo: an effect is concealed in the mock rig, recorded, diagnosed, and put into the twin.
//!
//! It goes the way of the commands: runs of the mock rig are exported as CSV, the CSV files are read and diagnosed as by
//! `diagnose --run-next=virtual`, and the improved model is loaded from the file that the diagnosis wrote.

use std::path::Path;

use serde::Serialize;

use super::concealed::{Concealed, ConcealedParameter, NameCheck, SEED, spaced};
use super::fresh::{Fresh, FreshErrors, fresh_step};
use super::played::{Played, percent};
use crate::cli::diagnose::{self, Ended};
use crate::cli::{CliError, Output};
use crate::config::Bench;
use crate::diagnose::Verdict;
use crate::recording::export::{self, Selection};
use crate::recording::{Recording, csv};
use crate::report::story::{StoryPart, StoryPicture, StoryStep, StoryTable, located_picture, loop_picture};
use crate::report::svg::{Ink, PlotCurve};

/// Shipped profiles that are recorded for the diagnosis: a slow loop over the whole travel and a quick one at one mean.
const RECORDED: [&str; 2] = ["static-ramp-12s", "sine-6mm-2.5hz-10"];
/// Shipped profile that judges the improved model: no diagnosis has seen its amplitude and frequency.
const FRESH: &str = "sine-10mm-1hz";
/// Folders of the story's files, in the folder of the demo.
const CONCEALED_FOLDER: &str = "concealed";
const DIAGNOSIS_FOLDER: &str = "diagnosis";
const BEFORE_FOLDER: &str = "twin-before";
const AFTER_FOLDER: &str = "twin-after";
const TRUTH_FOLDER: &str = "twin-truth";

/// The story, for scripts; `part` tells it to people.
#[derive(Serialize)]
pub(super) struct Story {
    seed: u64,
    concealed: Concealed,
    recorded: Vec<TwinError>,
    verdict: Verdict,
    named: Vec<String>,
    look_alikes: Vec<String>,
    name_check: NameCheck,
    /// True if the diagnosis asked for no further test.
    settled: bool,
    /// Number of tests that the diagnosis proposed and the mock rig ran.
    tests: usize,
    fresh: FreshErrors,
    #[serde(skip)]
    pub part: StoryPart,
}

/// How far a twin is from a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct TwinError {
    profile: String,
    nrmse: Option<f64>,
}

impl Story {
    /// The story as lines for the terminal.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.part.title.clone()];
        for (index, step) in self.part.steps.iter().enumerate() {
            lines.push(format!("{}. {}", index + 1, step.title));
            let said = step.text.iter().chain([&step.conclusion]);
            lines.extend(
                said.filter(|text| !text.is_empty())
                    .map(|text| format!("   {text}")),
            );
        }
        lines
    }
}

/// Runs the story; its files go to folders in `folder`.
pub(super) fn tell(bench: &Bench, configs: &Path, folder: &Path, output: &Output) -> Result<Story, CliError> {
    let concealed = Concealed::draw(SEED)?;
    let rig = concealed.in_bench(bench);
    let play = |name: &str, rig: &Bench, into: &str| {
        Played::shipped(name, rig, configs, &folder.join(into), output.json)
    };
    let runs = RECORDED
        .iter()
        .map(|name| play(name, &rig, CONCEALED_FOLDER))
        .collect::<Result<Vec<_>, _>>()?;
    let recordings = runs
        .iter()
        .map(|run| export_and_read(run, &folder.join(CONCEALED_FOLDER)))
        .collect::<Result<Vec<_>, _>>()?;
    let ended = diagnose::until_settled(&rig, recordings, &folder.join(DIAGNOSIS_FOLDER), output)?;
    let before = play(FRESH, &rig, BEFORE_FOLDER)?;
    let after = improved_twin(&rig, &folder.join(DIAGNOSIS_FOLDER))?
        .map(|improved| play(FRESH, &improved, AFTER_FOLDER))
        .transpose()?;
    let told = Bench {
        model: rig.specimen.model.clone(),
        ..rig.clone()
    };
    let fresh = Fresh::new(before, after, &play(FRESH, &told, TRUTH_FOLDER)?, &rig);
    let (named, look_alikes) = codes(&ended);
    let name_check = NameCheck::of(concealed.code, &named, &look_alikes);
    let steps = vec![
        concealed_step(&concealed),
        recorded_step(&runs, &ended),
        diagnosed_step(&concealed, name_check, &ended),
        fresh_step(&fresh, &format!("{DIAGNOSIS_FOLDER}/{}", diagnose::IMPROVED)),
    ];
    Ok(Story {
        seed: SEED,
        recorded: runs.iter().map(twin_error).collect(),
        verdict: ended.diagnosis.verdict,
        named: named.iter().map(|code| (*code).to_owned()).collect(),
        look_alikes: look_alikes.iter().map(|code| (*code).to_owned()).collect(),
        name_check,
        settled: ended.settled,
        tests: ended.earlier.len(),
        fresh: fresh.errors,
        part: StoryPart {
            title: "A concealed effect and its diagnosis".to_owned(),
            lead: "From here on the mock rig's spring has an effect that its model lacks.".to_owned(),
            steps,
        },
        concealed,
    })
}

/// Exports a run to `folder` and reads the file as the command `diagnose` reads it.
fn export_and_read(run: &Played, folder: &Path) -> Result<Recording, CliError> {
    let csv = folder.join(format!("{}.csv", run.profile.name));
    let exported = export::export(&run.file, Selection::Whole, &csv)?;
    Ok(csv::read_file(&exported.csv)?)
}

/// The bench with the twin of the improved bench file; its specimen stays as it is. `None` if no such file was written.
fn improved_twin(rig: &Bench, folder: &Path) -> Result<Option<Bench>, CliError> {
    let file = folder.join(diagnose::IMPROVED);
    if !file.is_file() {
        return Ok(None);
    }
    Ok(Some(Bench {
        model: Bench::load(&file)?.model,
        ..rig.clone()
    }))
}

/// Codes of the named effects, and those of their look-alikes.
fn codes(ended: &Ended) -> (Vec<&str>, Vec<&str>) {
    let d = &ended.diagnosis;
    (
        d.effects.iter().map(|e| e.code.as_str()).collect(),
        d.alternatives.iter().map(|a| a.code.as_str()).collect(),
    )
}

fn twin_error(run: &Played) -> TwinError {
    TwinError {
        profile: run.profile.name.clone(),
        nrmse: run.twin_nrmse,
    }
}

fn concealed_step(concealed: &Concealed) -> StoryStep {
    StoryStep {
        title: format!("Concealed: {}", spaced(concealed.code)),
        text: vec![
            concealed.statement.clone(),
            format!(
                "The spring on the mock rig has it from here on. Its size was drawn with seed {SEED}; neither the twin nor the diagnosis \
                 is told."
            ),
        ],
        ..StoryStep::default()
    }
}

fn recorded_step(runs: &[Played], ended: &Ended) -> StoryStep {
    let first = ended.earlier.first().unwrap_or(&ended.diagnosis);
    let errors = runs
        .iter()
        .map(|run| format!("{} {}", run.profile.name, percent(run.twin_nrmse)));
    let mut text = vec![format!(
        "Error of the twin, as a share of the force range: {}.",
        errors.collect::<Vec<_>>().join(", ")
    )];
    text.extend(
        first
            .location
            .iter()
            .map(|l| format!("Where they differ: {}", l.words)),
    );
    let worst = runs.iter().max_by(|a, b| {
        a.twin_nrmse
            .unwrap_or(0.0)
            .total_cmp(&b.twin_nrmse.unwrap_or(0.0))
    });
    let mut pictures: Vec<StoryPicture> = worst.map(loop_of).into_iter().collect();
    pictures.extend(located_picture(first));
    StoryStep {
        title: "Recorded with the unchanged model as the twin".to_owned(),
        text,
        pictures,
        files: runs
            .iter()
            .map(|run| format!("{CONCEALED_FOLDER}/{}.csv", run.profile.name))
            .collect(),
        ..StoryStep::default()
    }
}

fn loop_of(run: &Played) -> StoryPicture {
    let curves = [
        PlotCurve::measured("", run.curve(|s| Some(s.force_n))),
        PlotCurve::twin("", run.curve(|s| s.twin_force_n)),
    ];
    let legend = [("measured", Ink::Measured), ("unchanged twin", Ink::Twin)];
    loop_picture(&curves, &legend, &run.profile.name)
}

fn diagnosed_step(concealed: &Concealed, check: NameCheck, ended: &Ended) -> StoryStep {
    let d = &ended.diagnosis;
    let (named, look_alikes) = codes(ended);
    let mut text: Vec<String> = Vec::new();
    for earlier in &ended.earlier {
        text.push(earlier.summary.clone());
        text.extend(earlier.alternatives.iter().map(|a| {
            format!(
                "It could also be {} instead of {}: {}.",
                spaced(&a.code),
                spaced(&a.instead_of),
                a.why
            )
        }));
        text.extend(earlier.next_test.iter().map(|next| {
            let why = next.why.trim_end_matches('.');
            format!(
                "The mock rig then ran the next test by itself ({:.0} s). {why}.",
                next.duration_s
            )
        }));
    }
    text.push(d.summary.clone());
    text.extend(d.effects.iter().map(|e| {
        let sure = 100.0 * e.confidence;
        format!("{}, {sure:.0} % sure: {}", spaced(&e.code), e.statement)
    }));
    text.push(match (ended.settled, look_alikes.as_slice()) {
        (true, _) => format!("No further test is needed: {}.", ended.why),
        (false, []) => format!("It is not settled: {}.", ended.why),
        (false, others) => {
            let others: Vec<String> = others.iter().map(|code| spaced(code)).collect();
            format!(
                "It is not settled ({}): {} is still possible.",
                ended.why,
                others.join(" or ")
            )
        }
    });
    StoryStep {
        title: "Diagnosed".to_owned(),
        text,
        table: Some(sizes(concealed, ended)),
        conclusion: check.words(concealed.code, &named),
        files: [diagnose::REPORT, diagnose::IMPROVED]
            .iter()
            .map(|name| format!("{DIAGNOSIS_FOLDER}/{name}"))
            .collect(),
        ..StoryStep::default()
    }
}

/// Concealed and found size of each parameter.
fn sizes(concealed: &Concealed, ended: &Ended) -> StoryTable {
    let none = || "\u{2013}".to_owned();
    let row = |p: &ConcealedParameter| {
        let found = concealed.found(p.name, &ended.diagnosis);
        let interval = found.and_then(|v| v.ci95);
        vec![
            p.what.to_owned(),
            format!("{:.3} {}", p.value, p.unit),
            found.map_or_else(none, |v| format!("{:.3} {}", v.value, p.unit)),
            interval.map_or_else(none, |[low, high]| format!("{low:.3} to {high:.3}")),
        ]
    };
    StoryTable {
        head: vec!["size", "concealed", "found", "95 % interval"],
        rows: concealed.parameters.iter().map(row).collect(),
    }
}
