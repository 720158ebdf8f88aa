//! The state that the HTTP handlers, the runs and the daemon's main task share.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use super::access::AccessControl;
use super::audit::Audit;
use super::client_types::{PlotScale, Status};
use super::commander::Commander;
use super::diagnoses::Diagnoses;
use super::disk_space::DiskSpace;
use super::library::Library;
use super::live::Live;
use super::newest_run::NewestRun;
use super::permission;
use super::starts::Starts;
use super::store::Store;
use super::tally::Tally;
use super::twin_choice::TwinChoice;
use crate::config::Bench;
use crate::control::realtime::ControlHandle;
use crate::link::LinkHealth;
use crate::link::wire_log::WireLog;

/// Settings of a daemon at its start.
#[derive(Debug, Clone)]
pub(crate) struct DaemonSettings {
    pub bench: Arc<Bench>,
    /// `can:vcan0`, `serial:/dev/ttyUSB0`, or `mock:` for a mock rig in memory.
    pub link_address: String,
    /// Folder of the run files, the lock file and the endpoint file.
    pub data_folder: PathBuf,
    /// Folder of the profiles that can be started by name.
    pub profiles_folder: PathBuf,
    /// Address of the HTTP interface. Port 0 takes a free port; a prepared daemon has the port that it took.
    pub listen: SocketAddr,
    /// The address for programs of this computer: `listen`, or a free port of loopback where `listen` is for others.
    pub local: SocketAddr,
    /// How other computers reach the daemon; nothing for loopback only.
    pub remote: Remote,
}

/// How other computers reach the daemon.
#[derive(Debug, Clone, Default)]
pub(crate) struct Remote {
    /// Files of the certificate and its key (PEM), for TLS.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Host name under which a proxy with TLS serves this daemon.
    pub proxy: Option<String>,
    /// Further host names of this computer in the addresses that people open.
    pub names: Vec<String>,
}

/// The state of the daemon.
pub(super) struct DaemonState {
    pub settings: DaemonSettings,
    /// Handle of the control thread.
    pub control: ControlHandle,
    pub store: Store,
    pub library: Library,
    /// The live view of samples, for the technician's page.
    pub live: Live,
    pub newest_run: NewestRun,
    /// What the runs of this daemon came to.
    pub tally: Tally,
    pub diagnoses: Diagnoses,
    /// The model of the twin of the next run.
    pub twin: TwinChoice,
    /// How full the disk of the run files is.
    pub disk: DiskSpace,
    /// The run that is being prepared, and the order of starts and stops.
    pub starts: Starts,
    /// Who commands the bench.
    pub commander: Commander,
    /// Who may do what.
    pub access: AccessControl,
    /// Who did what.
    pub audit: Audit,
    /// Taken while a profile is checked for the page: one at a time.
    pub planning: Arc<tokio::sync::Semaphore>,
    link_health: Mutex<Arc<LinkHealth>>,
    /// Log of the frames, where one is wanted.
    pub wire_log: Option<WireLog>,
}

/// The state as an argument of every HTTP handler.
pub(super) type App = axum::extract::State<Arc<DaemonState>>;

impl DaemonState {
    /// `link_health` belongs to the link that `control` was started with.
    pub(super) fn new(
        settings: DaemonSettings,
        control: ControlHandle,
        store: Store,
        library: Library,
        link_health: Arc<LinkHealth>,
        live: Live,
        (access, audit): (AccessControl, Audit),
    ) -> Self {
        DaemonState {
            diagnoses: Diagnoses::of(&settings.data_folder),
            twin: TwinChoice::default(),
            settings,
            control,
            store,
            library,
            live,
            disk: DiskSpace::default(),
            newest_run: NewestRun::default(),
            tally: Tally::default(),
            starts: Starts::default(),
            commander: Commander::default(),
            access,
            audit,
            planning: Arc::new(tokio::sync::Semaphore::new(1)),
            link_health: Mutex::new(link_health),
            wire_log: None,
        }
    }

    /// Health of the link in use.
    pub(super) fn link_health(&self) -> Arc<LinkHealth> {
        Arc::clone(&self.link_health.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Replaces the health after the link was opened again.
    pub(super) fn set_link_health(&self, health: &Arc<LinkHealth>) {
        *self.link_health.lock().unwrap_or_else(PoisonError::into_inner) = Arc::clone(health);
    }

    /// What a person should know before the next run, one sentence each.
    fn warnings(&self) -> Vec<String> {
        let today = jiff::Timestamp::now().to_zoned(jiff::tz::TimeZone::UTC).date();
        let mut warnings = permission::overdue(&self.settings.bench, today);
        warnings.extend(self.disk.problem());
        warnings
    }

    /// Bench, rig and newest run as they are now.
    pub(super) fn status(&self) -> Status {
        let (rig, control_loop) = self.control.status();
        let settings = &self.settings;
        Status {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            bench: settings.bench.name.clone(),
            link: settings.link_address.clone(),
            link_open: self.link_health().is_open(),
            data_folder: settings.data_folder.display().to_string(),
            twin: self.twin.words(&settings.bench),
            twin_diagnosis: self.twin.diagnosis(),
            degraded: self.control.degraded().to_vec(),
            warnings: self.warnings(),
            plot: PlotScale::of(&settings.bench),
            preparing: self.starts.is_pending(),
            commander: self.commander.status(),
            rig,
            control_loop,
            run: self.newest_run.progress(),
        }
    }
}

#[cfg(test)]
impl DaemonState {
    /// The state of a daemon with the shipped bench, its data in `folder`, and a link at whose other end is no rig.
    pub(super) fn without_rig(folder: &std::path::Path) -> Arc<DaemonState> {
        let bench = Arc::new(Bench::shipped().expect("built in"));
        let (link, _) = crate::link::loopback::pair();
        let health = Arc::clone(&link.health);
        let rig = crate::control::Rig::new(bench.rig_config(1));
        // The thread ends with the last handle.
        let watcher = Box::new(crate::control::realtime::NoRecorder);
        let (control, _) = ControlHandle::spawn(rig, link, watcher).expect("a thread");
        let settings = DaemonSettings {
            link_address: "mock:".to_owned(),
            data_folder: folder.to_owned(),
            profiles_folder: folder.to_owned(),
            listen: ([127, 0, 0, 1], 0).into(),
            local: ([127, 0, 0, 1], 0).into(),
            remote: Remote::default(),
            bench,
        };
        let access = AccessControl::open(folder).expect("a folder");
        let audit = Audit::open(folder).expect("a folder");
        let library = Library::open(folder)
            .expect("a folder")
            .with_own(folder.join("profiles"));
        Arc::new(DaemonState::new(
            settings,
            control,
            Store::new(folder),
            library,
            health,
            Live::default(),
            (access, audit),
        ))
    }
}
