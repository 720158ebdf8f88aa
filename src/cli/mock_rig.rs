//! `leafbench mock-rig`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;

use super::shared::ctrl_c::ctrl_c_flag;
use super::shared::local::{self, BenchArg};
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::link::priority::raise_this_thread;
use crate::link::{self, Side};
use crate::mockrig::{list_of_faults, read_faults};
use crate::regular_file;

/// Simulate a rig at the other end of a CAN bus or serial line: firmware, hydraulics, sensors and a spring
#[derive(Debug, Args)]
#[command(after_help = format!("Runs in real time until Ctrl-C or until the line is closed.\n\nFaults:\n{}", list_of_faults()))]
pub(super) struct MockRigArgs {
    #[command(flatten)]
    bench: BenchArg,
    #[arg(
        long,
        value_name = "ADDRESS",
        help = format!("Address of the link to the host: {}", link::port_forms())
    )]
    link: String,
    /// Seed of the sensor noise [default: from the bench file]
    #[arg(long)]
    seed: Option<u64>,
    /// Fault that the rig plays, as NAME=AMOUNT@FROM..TO; may be given several times. `run+3s` counts from the begin of each motion
    #[arg(long = "fault", value_name = "FAULT")]
    fault: Vec<String>,
    /// File of such faults: a TOML file with the one key `faults`, a list of texts
    #[arg(long = "faults", value_name = "FILE")]
    faults: Option<PathBuf>,
}

impl CliCommand for MockRigArgs {
    const NAME: &'static str = "mock-rig";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench mock-rig --bench bench-configs/benches/mock-vcan.toml --link can:vcan0",
        "leafbench mock-rig --bench bench-configs/benches/mock-serial.toml --link serial:/dev/pts/3 --seed 7",
        "leafbench mock-rig --link can:vcan0 --fault status-lost@run+3s..8s --fault leak=20@60s",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let mut bench = self.bench.load()?;
        add_faults(&mut bench, &self.fault, self.faults.as_deref())?;
        let rig = local::mock_rig(&bench, self.seed)?;
        let side = Side::Rig {
            node: bench.link.node,
        };
        let link = link::open(&self.link, side)?;
        let health = Arc::clone(&link.health);
        // The rig stops between two ticks without unloading, as after a power cut.
        let stop = ctrl_c_flag();
        eprintln!(
            "mock rig of bench {} at {}; end it with Ctrl-C",
            bench.name, self.link
        );
        if let Err(reason) = raise_this_thread() {
            eprintln!(
                "no real-time priority ({reason}): under load the rig may stall, and the daemon then trips"
            );
        }
        let punctuality = rig
            .run_realtime(link, &stop)
            .map_err(|e| CliError::Internal(format!("the monotonic clock failed: {e}")))?;
        let line = if health.is_open() {
            ""
        } else {
            "the line is closed; "
        };
        let ticks = serde_json::json!({
            "ticks": punctuality.ticks,
            "late_ticks": punctuality.late_ticks,
            "worst_us": punctuality.worst_ns / 1000,
            "stalls": punctuality.stalls,
        });
        output.result(&ticks, || {
            format!(
                "{line}{} ticks, {} late, worst {:.1} ms",
                punctuality.ticks,
                punctuality.late_ticks,
                punctuality.worst_ns as f64 / 1e6
            )
        })?;
        Ok(Done::Success)
    }
}

/// Adds the faults of the command line to those of the bench file.
fn add_faults(bench: &mut Bench, given: &[String], file: Option<&Path>) -> Result<(), CliError> {
    let mut faults = given.to_vec();
    if let Some(path) = file {
        let text = regular_file::read_text(path, regular_file::WRITTEN_MAX_BYTES)
            .map_err(CliError::file(path, "reading"))?;
        let of_file =
            read_faults(&text).map_err(|error| CliError::Input(format!("{}: {error}", path.display())))?;
        faults.extend(of_file);
    }
    if faults.is_empty() {
        return Ok(());
    }
    let listed = bench
        .mock_rig
        .entry("faults")
        .or_insert_with(|| toml::Value::Array(Vec::new()));
    if let toml::Value::Array(listed) = listed {
        listed.extend(faults.into_iter().map(toml::Value::String));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_of_bench_command_line_and_file_are_played_together() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("training.toml");
        std::fs::write(&file, "faults = [\"leak@run+3s\", \"force-open@run+5s\"]").expect("written");
        let mut bench = Bench::shipped().expect("sound");
        add_faults(&mut bench, &["status-lost@3s..8s".to_owned()], Some(&file)).expect("read");
        let listed = bench.mock_rig["faults"].as_array().expect("a list");
        assert_eq!(listed.len(), 3);
        local::mock_rig(&bench, None).expect("all are understood");
    }

    #[test]
    fn a_mistyped_fault_starts_no_rig() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut bench = Bench::shipped().expect("sound");
        add_faults(&mut bench, &["status-lots@3s".to_owned()], None).expect("taken as it is");
        let said = local::mock_rig(&bench, None)
            .map(|_| ())
            .expect_err("no such fault");
        assert!(said.to_string().contains("did you mean status-lost?"), "{said}");
        let file = folder.path().join("training.toml");
        std::fs::write(&file, "fault = []").expect("written");
        let said = add_faults(&mut bench, &[], Some(&file)).expect_err("another key");
        assert!(said.to_string().contains("training.toml"), "{said}");
    }
}
