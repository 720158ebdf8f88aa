//! HTTP and JSON on loopback: routes, handlers and their description (OpenAPI), which a test holds together.

use std::net::SocketAddr;
use std::sync::Arc;

use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Json, Router};
use tokio::net::TcpListener;
use utoipa::OpenApi;

use super::client_types::{
    Accepted, Failure, Nothing, PlanRequest, ProfileSummary, RunDetail, RunProgress, RunState, RunSummary,
    StartRun, Started, Status, StopRequest,
};
use super::guard::{self, RequestGuard};
use super::plan::{self, Plan};
use super::runs::ending_word;
use super::{Shared, csv_download, page, socket};
use crate::control::TareReport;
use crate::control::realtime::{Reply, Request, RequestError};
use crate::recording::run_file::{RunFile, RunFileError, RunListing};

/// Largest body of a request: a profile file and then some.
const BODY_LIMIT: usize = 1 << 20;

/// What a failed request is answered with.
#[derive(Debug)]
pub(crate) struct ApiError {
    status: StatusCode,
    failure: Failure,
}

impl ApiError {
    /// `error` says what and where, `what_to_do` what to do, where `error` does not.
    pub(crate) fn new(status: StatusCode, error: String, what_to_do: String) -> Self {
        ApiError {
            status,
            failure: Failure { error, what_to_do },
        }
    }

    /// The HTTP status.
    pub(crate) fn status(&self) -> StatusCode {
        self.status
    }

    /// What was asked for cannot be used; the chain of causes in one line.
    pub(crate) fn invalid(error: &dyn std::error::Error) -> Self {
        ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, chain(error), String::new())
    }

    /// The data folder or a run file.
    pub(crate) fn disk(error: RunFileError) -> Self {
        let status = match error {
            RunFileError::NoSpace { .. } => StatusCode::INSUFFICIENT_STORAGE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        ApiError::new(status, chain(&error), String::new())
    }

    /// No run of this id.
    pub(crate) fn no_run(run_id: &str) -> Self {
        let shown: String = run_id.chars().take(40).collect();
        ApiError::new(
            StatusCode::NOT_FOUND,
            format!("there is no run \"{shown}\""),
            "GET /api/runs, or `leafbench runs`, lists all".to_owned(),
        )
    }

    /// Our own fault.
    pub(crate) fn internal(what: &str) -> Self {
        ApiError::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            what.to_owned(),
            "look at the daemon's log and report it".to_owned(),
        )
    }
}

/// An error with its causes in one line.
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

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        (self.status, Json(self.failure)).into_response()
    }
}

type Result<T> = std::result::Result<T, ApiError>;
/// The state of every handler.
pub(crate) type App = State<Arc<Shared>>;
type Body<T> = std::result::Result<Json<T>, JsonRejection>;

/// One route. The list is the router, and the tests' list of what to knock at.
struct Route {
    /// Names the handler's method for the test that compares this list with the description.
    #[cfg_attr(not(test), expect(dead_code))]
    method: &'static str,
    path: &'static str,
    handler: MethodRouter<Arc<Shared>>,
}

fn routes() -> Vec<Route> {
    let route = |method, path, handler| Route {
        method,
        path,
        handler,
    };
    vec![
        route("get", "/api/status", get(status)),
        route("post", "/api/run", post(run)),
        route("post", "/api/stop", post(stop)),
        route("post", "/api/hold", post(hold)),
        route("post", "/api/resume", post(resume)),
        route("post", "/api/reset", post(reset)),
        route("post", "/api/tare", post(tare)),
        route("get", "/api/runs", get(runs)),
        route("get", "/api/runs/{run_id}", get(run_detail)),
        route("get", "/api/runs/{run_id}/csv", get(run_csv)),
        route("get", "/api/profiles", get(profiles)),
        route("post", "/api/plan", post(plan_profile)),
        route("get", "/api/openapi.json", get(openapi)),
        route("get", "/api/live", get(socket::live)),
    ]
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "leafbench",
        description = "Controls a leaf-spring test bench. Loopback only. Failures are `{error, what_to_do}`."
    ),
    paths(
        status,
        run,
        stop,
        hold,
        resume,
        reset,
        tare,
        runs,
        run_detail,
        run_csv,
        profiles,
        plan_profile,
        openapi,
        socket::live
    )
)]
struct Description;

/// Everything behind the guard.
pub(crate) fn router(address: SocketAddr, shared: Arc<Shared>) -> Router {
    let api = routes()
        .into_iter()
        .fold(Router::new(), |router, r| router.route(r.path, r.handler));
    api.merge(page::router())
        .fallback(|| async {
            ApiError::new(
                StatusCode::NOT_FOUND,
                "there is nothing at this address".to_owned(),
                "GET /api/openapi.json lists what there is".to_owned(),
            )
        })
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        .layer(axum::middleware::from_fn_with_state(
            RequestGuard::new(address),
            guard::check,
        ))
        .with_state(shared)
}

/// Serves until the task is aborted.
pub(crate) async fn serve(listener: TcpListener, address: SocketAddr, shared: Arc<Shared>) {
    if let Err(error) = axum::serve(listener, router(address, shared)).await {
        tracing::error!("the HTTP interface ended: {error}");
    }
}

/// The bench and the run under way.
#[utoipa::path(get, path = "/api/status", responses((status = 200, body = Status)))]
async fn status(State(shared): App) -> Json<Status> {
    Json(status_of(&shared))
}

/// [`Status`] of this moment.
pub(crate) fn status_of(shared: &Shared) -> Status {
    let (rig, control_loop) = shared.control.status();
    let settings = &shared.settings;
    Status {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        bench: settings.bench.name.clone(),
        link: settings.link_address.clone(),
        link_open: shared.link_health().is_open(),
        data_folder: settings.data_folder.display().to_string(),
        twin: settings.bench.model.name.clone(),
        degraded: shared.control.degraded().to_vec(),
        rig,
        control_loop,
        run: shared.runs.newest(),
    }
}

/// Starts a run. It is checked against the limits and dry-run on the model first; a predicted trip is refused.
#[utoipa::path(post, path = "/api/run", request_body = StartRun,
    responses((status = 202, body = Started), (status = 409, body = Failure), (status = 422, body = Failure)))]
async fn run(State(shared): App, body: Body<StartRun>) -> Result<(StatusCode, Json<Started>)> {
    let Json(order) = body?;
    Ok((
        StatusCode::ACCEPTED,
        Json(shared.runs.start(&shared, order).await?),
    ))
}

async fn ask(shared: &Shared, request: Request, message: &str) -> Result<Json<Accepted>> {
    shared.control.ask(request).await?;
    Ok(Json(Accepted {
        message: message.to_owned(),
    }))
}

/// Ends the run under way: the rig unloads, the data are kept.
#[utoipa::path(post, path = "/api/stop", request_body = StopRequest,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
async fn stop(State(shared): App, body: Body<StopRequest>) -> Result<Json<Accepted>> {
    // A stop whose body cannot be read is a stop all the same.
    let reason = body.ok().and_then(|Json(b)| b.reason);
    let cause = reason.unwrap_or_else(|| "stopped by an operator".to_owned());
    ask(&shared, Request::Stop(cause), "the rig unloads").await
}

/// Keeps the position. The firmware unloads by itself when nobody comes back.
#[utoipa::path(post, path = "/api/hold", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
async fn hold(State(shared): App) -> Result<Json<Accepted>> {
    ask(&shared, Request::Hold, "the rig holds its position").await
}

/// Goes on after a hold.
#[utoipa::path(post, path = "/api/resume", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
async fn resume(State(shared): App) -> Result<Json<Accepted>> {
    ask(&shared, Request::Resume, "the run goes on").await
}

/// Clears the interlock. Never resumes motion.
#[utoipa::path(post, path = "/api/reset", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
async fn reset(State(shared): App) -> Result<Json<Accepted>> {
    ask(
        &shared,
        Request::Reset,
        "the interlock is being reset; nothing moves",
    )
    .await
}

/// Takes the mean of the last half second as zero on both channels.
#[utoipa::path(post, path = "/api/tare", request_body = Nothing,
    responses((status = 200, body = TareReport), (status = 409, body = Failure)))]
async fn tare(State(shared): App) -> Result<Json<TareReport>> {
    match shared.control.ask(Request::Tare).await? {
        Reply::Tared(report) => Ok(Json(report)),
        Reply::Accepted => Err(ApiError::internal("control took the tare but reported none")),
    }
}

/// Runs `work`, which reads files, away from the threads that serve the interface.
async fn blocking<T: Send + 'static>(
    shared: &Arc<Shared>,
    work: impl FnOnce(&Shared) -> Result<T> + Send + 'static,
) -> Result<T> {
    let shared = Arc::clone(shared);
    tokio::task::spawn_blocking(move || work(&shared))
        .await
        .map_err(|_| ApiError::internal("a file could not be read"))?
}

/// Every run of the data folder, newest first.
#[utoipa::path(get, path = "/api/runs", responses((status = 200, body = Vec<RunSummary>)))]
async fn runs(State(shared): App) -> Result<Json<Vec<RunSummary>>> {
    let list = blocking(&shared, |shared| shared.store.list().map_err(ApiError::disk)).await?;
    Ok(Json(list.into_iter().rev().map(summary).collect()))
}

/// The row of a run.
pub(crate) fn summary(run: RunListing) -> RunSummary {
    let (ending, cause) = match &run.outcome {
        Some(outcome) => (ending_word(outcome.ending), outcome.cause.clone()),
        None => ("open", String::new()),
    };
    RunSummary {
        ending: ending.to_owned(),
        cause,
        run_id: run.run_id,
        started_utc: run.started_utc,
        profile: run.profile_name,
        specimen: run.specimen,
        samples: run.samples,
        lost: run.lost,
        cycles_completed: run.cycles_completed,
        problem: run.problem,
    }
}

/// One run with its header and events; `latest` is the newest.
#[utoipa::path(get, path = "/api/runs/{run_id}", params(("run_id" = String, Path)),
    responses((status = 200, body = RunDetail), (status = 404, body = Failure)))]
async fn run_detail(State(shared): App, Path(run_id): Path<String>) -> Result<Json<RunDetail>> {
    blocking(&shared, move |shared| {
        let listing = shared.store.find(&run_id).map_err(ApiError::disk)?;
        let listing = listing.ok_or_else(|| ApiError::no_run(&run_id))?;
        let file = RunFile::open(&listing.path).map_err(ApiError::disk)?;
        let value = |v: serde_json::Result<_>| v.map_err(|e| ApiError::internal(&e.to_string()));
        let events = file
            .events()
            .iter()
            .map(|e| value(serde_json::to_value(e)))
            .collect::<Result<_>>()?;
        let header = value(serde_json::to_value(file.header()))?;
        Ok(Json(RunDetail {
            summary: summary(listing),
            header,
            events,
        }))
    })
    .await
}

/// The run as CSV: whole, one cycle (`?cycle=3`), the mean loop (`?mean_loop=true`) or every n-th sample (`?every=10`).
#[utoipa::path(get, path = "/api/runs/{run_id}/csv",
    params(("run_id" = String, Path), csv_download::Chunk),
    responses((status = 200, content_type = "text/csv", body = String), (status = 404, body = Failure)))]
async fn run_csv(
    State(shared): App,
    Path(run_id): Path<String>,
    part: std::result::Result<Query<csv_download::Chunk>, QueryRejection>,
) -> Result<Response> {
    let Query(part) = part?;
    let file = blocking(&shared, move |shared| {
        csv_download::prepare(&shared.store, &run_id, &part)
    })
    .await?;
    Ok(csv_download::stream(file))
}

/// The profiles that can be started by name.
#[utoipa::path(get, path = "/api/profiles", responses((status = 200, body = Vec<ProfileSummary>)))]
async fn profiles(State(shared): App) -> Result<Json<Vec<ProfileSummary>>> {
    blocking(&shared, |shared| {
        shared.library.list().map(Json).map_err(|e| ApiError::invalid(&e))
    })
    .await
}

/// Checks a profile against the limits and dry-runs it on the model. Nothing moves.
#[utoipa::path(post, path = "/api/plan", request_body = PlanRequest,
    responses((status = 200, body = Plan), (status = 422, body = Failure)))]
async fn plan_profile(State(shared): App, body: Body<PlanRequest>) -> Result<Json<Plan>> {
    let Json(request) = body?;
    blocking(&shared, move |shared| {
        let (profile, _) = shared
            .library
            .find(&request.profile)
            .map_err(|e| ApiError::invalid(&e))?;
        plan::check(&shared.settings.bench, &profile)
            .map(Json)
            .map_err(|e| ApiError::invalid(&e))
    })
    .await
}

/// This description.
#[utoipa::path(get, path = "/api/openapi.json", responses((status = 200, body = Object)))]
async fn openapi() -> Result<Response> {
    let text = Description::openapi()
        .to_json()
        .map_err(|e| ApiError::internal(&e.to_string()))?;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

/// True where the run is over, one way or another.
pub(crate) fn is_over(run: &RunProgress) -> bool {
    matches!(run.state, RunState::Ended | RunState::NeverStarted)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_description_and_the_router_name_the_same_requests() {
        let described: serde_json::Value =
            serde_json::from_str(&Description::openapi().to_json().expect("written")).expect("JSON");
        let paths = described["paths"].as_object().expect("paths");
        let described: BTreeSet<(String, String)> = paths
            .iter()
            .flat_map(|(path, item)| {
                let methods = item.as_object().expect("an item").keys();
                methods.map(move |method| (method.clone(), path.clone()))
            })
            .collect();
        let routed: BTreeSet<_> = routes()
            .iter()
            .map(|r| (r.method.to_owned(), r.path.to_owned()))
            .collect();
        assert_eq!(described, routed);
    }

    #[test]
    fn every_answer_is_described_with_its_fields() {
        let text = Description::openapi().to_json().expect("written");
        for schema in ["RigStatus", "RunProgress", "Failure", "Plan", "TareReport"] {
            assert!(text.contains(&format!("\"{schema}\":{{")), "{schema}");
        }
    }
}
