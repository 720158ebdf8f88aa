//! What can go wrong on the command line, and the exit code of each.

use std::path::PathBuf;

use crate::config::ConfigError;
use crate::control::Refusal;
use crate::daemon::DaemonError;
use crate::daemon::library::LibraryError;
use crate::diagnose::DiagnoseError;
use crate::diagnose::aggregates::AggregateError;
use crate::identify::IdentifyError;
use crate::link::LinkError;
use crate::mockrig::MockRigError;
use crate::model::BuildError;
use crate::profile::ProfileError;
use crate::recording::csv::CsvError;
use crate::recording::export::ExportError;
use crate::recording::run_file::RunFileError;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// Nobody listens.
    #[error(
        "no daemon is running here ({tried}): start one in another terminal with `leafbench daemon --bench \
         bench-configs/benches/mock.toml`, in this same folder or with the same --data"
    )]
    NoDaemon {
        /// What was tried.
        tried: String,
    },
    /// The daemon went away while we waited.
    #[error(
        "the daemon has gone: the rig unloads by itself; start the daemon again, it closes the run as aborted"
    )]
    DaemonGone,
    /// The daemon said no.
    #[error("{0}")]
    Refused(String),
    /// Input of a kind that has no error of its own.
    #[error("{0}")]
    Input(String),
    /// A file or folder.
    #[error("{path}: {doing} failed: check the path, its rights and the disk's space")]
    File {
        /// Which.
        path: PathBuf,
        /// What was tried.
        doing: &'static str,
        /// The system's own words.
        source: std::io::Error,
    },
    /// A bench or specimen file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A profile by name.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// A profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The daemon could not start.
    #[error(transparent)]
    Daemon(#[from] DaemonError),
    /// The link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The model.
    #[error("the model cannot be built")]
    Model(#[from] BuildError),
    /// A fit that cannot be put.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A recording.
    #[error(transparent)]
    Csv(#[from] CsvError),
    /// The mock rig.
    #[error(transparent)]
    MockRig(#[from] MockRigError),
    /// A run file.
    #[error(transparent)]
    RunFile(#[from] RunFileError),
    /// An export.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Control, in virtual time.
    #[error("the rig refused")]
    Control(#[from] Refusal),
    /// Recordings or a baseline that cannot be diagnosed.
    #[error(transparent)]
    Diagnose(#[from] DiagnoseError),
    /// Tables that cannot be diagnosed.
    #[error(transparent)]
    Aggregates(AggregateError),
    /// Our own fault.
    #[error("{0}: this is a defect of leafbench, please report it")]
    Internal(String),
}

impl CliError {
    /// See the help's list.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            CliError::NoDaemon { .. } | CliError::DaemonGone => 3,
            CliError::Refused(_) | CliError::Control(_) => 4,
            _ => 2,
        }
    }

    /// A file or folder that failed.
    pub(crate) fn file(
        path: &std::path::Path,
        doing: &'static str,
    ) -> impl FnOnce(std::io::Error) -> CliError {
        let path = path.to_owned();
        move |source| CliError::File { path, doing, source }
    }
}
