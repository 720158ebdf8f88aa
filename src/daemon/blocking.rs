//! Work of a handler that reads files: on a thread that does not serve the interface.

use std::sync::Arc;

use super::error::ApiError;
use super::state::DaemonState;

/// Runs `work`, which reads files, on a thread that does not serve the interface.
pub(super) async fn blocking<T: Send + 'static>(
    state: &Arc<DaemonState>,
    work: impl FnOnce(&DaemonState) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let state = Arc::clone(state);
    tokio::task::spawn_blocking(move || work(&state))
        .await
        .map_err(|_| ApiError::internal("a file could not be read"))?
}
