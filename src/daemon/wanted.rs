//! Whether work that a client asked for is still wanted. The one who waits and the one who works share a [`Wanted`].

use std::sync::{Arc, OnceLock};

use axum::http::StatusCode;

use super::error::ApiError;

/// Why work is no longer wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Withdrawal {
    /// The bench was stopped, for this reason.
    Stopped(String),
    /// The connection of the client that asked was closed.
    ClientLeft,
    /// The daemon ends, for this reason.
    DaemonEnds(String),
}

impl From<&Withdrawal> for ApiError {
    fn from(withdrawal: &Withdrawal) -> ApiError {
        let (status, why) = match withdrawal {
            Withdrawal::Stopped(cause) => (StatusCode::CONFLICT, cause.as_str()),
            Withdrawal::ClientLeft => (StatusCode::CONFLICT, "its client left"),
            Withdrawal::DaemonEnds(cause) => (StatusCode::SERVICE_UNAVAILABLE, cause.as_str()),
        };
        ApiError::new(
            status,
            format!("the run was stopped before it began ({why}): nothing has moved"),
            "start it again when the bench is ready".to_owned(),
        )
    }
}

/// A piece of work that can be withdrawn once. Clones share the state.
#[derive(Debug, Clone, Default)]
pub(super) struct Wanted(Arc<OnceLock<Withdrawal>>);

impl Wanted {
    /// Withdraws the work. The first reason stays.
    pub(super) fn withdraw(&self, why: Withdrawal) {
        let _ = self.0.set(why);
    }

    /// Why the work is no longer wanted; `None` while it is.
    pub(super) fn withdrawn(&self) -> Option<&Withdrawal> {
        self.0.get()
    }

    /// Refuses work that is no longer wanted.
    pub(super) fn check(&self) -> Result<(), ApiError> {
        self.withdrawn().map_or(Ok(()), |why| Err(why.into()))
    }

    /// Withdraws the work when it is dropped, as the handler of a request is when its client leaves. Work that is done by
    /// then is not affected.
    pub(super) fn while_client_waits(&self) -> ClientWaits {
        ClientWaits(self.clone())
    }
}

/// The client that waits for a piece of work.
pub(super) struct ClientWaits(Wanted);

impl Drop for ClientWaits {
    fn drop(&mut self) {
        self.0.withdraw(Withdrawal::ClientLeft);
    }
}
