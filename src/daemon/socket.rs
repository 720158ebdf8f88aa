//! `/api/live`: what a run does, as it does it, over a WebSocket. Thinned samples 25 times a second, the status 10 times;
//! a watcher that reads too slowly is told how many points it missed and delays nobody.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use tokio::sync::broadcast::error::RecvError;

use super::Shared;
use super::api::{App, status_of};
use super::client_types::Status;
use super::live::{Batch, points_in};

/// The status is sent this often.
const STATUS_PERIOD: Duration = Duration::from_millis(100);
/// A watcher that takes longer over one message is let go.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// Watchers have nothing to say: longer messages end the connection.
const LARGEST_MESSAGE: usize = 1024;

/// One message to a watcher.
#[derive(serde::Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Telegram<'a> {
    /// Thinned samples; `skipped` points before them did not get through to this watcher.
    Samples {
        skipped: u64,
        #[serde(flatten)]
        batch: &'a Batch,
    },
    /// As GET /api/status.
    Status { status: Box<Status> },
}

/// Live samples and status over a WebSocket: messages `{"type":"samples"}` and `{"type":"status"}`.
#[utoipa::path(get, path = "/api/live", responses((status = 101, description = "WebSocket of JSON messages")))]
pub(crate) async fn live(State(shared): App, upgrade: WebSocketUpgrade) -> Response {
    upgrade
        .max_message_size(LARGEST_MESSAGE)
        .on_upgrade(move |socket| serve(socket, shared))
}

async fn serve(mut socket: WebSocket, shared: Arc<Shared>) {
    let (recent, mut batches) = shared.live.watch();
    for batch in recent {
        if send(
            &mut socket,
            text(&Telegram::Samples {
                skipped: 0,
                batch: &batch,
            }),
        )
        .await
        .is_none()
        {
            return;
        }
    }
    let mut status_due = tokio::time::interval(STATUS_PERIOD);
    status_due.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut skipped = 0;
    loop {
        let message = tokio::select! {
            batch = batches.recv() => match batch {
                Ok(batch) => text(&Telegram::Samples { skipped: std::mem::take(&mut skipped), batch: &batch }),
                Err(RecvError::Lagged(lost)) => {
                    skipped += points_in(lost);
                    continue;
                }
                Err(RecvError::Closed) => return,
            },
            _ = status_due.tick() => text(&Telegram::Status { status: Box::new(status_of(&shared)) }),
            incoming = socket.recv() => match incoming {
                // Pings are answered by the socket itself.
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        };
        if send(&mut socket, message).await.is_none() {
            return;
        }
    }
}

/// `None` where the watcher has gone or takes too long.
async fn send(socket: &mut WebSocket, message: Option<Message>) -> Option<()> {
    tokio::time::timeout(SEND_TIMEOUT, socket.send(message?))
        .await
        .ok()?
        .ok()
}

fn text(telegram: &Telegram) -> Option<Message> {
    Some(Message::Text(serde_json::to_string(telegram).ok()?.into()))
}
