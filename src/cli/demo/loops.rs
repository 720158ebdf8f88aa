//! The ramp and the sine of the demo: rows of the table, exported files and sections of the page.

use std::path::Path;

use super::played::{Played, SETTLED_CYCLE};
use crate::cli::{CliError, Output};
use crate::config::Bench;
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::cycles::CycleSummary;
use crate::recording::export::{self, Selection};
use crate::recording::metrics::{Range, loop_energy_j, secant_rate_n_per_mm};
use crate::recording::run_file::EXTENSION;
use crate::recording::{Ending, Sample};
use crate::report::loops::Section;
use crate::report::svg::{PlotCurve, xy_plot};

/// Shipped profiles that are run: a force-controlled ramp and a displacement-controlled sine.
const PROFILES: [&str; 2] = ["static-ramp", "sine-6mm-1hz"];

/// One row of the table: one profile's run.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(super) struct DemoRow {
    profile: String,
    ending: Ending,
    peak_force_n: f64,
    loop_energy_j: f64,
    rate_n_per_mm: Option<f64>,
    samples: u64,
    lost: u64,
    /// Relative error of the amplitude in the fifth counted cycle; `None` without cycles.
    amplitude_error: Option<f64>,
    twin_nrmse: Option<f64>,
}

impl DemoRow {
    /// True if the run came to its end and no sample is missing.
    pub(super) fn is_complete(&self) -> bool {
        self.ending == Ending::Completed && self.lost == 0
    }
}

/// The runs of [`PROFILES`].
#[derive(Default)]
pub(super) struct Loops {
    pub rows: Vec<DemoRow>,
    pub sections: Vec<Section>,
    /// Bench time of all runs.
    pub virtual_s: f64,
}

/// Runs the profiles and exports each run to `folder`.
pub(super) fn record(
    bench: &Bench,
    configs: &Path,
    folder: &Path,
    output: &Output,
) -> Result<Loops, CliError> {
    let mut loops = Loops::default();
    for name in PROFILES {
        let run = Played::shipped(name, bench, configs, folder, output.json)?;
        let (row, section) = export_and_summarise(&run, folder)?;
        loops.virtual_s += run.virtual_s;
        loops.rows.push(row);
        loops.sections.push(section);
    }
    Ok(loops)
}

/// Exports one run; its row of the table and its section of the page.
fn export_and_summarise(run: &Played, folder: &Path) -> Result<(DemoRow, Section), CliError> {
    let name = &run.profile.name;
    let exported = export::export(&run.file, Selection::Whole, &folder.join(format!("{name}.csv")))?;
    let cycles = match exported.survey.cycles.is_empty() {
        true => Vec::new(),
        false => {
            export::export(
                &run.file,
                Selection::MeanLoop,
                &folder.join(format!("{name}-mean-loop.csv")),
            )?;
            export::export_cycles(&run.file, &folder.join(format!("{name}.cycles.csv")))?
        }
    };
    let row = row(run, &cycles, exported.survey.lost);
    let section = section(run, &row);
    Ok((row, section))
}

fn row(run: &Played, cycles: &[CycleSummary], lost: u64) -> DemoRow {
    let samples = &run.samples;
    let force: Vec<f64> = samples.iter().map(|s| s.force_n).collect();
    let displacement: Vec<f64> = samples.iter().map(|s| s.displacement_mm).collect();
    let whole: Vec<&CycleSummary> = cycles.iter().filter(|c| c.complete).collect();
    let mean =
        |value: fn(&CycleSummary) -> f64| whole.iter().map(|c| value(c)).sum::<f64>() / whole.len() as f64;
    let (loop_energy_j, rate_n_per_mm) = match whole.is_empty() {
        // A ramp has no counted cycles: the whole run is one loop.
        true => {
            let ranges = Range::of(&displacement).zip(Range::of(&force));
            (
                loop_energy_j(&displacement, &force),
                ranges.and_then(|(x, f)| secant_rate_n_per_mm(x, f)),
            )
        }
        false => (
            mean(|c| c.loop_energy_j),
            Some(mean(|c| c.secant_rate_n_per_mm.unwrap_or(f64::NAN))),
        ),
    };
    let target_mm = target_amplitude(samples, &whole, &run.profile);
    let settled = whole.iter().find(|c| c.cycle == SETTLED_CYCLE).zip(target_mm);
    DemoRow {
        profile: run.profile.name.clone(),
        ending: run.file.outcome().map_or(Ending::Aborted, |o| o.ending),
        peak_force_n: force.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        loop_energy_j,
        rate_n_per_mm,
        samples: samples.len() as u64,
        lost,
        amplitude_error: settled.map(|(c, target)| c.displacement_mm.amplitude() / target - 1.0),
        twin_nrmse: run.twin_nrmse,
    }
}

/// The amplitude of the profile's first counted cycle.
fn target_amplitude(samples: &[Sample], whole: &[&CycleSummary], profile: &Profile) -> Option<f64> {
    let first = whole.first()?;
    let segment = samples.iter().find(|s| s.cycle == first.cycle)?.segment;
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ)).ok()?;
    player.target_of(segment).map(|t| t.amplitude)
}

fn section(run: &Played, row: &DemoRow) -> Section {
    let name = &run.profile.name;
    let curves = [
        PlotCurve::measured("measured", run.curve(|s| Some(s.force_n))),
        PlotCurve::twin("twin", run.curve(|s| s.twin_force_n)),
    ];
    let optional = |value: Option<f64>, scale: f64, digits: usize, unit: &str| {
        value.map_or("\u{2013}".to_owned(), |v| {
            format!("{:.digits$} {unit}", v * scale)
        })
    };
    Section {
        title: name.clone(),
        text: run.profile.description.clone(),
        svg: xy_plot("displacement in mm", "force in N", &curves),
        facts: vec![
            ("Peak force".to_owned(), format!("{:.1} N", row.peak_force_n)),
            ("Loop energy".to_owned(), format!("{:.2} J", row.loop_energy_j)),
            (
                "Secant rate".to_owned(),
                optional(row.rate_n_per_mm, 1.0, 2, "N/mm"),
            ),
            (
                "Samples".to_owned(),
                format!("{}, {} lost", row.samples, row.lost),
            ),
            (
                format!("Amplitude error, cycle {SETTLED_CYCLE}"),
                optional(row.amplitude_error, 100.0, 2, "%"),
            ),
            ("Twin NRMSE".to_owned(), optional(row.twin_nrmse, 100.0, 2, "%")),
        ],
        files: vec![
            format!("{name}.csv"),
            format!("{name}.datapackage.json"),
            format!("{name}.{EXTENSION}"),
        ],
    }
}

/// The rows as lines of text, with the heading.
pub(super) fn table(rows: &[DemoRow]) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<16}{:>12}{:>14}{:>14}{:>10}{:>6}{:>14}{:>12}",
        "profile", "peak force", "loop energy", "rate", "samples", "lost", "amplitude*", "twin NRMSE"
    )];
    lines.extend(rows.iter().map(|r| {
        let percent = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{:+.2} %", 100.0 * v));
        format!(
            "{:<16}{:>10.1} N{:>12.2} J{:>14}{:>10}{:>6}{:>14}{:>12}",
            r.profile,
            r.peak_force_n,
            r.loop_energy_j,
            r.rate_n_per_mm.map_or("-".to_owned(), |v| format!("{v:.2} N/mm")),
            r.samples,
            r.lost,
            percent(r.amplitude_error),
            percent(r.twin_nrmse).trim_start_matches('+')
        )
    }));
    lines.push(format!(
        "* error of the amplitude in counted cycle {SETTLED_CYCLE}"
    ));
    lines
}
