//! `leafbench demo`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;

use super::shared::local;
use super::virtual_bench::record_run;
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::daemon::library;
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::cycles::CycleSummary;
use crate::recording::export::{self, Selection};
use crate::recording::metrics::{NrmseMeter, Range, loop_energy_j, secant_rate_n_per_mm};
use crate::recording::run_file::{EXTENSION, RunFile};
use crate::recording::{Ending, Sample};
use crate::report::loops::{LoopPage, Section};
use crate::report::svg::{PlotCurve, xy_plot};

/// Shipped profiles that are run: a force-controlled ramp and a displacement-controlled sine.
const PROFILES: [&str; 2] = ["static-ramp", "sine-6mm-1hz"];
/// Points of a curve in the page: finer than a screen shows.
const CURVE_POINTS: usize = 2000;
/// Counted cycle by which amplitude and mean have settled.
const SETTLED_CYCLE: u32 = 5;
/// Static ramp and 6 mm sine on the mock rig in virtual time: table, CSV and a page with the loops
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder to write to; earlier results of the demo there are replaced
    #[arg(long, value_name = "DIR", default_value = "leafbench-demo")]
    out: PathBuf,
}

/// One row of the table: one profile's run.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
struct DemoRow {
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

#[derive(serde::Serialize)]
struct Demo {
    folder: PathBuf,
    page: PathBuf,
    rows: Vec<DemoRow>,
    virtual_s: f64,
    real_s: f64,
}

impl CliCommand for DemoArgs {
    const NAME: &'static str = "demo";
    const EXAMPLES: &'static [&'static str] = &["leafbench demo", "leafbench demo --out loops --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let begun = Instant::now();
        let folder = self.out;
        std::fs::create_dir_all(&folder).map_err(CliError::file(&folder, "creating the folder"))?;
        let configs = local::configs()?;
        let bench = Bench::load(&configs.join("benches/mock.toml"))?;
        let (mut rows, mut sections, mut virtual_s) = (Vec::new(), Vec::new(), 0.0);
        for name in PROFILES {
            let (profile, text) = library::read(&configs.join("profiles").join(format!("{name}.toml")))?;
            let run = record_run(&bench, &profile, text, &folder, output.json)?;
            virtual_s += run.virtual_s;
            let (row, section) = export_and_summarise(&run.file, &profile, &folder)?;
            rows.push(row);
            sections.push(section);
        }
        let demo = Demo {
            page: write_page(&folder, &bench, sections)?,
            folder,
            rows,
            virtual_s,
            real_s: begun.elapsed().as_secs_f64(),
        };
        output.result(&demo, || text(&demo))?;
        let complete = |r: &DemoRow| r.ending == Ending::Completed && r.lost == 0;
        Ok(Done::success_if(demo.rows.iter().all(complete)))
    }
}

/// Writes the page with the loops; its path.
fn write_page(folder: &Path, bench: &Bench, sections: Vec<Section>) -> Result<PathBuf, CliError> {
    let page = folder.join("index.html");
    let html = LoopPage {
        title: "leafbench demo: measured loops and twin",
        lead: &lead(bench),
        sections,
    }
    .render();
    std::fs::write(&page, html).map_err(CliError::file(&page, "writing"))?;
    Ok(page)
}

fn lead(bench: &Bench) -> String {
    format!(
        "Measured on the mock rig in virtual time, specimen {}, twin: model {}. No real rig was involved.",
        bench.specimen.name, bench.model.name
    )
}

/// Exports one run; its row of the table and its section of the page.
fn export_and_summarise(
    run: &RunFile,
    profile: &Profile,
    folder: &Path,
) -> Result<(DemoRow, Section), CliError> {
    let name = &profile.name;
    let exported = export::export(run, Selection::Whole, &folder.join(format!("{name}.csv")))?;
    let cycles = match exported.survey.cycles.is_empty() {
        true => Vec::new(),
        false => {
            export::export(
                run,
                Selection::MeanLoop,
                &folder.join(format!("{name}-mean-loop.csv")),
            )?;
            export::export_cycles(run, &folder.join(format!("{name}.cycles.csv")))?
        }
    };
    // Segment 0 is outside the profile, such as the unloading after it: recorded, but no part of the test.
    let samples: Vec<Sample> = run.samples().filter(|s| s.segment > 0).collect();
    let row = row(run, profile, &samples, &cycles, exported.survey.lost);
    let section = section(name, &profile.description, &samples, &row);
    Ok((row, section))
}

fn row(run: &RunFile, profile: &Profile, samples: &[Sample], cycles: &[CycleSummary], lost: u64) -> DemoRow {
    let force: Vec<f64> = samples.iter().map(|s| s.force_n).collect();
    let displacement: Vec<f64> = samples.iter().map(|s| s.displacement_mm).collect();
    let mut twin = NrmseMeter::default();
    for (sample, twin_n) in samples.iter().filter_map(|s| Some((s, s.twin_force_n?))) {
        twin.add(sample.force_n, twin_n);
    }
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
    let target_mm = target_amplitude(samples, &whole, profile);
    let settled = whole.iter().find(|c| c.cycle == SETTLED_CYCLE).zip(target_mm);
    DemoRow {
        profile: profile.name.clone(),
        ending: run.outcome().map_or(Ending::Aborted, |o| o.ending),
        peak_force_n: force.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        loop_energy_j,
        rate_n_per_mm,
        samples: samples.len() as u64,
        lost,
        amplitude_error: settled.map(|(c, target)| c.displacement_mm.amplitude() / target - 1.0),
        twin_nrmse: twin.value(),
    }
}

/// The amplitude of the profile's first counted cycle.
fn target_amplitude(samples: &[Sample], whole: &[&CycleSummary], profile: &Profile) -> Option<f64> {
    let first = whole.first()?;
    let segment = samples.iter().find(|s| s.cycle == first.cycle)?.segment;
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ)).ok()?;
    player.target_of(segment).map(|t| t.amplitude)
}

fn section(name: &str, description: &str, samples: &[Sample], row: &DemoRow) -> Section {
    let step = samples.len().div_ceil(CURVE_POINTS * 4).max(1);
    let shown: Vec<&Sample> = samples.iter().step_by(step).collect();
    let measured = shown.iter().map(|s| (s.displacement_mm, s.force_n)).collect();
    let twin = shown
        .iter()
        .filter_map(|s| Some((s.displacement_mm, s.twin_force_n?)))
        .collect();
    let curves = [
        PlotCurve::measured("measured", measured),
        PlotCurve::twin("twin", twin),
    ];
    let optional = |value: Option<f64>, scale: f64, digits: usize, unit: &str| {
        value.map_or("\u{2013}".to_owned(), |v| {
            format!("{:.digits$} {unit}", v * scale)
        })
    };
    Section {
        title: name.to_owned(),
        text: description.to_owned(),
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

fn text(demo: &Demo) -> String {
    let mut lines = vec![format!(
        "{:<16}{:>12}{:>14}{:>14}{:>10}{:>6}{:>14}{:>12}",
        "profile", "peak force", "loop energy", "rate", "samples", "lost", "amplitude*", "twin NRMSE"
    )];
    lines.extend(demo.rows.iter().map(|r| {
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
    lines.push(String::new());
    lines.push(format!(
        "{:.0} s of bench time in {:.1} s; CSV, data packages and run files in {}, loops in {}",
        demo.virtual_s,
        demo.real_s,
        demo.folder.display(),
        demo.page.display()
    ));
    lines.join("\n")
}
