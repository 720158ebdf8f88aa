//! The daemon: owns the rig, runs one test at a time, and lets people and scripts in through HTTP on loopback. It comes up
//! observing and leaves the rig unloaded. Safety is not here: the firmware unloads by itself when this process is gone.
//!
//! `claim` makes it the only one, `store` is its data folder, `runs` starts and follows runs, `plan` checks them before,
//! `live` feeds watchers, `api` is the HTTP interface behind `guard`, `page/` what a technician sees.

pub(crate) mod api;
mod backlog;
pub(crate) mod claim;
pub(crate) mod client_types;
mod csv_download;
pub(crate) mod guard;
pub(crate) mod header;
pub(crate) mod library;
pub(crate) mod live;
mod page;
pub(crate) mod plan;
pub(crate) mod runs;
pub(crate) mod socket;
pub(crate) mod store;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};

use crate::config::Bench;
use crate::control::realtime::{ControlHandle, Request};
use crate::control::{Phase, Rig};
use crate::link::{self, Link, LinkHealth, Side};
use crate::recording::run_file::RunFileError;
use claim::Claim;
use client_types::Endpoint;
use library::Library;
use live::Live;
use runs::Runs;
use store::Store;

/// Name of the file in the data folder that tells where the daemon listens.
pub(crate) const ENDPOINT_FILE: &str = "daemon.json";
/// Unloading from 15 mm at 5 mm/s takes 3 s; the whole exit must not take more than 5 s.
const UNLOAD_AT_EXIT: Duration = Duration::from_millis(4200);
/// A lost link is tried again this often.
const RELINK_PERIOD: Duration = Duration::from_secs(1);

/// Why the daemon does not start or ends.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DaemonError {
    /// Another daemon is there.
    #[error("{what} belongs to another daemon (process {owner}): stop that one first, or use its page")]
    Claimed {
        /// The data folder or the link.
        what: String,
        /// Its process.
        owner: String,
    },
    /// A folder or file of the daemon's own.
    #[error("{path} cannot be used: check its rights and the disk's space")]
    Folder {
        /// Which.
        path: PathBuf,
        /// The system's own words.
        source: std::io::Error,
    },
    /// The address cannot be listened at.
    #[error(
        "{address} cannot be listened at: is the port taken? Give another one with --listen 127.0.0.1:PORT"
    )]
    Listen {
        /// As asked for.
        address: SocketAddr,
        /// The system's own words.
        source: std::io::Error,
    },
    /// Not on loopback.
    #[error(
        "{0} is not on this computer alone: give 127.0.0.1:PORT; the interface has no password and moves the rig"
    )]
    NotLoopback(SocketAddr),
    /// Runs of the data folder.
    #[error("the data folder cannot be read")]
    Runs(#[from] RunFileError),
    /// A thread or the runtime.
    #[error("the daemon cannot start a thread: is the system out of memory?")]
    System(#[from] std::io::Error),
    /// The profiles.
    #[error(transparent)]
    Library(#[from] library::LibraryError),
}

/// What a daemon is started with.
#[derive(Debug, Clone)]
pub(crate) struct DaemonSettings {
    /// Checked bench config.
    pub bench: Arc<Bench>,
    /// `can:vcan0`, `serial:/dev/ttyUSB0`, `mock:`.
    pub link_address: String,
    /// Run files, lock and endpoint file.
    pub data_folder: PathBuf,
    /// Profiles that can be started by name.
    pub profiles_folder: PathBuf,
    /// Where to listen; port 0 takes a free one.
    pub listen: SocketAddr,
}

/// What the parts of the daemon share.
pub(crate) struct Shared {
    /// As started.
    pub settings: DaemonSettings,
    /// The control thread.
    pub control: ControlHandle,
    /// The data folder.
    pub store: Store,
    /// Profiles by name.
    pub library: Library,
    /// Watchers.
    pub live: Live,
    /// The run under way and the newest before it.
    pub runs: Runs,
    /// Health of the link as it was first opened, until it is opened anew.
    link_health: std::sync::Mutex<Arc<LinkHealth>>,
}

/// Runs the daemon until SIGTERM or SIGINT. `started` is told where it listens.
pub(crate) fn serve(
    settings: DaemonSettings,
    _claim: Claim,
    link: Link,
    started: impl FnOnce(&Endpoint) + Send,
) -> Result<(), DaemonError> {
    if !settings.listen.ip().is_loopback() {
        return Err(DaemonError::NotLoopback(settings.listen));
    }
    let store = Store::new(&settings.data_folder);
    for sentence in store.close_left_open()? {
        tracing::warn!("{sentence}");
    }
    let library = Library::open(&settings.profiles_folder)?;
    let rig = Rig::new(settings.bench.rig_config(session_number()));
    let health = Arc::clone(&link.health);
    let (control, thread) = ControlHandle::spawn(rig, link)?;
    for sentence in control.degraded() {
        tracing::warn!("{sentence}");
    }
    let shared = Arc::new(Shared {
        settings,
        control,
        store,
        library,
        live: Live::default(),
        runs: Runs::default(),
        link_health: std::sync::Mutex::new(health),
    });
    // Two threads: the interface must never take both cores from control.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let result = runtime.block_on(serve_until_signal(Arc::clone(&shared), started));
    // Watchers that still hang on a socket are dropped, not waited for.
    runtime.shutdown_timeout(Duration::from_millis(200));
    // The control thread has ended by request; a panic there has ended the process already.
    let _ = thread.join();
    result
}

async fn serve_until_signal(
    shared: Arc<Shared>,
    started: impl FnOnce(&Endpoint) + Send,
) -> Result<(), DaemonError> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let address = shared.settings.listen;
    let failed = |source| DaemonError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    let endpoint = Endpoint {
        url: format!("http://{address}"),
        pid: std::process::id(),
    };
    let endpoint_path = shared.settings.data_folder.join(ENDPOINT_FILE);
    publish(&endpoint_path, &endpoint)?;
    started(&endpoint);

    let relink = tokio::spawn(relink_for_ever(Arc::clone(&shared)));
    let server = tokio::spawn(api::serve(listener, address, Arc::clone(&shared)));
    let name = tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "SIGINT",
    };
    tracing::info!("{name}: unloading the rig, then ending");
    unload(&shared, name).await;
    server.abort();
    relink.abort();
    // Commands stop with it and the lease lapses; whatever is still loaded then, the firmware unloads.
    let _ = shared.control.ask(Request::End).await;
    for sentence in shared
        .runs
        .close_unfinished(&format!("the daemon ended ({name}) before the rig had unloaded"))
    {
        tracing::warn!("{sentence}");
    }
    // Only ours is removed: the lock is still held, so nobody else has written one.
    let _ = std::fs::remove_file(&endpoint_path);
    Ok(())
}

/// Safe first: stops what moves and waits until the rig is down and the run's file closed.
async fn unload(shared: &Shared, signal: &str) {
    let deadline = tokio::time::Instant::now() + UNLOAD_AT_EXIT;
    let cause = format!("the daemon was ended ({signal})");
    // Refused where nothing is to be stopped.
    let _ = shared.control.ask(Request::Stop(cause)).await;
    while tokio::time::Instant::now() < deadline {
        let (status, _) = shared.control.status();
        let down = matches!(
            status.phase,
            Phase::Ready | Phase::Interlocked | Phase::Connecting
        );
        if down && shared.runs.all_closed() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Opens a lost link again. Control only observes the rig that it finds there.
async fn relink_for_ever(shared: Arc<Shared>) {
    let side = Side::Host {
        rig_node: shared.settings.bench.link.node,
    };
    let mut complained = false;
    loop {
        tokio::time::sleep(RELINK_PERIOD).await;
        if shared.link_health().is_open() || link::is_in_process(&shared.settings.link_address) {
            complained = false;
            continue;
        }
        match link::open(&shared.settings.link_address, side) {
            Ok(link) => {
                tracing::info!("link {} is open again", shared.settings.link_address);
                *shared
                    .link_health
                    .lock()
                    .unwrap_or_else(std::sync::PoisonError::into_inner) = Arc::clone(&link.health);
                // Fails only where control has ended, and then so do we.
                let _ = shared.control.ask(Request::Relink(Box::new(link))).await;
            }
            Err(error) if !complained => {
                tracing::error!("the link is lost: {error}");
                complained = true;
            }
            Err(_) => {}
        }
    }
}

impl Shared {
    /// Counters of the link in use.
    pub(crate) fn link_health(&self) -> Arc<LinkHealth> {
        Arc::clone(
            &self
                .link_health
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner),
        )
    }
}

/// The file that `leafbench run` finds the daemon by; it appears whole or not at all.
fn publish(path: &Path, endpoint: &Endpoint) -> Result<(), DaemonError> {
    let failed = |source| DaemonError::Folder {
        path: path.to_owned(),
        source,
    };
    let text = serde_json::to_string(endpoint).map_err(|e| failed(e.into()))?;
    let draft = path.with_extension("json.new");
    std::fs::write(&draft, text + "\n").map_err(failed)?;
    std::fs::rename(&draft, path).map_err(failed)
}

/// 1 to 255; another one after each start, so that a rig tells an old daemon's frames from ours.
fn session_number() -> u8 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    (RandomState::new().build_hasher().finish() % 255) as u8 + 1
}
