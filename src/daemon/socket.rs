//! `/api/live`: a WebSocket that sends thinned samples 40 times per second and the status 10 times per second. A viewer
//! that reads too slowly is told how many samples it missed, and does not delay the others.

use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State};
use axum::response::Response;
use tokio::sync::broadcast::error::RecvError;

use super::access::Person;
use super::client_types::Status;
use super::connections::Connection;
use super::live::{LiveBatch, points_in};
use super::state::{App, DaemonState};

/// Time between two status messages.
const STATUS_PERIOD: Duration = Duration::from_millis(100);
/// A viewer that takes longer to receive one message is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest message from a viewer, bytes. Viewers send nothing; a longer message ends the connection.
const LARGEST_MESSAGE: usize = 1024;

/// The client that opens the socket.
#[derive(Debug, Default, serde::Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Viewer {
    /// Id of the client, as in the header `leafbench-caller`: it keeps the command while its socket is open.
    #[serde(default)]
    caller: Option<String>,
}

/// One message to a viewer.
#[derive(serde::Serialize, utoipa::ToSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(super) enum LiveMessage<'a> {
    /// Thinned samples. This viewer did not get the `skipped` samples before them.
    Samples {
        skipped: u64,
        #[serde(flatten)]
        batch: &'a LiveBatch,
    },
    /// The same as the answer to GET /api/status.
    Status { status: Box<Status> },
}

/// Live samples and status over a WebSocket: messages `{"type":"samples"}` and `{"type":"status"}`.
#[utoipa::path(get, path = "/api/live", params(Viewer), responses((status = 101, description = "WebSocket of JSON messages")))]
pub(super) async fn live(
    State(state): App,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(person): Extension<Person>,
    Query(viewer): Query<Viewer>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let in_use = connection.begin_request();
    upgrade
        .max_message_size(LARGEST_MESSAGE)
        // Without this the head of one frame would reserve up to 16 MiB before the message is refused.
        .max_frame_size(LARGEST_MESSAGE)
        .on_upgrade(move |socket| async move {
            let _presence = viewer
                .caller
                .map(|id| state.commander.presence((person.name, id)));
            serve(socket, state).await;
            drop(in_use);
        })
}

async fn serve(mut socket: WebSocket, state: Arc<DaemonState>) {
    let (recent, mut batches) = state.live.subscribe();
    for batch in recent {
        let message = text(&LiveMessage::Samples {
            skipped: 0,
            batch: &batch,
        });
        if send(&mut socket, message).await.is_none() {
            return;
        }
    }
    let mut status_due = tokio::time::interval(STATUS_PERIOD);
    status_due.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut skipped = 0;
    loop {
        let message = tokio::select! {
            batch = batches.recv() => match batch {
                Ok(batch) => text(&LiveMessage::Samples { skipped: std::mem::take(&mut skipped), batch: &batch }),
                Err(RecvError::Lagged(lost)) => {
                    skipped += points_in(lost);
                    continue;
                }
                Err(RecvError::Closed) => return,
            },
            _ = status_due.tick() => text(&LiveMessage::Status { status: Box::new(state.status()) }),
            incoming = socket.recv() => match incoming {
                // The library answers pings.
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        };
        if send(&mut socket, message).await.is_none() {
            return;
        }
    }
}

/// `None` if the viewer has disconnected or takes too long.
async fn send(socket: &mut WebSocket, message: Option<Message>) -> Option<()> {
    tokio::time::timeout(SEND_TIMEOUT, socket.send(message?))
        .await
        .ok()?
        .ok()
}

fn text(telegram: &LiveMessage) -> Option<Message> {
    Some(Message::Text(serde_json::to_string(telegram).ok()?.into()))
}
