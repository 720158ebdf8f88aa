//! `leafbench papers`: reruns what the three papers report.
//!
//! - `text` the tables as Markdown · `page` docs/papers.md and its pictures

mod page;
mod text;

use std::path::PathBuf;
use std::time::Instant;

use clap::{Arg, ArgMatches, value_parser};
use serde_json::json;

use super::progress::{Progress, ProgressMark};
use super::{CliError, Command, Done, Output};
use crate::identify::leaf_pack_rows::{AmplitudeReading, RowFit, mount_name};
use crate::identify::loop_points::FiveLinkComparison;
use crate::identify::targets::Aggregate;
use crate::papers::first::{self, Choice, LeafPackRerun, ReadingRerun};
use crate::papers::{second, third};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "papers",
    what: "Rerun what the three papers report and print their figures beside ours",
    arguments: |command| {
        command
            .arg(
                Arg::new("amplitude")
                    .long("amplitude")
                    .value_parser(["whole", "half", "both"])
                    .default_value("both")
                    .help("What the first paper's \"amplitude\" means: the whole stroke or half of it"),
            )
            .arg(
                Arg::new("trough-mm")
                    .long("trough-mm")
                    .value_name("MM")
                    .value_parser(value_parser!(f64))
                    .help("Lowest displacement of the first paper's sines, 0 to 8 [default: fitted]"),
            )
            .arg(
                Arg::new("threads")
                    .long("threads")
                    .value_name("N")
                    .value_parser(value_parser!(usize))
                    .default_value("0")
                    .help("Cores to use, 0 for all; the figures do not depend on it"),
            )
            .arg(
                Arg::new("out")
                    .long("out")
                    .value_name("FOLDER")
                    .value_parser(value_parser!(PathBuf))
                    .help("Also write the page papers.md and its plots there"),
            )
    },
    run,
};

/// The three papers run again.
struct Papers {
    first: LeafPackRerun,
    second: FiveLinkComparison,
    third: Vec<third::WagonRow>,
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let choice = choice(matches)?;
    let start = Instant::now();
    let mut progress = Progress::new("papers", output.json);
    let mut show = |share: f64| {
        let elapsed_s = start.elapsed().as_secs_f64();
        progress.show(ProgressMark {
            elapsed_s,
            remaining_s: if share > 0.0 {
                elapsed_s * (1.0 - share) / share
            } else {
                60.0
            },
            cycles: 0,
            cycles_total: 0,
        });
    };
    let papers = Papers {
        first: first::rerun(&choice, &mut show)?,
        second: second::rerun(choice.threads)?,
        third: third::rerun(choice.threads)?,
    };
    progress.finish();
    if let Some(folder) = matches.get_one::<PathBuf>("out") {
        page::write(&papers, folder)?;
    }
    output.result(&json(&papers), || text::tables(&papers))?;
    Ok(Done::Well)
}

fn choice(matches: &ArgMatches) -> Result<Choice, CliError> {
    let readings = match matches.get_one::<String>("amplitude").map(String::as_str) {
        Some("whole") => vec![AmplitudeReading::Whole],
        Some("half") => vec![AmplitudeReading::Half],
        _ => vec![AmplitudeReading::Whole, AmplitudeReading::Half],
    };
    let trough_mm = matches.get_one::<f64>("trough-mm").copied();
    if let Some(mm) = trough_mm.filter(|mm| !(0.0..=8.0).contains(mm)) {
        return Err(CliError::Input(format!(
            "--trough-mm {mm} is outside 0 to 8: give the lowest displacement of the sines in mm"
        )));
    }
    Ok(Choice {
        readings,
        trough_mm,
        threads: matches.get_one::<usize>("threads").copied().unwrap_or(0),
    })
}

fn json(papers: &Papers) -> serde_json::Value {
    let first = &papers.first;
    let pairs: Vec<_> = first
        .two_numbers
        .iter()
        .map(|t| {
            json!({ "mounting": mount_name(t.mounting), "printed": t.printed, "found": t.found,
                    "target": pair_json(t.target), "reach": pair_json(t.reach) })
        })
        .collect();
    let readings: Vec<_> = first.readings.iter().map(reading_json).collect();
    let second: Vec<_> = papers
        .second
        .rows()
        .into_iter()
        .map(|r| json!({ "model": r.model, "rms_n": r.rms_n, "share_of_envelope": r.share_of_envelope }))
        .collect();
    let third: Vec<_> = papers.third.iter().map(wagon_json).collect();
    json!({ "first": { "transition_velocity_mm_s": first.statics.transition_velocity_mm_s,
                       "two_numbers": pairs, "readings": readings },
            "second": second, "third": third })
}

fn pair_json(pair: Aggregate) -> serde_json::Value {
    json!({ "peak_n": pair.peak_force_n, "loop_j": pair.loop_energy_j })
}

fn reading_json(reading: &ReadingRerun) -> serde_json::Value {
    let own: Vec<_> = reading
        .tanh
        .rows
        .iter()
        .map(|o| {
            json!({ "mounting": mount_name(o.mounting), "row": o.name, "measured": pair_json(o.measured),
                    "paper": pair_json(o.simulated), "ours": pair_json(o.ours), "at_most_j": o.at_most_j })
        })
        .collect();
    json!({ "reading": reading.reading.name(), "misfit": reading.misfit(), "own_model": own,
            "fits": reading.fits.iter().map(fit_json).collect::<Vec<_>>() })
}

fn fit_json(f: &RowFit) -> serde_json::Value {
    let values: serde_json::Map<_, _> = (f.fit.parameters.iter().zip(&f.fit.values).zip(&f.fit.free))
        .filter(|(_, free)| **free)
        .map(|((p, v), _)| (p.name.to_owned(), json!(v)))
        .collect();
    let rows: Vec<_> = f
        .rows
        .iter()
        .map(|r| {
            json!({ "mounting": mount_name(r.mounting), "row": r.name, "measured": pair_json(r.measured),
                    "ours": pair_json(r.ours) })
        })
        .collect();
    let [worst_peak, worst_energy] = f.worst_errors();
    json!({ "case": f.case.name(), "values": values, "rows": rows, "worst_peak": worst_peak,
            "worst_energy": worst_energy, "evaluations": f.fit.evaluations, "at_bounds": f.at_bounds() })
}

fn wagon_json(row: &third::WagonRow) -> serde_json::Value {
    let figures: Vec<_> = row
        .figures
        .iter()
        .map(|f| json!({ "name": f.name, "published": f.published, "identified": f.identified }))
        .collect();
    json!({ "spring": row.spring, "method": row.method, "evaluations": row.evaluations, "worst": row.worst,
            "figures": figures })
}
