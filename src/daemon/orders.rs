//! Orders to control that must not be lost: a stop, the reaction to a model mismatch, the end of control.

use std::time::Duration;

use crate::control::realtime::{ControlHandle, Reply, Request, RequestError};

/// Tries of an order while too many others wait. Control takes one request per millisecond, and eight can wait.
const TRIES: u32 = 200;
/// Pause between two tries.
const PAUSE: Duration = Duration::from_millis(5);

/// Asks control again until there is room for the order that `request` makes.
pub(super) async fn insist(
    control: &ControlHandle,
    request: impl Fn() -> Request,
) -> Result<Reply, RequestError> {
    for _ in 0..TRIES {
        match control.ask(request()).await {
            Err(RequestError::Overloaded) => tokio::time::sleep(PAUSE).await,
            answer => return answer,
        }
    }
    Err(RequestError::Overloaded)
}
