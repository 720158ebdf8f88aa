//! Diagnoses over HTTP: ask for one, follow it, read what it left, give its improved model to the twin.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::blocking::blocking;
use super::client_types::{Accepted, Failure};
use super::commanding::Commanding;
use super::diagnoses::JobError;
use super::diagnoses::job::{DiagnosisJob, IMPROVED, JobState};
use super::error::ApiError;
use super::request_body::JsonBody;
use super::state::{App, DaemonState};
use super::store;
use super::twin_choice::ImprovedTwin;
use crate::config::Bench;
use crate::control::Phase;

/// Most runs of one diagnosis.
const MOST_RUNS: usize = 50;
/// A report shows only itself: no script, nothing from elsewhere. The page may have it in a frame.
const REPORT_POLICY: [(HeaderName, &str); 2] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; sandbox",
    ),
    (header::X_FRAME_OPTIONS, "SAMEORIGIN"),
];

impl From<JobError> for ApiError {
    fn from(error: JobError) -> ApiError {
        let status = match error {
            JobError::Unknown(_) => StatusCode::NOT_FOUND,
            JobError::TooMany | JobError::State { .. } => StatusCode::CONFLICT,
            JobError::Disk(_) => StatusCode::INSUFFICIENT_STORAGE,
        };
        ApiError::new(status, super::chain(&error), String::new())
    }
}

/// Which runs to diagnose.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct DiagnoseRequest {
    /// Run ids, whole or short. All runs are of one specimen.
    pub runs: Vec<String>,
    /// The runs have different specimens in their headers and are of the same spring all the same.
    #[serde(default)]
    pub mixed_specimens: bool,
}

/// Which model the twin of the next run has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TwinRequest {
    /// Id of a diagnosis whose improved model is taken; null for the model of the bench file.
    pub diagnosis: Option<String>,
}

/// Diagnoses runs: which physics do they show that the bench's model lacks? One diagnosis at a time is computed, at the lowest
/// priority; the others wait.
#[utoipa::path(post, path = "/api/diagnoses", request_body = DiagnoseRequest,
    responses((status = 202, body = DiagnosisJob), (status = 404, body = Failure), (status = 409, body = Failure),
        (status = 422, body = Failure)))]
pub(super) async fn ask(
    State(state): App,
    JsonBody(request): JsonBody<DiagnoseRequest>,
) -> Result<(StatusCode, Json<DiagnosisJob>), ApiError> {
    let job = blocking(&state, move |state| {
        let job = job_of(state, &request)?;
        state.diagnoses.add(job.clone(), &state.settings.bench)?;
        Ok(job)
    })
    .await?;
    Ok((StatusCode::ACCEPTED, Json(job)))
}

/// The job for a request whose runs are there and belong together.
fn job_of(state: &DaemonState, request: &DiagnoseRequest) -> Result<DiagnosisJob, ApiError> {
    let refusal = |error: String, what_to_do: &str| {
        Err(ApiError::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            error,
            what_to_do.to_owned(),
        ))
    };
    if request.runs.is_empty() || request.runs.len() > MOST_RUNS {
        return refusal(
            format!("{} runs were chosen for a diagnosis", request.runs.len()),
            "choose 1 to 50 runs",
        );
    }
    let mut runs = Vec::new();
    let mut specimen: Option<String> = None;
    for id in &request.runs {
        let run = state.store.find(id).map_err(ApiError::not_found)?;
        if !run.is_closed() {
            return refusal(
                format!("run {} has no end yet, or cannot be read", run.run_id),
                "wait for its end, or choose another run",
            );
        }
        let first = specimen.get_or_insert_with(|| run.specimen.clone());
        if *first != run.specimen && !request.mixed_specimens {
            return refusal(
                format!(
                    "the runs are of different specimens: \"{first}\" and \"{}\"",
                    run.specimen
                ),
                "choose runs of one specimen",
            );
        }
        if !runs.contains(&run.run_id) {
            runs.push(run.run_id);
        }
    }
    let now = jiff::Timestamp::now();
    Ok(DiagnosisJob {
        id: store::new_run_id(now),
        asked_utc: now.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        runs,
        specimen: specimen.unwrap_or_default(),
        bench: state.settings.bench.name.clone(),
        mixed_specimens: request.mixed_specimens,
        state: JobState::Queued,
        share: 0.0,
        step: String::new(),
        error: String::new(),
        found: None,
    })
}

/// All diagnoses of the data folder, newest first.
#[utoipa::path(get, path = "/api/diagnoses", responses((status = 200, body = Vec<DiagnosisJob>)))]
pub(super) async fn list(State(state): App) -> Json<Vec<DiagnosisJob>> {
    Json(state.diagnoses.list())
}

/// One diagnosis: how far it is, and in short what it found.
#[utoipa::path(get, path = "/api/diagnoses/{id}", params(("id" = String, Path)),
    responses((status = 200, body = DiagnosisJob), (status = 404, body = Failure)))]
pub(super) async fn one(State(state): App, Path(id): Path<String>) -> Result<Json<DiagnosisJob>, ApiError> {
    Ok(Json(state.diagnoses.get(&id)?))
}

/// Cancels a diagnosis that waits or is computed. Removes one that is over, with its files.
#[utoipa::path(delete, path = "/api/diagnoses/{id}", params(("id" = String, Path)),
    responses((status = 200, body = DiagnosisJob), (status = 404, body = Failure)))]
pub(super) async fn end(State(state): App, Path(id): Path<String>) -> Result<Json<DiagnosisJob>, ApiError> {
    let job = blocking(&state, move |state| Ok(state.diagnoses.end_or_remove(&id)?)).await?;
    Ok(Json(job))
}

/// A file of a diagnosis that is done: `report.html`, `diagnosis.json`, `improved.toml` or `next-test.toml`.
#[utoipa::path(get, path = "/api/diagnoses/{id}/{file}", params(("id" = String, Path), ("file" = String, Path)),
    responses((status = 200, content_type = "text/html", body = String), (status = 404, body = Failure),
        (status = 409, body = Failure)))]
pub(super) async fn file(
    State(state): App,
    Path((id, file)): Path<(String, String)>,
) -> Result<Response, ApiError> {
    let (bytes, kind) = blocking(&state, move |state| {
        let (path, kind) = state.diagnoses.file(&id, &file)?;
        Ok((std::fs::read(path).map_err(JobError::Disk)?, kind))
    })
    .await?;
    Ok((REPORT_POLICY, [(header::CONTENT_TYPE, kind)], bytes).into_response())
}

/// Gives the twin of the next run the improved model of a diagnosis, or that of the bench file again. The check of a profile
/// uses it, too. Refused while the bench is at work.
#[utoipa::path(post, path = "/api/twin", request_body = TwinRequest,
    responses((status = 200, body = Accepted), (status = 404, body = Failure), (status = 409, body = Failure)))]
pub(super) async fn choose_twin(
    _: Commanding,
    State(state): App,
    JsonBody(request): JsonBody<TwinRequest>,
) -> Result<Json<Accepted>, ApiError> {
    let improved = match request.diagnosis {
        None => None,
        Some(id) => Some(blocking(&state, move |state| improved_of(state, &id)).await?),
    };
    let _turn = state.starts.turn().await;
    let at_rest = matches!(
        state.control.status().0.phase,
        Phase::Ready | Phase::Interlocked | Phase::Connecting
    );
    if state.starts.is_pending() || !at_rest {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            "the twin keeps its model while the bench is at work".to_owned(),
            "wait for the end of the run, or stop it".to_owned(),
        ));
    }
    state.twin.set(improved);
    let message = format!(
        "the twin has the model {}",
        state.twin.words(&state.settings.bench)
    );
    tracing::info!("{message}");
    Ok(Json(Accepted { message }))
}

/// The improved model of a diagnosis of this bench.
fn improved_of(state: &DaemonState, id: &str) -> Result<ImprovedTwin, ApiError> {
    let job = state.diagnoses.get(id)?;
    if job.bench != state.settings.bench.name {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            format!(
                "diagnosis {id} is of bench {} and this is {}",
                job.bench, state.settings.bench.name
            ),
            "choose a diagnosis of this bench".to_owned(),
        ));
    }
    let (path, _) = state.diagnoses.file(id, IMPROVED)?;
    let bench = Bench::load(&path).map_err(|e| ApiError::invalid(&e))?;
    // A model that cannot be built would be refused at the next start, when it is too late to say so.
    bench.model.plant().map_err(|e| ApiError::invalid(&e))?;
    Ok(ImprovedTwin {
        diagnosis: job.id,
        model: bench.model,
    })
}
