//! `leafbench demo`: the bench's main job in virtual time. Static ramp and the 6 mm 1 Hz sine on the mock rig, twin
//! beside, run files, CSV, data packages and a page with the loops.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::table;
use super::virtual_bench::{VirtualBench, VirtualBenchError};
use crate::config::{Bench, ConfigError};
use crate::control::RigStatus;
use crate::control::run::RunOrder;
use crate::profile::{Profile, ProfileError};
use crate::recording::Ending;
use crate::recording::cycles::CycleSummary;
use crate::recording::export::{self, ExportError, Selection};
use crate::recording::metrics::{LoopIntegral, Range, secant_rate_n_per_mm};
use crate::recording::run_file::{EXTENSION, RunFile, RunFileError, RunFileWriter};
use crate::report::loops::{self, LoopSection};
use crate::report::svg::PlotError;
use crate::twin::Twin;

/// The profiles of the demo, in order.
pub const PROFILES: [&str; 2] = ["static-ramp", "sine-6mm-1hz"];
/// Counted cycle by which amplitude and mean must be right.
const JUDGED_CYCLE: u32 = 5;
const HEAD: [&str; 9] = [
    "profile",
    "peak force N",
    "loop energy J",
    "rate N/mm",
    "samples",
    "lost",
    "amplitude error at cycle 5 %",
    "twin NRMSE %",
    "x real time",
];

/// Why the demo ended early.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// A config file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A profile file cannot be read.
    #[error("{} cannot be read: run from the project's folder, or give --configs", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// A profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The bench.
    #[error(transparent)]
    Bench(#[from] VirtualBenchError),
    /// The twin's model.
    #[error("the twin's model cannot be built")]
    Model(#[from] crate::model::BuildError),
    /// The run file.
    #[error(transparent)]
    RunFile(#[from] RunFileError),
    /// The export.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The page.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The folder or page cannot be written.
    #[error("{} cannot be written", path.display())]
    Write {
        /// What.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// A run did not complete.
    #[error("run {run_id} did not complete: {cause}")]
    NotCompleted {
        /// Which.
        run_id: String,
        /// Why.
        cause: String,
    },
}

/// Figures of one run, for the table and for scripts.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct DemoRun {
    /// Profile.
    pub profile: String,
    /// Highest force in N.
    pub peak_force_n: f64,
    /// Loop energy in J: of the whole run, or the mean over counted cycles.
    pub loop_energy_j: f64,
    /// Secant rate in N/mm.
    pub secant_rate_n_per_mm: Option<f64>,
    /// Samples recorded.
    pub samples: u64,
    /// Samples missing.
    pub lost: u64,
    /// Amplitude against the profile's at the fifth counted cycle, in percent; `None` without cycles.
    pub amplitude_error_cycle5_percent: Option<f64>,
    /// Misfit of the twin in percent of the force's range.
    pub twin_nrmse_percent: Option<f64>,
    /// Virtual seconds a second, recording included.
    pub real_time_factor: f64,
    /// CSV of the whole run.
    pub csv: PathBuf,
}

/// Runs the demo of the bench file at `bench_path`; profiles are beside it in `../profiles`. Everything goes to `out`.
pub fn run(
    bench_path: &Path,
    out: &Path,
    progress: &mut dyn FnMut(&str, &RigStatus),
) -> Result<Vec<DemoRun>, DemoError> {
    let bench = Bench::load(bench_path)?;
    let configs = bench_path
        .parent()
        .and_then(Path::parent)
        .unwrap_or(Path::new("."));
    std::fs::create_dir_all(out).map_err(|source| DemoError::Write {
        path: out.to_owned(),
        source,
    })?;
    let mut runs = Vec::new();
    let mut sections = Vec::new();
    for name in PROFILES {
        let (run, section) = one_run(&bench, configs, name, out, progress)?;
        runs.push(run);
        sections.push(section);
    }
    let page = loops::page(
        "leafbench demo: measured loops",
        "Mock rig in virtual time. Measured is what the load cell and the LVDT gave; the twin is the same spring model, stepped with the measured displacement.",
        &HEAD,
        &runs.iter().map(row).collect::<Vec<_>>(),
        &sections,
    )?;
    let path = out.join("loops.html");
    std::fs::write(&path, page).map_err(|source| DemoError::Write { path, source })?;
    Ok(runs)
}

/// The summary table for the terminal.
pub fn summary(runs: &[DemoRun]) -> String {
    table::render(&HEAD, &runs.iter().map(row).collect::<Vec<_>>())
}

fn row(run: &DemoRun) -> Vec<String> {
    let or_dash =
        |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    vec![
        run.profile.clone(),
        format!("{:.1}", run.peak_force_n),
        format!("{:.3}", run.loop_energy_j),
        or_dash(run.secant_rate_n_per_mm, 2),
        run.samples.to_string(),
        run.lost.to_string(),
        or_dash(run.amplitude_error_cycle5_percent, 3),
        or_dash(run.twin_nrmse_percent, 3),
        format!("{:.0}", run.real_time_factor),
    ]
}

fn one_run(
    bench: &Bench,
    configs: &Path,
    name: &str,
    out: &Path,
    progress: &mut dyn FnMut(&str, &RigStatus),
) -> Result<(DemoRun, LoopSection), DemoError> {
    let path = configs.join("profiles").join(format!("{name}.toml"));
    let toml = std::fs::read_to_string(&path).map_err(|source| DemoError::Read {
        path: path.clone(),
        source,
    })?;
    let profile = Profile::from_toml(&toml, &path.display().to_string())?;
    let run_id = format!("demo-{name}");
    let header = bench.header(&run_id, &super::now_utc(), &profile, &toml)?;
    let file = out.join(&run_id).with_extension(EXTENSION);
    remove_if_there(&file).map_err(|source| DemoError::Write {
        path: file.clone(),
        source,
    })?;
    let writer = RunFileWriter::create(&file, &header)?;
    let mut twin = Twin::new(bench.model.plant()?, Box::new(writer), || false);
    let planned_s = header.duration_planned_s;
    let began = Instant::now();
    let mut virtual_bench = VirtualBench::new(bench)?;
    virtual_bench.run(
        RunOrder {
            header,
            profile,
            first_cycle: 1,
        },
        &mut twin,
        &mut |status| progress(name, status),
    )?;
    drop(twin);
    let real_time_factor = planned_s / began.elapsed().as_secs_f64();
    let run = RunFile::open(&file)?;
    if let Some(outcome) = run.outcome().filter(|o| o.ending != Ending::Completed) {
        return Err(DemoError::NotCompleted {
            run_id,
            cause: outcome.cause.clone(),
        });
    }
    let csv = out.join(format!("{name}.csv"));
    export::export(&run, Selection::Whole, &csv)?;
    let cycles = if run.survey().cycles_completed() > 0 {
        export::export(
            &run,
            Selection::MeanLoop,
            &out.join(format!("{name}-mean-loop.csv")),
        )?;
        export::export_cycles(&run, &out.join(format!("{name}-cycles.csv")))?
    } else {
        Vec::new()
    };
    let figures = judge(name, &run, &cycles, real_time_factor, csv);
    let section = section(name, &run, &figures);
    Ok((figures, section))
}

/// A demo repeats: the run file of the one before goes.
fn remove_if_there(path: &Path) -> std::io::Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

fn judge(name: &str, run: &RunFile, cycles: &[CycleSummary], real_time_factor: f64, csv: PathBuf) -> DemoRun {
    let (mut force_n, mut displacement_mm) = (None, None);
    let mut whole = LoopIntegral::default();
    let mut twin = crate::recording::metrics::NrmseMeter::default();
    for sample in run.samples() {
        force_n = Some(Range::including(force_n, sample.force_n));
        displacement_mm = Some(Range::including(displacement_mm, sample.displacement_mm));
        whole.add(sample.displacement_mm, sample.force_n);
        if let Some(twin_force_n) = sample.twin_force_n {
            twin.add(sample.force_n, twin_force_n);
        }
    }
    let survey = run.survey();
    let complete: Vec<&CycleSummary> = cycles.iter().filter(|c| c.complete).collect();
    let mean =
        |of: fn(&CycleSummary) -> f64| complete.iter().map(|c| of(c)).sum::<f64>() / complete.len() as f64;
    let asked = asked_amplitude(run);
    let judged = complete.iter().find(|c| c.cycle == JUDGED_CYCLE);
    DemoRun {
        profile: name.to_owned(),
        peak_force_n: force_n.map_or(f64::NAN, |r| r.peak),
        loop_energy_j: if complete.is_empty() {
            whole.energy_j()
        } else {
            mean(|c| c.loop_energy_j)
        },
        secant_rate_n_per_mm: match (complete.first(), displacement_mm.zip(force_n)) {
            (Some(_), _) => Some(mean(|c| c.secant_rate_n_per_mm.unwrap_or(f64::NAN))),
            (None, Some((x, f))) => secant_rate_n_per_mm(x, f),
            (None, None) => None,
        },
        samples: survey.samples,
        lost: survey.lost + survey.damaged,
        amplitude_error_cycle5_percent: judged
            .zip(asked)
            .map(|(c, asked)| 100.0 * (c.displacement_mm.amplitude() / asked - 1.0)),
        twin_nrmse_percent: twin.value().map(|v| 100.0 * v),
        real_time_factor,
        csv,
    }
}

/// Amplitude that the profile asks for in its counted cycles.
fn asked_amplitude(run: &RunFile) -> Option<f64> {
    use crate::profile::Segment;
    let profile = Profile::from_toml(&run.header().profile_toml, "run file").ok()?;
    profile
        .blocks
        .iter()
        .flat_map(|b| &b.segments)
        .find_map(|s| match s {
            Segment::Sine { amplitude, .. } | Segment::Triangle { amplitude, .. } => Some(*amplitude),
            _ => None,
        })
}

fn section(name: &str, run: &RunFile, figures: &DemoRun) -> LoopSection {
    let samples = run
        .samples()
        .step_by(10)
        .map(|s| [s.displacement_mm, s.force_n, s.twin_force_n.unwrap_or(f64::NAN)])
        .collect();
    let last_cycle = run.survey().cycles.last().map(|c| c.cycle);
    LoopSection {
        title: name.to_owned(),
        samples,
        last_cycle: match last_cycle {
            Some(last) => run
                .samples()
                .filter(|s| s.cycle == last)
                .map(|s| [s.displacement_mm, s.force_n, s.twin_force_n.unwrap_or(f64::NAN)])
                .collect(),
            None => Vec::new(),
        },
        caption: format!(
            "{} samples, {} lost, twin NRMSE {:.3} %.",
            figures.samples,
            figures.lost,
            figures.twin_nrmse_percent.unwrap_or(f64::NAN)
        ),
    }
}
