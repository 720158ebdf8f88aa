//! `leafbench mock-rig`.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Arg, ArgMatches};

use super::{CliError, Command, Done, Output, local, stop_on_ctrl_c};
use crate::link::priority::raise_this_thread;
use crate::link::{self, Side};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "mock-rig",
    what: "Be a rig at the far end of a CAN bus or serial line: firmware, hydraulics, sensors and a spring",
    arguments: |command| {
        command
            .arg(local::bench_argument())
            .arg(
                Arg::new("link")
                    .long("link")
                    .value_name("ADDRESS")
                    .required(true)
                    .help(format!("Link to the host: {}", link::port_forms())),
            )
            .arg(
                Arg::new("seed")
                    .long("seed")
                    .value_parser(clap::value_parser!(u64))
                    .help("Seed of the noise [default: the bench's]"),
            )
            .after_help("Runs in real time until it is ended or the line is gone.")
    },
    run,
};

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    let bench = local::bench(matches)?;
    let Some(address) = matches.get_one::<String>("link") else {
        return Err(CliError::Input("give --link".to_owned()));
    };
    let rig = local::mock_rig(&bench, matches.get_one::<u64>("seed").copied())?;
    let link = link::open(
        address,
        Side::Rig {
            node: bench.link.node,
        },
    )?;
    let health = Arc::clone(&link.health);
    // Between two ticks, as a power cut ends a rig.
    let stop = Arc::new(AtomicBool::new(false));
    stop_on_ctrl_c(Arc::clone(&stop));
    eprintln!(
        "mock rig of bench {} at {address}; end it with Ctrl-C",
        bench.name
    );
    if let Err(reason) = raise_this_thread() {
        eprintln!(
            "no real-time priority ({reason}): under load the rig may stall, and the daemon then trips"
        );
    }
    let punctuality = rig
        .run_realtime(link, &stop)
        .map_err(|e| CliError::Internal(format!("the monotonic clock failed: {e}")))?;
    let lost = if health.is_open() {
        ""
    } else {
        "the line is gone; "
    };
    let ticks = serde_json::json!({
        "ticks": punctuality.ticks,
        "late_ticks": punctuality.late_ticks,
        "worst_us": punctuality.worst_ns / 1000,
        "stalls": punctuality.stalls,
    });
    output.result(&ticks, || {
        format!(
            "{lost}{} ticks, {} late, worst {:.1} ms",
            punctuality.ticks,
            punctuality.late_ticks,
            punctuality.worst_ns as f64 / 1e6
        )
    })?;
    Ok(Done::Well)
}
