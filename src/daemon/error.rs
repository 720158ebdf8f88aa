//! The errors of the daemon: why it does not start, and what it answers to a request that failed.

use std::net::SocketAddr;
use std::path::PathBuf;

use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};

use super::access::tokens::TokenError;
use super::client_types::{Failure, TextPlace};
use super::library::LibraryError;
use super::store::FindRunError;
use crate::control::realtime::RequestError;
use crate::recording::run_file::RunFileError;

/// Why the daemon does not start, or why it ends.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DaemonError {
    /// Another process holds the lock of the data folder or of the link.
    #[error("{what} belongs to another daemon (process {owner}): stop that daemon first, or use its page")]
    Locked {
        /// The data folder or the address of the link.
        what: String,
        /// Process id of the other daemon.
        owner: String,
    },
    /// A folder or file of the daemon cannot be created, read or written.
    #[error("{path} cannot be used: check its permissions and the free space on the disk")]
    Folder { path: PathBuf, source: std::io::Error },
    /// The claim on a link cannot be made.
    #[error("{what} cannot be claimed for this daemon: check how many sockets this computer has open")]
    Claim {
        /// The address of the link.
        what: String,
        source: std::io::Error,
    },
    /// The socket for the HTTP interface cannot be opened.
    #[error(
        "the daemon cannot listen on {address}: stop the program that uses this port, or give another one with \
         --listen 127.0.0.1:PORT"
    )]
    Listen {
        address: SocketAddr,
        source: std::io::Error,
    },
    /// The address for the HTTP interface is not a loopback address, and nothing encrypts what goes over it.
    #[error(
        "other computers can reach {0}, and without TLS they can read the tokens: add --tls-cert FILE and --tls-key FILE, \
         or --behind-proxy NAME if a proxy with TLS stands before the daemon, or listen on 127.0.0.1:PORT (docs/operations.md, \
         \"Reach the bench from other computers\")"
    )]
    NotLoopback(SocketAddr),
    /// Certificate or key cannot be used.
    #[error("{path} cannot be used for TLS: give the certificate chain and its private key as PEM files")]
    Tls {
        path: PathBuf,
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    #[error(transparent)]
    Tokens(#[from] TokenError),
    #[error("the runs in the data folder cannot be read")]
    Runs(#[from] RunFileError),
    /// The operating system gives no thread, timer or signal handler.
    #[error("the daemon cannot start its threads: free memory, then start it again")]
    System(#[from] std::io::Error),
    #[error(transparent)]
    Library(#[from] LibraryError),
}

/// The answer to a request that failed.
#[derive(Debug)]
pub(crate) struct ApiError {
    status: StatusCode,
    failure: Failure,
}

impl ApiError {
    /// `error` says what is wrong and where. `what_to_do` is empty if `error` says that too.
    pub(super) fn new(status: StatusCode, error: String, what_to_do: String) -> Self {
        ApiError {
            status,
            failure: Failure {
                error,
                what_to_do,
                place: None,
            },
        }
    }

    /// A profile cannot be found, used, saved or deleted. The error of a text has its place.
    pub(super) fn profile(error: &LibraryError) -> Self {
        let status = match error {
            LibraryError::Exists { .. } | LibraryError::NotOwn { .. } => StatusCode::CONFLICT,
            LibraryError::Write { .. } => StatusCode::INTERNAL_SERVER_ERROR,
            _ => StatusCode::UNPROCESSABLE_ENTITY,
        };
        let mut refusal = ApiError::new(status, chain(error), String::new());
        refusal.failure.place = error.place().map(|(line, column)| TextPlace { line, column });
        refusal
    }

    /// 422: the request is well-formed but its content cannot be used.
    pub(super) fn invalid(error: &dyn std::error::Error) -> Self {
        ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, chain(error), String::new())
    }

    /// The data folder or a run file cannot be read or written.
    pub(super) fn disk(error: RunFileError) -> Self {
        let status = match error {
            RunFileError::NoSpace { .. } => StatusCode::INSUFFICIENT_STORAGE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        ApiError::new(status, chain(&error), String::new())
    }

    /// An id stands for no run, or for several.
    pub(super) fn not_found(error: FindRunError) -> Self {
        match error {
            FindRunError::Disk(error) => ApiError::disk(error),
            FindRunError::Unknown { id, .. } => ApiError::no_run(&id),
            several @ FindRunError::Several { .. } => {
                ApiError::new(StatusCode::CONFLICT, several.to_string(), String::new())
            }
        }
    }

    /// The data folder has no run with this id.
    fn no_run(run_id: &str) -> Self {
        let shown: String = run_id.chars().take(40).collect();
        ApiError::new(
            StatusCode::NOT_FOUND,
            format!("there is no run \"{shown}\""),
            "GET /api/runs, or `leafbench runs`, lists all runs".to_owned(),
        )
    }

    /// A defect of the daemon itself.
    pub(super) fn internal(what: &str) -> Self {
        ApiError::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            what.to_owned(),
            "read the daemon's log and report this defect".to_owned(),
        )
    }
}

#[cfg(test)]
impl ApiError {
    pub(super) fn status(&self) -> StatusCode {
        self.status
    }
}

/// An error with all its causes in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

impl From<RequestError> for ApiError {
    fn from(error: RequestError) -> Self {
        let status = match error {
            RequestError::Refused(_) => StatusCode::CONFLICT,
            RequestError::Overloaded | RequestError::Ended => StatusCode::SERVICE_UNAVAILABLE,
        };
        ApiError::new(status, error.to_string(), String::new())
    }
}

impl From<JsonRejection> for ApiError {
    fn from(rejection: JsonRejection) -> Self {
        let what_to_do = "GET /api/openapi.json describes every request".to_owned();
        ApiError::new(rejection.status(), rejection.body_text(), what_to_do)
    }
}

impl From<QueryRejection> for ApiError {
    fn from(rejection: QueryRejection) -> Self {
        ApiError::new(rejection.status(), rejection.body_text(), String::new())
    }
}

/// On an answer: what the audit log says about the request besides its address.
#[derive(Debug, Clone)]
pub(super) struct AuditNote(pub String);

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let note = Extension(AuditNote(self.failure.error.clone()));
        (self.status, note, Json(self.failure)).into_response()
    }
}
