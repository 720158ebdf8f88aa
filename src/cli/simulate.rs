//! `leafbench simulate`.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::{Arg, ArgMatches};

use super::plan::profile_argument;
use super::{CliError, Command, Done, Output, local};
use crate::config::ModelConfig;
use crate::model::leaf_pack::{self, LeafPack, PackStructure, Values};
use crate::model::{BuildError, Plant};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::csv::{CsvFormat, CsvWriter};
use crate::recording::{Flags, Sample};
use crate::report::pack as pack_drawing;
use crate::twin::{Predicted, dry_run_with};

/// Millimetres and newtons of a model have no counts: digits that no comparison misses.
const DECIMALS: u32 = 6;
/// Pictures of an animation, about, and how long it takes.
const FRAMES: usize = 60;
const SHOWN_S: f64 = 6.0;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "simulate",
    what: "Step the bench's model through a profile, without rig or noise, and write what it does as CSV",
    arguments: |command| {
        command
            .arg(profile_argument())
            .arg(local::bench_argument())
            .arg(local::profiles_argument())
            .arg(
                Arg::new("out")
                    .long("out")
                    .value_name("FILE")
                    .value_parser(clap::value_parser!(PathBuf))
                    .help("CSV to write [default: PROFILE.simulated.csv here]"),
            )
            .arg(
                Arg::new("draw")
                    .long("draw")
                    .value_name("NAME")
                    .value_parser(clap::value_parser!(PathBuf))
                    .help("Also draw the leaf pack: NAME.svg at the greatest force, NAME-moving.svg as it deforms"),
            )
    },
    run,
};

#[derive(serde::Serialize)]
struct Simulated {
    csv: PathBuf,
    rows: u64,
    model: String,
    peak_force_n: f64,
    peak_displacement_mm: f64,
    energy_j: f64,
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let bench = local::bench(matches)?;
    let name = matches
        .get_one::<String>("profile")
        .map(String::as_str)
        .unwrap_or_default();
    let (profile, _) = local::profile(matches, name)?;
    let path = matches
        .get_one::<PathBuf>("out")
        .cloned()
        .unwrap_or_else(|| format!("{}.simulated.csv", profile.name).into());
    let file = std::fs::File::create(&path).map_err(CliError::file(&path, "making the file"))?;
    let format = CsvFormat {
        time_decimals: 3,
        displacement_decimals: DECIMALS,
        force_decimals: DECIMALS,
        command_modes: vec![profile.mode],
    };
    let failed = || CliError::file(&path, "writing");
    let mut sink = BufWriter::new(file);
    let mut csv = CsvWriter::new(&mut sink, format).map_err(failed())?;
    let plant = bench.model.plant()?;
    let draw = matches.get_one::<PathBuf>("draw");
    let pack = draw.map(|_| drawn_pack(&bench.model)).transpose()?;
    let mut path_mm = Vec::new();
    let rate_hz = f64::from(SAMPLE_RATE_HZ);
    let mut tick = 0;
    let mut fault = None;
    let dry = dry_run_with(
        &profile,
        plant.as_ref(),
        &bench.profile_limits(),
        rate_hz,
        &mut |p| {
            tick += 1;
            path_mm.push(p.displacement_mm);
            if fault.is_none() {
                fault = csv.sample(&sample(tick, rate_hz, p)).err();
            }
        },
    )?;
    fault.map_or(Ok(()), Err).map_err(failed())?;
    let rows = csv.rows();
    sink.flush().map_err(failed())?;
    if let (Some(name), Some(pack)) = (draw, pack) {
        draw_pack(pack, &path_mm, name)?;
    }
    let simulated = Simulated {
        csv: path,
        rows,
        model: bench.model.name.clone(),
        peak_force_n: dry.peak_force_n,
        peak_displacement_mm: dry.peak_displacement_mm,
        energy_j: dry.energy_j,
    };
    output.result(&simulated, || {
        format!(
            "{}  ({rows} rows of model {}): peak {:.1} N, {:.3} mm, {:.2} J",
            simulated.csv.display(),
            simulated.model,
            simulated.peak_force_n,
            simulated.peak_displacement_mm,
            simulated.energy_j
        )
    })?;
    Ok(Done::Well)
}

/// The bench's leaf pack, whose state can be drawn.
fn drawn_pack(model: &ModelConfig) -> Result<LeafPack, CliError> {
    if model.name != leaf_pack::MODEL.name {
        return Err(CliError::Input(format!(
            "--draw knows model leaf-pack, this bench has {}: take a bench with a leaf pack",
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

/// Pictures of the cycle with the farthest turning point, or of the whole way where there is only one.
fn draw_pack(mut pack: LeafPack, path_mm: &[f64], name: &Path) -> Result<(), CliError> {
    let turns = turning_points(path_mm);
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
    // Between pictures at least this finely: friction remembers the way.
    let stride = (every / 10).max(1);
    let mut before = 0;
    for (k, &displacement_mm) in path_mm[..end].iter().enumerate() {
        let pictured = k >= start && (k % every == 0 || k == peak_at);
        if pictured || k % stride == 0 {
            let ticks = (k - before).max(1);
            pack.step(displacement_mm, ticks as f64 / f64::from(SAMPLE_RATE_HZ));
            before = k;
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

/// Places where the path turns by more than a fiftieth of its range.
fn turning_points(path_mm: &[f64]) -> Vec<usize> {
    let (low, high) = path_mm
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &d| {
            (low.min(d), high.max(d))
        });
    let band = 0.02 * (high - low);
    let (mut points, mut best, mut sense) = (Vec::new(), 0, 1.0);
    for (k, &d) in path_mm.iter().enumerate() {
        let ahead = sense * (d - path_mm[best]);
        if ahead >= 0.0 {
            best = k;
        } else if ahead < -band {
            points.push(best);
            (best, sense) = (k, -sense);
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
