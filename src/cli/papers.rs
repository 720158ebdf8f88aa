//! `leafbench papers`: reruns what the three papers report.
//!
//! - `text` the tables as Markdown · `page` docs/papers.md and its pictures

mod page;
mod text;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::shared::progress::Progress;
use super::{CliCommand, CliError, Done, Output};
use crate::identify::leaf_pack_rows::{AmplitudeReading, RowFit, mount_name};
use crate::identify::loop_points::FiveLinkComparison;
use crate::identify::targets::Aggregate;
use crate::papers::first::{self, Choice, LeafPackRerun, ReadingRerun};
use crate::papers::{second, third};

/// Compute the results of the three papers again and print them beside the published figures
#[derive(Debug, Args)]
pub(super) struct PapersArgs {
    /// What the first paper's "amplitude" means
    #[arg(long, value_enum, default_value_t = AmplitudeOption::Both)]
    amplitude: AmplitudeOption,
    /// Lowest displacement of the first paper's sines in mm, 0 to 8 [default: fitted]
    #[arg(long, value_name = "MM", value_parser = trough_in_mm)]
    trough_mm: Option<f64>,
    /// Cores to use, 0 for all; the figures do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Also write the page papers.md and its plots there
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Readings of the word "amplitude" that are run.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum AmplitudeOption {
    /// The whole stroke
    Whole,
    /// Half of the stroke
    Half,
    /// One after the other
    Both,
}

fn trough_in_mm(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|mm| (0.0..=8.0).contains(mm))
        .ok_or_else(|| "enter the sines' lowest displacement in mm, 0 to 8".to_owned())
}

/// The three papers run again.
struct Papers {
    first: LeafPackRerun,
    second: FiveLinkComparison,
    third: Vec<third::WagonRow>,
}

impl CliCommand for PapersArgs {
    const NAME: &'static str = "papers";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench papers",
        "leafbench papers --amplitude whole --out docs",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let choice = self.choice();
        let mut progress = Progress::new("papers", output.json);
        let mut show = |share: f64| progress.show_share(share, "fitting the models to the papers' tables");
        let papers = Papers {
            first: first::rerun(&choice, &mut show)?,
            second: second::rerun(choice.threads)?,
            third: third::rerun(choice.threads)?,
        };
        progress.finish();
        if let Some(folder) = &self.out {
            page::write(&papers, folder)?;
        }
        output.result(&json(&papers), || text::tables(&papers))?;
        Ok(Done::Success)
    }
}

impl PapersArgs {
    fn choice(&self) -> Choice {
        Choice {
            readings: match self.amplitude {
                AmplitudeOption::Whole => vec![AmplitudeReading::Whole],
                AmplitudeOption::Half => vec![AmplitudeReading::Half],
                AmplitudeOption::Both => vec![AmplitudeReading::Whole, AmplitudeReading::Half],
            },
            trough_mm: self.trough_mm,
            threads: self.threads,
        }
    }
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
