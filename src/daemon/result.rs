//! The result of a recorded run and its certificate, over HTTP.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::IntoResponse;

use super::client_types::Failure;
use super::error::ApiError;
use super::state::{App, DaemonState};
use crate::acceptance::RunResult;
use crate::recording::run_file::RunFile;
use crate::report::certificate;

/// What a certificate may load: nothing. Its style is inside.
const CERTIFICATE_POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'";

/// Opens the run and makes something of it, on a thread that may wait for the disk.
async fn of_run<T: Send + 'static>(
    state: Arc<DaemonState>,
    run_id: String,
    make: fn(&RunFile) -> Result<T, ApiError>,
) -> Result<T, ApiError> {
    let work = move || {
        let listing = state.store.find(&run_id).map_err(ApiError::not_found)?;
        make(&RunFile::open(&listing.path).map_err(ApiError::disk)?)
    };
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|_| ApiError::internal("the result could not be computed"))?
}

/// The result of a run: peak, valley, energy and rate of each cycle, their trends, and the verdict on each limit of the profile.
#[utoipa::path(get, path = "/api/runs/{run_id}/result", params(("run_id" = String, Path)),
    responses((status = 200, body = RunResult), (status = 404, body = Failure)))]
pub(super) async fn run_result(
    State(state): App,
    Path(run_id): Path<String>,
) -> Result<Json<RunResult>, ApiError> {
    of_run(state, run_id, |run| Ok(Json(RunResult::of(run)))).await
}

/// The certificate of a run: one HTML page that prints on one sheet A4.
#[utoipa::path(get, path = "/api/runs/{run_id}/certificate", params(("run_id" = String, Path)),
    responses((status = 200, content_type = "text/html", body = String), (status = 404, body = Failure)))]
pub(super) async fn run_certificate(
    State(state): App,
    Path(run_id): Path<String>,
) -> Result<impl IntoResponse, ApiError> {
    let page = of_run(state, run_id, |run| {
        certificate::page(run).map_err(|e| ApiError::internal(&format!("the run file cannot be read: {e}")))
    })
    .await?;
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, CERTIFICATE_POLICY),
    ];
    Ok((headers, page))
}
