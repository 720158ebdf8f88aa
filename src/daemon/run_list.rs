//! The list of runs over HTTP, in pages, and the thread that keeps its index ready.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Json;
use axum::extract::Query;
use axum::extract::rejection::QueryRejection;
use axum::http::HeaderMap;
use axum::http::header::{HeaderName, HeaderValue};

use super::blocking::blocking;
use super::client_types::{Failure, RunSummary};
use super::error::ApiError;
use super::run_search::RunQuery;
use super::state::{App, DaemonState};
use crate::control::Phase;

/// A request reads files in full for at most this time; the thread of the index reads the rest. The whole answer is to come
/// within 200 ms.
const READ_WITHIN: Duration = Duration::from_millis(80);
/// Pause of the thread of the index when nothing is left to read, and during a run.
const INDEX_PAUSE: Duration = Duration::from_secs(2);
/// The thread of the index looks this often whether a run has begun.
const INDEX_TURN: Duration = Duration::from_millis(200);

/// Header: number of runs that fit, on all pages.
const TOTAL: HeaderName = HeaderName::from_static("leafbench-total");
/// Header: where the next page goes on; not there on the last one.
const NEXT: HeaderName = HeaderName::from_static("leafbench-next");
/// Header: number of runs whose file was not read in full yet.
const UNREAD: HeaderName = HeaderName::from_static("leafbench-unread");

/// The runs of the data folder that fit, newest first. The header `leafbench-total` has their number; `leafbench-next`, if it is
/// there, is the value of `after` for the next page; `leafbench-unread` counts the runs whose damage, if any, is not known yet.
#[utoipa::path(get, path = "/api/runs", params(RunQuery),
    responses((status = 200, body = Vec<RunSummary>,
        headers(("leafbench-total" = usize), ("leafbench-next" = String), ("leafbench-unread" = usize))),
        (status = 400, body = Failure)))]
pub(super) async fn runs(
    axum::extract::State(state): App,
    query: Result<Query<RunQuery>, QueryRejection>,
) -> Result<(HeaderMap, Json<Vec<RunSummary>>), ApiError> {
    let query = query?.0;
    let page = blocking(&state, move |state| {
        state
            .store
            .search(&query, Some(READ_WITHIN))
            .map_err(ApiError::disk)
    })
    .await?;
    let mut headers = HeaderMap::new();
    headers.insert(TOTAL, page.total.into());
    headers.insert(UNREAD, page.unread.into());
    let next = page.next.as_deref().map(HeaderValue::from_str);
    headers.extend(next.and_then(Result::ok).map(|next| (NEXT, next)));
    Ok((
        headers,
        Json(page.runs.iter().map(|run| run.summary.clone()).collect()),
    ))
}

/// The thread that reads run files in full before anybody asks. Dropping it ends the thread.
pub(super) struct IndexThread(Arc<AtomicBool>);

impl IndexThread {
    /// Starts the thread. It rests while the bench is at work.
    pub(super) fn spawn(state: &Arc<DaemonState>) -> IndexThread {
        let ends = Arc::new(AtomicBool::new(false));
        let (state, over) = (Arc::clone(state), Arc::clone(&ends));
        let work = move || {
            while !over.load(Ordering::Relaxed) {
                let at_rest = matches!(
                    state.control.status().0.phase,
                    Phase::Ready | Phase::Interlocked | Phase::Connecting
                );
                let left = match at_rest {
                    // A folder that cannot be read is reported to the one who asks.
                    true => state.store.check_some(INDEX_TURN).unwrap_or(0),
                    false => 0,
                };
                if left == 0 {
                    std::thread::park_timeout(INDEX_PAUSE);
                }
            }
        };
        // Without the thread, requests read the files.
        if let Err(error) = std::thread::Builder::new()
            .name("run index".to_owned())
            .spawn(work)
        {
            tracing::warn!("the index of the runs has no thread: {error}");
        }
        IndexThread(ends)
    }
}

impl Drop for IndexThread {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
