//! `leafbench mock-rig`.

use std::sync::Arc;

use clap::Args;

use super::shared::ctrl_c::ctrl_c_flag;
use super::shared::local::{self, BenchArg};
use super::{CliCommand, CliError, Done, Output};
use crate::link::priority::raise_this_thread;
use crate::link::{self, Side};

/// Simulate a rig at the other end of a CAN bus or serial line: firmware, hydraulics, sensors and a spring
#[derive(Debug, Args)]
#[command(after_help = "Runs in real time until Ctrl-C or until the line is closed.")]
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
}

impl CliCommand for MockRigArgs {
    const NAME: &'static str = "mock-rig";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench mock-rig --bench bench-configs/benches/mock-vcan.toml --link can:vcan0",
        "leafbench mock-rig --bench bench-configs/benches/mock-serial.toml --link serial:/dev/pts/3 --seed 7",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let bench = self.bench.load()?;
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
