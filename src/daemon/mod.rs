//! The daemon: owns the rig, runs one test at a time, and serves people and scripts through HTTP. At its start
//! it only observes the rig; at its end it unloads the rig. Safety is left to the firmware, which unloads the rig by itself
//! when this process ends.
//!
//! Each file uses only files above it in this list:
//!
//! | file | subject |
//! |---|---|
//! | `access` | tokens, roles, sessions: who may do what |
//! | `client_types` | requests and answers |
//! | `run_index`, `run_search` | what a list says about each run file, filters and pages |
//! | `library`, `store`, `header` | profiles, run files, header of a recording |
//! | `reading`, `live`, `backlog`, `disk_space`, `disk_watch` | readings of the last second, samples for the live view, samples that wait for the recording thread or for the disk, free space |
//! | `error` | why the daemon or a request fails |
//! | `audit` | log of who did what, chained by hash |
//! | `lock`, `endpoint` | one daemon per rig, the file by which commands find it |
//! | `connections`, `guard`, `server`, `request_body`, `tls` | limits of connections and requests, protection from other web pages, TLS |
//! | `wanted`, `starts`, `orders` | work that may be withdrawn, order of starts and stops, orders that control must get |
//! | `course`, `plan`, `download` | thinned course of a predicted run, check of a profile, export |
//! | `editor`, `imports` | own profiles for the page's editor, tables of other programs |
//! | `permission` | calibrations, specimen, and who answers for a start all the same |
//! | `diagnoses`, `twin_choice` | diagnoses as processes of their own, the model of the next run's twin |
//! | `commander` | who commands, who watches |
//! | `newest_run`, `tally`, `state` | what the handlers and the runs share |
//! | `blocking` | work of a handler that reads files |
//! | `metrics`, `notify`, `computer` | figures for Prometheus; signs of life for systemd; memory and wall clock |
//! | `commanding` | who sends an order, and whether that client commands |
//! | `gate`, `sign_in` | who gets through to a route, how browsers sign in |
//! | `resume`, `progress`, `prepare` | what a run needs before it can start |
//! | `runs`, `socket`, `page` | life of a run, live view, the technician's page |
//! | `run_list`, `compare`, `diagnosis_api` | runs in pages with the thread of their index, two runs over each other, diagnoses over HTTP |
//! | `api` | handlers of the bench, its runs and its profiles |
//! | `description`, `routes` | answers that all routes share, all routes with what they need |

pub(crate) mod access;
mod api;
pub(crate) mod audit;
mod backlog;
mod blocking;
pub(crate) mod client_types;
mod commander;
mod commanding;
mod compare;
mod computer;
mod connections;
mod course;
mod description;
mod diagnoses;
mod diagnosis_api;
mod disk_space;
mod disk_watch;
mod download;
mod editor;
mod endpoint;
mod error;
mod gate;
mod guard;
pub(crate) mod header;
mod imports;
pub(crate) mod library;
mod live;
mod lock;
mod metrics;
mod newest_run;
mod notify;
mod orders;
mod page;
mod permission;
pub(crate) mod plan;
mod prepare;
mod progress;
pub(crate) mod reading;
mod request_body;
mod result;
mod resume;
pub(crate) mod routes;
mod run_index;
mod run_list;
pub(crate) mod run_search;
mod runs;
mod server;
mod sign_in;
mod socket;
mod starts;
mod state;
pub(crate) mod store;
mod tally;
mod tls;
mod twin_choice;
mod wanted;

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::control::realtime::{ControlHandle, Request};
use crate::control::{Phase, Rig};
use crate::link::wire_log::WireLog;
use crate::link::{self, Link, Side};
use crate::recording::recorder;
use access::AccessControl;
use audit::Audit;
use client_types::Endpoint;
use endpoint::EndpointFile;
use guard::RequestGuard;
use library::Library;
use live::{Live, Watcher};
use lock::DaemonLock;
use notify::ServiceManager;
use run_list::IndexThread;
use server::{Door, ServerLimits};
use state::DaemonState;
use store::Store;
use wanted::Withdrawal;

pub(crate) use endpoint::ENDPOINT_FILE;
pub(crate) use error::{DaemonError, chain};
pub(crate) use state::{DaemonSettings, Remote};

/// Longest wait for the rig to unload when the daemon ends. Unloading from 15 mm at 5 mm/s takes 3 s; the daemon must end
/// within 5 s.
const UNLOAD_AT_EXIT: Duration = Duration::from_millis(4200);
/// Time between two attempts to open a lost link.
const RELINK_PERIOD: Duration = Duration::from_secs(1);
/// Time between two looks at the free space of the disk.
const DISK_LOOK_PERIOD: Duration = Duration::from_secs(5);
/// Time between two looks whether the list of tokens has changed: a token that was removed is good for so long.
const TOKENS_LOOK_PERIOD: Duration = Duration::from_millis(250);
/// Longest wait for the audit log when the daemon ends.
const AUDIT_AT_EXIT: Duration = Duration::from_millis(500);
/// Longest wait for requests that are still served when the daemon ends.
const REQUESTS_AT_EXIT: Duration = Duration::from_millis(200);
/// Longest wait for the control thread after it was asked to end. It looks every millisecond.
const CONTROL_AT_EXIT: Duration = Duration::from_secs(1);

/// A daemon that is ready to take the rig. All that can fail without the rig is done: a daemon that cannot serve sends no
/// frame and opens no link.
pub(crate) struct Daemon {
    settings: DaemonSettings,
    /// The claims on data folder and link, released last.
    lock: DaemonLock,
    endpoint: EndpointFile,
    doors: Vec<Door>,
    guard: RequestGuard,
    runtime: Runtime,
    store: Store,
    library: Library,
    access: AccessControl,
    audit: Audit,
    wire_log: Option<WireLog>,
}

impl Daemon {
    /// Claims data folder and link, opens the port, and publishes where the daemon listens.
    pub(crate) fn prepare(mut settings: DaemonSettings) -> Result<Daemon, DaemonError> {
        let remote = &settings.remote;
        if !settings.listen.ip().is_loopback() && remote.tls.is_none() && remote.proxy.is_none() {
            return Err(DaemonError::NotLoopback(settings.listen));
        }
        let lock = DaemonLock::take(&settings.data_folder, &settings.link_address)?;
        // Control needs a core of its own, so the interface gets only two threads.
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()?;
        let doors = open_doors(&mut settings, &runtime)?;
        let library = Library::open(&settings.profiles_folder)?
            .with_own(settings.data_folder.join(library::OWN_PROFILES));
        let store = Store::new(&settings.data_folder);
        for sentence in store.close_left_open()? {
            tracing::warn!("{sentence}");
        }
        let access = AccessControl::open(&settings.data_folder)?;
        let audit = Audit::open(&settings.data_folder)?;
        let page = page_for_others(&settings);
        let endpoint = EndpointFile::publish(&settings.data_folder, settings.local, page)?;
        Ok(Daemon {
            guard: guard_of(&settings),
            settings,
            lock,
            endpoint,
            doors,
            runtime,
            store,
            library,
            access,
            audit,
            wire_log: None,
        })
    }

    /// Logs all frames of the link, also of one that is opened again.
    pub(crate) fn log_wire(&mut self, log: WireLog) {
        self.wire_log = Some(log);
    }

    /// Controls the rig at the other end of `link` until SIGTERM or SIGINT. Calls `started` as soon as requests are served, with a
    /// link that signs the owner's browser in.
    pub(crate) fn serve(
        self,
        mut link: Link,
        started: impl FnOnce(&Endpoint, &str) + Send,
    ) -> Result<(), DaemonError> {
        let runtime = self.runtime;
        let signals = runtime.block_on(async { Signals::catch() })?;
        let rig = Rig::new(self.settings.bench.rig_config(session_number()));
        let health = Arc::clone(&link.health);
        if let Some(log) = &self.wire_log {
            log.follow(&mut link);
        }
        // From here nothing fails until the control thread has ended: it holds the rig.
        let live = Live::default();
        // The thread ends with control, which has the only input.
        let (watcher, _) = recorder::spawn(live.idle_recorder())?;
        let (control, thread) = ControlHandle::spawn(rig, link, Box::new(Watcher(watcher)))?;
        let people = (self.access, self.audit);
        let mut state = DaemonState::new(
            self.settings,
            control,
            self.store,
            self.library,
            health,
            live,
            people,
        );
        state.wire_log = self.wire_log;
        let state = Arc::new(state);
        warn_of_limitations(&state);
        let link = state.access.owner_link()?;
        let link = sign_in::link_url(&state, &link);
        let router = routes::router(self.guard, &state);
        let server = runtime.spawn(server::serve(self.doors, router, ServerLimits::default()));
        let serving = serve_until_signal(Arc::clone(&state), server, signals, || {
            started(&self.endpoint.endpoint, &link);
        });
        runtime.block_on(serving);
        // Does not wait for viewers whose sockets are still open.
        runtime.shutdown_timeout(REQUESTS_AT_EXIT);
        await_end(&thread);
        state.audit.close(AUDIT_AT_EXIT);
        drop(self.endpoint);
        drop(self.lock);
        Ok(())
    }
}

/// The signals that end the daemon.
struct Signals {
    terminate: Signal,
    interrupt: Signal,
}

impl Signals {
    /// From now on the signals no longer end the process.
    fn catch() -> Result<Signals, DaemonError> {
        Ok(Signals {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    /// Waits for the next signal and returns its name.
    async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.interrupt.recv() => "SIGINT",
        }
    }
}

fn warn_of_limitations(state: &DaemonState) {
    let today = jiff::Timestamp::now().to_zoned(jiff::tz::TimeZone::UTC).date();
    for sentence in permission::overdue(&state.settings.bench, today) {
        tracing::warn!("{sentence}");
    }
    for sentence in state.control.degraded() {
        tracing::warn!("{sentence}");
    }
}

/// Waits for the control thread, which was asked to end. The process ends in any case: its end is also the end of the lease.
fn await_end(thread: &JoinHandle<()>) {
    let deadline = Instant::now() + CONTROL_AT_EXIT;
    while !thread.is_finished() {
        if Instant::now() > deadline {
            tracing::error!(
                "the control thread does not end: the rig unloads by itself when this process ends"
            );
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

async fn serve_until_signal(
    state: Arc<DaemonState>,
    server: tokio::task::JoinHandle<()>,
    mut signals: Signals,
    started: impl FnOnce() + Send,
) {
    state
        .audit
        .note_daemon("start", &format!("tokens: {}", state.access.words()));
    let tokens = tokio::spawn(watch_tokens(Arc::clone(&state)));
    let relink = tokio::spawn(keep_link_open(Arc::clone(&state)));
    let disk = tokio::spawn(watch_disk_space(Arc::clone(&state)));
    let computer = tokio::spawn(computer::watch(Arc::clone(&state)));
    let manager = Arc::new(ServiceManager::of_this_process());
    let (watching, control) = (Arc::clone(&manager), state.control.clone());
    let watchdog = tokio::spawn(async move { watching.watch(control).await });
    let _index = IndexThread::spawn(&state);
    let _diagnoses = state.diagnoses.spawn();
    started();
    manager.tell(&format!("READY=1\nSTATUS=page http://{}/", state.settings.listen));
    let name = signals.next().await;
    state.audit.note_daemon("end", name);
    manager.tell("STOPPING=1");
    tracing::info!("{name}: unloading the rig, then ending");
    unload(&state, name).await;
    watchdog.abort();
    server.abort();
    relink.abort();
    disk.abort();
    tokens.abort();
    computer.abort();
    // Commands end with the control thread and the lease expires. If the rig is still loaded, the firmware unloads it.
    if let Err(error) = orders::insist(&state.control, || Request::End).await {
        tracing::warn!("the control thread was not asked to end: {error}");
    }
    let cause = format!("the daemon ended ({name}) before the rig had unloaded");
    if let Some(sentence) = state.newest_run.close_unfinished(&cause) {
        tracing::warn!("{sentence}");
    }
}

/// Stops the run and waits until the rig is unloaded and the run file is closed. No further run starts.
async fn unload(state: &DaemonState, signal: &str) {
    let deadline = tokio::time::Instant::now() + UNLOAD_AT_EXIT;
    let cause = format!("the daemon was ended ({signal})");
    // A disk that cannot be written does not keep the daemon: what is missing is in the outcome.
    state.newest_run.give_up_waiting();
    state.starts.end(Withdrawal::DaemonEnds(cause.clone()));
    // A rig that is not ours is left alone: another daemon may be running a test on it.
    let connected = state.control.status().0.phase != Phase::Connecting;
    if connected && let Err(error) = runs::stop(state, &cause).await {
        tracing::warn!("control did not take the stop: {error}");
    }
    while tokio::time::Instant::now() < deadline {
        let (status, _) = state.control.status();
        let unloaded = matches!(
            status.phase,
            Phase::Ready | Phase::Interlocked | Phase::Connecting
        );
        if unloaded && state.newest_run.is_closed() && !state.starts.is_pending() {
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
        // Opening may wait for the system, and a waiting task would stop the page.
        let address = state.settings.link_address.clone();
        let Ok(opened) = tokio::task::spawn_blocking(move || link::open(&address, side)).await else {
            continue;
        };
        match opened {
            Ok(mut link) => {
                if let Some(log) = &state.wire_log {
                    log.follow(&mut link);
                }
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

/// Looks how full the disk is, now and then. A disk that does not answer holds up a thread of its own only.
async fn watch_disk_space(state: Arc<DaemonState>) {
    loop {
        let looking = Arc::clone(&state);
        // Fails only when the runtime ends.
        let _ = tokio::task::spawn_blocking(move || looking.disk.look(looking.store.folder())).await;
        tokio::time::sleep(DISK_LOOK_PERIOD).await;
    }
}

/// Looks whether a token was added or removed, now and then. A disk that does not answer holds up a thread of its own only.
async fn watch_tokens(state: Arc<DaemonState>) {
    loop {
        tokio::time::sleep(TOKENS_LOOK_PERIOD).await;
        let looking = Arc::clone(&state);
        // Fails only when the runtime ends.
        let told = tokio::task::spawn_blocking(move || looking.access.refresh()).await;
        match told {
            Ok(Ok(sentences)) => {
                for sentence in sentences {
                    tracing::info!("{sentence}");
                    state.audit.note_daemon("tokens", &sentence);
                }
            }
            Ok(Err(error)) => tracing::warn!("the tokens stay as they are: {}", chain(&error)),
            Err(_) => {}
        }
    }
}

/// Opens the port, and a port of loopback for the commands of this computer where the first one is for others.
fn open_doors(settings: &mut DaemonSettings, runtime: &Runtime) -> Result<Vec<Door>, DaemonError> {
    let open = |asked: SocketAddr| {
        let listen = async {
            let listener = TcpListener::bind(asked).await?;
            let address = listener.local_addr()?;
            Ok((listener, address))
        };
        runtime.block_on(listen).map_err(|source| DaemonError::Listen {
            address: asked,
            source,
        })
    };
    let tls = match &settings.remote.tls {
        Some((certificate, key)) => Some(tls::acceptor(certificate, key)?),
        None => None,
    };
    let (listener, address) = open(settings.listen)?;
    settings.listen = address;
    settings.local = address;
    let for_others = tls.is_some() || !address.ip().is_loopback();
    let mut doors = vec![Door { listener, tls }];
    if for_others {
        let (listener, address) = open(([127, 0, 0, 1], 0).into())?;
        settings.local = address;
        doors.push(Door { listener, tls: None });
    }
    Ok(doors)
}

/// The addresses under which the daemon answers.
fn guard_of(settings: &DaemonSettings) -> RequestGuard {
    let mut guard = RequestGuard::new(settings.local);
    if settings.remote.tls.is_some() {
        guard = guard.with_tls(settings.listen, &settings.remote.names);
    }
    if let Some(name) = &settings.remote.proxy {
        guard = guard.with_proxy(name);
    }
    guard
}

/// Where other computers find the page.
fn page_for_others(settings: &DaemonSettings) -> Option<String> {
    let remote = &settings.remote;
    let port = settings.listen.port();
    let direct = || match remote.names.first() {
        Some(name) => format!("https://{name}:{port}/"),
        None => format!("https://{}/", settings.listen),
    };
    let behind = remote.proxy.as_ref().map(|name| format!("https://{name}/"));
    behind.or_else(|| remote.tls.is_some().then(direct))
}

/// A random number from 1 to 255 for each start, so that the rig can tell frames of an earlier daemon from ours.
fn session_number() -> u8 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    (RandomState::new().build_hasher().finish() % 255) as u8 + 1
}
