//! `leafbench daemon`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use super::shared::client::DATA_VARIABLE;
use super::shared::journal::{JournalWriter, is_journal};
use super::shared::local::{self, BenchArg, ProfilesArg};
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::daemon::client_types::Endpoint;
use crate::daemon::{Daemon, DaemonSettings, Remote};
use crate::link::wire_log::{WireLog, WireLogThread};
use crate::link::{self, Link, Side, loopback};

/// Control the rig: connect, serve the technician's page and the other commands, record runs
#[derive(Debug, Args)]
#[command(
    after_help = "SIGTERM or Ctrl-C ends the daemon: within 5 s it unloads the rig and closes the run's file.\n\
                  Under systemd (Type=notify) it reports when it is ready, and twice a second that the control loop turns."
)]
pub(super) struct DaemonArgs {
    #[command(flatten)]
    bench: BenchArg,
    #[command(flatten)]
    profiles: ProfilesArg,
    /// Folder of the run files; the other commands find the daemon through it [default: from the bench file]
    #[arg(long, value_name = "DIR", env = DATA_VARIABLE)]
    data: Option<PathBuf>,
    #[arg(
        long,
        value_name = "ADDRESS",
        help = format!("Address of the link: {} [default: from the bench file]", link::address_forms())
    )]
    link: Option<String>,
    /// Address and port of the page and of the commands; port 0 takes a free one [default: from the bench file]
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<SocketAddr>,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Also log all frames of the link in the format of `candump -L`, for canplayer; an earlier log there is replaced
    #[arg(long, value_name = "FILE")]
    wire_log: Option<PathBuf>,
    /// Most space for the wire log, MB: FILE and FILE.old together, the newest frames stay; 1000 MB are about 3 h
    #[arg(long, value_name = "MB", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    wire_log_mb: u64,
}

/// How other computers reach the daemon.
#[derive(Debug, Args)]
struct RemoteArgs {
    /// Certificate chain for TLS (PEM), so that other computers may reach the daemon; needs --tls-key
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate (PEM)
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Host name that people write in the address of the page; may be given several times
    #[arg(long = "name", value_name = "NAME")]
    names: Vec<String>,
    /// Host name of a proxy with TLS that stands before the daemon
    #[arg(long, value_name = "NAME")]
    behind_proxy: Option<String>,
}

impl CliCommand for DaemonArgs {
    const NAME: &'static str = "daemon";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench daemon --bench bench-configs/benches/mock.toml",
        "leafbench daemon --bench bench-configs/benches/mock-vcan.toml --link can:vcan0 --listen 127.0.0.1:0",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        log_to_stderr();
        let bench = Arc::new(self.bench.load()?);
        let wire_log = self.wire_log.clone().zip(Some(self.wire_log_mb));
        let listen = self.listen.unwrap_or(bench.daemon.listen);
        let settings = DaemonSettings {
            link_address: self.link.unwrap_or_else(|| bench.link.address.clone()),
            data_folder: self.data.unwrap_or_else(|| bench.daemon.data_folder.clone()),
            profiles_folder: self.profiles.folder()?,
            listen,
            local: listen,
            remote: Remote {
                tls: self.remote.tls_cert.zip(self.remote.tls_key),
                proxy: self.remote.behind_proxy,
                names: self.remote.names,
            },
            bench: Arc::clone(&bench),
        };
        let link_address = settings.link_address.clone();
        // The rig comes last: a daemon that cannot serve must not touch it.
        let mut daemon = Daemon::prepare(settings)?;
        let log_thread = match wire_log {
            Some((path, max_mb)) => Some(start_wire_log(&mut daemon, &path, &link_address, max_mb)?),
            None => None,
        };
        let link = open_link(&link_address, &bench)?;
        daemon.serve(link, |endpoint, sign_in| announce(endpoint, sign_in, output))?;
        if let Some(thread) = log_thread {
            thread.finish();
        }
        Ok(Done::Success)
    }
}

/// Starts the log of the frames. Its lines name the CAN interface, or the kind of the link.
fn start_wire_log(
    daemon: &mut Daemon,
    path: &Path,
    link_address: &str,
    max_mb: u64,
) -> Result<WireLogThread, CliError> {
    let (scheme, place) = link_address.split_once(':').unwrap_or((link_address, ""));
    let name = if scheme == "can" { place } else { scheme };
    let started = WireLog::start(path, name, max_mb * 1_000_000);
    let (log, thread) = started.map_err(CliError::file(path, "writing"))?;
    daemon.log_wire(log);
    Ok(thread)
}

/// Prints the daemon's address, with a link that signs a browser in. A journal that other people read gets no such link.
fn announce(endpoint: &Endpoint, sign_in: &str, output: &Output) {
    let others = match &endpoint.page {
        Some(page) => format!("\nleafbench daemon: other computers open {page}"),
        None => String::new(),
    };
    let page = match is_journal(&std::io::stdout()) {
        true => format!(
            "the page is {}/, and `leafbench open` signs a browser in",
            endpoint.url
        ),
        false => format!("open {sign_in} in a browser (it works once; `leafbench open` prints another)"),
    };
    // The daemon runs on where stdout is closed.
    let _ = output.result(endpoint, || format!("leafbench daemon: {page}{others}"));
}

/// Opens the link to the rig, or to a mock rig in this process that the control loop steps; the daemon itself does not know
/// which.
fn open_link(address: &str, bench: &Bench) -> Result<Link, CliError> {
    if !link::is_in_process(address) {
        return Ok(link::open(
            address,
            Side::Host {
                rig_node: bench.link.node,
            },
        )?);
    }
    let mut rig = local::mock_rig(bench, None)?;
    Ok(loopback::stepped(move |rig_end| rig.tick(rig_end)))
}

/// Logs to stderr, for the journal with priorities. The environment variable LEAFBENCH_LOG sets the level, for all or by module:
/// `debug`, `warn,leafbench::link=trace`.
fn log_to_stderr() {
    let wanted = std::env::var("LEAFBENCH_LOG").ok();
    let levels: Targets = wanted
        .and_then(|text| text.parse().ok())
        .unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let stderr = std::io::stderr();
    let layer = tracing_subscriber::fmt::layer();
    let lines = match is_journal(&stderr) {
        true => {
            let plain = layer.with_ansi(false).without_time().with_level(false);
            plain.with_writer(JournalWriter).boxed()
        }
        false => {
            let colours = std::io::IsTerminal::is_terminal(&stderr);
            layer.with_ansi(colours).with_writer(std::io::stderr).boxed()
        }
    };
    // Fails only if a log was set up before.
    let _ = tracing_subscriber::registry()
        .with(lines.with_filter(levels))
        .try_init();
}
