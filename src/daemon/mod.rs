//! The daemon: owns the rig, runs one test at a time, and serves people and scripts through HTTP on loopback. At its start
//! it only observes the rig; at its end it unloads the rig. Safety is left to the firmware, which unloads the rig by itself
//! when this process ends.
//!
//! Each file uses only files above it in this list:
//!
//! | file | subject |
//! |---|---|
//! | `client_types` | requests and answers |
//! | `library`, `store`, `header` | profiles, run files, header of a recording |
//! | `live`, `backlog`, `disk_watch` | samples for the live view, samples that wait for the recording thread or for the disk |
//! | `error` | why the daemon or a request fails |
//! | `lock`, `plan`, `csv_download`, `guard` | one daemon per rig, check of a profile, export, protection from other web pages |
//! | `newest_run`, `state` | what the handlers and the runs share |
//! | `runs`, `socket`, `page` | life of a run, live view, the technician's page |
//! | `api` | routes and handlers |

mod api;
mod backlog;
pub(crate) mod client_types;
mod csv_download;
mod disk_watch;
mod error;
mod guard;
pub(crate) mod header;
pub(crate) mod library;
mod live;
pub(crate) mod lock;
mod newest_run;
mod page;
pub(crate) mod plan;
mod runs;
mod socket;
mod state;
pub(crate) mod store;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};

use crate::control::realtime::{ControlHandle, Request};
use crate::control::{Phase, Rig};
use crate::link::{self, Link, Side};
use crate::recording::atomic_file;
use client_types::Endpoint;
use library::Library;
use lock::DaemonLock;
use state::DaemonState;
use store::Store;

pub(crate) use error::{DaemonError, chain};
pub(crate) use state::DaemonSettings;

/// Name of the file in the data folder that says where the daemon listens.
pub(crate) const ENDPOINT_FILE: &str = "daemon.json";
/// Longest wait for the rig to unload when the daemon ends. Unloading from 15 mm at 5 mm/s takes 3 s; the daemon must end
/// within 5 s.
const UNLOAD_AT_EXIT: Duration = Duration::from_millis(4200);
/// Time between two attempts to open a lost link.
const RELINK_PERIOD: Duration = Duration::from_secs(1);

/// Runs the daemon until SIGTERM or SIGINT. Calls `started` as soon as the daemon listens.
pub(crate) fn serve(
    settings: DaemonSettings,
    _lock: DaemonLock,
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
    let state = Arc::new(DaemonState::new(settings, control, store, library, health));
    // Control needs a core of its own, so the interface gets only two threads.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let result = runtime.block_on(serve_until_signal(Arc::clone(&state), started));
    // Does not wait for viewers whose sockets are still open.
    runtime.shutdown_timeout(Duration::from_millis(200));
    // The control thread ends on request. A panic there has already ended the process.
    let _ = thread.join();
    result
}

async fn serve_until_signal(
    state: Arc<DaemonState>,
    started: impl FnOnce(&Endpoint) + Send,
) -> Result<(), DaemonError> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let address = state.settings.listen;
    let failed = |source| DaemonError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    let endpoint = Endpoint {
        url: format!("http://{address}"),
        pid: std::process::id(),
    };
    let endpoint_path = state.settings.data_folder.join(ENDPOINT_FILE);
    publish(&endpoint_path, &endpoint)?;
    started(&endpoint);

    let relink = tokio::spawn(keep_link_open(Arc::clone(&state)));
    let server = tokio::spawn(api::serve(listener, address, Arc::clone(&state)));
    let name = tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "SIGINT",
    };
    tracing::info!("{name}: unloading the rig, then ending");
    unload(&state, name).await;
    server.abort();
    relink.abort();
    // Commands end with the control thread and the lease expires. If the rig is still loaded, the firmware unloads it.
    let _ = state.control.ask(Request::End).await;
    let cause = format!("the daemon ended ({name}) before the rig had unloaded");
    if let Some(sentence) = state.newest_run.close_unfinished(&cause) {
        tracing::warn!("{sentence}");
    }
    // The file is ours: this daemon still holds the lock.
    let _ = std::fs::remove_file(&endpoint_path);
    Ok(())
}

/// Stops the run and waits until the rig is unloaded and the run file is closed.
async fn unload(state: &DaemonState, signal: &str) {
    let deadline = tokio::time::Instant::now() + UNLOAD_AT_EXIT;
    let cause = format!("the daemon was ended ({signal})");
    // A disk that cannot be written does not keep the daemon: what is missing is in the outcome.
    state.newest_run.give_up_waiting();
    // Control refuses it if no run is under way.
    let _ = state.control.ask(Request::Stop(cause)).await;
    while tokio::time::Instant::now() < deadline {
        let (status, _) = state.control.status();
        let unloaded = matches!(
            status.phase,
            Phase::Ready | Phase::Interlocked | Phase::Connecting
        );
        if unloaded && state.newest_run.is_closed() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Opens a lost link again. Control then only observes the rig.
async fn keep_link_open(state: Arc<DaemonState>) {
    let side = Side::Host {
        rig_node: state.settings.bench.link.node,
    };
    let mut reported = false;
    loop {
        tokio::time::sleep(RELINK_PERIOD).await;
        if state.link_health().is_open() || link::is_in_process(&state.settings.link_address) {
            reported = false;
            continue;
        }
        match link::open(&state.settings.link_address, side) {
            Ok(link) => {
                tracing::info!("link {} is open again", state.settings.link_address);
                state.set_link_health(&link.health);
                // Fails only if control has ended, and then this process ends too.
                let _ = state.control.ask(Request::Relink(Box::new(link))).await;
            }
            Err(error) if !reported => {
                tracing::error!("the link is lost: {error}");
                reported = true;
            }
            Err(_) => {}
        }
    }
}

/// Writes the file by which `leafbench run` finds the daemon. The rename makes it appear complete or not at all.
fn publish(path: &Path, endpoint: &Endpoint) -> Result<(), DaemonError> {
    let failed = |source| DaemonError::Folder {
        path: path.to_owned(),
        source,
    };
    let text = serde_json::to_string(endpoint).map_err(|e| failed(e.into()))?;
    let draft = path.with_extension("json.new");
    // What a killed daemon left there.
    let _ = std::fs::remove_file(&draft);
    let mut file = atomic_file::create_private(&draft).map_err(failed)?;
    file.write_all((text + "\n").as_bytes()).map_err(failed)?;
    std::fs::rename(&draft, path).map_err(failed)
}

/// A random number from 1 to 255 for each start, so that the rig can tell frames of an earlier daemon from ours.
fn session_number() -> u8 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    (RandomState::new().build_hasher().finish() % 255) as u8 + 1
}
