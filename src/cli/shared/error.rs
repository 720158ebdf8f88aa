//! The errors of the command line, and the exit code of each.

use std::path::{Path, PathBuf};

use crate::archive::ArchiveError;
use crate::config::ConfigError;
use crate::control::Refusal;
use crate::daemon::DaemonError;
use crate::daemon::access::tokens::TokenError;
use crate::daemon::library::LibraryError;
use crate::daemon::store::FindRunError;
use crate::diagnose::DiagnoseError;
use crate::diagnose::aggregates::AggregateError;
use crate::fleet::FleetError;
use crate::fleet::estimate::EstimateTableError;
use crate::fleet::predict::next_run::PredictError;
use crate::identify::IdentifyError;
use crate::link::LinkError;
use crate::mockrig::MockRigError;
use crate::model::BuildError;
use crate::profile::ProfileError;
use crate::recording::csv::CsvError;
use crate::recording::export::ExportError;
use crate::recording::import::ImportError;
use crate::recording::run_file::RunFileError;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// No daemon answers for the data folder.
    #[error(
        "no daemon is running here ({tried}): start one in another terminal with `leafbench daemon --bench \
         bench-configs/benches/mock.toml`, in this same folder or with the same --data"
    )]
    NoDaemon {
        /// The file or address that was tried.
        tried: String,
    },
    /// The daemon stopped answering while a command waited for a run.
    #[error(
        "the daemon no longer answers and the rig unloads by itself: start the daemon again, it closes the run as aborted"
    )]
    DaemonGone,
    /// The daemon refused the request; the text is its own.
    #[error("{0}")]
    Refused(String),
    /// Unusable input that has no error type of its own.
    #[error("{0}")]
    Input(String),
    /// A file or folder could not be read or written.
    #[error("{path}: {doing} failed: check the path, the access rights and the free space of the disk")]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What was tried, such as "writing".
        doing: &'static str,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A bench or specimen file is unusable.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A profile was not found by its name.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// A run was not found by its id.
    #[error(transparent)]
    FindRun(#[from] FindRunError),
    /// The next run cannot be predicted.
    #[error(transparent)]
    Predict(#[from] PredictError),
    /// A profile cannot be played.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The daemon could not start.
    #[error(transparent)]
    Daemon(#[from] DaemonError),
    /// A token could not be added, listed or removed.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The link could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The model's name, values or structure are unusable.
    #[error("the model cannot be built")]
    Model(#[from] BuildError),
    /// A fit could not start.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A recording (CSV) is unusable.
    #[error(transparent)]
    Csv(#[from] CsvError),
    /// A table of another program cannot be imported.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// The mock rig's config is unusable.
    #[error(transparent)]
    MockRig(#[from] MockRigError),
    /// A run file cannot be read or written.
    #[error(transparent)]
    RunFile(#[from] RunFileError),
    /// A run cannot be exported.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// An archive cannot be written or read.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// Control refused an order, in virtual time.
    #[error("the rig refused")]
    Control(#[from] Refusal),
    /// Recordings or a baseline that cannot be diagnosed.
    #[error(transparent)]
    Diagnose(#[from] DiagnoseError),
    /// Tables that cannot be diagnosed.
    #[error(transparent)]
    Aggregates(AggregateError),
    /// A table of estimates is unusable.
    #[error(transparent)]
    Estimates(#[from] EstimateTableError),
    /// A table of estimates cannot be pooled.
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// A defect of leafbench itself.
    #[error("{0}: this is a defect of leafbench, please report it")]
    Internal(String),
}

impl CliError {
    /// Exit code of the process; the help of `leafbench` lists them.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            CliError::NoDaemon { .. } | CliError::DaemonGone => 3,
            CliError::Refused(_) | CliError::Control(_) => 4,
            _ => 2,
        }
    }

    /// For `map_err`: the file or folder that failed, and what was tried with it.
    pub(crate) fn file(path: &Path, doing: &'static str) -> impl FnOnce(std::io::Error) -> CliError {
        let path = path.to_owned();
        move |source| CliError::File { path, doing, source }
    }
}
