//! `leafbench daemon`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Arg, ArgMatches};

use super::client::{data_argument, named_data_folder};
use super::{CliError, Command, Done, Output, local};
use crate::config::Bench;
use crate::daemon::client_types::Endpoint;
use crate::daemon::lock::DaemonLock;
use crate::daemon::{self, DaemonSettings};
use crate::link::priority::raise_this_thread;
use crate::link::{self, Link, Side, loopback};

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "daemon",
    what: "Own the rig: connect, serve the technician's page and the other commands, record runs",
    arguments,
    run,
};

fn arguments(command: clap::Command) -> clap::Command {
    command
        .arg(local::bench_argument())
        .arg(local::profiles_argument())
        .arg(data_argument())
        .arg(
            Arg::new("link")
                .long("link")
                .value_name("ADDRESS")
                .help(format!("Instead of the bench's link: {}", link::address_forms())),
        )
        .arg(
            Arg::new("listen")
                .long("listen")
                .value_name("ADDRESS")
                .value_parser(clap::value_parser!(SocketAddr))
                .help("Instead of the bench's address for page and commands; port 0 takes a free one"),
        )
        .after_help("Ends with SIGTERM or Ctrl-C: unloads the rig first, closes the run's file, within 5 s.")
}

fn run(matches: &ArgMatches, output: &Output) -> Result<Done, CliError> {
    log_to_stderr();
    end_with_the_first_panic();
    let bench = Arc::new(local::bench(matches)?);
    let settings = DaemonSettings {
        link_address: matches
            .get_one::<String>("link")
            .unwrap_or(&bench.link.address)
            .clone(),
        data_folder: named_data_folder(matches).unwrap_or_else(|| bench.daemon.data_folder.clone()),
        profiles_folder: local::profiles_folder(matches)?,
        listen: *matches
            .get_one::<SocketAddr>("listen")
            .unwrap_or(&bench.daemon.listen),
        bench: Arc::clone(&bench),
    };
    let lock = DaemonLock::take(&settings.data_folder, &settings.link_address)?;
    let link = open_link(&settings.link_address, &bench)?;
    daemon::serve(settings, lock, link, |endpoint| announce(endpoint, output))?;
    Ok(Done::Well)
}

/// One line that people and scripts read.
fn announce(endpoint: &Endpoint, output: &Output) {
    // A stdout that nobody reads is no reason to stop.
    let _ = output.result(endpoint, || {
        format!("leafbench daemon: open {}/ in a browser", endpoint.url)
    });
}

/// The daemon cannot tell a mock rig from a rig; only this function can.
fn open_link(address: &str, bench: &Bench) -> Result<Link, CliError> {
    if !link::is_in_process(address) {
        return Ok(link::open(
            address,
            Side::Host {
                rig_node: bench.link.node,
            },
        )?);
    }
    let rig = local::mock_rig(bench, None)?;
    let (host_end, rig_end) = loopback::pair();
    std::thread::Builder::new()
        .name("mock-rig".to_owned())
        .spawn(move || {
            // A firmware has its own processor. Control says what is missing where this is not allowed.
            let _ = raise_this_thread();
            static NEVER: AtomicBool = AtomicBool::new(false);
            if let Err(error) = rig.run_realtime(rig_end, &NEVER) {
                tracing::error!("the mock rig ended: {error}");
            }
        })
        .map_err(CliError::file(&PathBuf::from("mock rig"), "starting its thread"))?;
    Ok(host_end)
}

fn log_to_stderr() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("LEAFBENCH_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    // Fails only where a log is set up already.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()))
        .try_init();
}

/// A daemon that limps on after a panic would keep the lease alive: end at once, so that the rig unloads by itself.
fn end_with_the_first_panic() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        report(panic);
        std::process::abort();
    }));
}
