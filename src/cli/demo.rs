//! `leafbench demo`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Arg, ArgMatches};

use super::progress::{Progress, ProgressMark};
use super::virtual_bench::VirtualBench;
use super::{CliError, Command, Done, Output, local};
use crate::config::Bench;
use crate::control::run::RunOrder;
use crate::daemon::{header, library};
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::cycles::CycleSummary;
use crate::recording::export::{self, Selection};
use crate::recording::metrics::{NrmseMeter, Range, loop_energy_j, secant_rate_n_per_mm};
use crate::recording::run_file::{EXTENSION, RunFile, RunFileWriter};
use crate::recording::{Ending, Sample};
use crate::report::loops::{LoopPage, Section};
use crate::report::svg::{PlotCurve, xy_plot};
use crate::twin::Twin;

/// What is shown: a force-controlled ramp and a displacement-controlled sine.
const PROFILES: [&str; 2] = ["static-ramp", "sine-6mm-1hz"];
/// Points of a curve in the page: more than a screen has.
const CURVE_POINTS: usize = 2000;
/// By this counted cycle amplitude and mean have settled.
const SETTLED_CYCLE: u32 = 5;
/// The progress bar moves this often, in ms of bench time.
const PROGRESS_MS: u64 = 500;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "demo",
    what: "Static ramp and 6 mm sine on the mock rig in virtual time: table, CSV and a page with the loops",
    arguments: |command| {
        command.arg(
            Arg::new("out")
                .long("out")
                .value_name("DIR")
                .value_parser(clap::value_parser!(PathBuf))
                .default_value("leafbench-demo")
                .help("Folder to write to; earlier results of the demo there are replaced"),
        )
    },
    run,
};

/// One row of the table.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
struct DemoRow {
    profile: String,
    ending: Ending,
    peak_force_n: f64,
    loop_energy_j: f64,
    rate_n_per_mm: Option<f64>,
    samples: u64,
    lost: u64,
    /// Of the fifth counted cycle, relative; `None` without cycles.
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

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let begun = Instant::now();
    let folder = matches
        .get_one::<PathBuf>("out")
        .cloned()
        .unwrap_or_else(|| "leafbench-demo".into());
    std::fs::create_dir_all(&folder).map_err(CliError::file(&folder, "making the folder"))?;
    let configs = local::configs()?;
    let bench = Bench::load(&configs.join("benches/mock.toml"))?;
    let (mut rows, mut sections, mut virtual_s) = (Vec::new(), Vec::new(), 0.0);
    for name in PROFILES {
        let (profile, text) = library::read(&configs.join("profiles").join(format!("{name}.toml")))?;
        let run = play(&bench, &profile, text, &folder, &mut virtual_s, output)?;
        let (row, section) = account(&run, &profile, &folder)?;
        rows.push(row);
        sections.push(section);
    }
    let page = folder.join("index.html");
    let title = "leafbench demo: measured loops and twin";
    let html = LoopPage {
        title,
        lead: &lead(&bench),
        sections,
    }
    .render();
    std::fs::write(&page, html).map_err(CliError::file(&page, "writing"))?;
    let demo = Demo {
        folder,
        page,
        rows,
        virtual_s,
        real_s: begun.elapsed().as_secs_f64(),
    };
    output.result(&demo, || text(&demo))?;
    let well = demo
        .rows
        .iter()
        .all(|r| r.ending == Ending::Completed && r.lost == 0);
    Ok(if well { Done::Well } else { Done::Otherwise })
}

fn lead(bench: &Bench) -> String {
    format!(
        "Measured on the mock rig in virtual time, specimen {}, twin: model {}. No real rig was involved.",
        bench.specimen.name, bench.model.name
    )
}

/// One profile from hello to unloaded rig, into a run file.
pub(super) fn play(
    bench: &Bench,
    profile: &Profile,
    profile_toml: String,
    folder: &Path,
    virtual_s: &mut f64,
    output: &Output,
) -> Result<RunFile, CliError> {
    let path = folder.join(format!("{}.{EXTENSION}", profile.name));
    for ending in ["", "-wal", "-shm"] {
        // Missing ones are the rule.
        let _ = std::fs::remove_file(format!("{}{ending}", path.display()));
    }
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ))?;
    let planned = header::Planned {
        cycles: player.total_cycles(),
        duration_s: player.duration_s(),
    };
    let now = jiff::Timestamp::now();
    let header = header::new(profile.name.clone(), now, bench, profile, profile_toml, planned);
    let writer = RunFileWriter::create(&path, &header)?;
    let mut chain = Twin::new(
        bench.model.plant()?,
        bench.displacement_channel.noise_mm,
        Box::new(writer),
        || false,
    )
    .watching(bench.noise());
    let order = RunOrder {
        header,
        profile: profile.clone(),
        first_cycle: 1,
    };
    let mut progress = Progress::new(&profile.name, output.json);
    let mut turns = 0;
    let mut virtual_bench = VirtualBench::new(bench, None)?;
    virtual_bench.play(order, &mut chain, |bench| {
        turns += 1;
        if turns % PROGRESS_MS == 0 {
            let status = bench.rig.status();
            progress.show(ProgressMark {
                elapsed_s: status.elapsed_s,
                remaining_s: status.remaining_s,
                cycles: status.cycles_completed,
                cycles_total: status.cycles_total,
            });
        }
    })?;
    progress.finish();
    *virtual_s += virtual_bench.now_ns() as f64 * 1e-9;
    drop(chain);
    Ok(RunFile::open(&path)?)
}

/// Exports one run and sums it up.
fn account(run: &RunFile, profile: &Profile, folder: &Path) -> Result<(DemoRow, Section), CliError> {
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
    // The run's own motion; the unload after it is recorded too, but is no test.
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
        // A ramp is one loop of its own.
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
    let asked = asked_amplitude(samples, &whole, profile);
    let settled = whole.iter().find(|c| c.cycle == SETTLED_CYCLE).zip(asked);
    DemoRow {
        profile: profile.name.clone(),
        ending: run.outcome().map_or(Ending::Aborted, |o| o.ending),
        peak_force_n: force.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        loop_energy_j,
        rate_n_per_mm,
        samples: samples.len() as u64,
        lost,
        amplitude_error: settled.map(|(c, asked)| c.displacement_mm.amplitude() / asked - 1.0),
        twin_nrmse: twin.value(),
    }
}

/// The amplitude that the profile's first counted cycle is to reach.
fn asked_amplitude(samples: &[Sample], whole: &[&CycleSummary], profile: &Profile) -> Option<f64> {
    let first = whole.first()?;
    let segment = samples.iter().find(|s| s.cycle == first.cycle)?.segment;
    let player = Player::new(profile, 0.0, f64::from(SAMPLE_RATE_HZ)).ok()?;
    player.target_of(segment).map(|t| t.amplitude)
}

fn section(name: &str, description: &str, samples: &[Sample], row: &DemoRow) -> Section {
    let step = samples.len().div_ceil(CURVE_POINTS * 4).max(1);
    // A sine repeats: a dozen cycles show every loop, finer.
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
