//! `leafbench simulate`: on the model here, on the mock rig in `rig_run`.

mod rig_run;

use std::io::{BufWriter, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use clap::Args;

use super::shared::local::{BenchArg, ProfileArgs};
use super::{CliCommand, CliError, Done, Output};
use crate::config::{Bench, ModelConfig};
use crate::model::leaf_pack::{self, LeafPack, PackStructure, Values};
use crate::model::{BuildError, Plant};
use crate::profile::Profile;
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::csv::{CsvFormat, CsvWriter};
use crate::recording::{Flags, Sample};
use crate::report::pack as pack_drawing;
use crate::twin::{Predicted, dry_run_with};

/// Decimals of mm and N in the CSV: a model has no counts that would set its resolution.
const DECIMALS: u32 = 6;
/// Approximate number of pictures in an animation.
const FRAMES: usize = 60;
/// Duration of an animation in s.
const SHOWN_S: f64 = 6.0;

/// Run a profile on the model of the bench, or on the mock rig in virtual time, and write displacement and force as CSV
#[derive(Debug, Args)]
#[command(
    after_help = "Without --rig the model is stepped along the commanded motion: no noise, no hydraulics. With --rig the mock rig of the\n\
                  bench runs the profile as a daemon would, with noise, hydraulics, limits and the twin beside: the CSV is that of\n\
                  an export, with its data package. Exit code 1: the run did not complete."
)]
pub(super) struct SimulateArgs {
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    bench: BenchArg,
    /// CSV to write [default: PROFILE.simulated.csv here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Run on the mock rig of the bench in virtual time, with sensor noise and hydraulics
    #[arg(long, conflicts_with = "draw")]
    rig: bool,
    /// Seed of the sensor noise of --rig [default: from the bench file]
    #[arg(long, requires = "rig", value_parser = clap::value_parser!(i64).range(0..))]
    seed: Option<i64>,
    /// With --rig: replace files that are there already
    #[arg(long, requires = "rig")]
    force: bool,
    /// Also draw the leaf pack: NAME.svg at the greatest force, NAME-moving.svg as it deforms
    #[arg(long, value_name = "NAME")]
    draw: Option<PathBuf>,
}

#[derive(serde::Serialize)]
struct Simulated {
    csv: PathBuf,
    rows: u64,
    model: String,
    peak_force_n: f64,
    peak_displacement_mm: f64,
    energy_j: f64,
}

impl CliCommand for SimulateArgs {
    const NAME: &'static str = "simulate";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench simulate sine-6mm-1hz",
        "leafbench simulate sine-6mm-2.5hz-10 --rig --seed 7 --out noisy.csv",
        "leafbench simulate static-ramp-12s --bench bench-configs/benches/samurai-rail.toml --draw pack",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let bench = self.bench.load()?;
        let (profile, text) = self.profile.load()?;
        if self.rig {
            return rig_run::play(
                rig_run::RigRun {
                    bench,
                    profile,
                    profile_toml: text,
                    out: self.out,
                    seed: self.seed,
                    force: self.force,
                },
                output,
            );
        }
        let path = self
            .out
            .unwrap_or_else(|| format!("{}.simulated.csv", profile.name).into());
        let drawing = match self.draw {
            Some(name) => Some((name, drawable_pack(&bench.model)?)),
            None => None,
        };
        let (simulated, path_mm) = simulate(&bench, &profile, path)?;
        if let Some((name, pack)) = drawing {
            draw_pack(pack, &path_mm, &name)?;
        }
        output.result(&simulated, || line(&simulated))?;
        Ok(Done::Success)
    }
}

fn line(s: &Simulated) -> String {
    format!(
        "{}  ({} rows of model {}): peak {:.1} N, {:.3} mm, {:.2} J",
        s.csv.display(),
        s.rows,
        s.model,
        s.peak_force_n,
        s.peak_displacement_mm,
        s.energy_j
    )
}

/// Runs the profile on the bench's model into the CSV; also returns the displacement of every tick in mm.
fn simulate(bench: &Bench, profile: &Profile, path: PathBuf) -> Result<(Simulated, Vec<f64>), CliError> {
    let plant = bench.model.plant()?;
    let file = std::fs::File::create(&path).map_err(CliError::file(&path, "creating the file"))?;
    let format = CsvFormat {
        time_decimals: 3,
        displacement_decimals: DECIMALS,
        force_decimals: DECIMALS,
        command_modes: vec![profile.mode],
    };
    let failed = || CliError::file(&path, "writing");
    let mut sink = BufWriter::new(file);
    let mut csv = CsvWriter::new(&mut sink, format).map_err(failed())?;
    let mut path_mm = Vec::new();
    let rate_hz = f64::from(SAMPLE_RATE_HZ);
    let mut first_fault = None;
    let dry = dry_run_with(
        profile,
        plant.as_ref(),
        &bench.profile_limits(),
        rate_hz,
        &mut |p| {
            path_mm.push(p.displacement_mm);
            first_fault = csv.sample(&sample(path_mm.len() as u64, rate_hz, p)).err();
            match first_fault {
                None => ControlFlow::Continue(()),
                Some(_) => ControlFlow::Break(()),
            }
        },
    )?;
    first_fault.map_or(Ok(()), Err).map_err(failed())?;
    let rows = csv.rows();
    sink.flush().map_err(failed())?;
    let simulated = Simulated {
        csv: path,
        rows,
        model: bench.model.name.clone(),
        peak_force_n: dry.peak_force_n,
        peak_displacement_mm: dry.peak_displacement_mm,
        energy_j: dry.energy_j,
    };
    Ok((simulated, path_mm))
}

/// The bench's leaf pack as a type that can be drawn; refused for another model.
fn drawable_pack(model: &ModelConfig) -> Result<LeafPack, CliError> {
    if model.name != leaf_pack::MODEL.name {
        return Err(CliError::Input(format!(
            "--draw works with model {} only, and this bench has {}: name a bench with a leaf pack",
            leaf_pack::MODEL.name,
            model.name
        )));
    }
    let refused = |reason| {
        CliError::Model(BuildError::Structure {
            model: leaf_pack::MODEL.name,
            reason,
        })
    };
    let structure = PackStructure::from_table(&model.structure).map_err(refused)?;
    let values = Values::from_slice(&model.values()?)
        .ok_or_else(|| CliError::Internal("a leaf pack's values are incomplete".to_owned()))?;
    LeafPack::new(&structure, &values).map_err(refused)
}

/// Draws the cycle with the largest displacement, or the whole path if it has one reversal only.
fn draw_pack(mut pack: LeafPack, path_mm: &[f64], name: &Path) -> Result<(), CliError> {
    let turns = reversals(path_mm);
    let farthest = (0..turns.len()).fold(0, |m, k| {
        if path_mm[turns[k]] > path_mm[turns[m]] {
            k
        } else {
            m
        }
    });
    let peak_at = turns.get(farthest).copied().unwrap_or(0);
    let start = farthest.checked_sub(2).map_or(0, |k| turns[k]);
    let end = turns.get(farthest + 1).copied().unwrap_or(path_mm.len());
    let every = ((end - start) / FRAMES).max(1);
    let mut shapes = Vec::new();
    // The pack is also stepped between pictures, because friction depends on the path.
    let stride = (every / 10).max(1);
    let mut last_step = 0;
    for (k, &displacement_mm) in path_mm[..end].iter().enumerate() {
        let pictured = k >= start && (k % every == 0 || k == peak_at);
        if pictured || k % stride == 0 {
            let ticks = (k - last_step).max(1);
            pack.step(displacement_mm, ticks as f64 / f64::from(SAMPLE_RATE_HZ));
            last_step = k;
        }
        if pictured {
            shapes.push(pack.shape());
        }
    }
    let Some(peak) = shapes.iter().max_by(|a, b| a.pusher[1].total_cmp(&b.pusher[1])) else {
        return Ok(());
    };
    let stem = name.with_extension("");
    let file = |end: &str| PathBuf::from(format!("{}{end}.svg", stem.display()));
    for (path, svg) in [
        (file(""), pack_drawing::picture(peak)),
        (file("-moving"), pack_drawing::animation(&shapes, SHOWN_S)),
    ] {
        std::fs::write(&path, svg).map_err(CliError::file(&path, "writing"))?;
    }
    Ok(())
}

/// Indices of the path's reversals; a movement back of less than 2 % of the range is ignored.
fn reversals(path_mm: &[f64]) -> Vec<usize> {
    let (low, high) = path_mm
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &d| {
            (low.min(d), high.max(d))
        });
    let band = 0.02 * (high - low);
    let (mut points, mut extreme, mut sense) = (Vec::new(), 0, 1.0);
    for (k, &d) in path_mm.iter().enumerate() {
        let ahead = sense * (d - path_mm[extreme]);
        if ahead >= 0.0 {
            extreme = k;
        } else if ahead < -band {
            points.push(extreme);
            (extreme, sense) = (k, -sense);
        }
    }
    points
}

fn sample(tick: u64, rate_hz: f64, p: &Predicted) -> Sample {
    Sample {
        tick,
        time_s: tick as f64 / rate_hz,
        force_n: p.force_n,
        displacement_mm: p.displacement_mm,
        force_counts: 0,
        displacement_counts: 0,
        command: Some(p.slot.command),
        cycle: p.slot.cycle,
        segment: p.slot.segment,
        twin_force_n: None,
        flags: Flags::default(),
    }
}
