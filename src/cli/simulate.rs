//! `leafbench simulate`.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use clap::{Arg, ArgMatches};

use super::plan::profile_argument;
use super::{CliError, Command, Done, Output, local};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::csv::{CsvFormat, CsvWriter};
use crate::recording::{Flags, Sample};
use crate::twin::{Predicted, dry_run_with};

/// Millimetres and newtons of a model have no counts: digits that no comparison misses.
const DECIMALS: u32 = 6;

/// See [`super::COMMANDS`].
pub const COMMAND: Command = Command {
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
            if fault.is_none() {
                fault = csv.sample(&sample(tick, rate_hz, p)).err();
            }
        },
    )?;
    fault.map_or(Ok(()), Err).map_err(failed())?;
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
