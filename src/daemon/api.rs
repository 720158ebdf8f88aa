//! The handlers of the bench, its runs and its profiles. [`super::routes`] says under which address each one is.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::rejection::QueryRejection;
use axum::extract::{self, FromRequest, Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};

use super::access::Person;
use super::access::role::Role;
use super::blocking::blocking;
use super::client_types::{
    Accepted, Caller, Failure, JogRequest, Nothing, PlanRequest, ProfileSummary, RunDetail, SensorReadings,
    StartRun, Started, Status, StopRequest,
};
use super::commander::client_id;
use super::commanding::{self, Commanding};
use super::download::{self, DownloadFormat, DownloadPart};
use super::error::{ApiError, AuditNote};
use super::plan::{self, Plan, PlanError};
use super::request_body::JsonBody;
use super::state::{App, DaemonState};
use super::wanted::Wanted;
use super::{metrics, runs as run_life};
use crate::control::TareReport;
use crate::control::realtime::{Reply, Request};
use crate::recording::export::TableFormat;
use crate::recording::run_file::{RunFile, RunListing};

/// A stop waits at most so long for its reason.
const STOP_REASON_WAIT: Duration = Duration::from_millis(50);
/// A check of a profile waits at most so long for the one before.
const PLAN_WAIT: Duration = Duration::from_secs(2);

type Result<T> = std::result::Result<T, ApiError>;

/// The bench and the run under way. A client that commands and asks for it with the header `leafbench-caller` keeps the
/// command.
#[utoipa::path(get, path = "/api/status", responses((status = 200, body = Status)))]
pub(super) async fn status(
    State(state): App,
    Extension(person): Extension<Person>,
    headers: HeaderMap,
) -> Result<Json<Status>> {
    let caller = commanding::caller(&person, &headers)?;
    let _presence = caller.map(|caller| state.commander.presence(client_id(&caller)));
    Ok(Json(state.status()))
}

/// Takes the command of the bench, and does nothing else. Every order takes it too, if it is free. The header
/// `leafbench-caller` says who sends the request, as JSON in ASCII: `{"id", "name", "stays", "take_over"}`. While another
/// client commands, an order is refused with 409 unless `take_over` is true. A client that stays away for 5 s loses it.
#[utoipa::path(post, path = "/api/command", request_body = Nothing,
    params(("leafbench-caller" = Option<Caller>, Header)),
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
pub(super) async fn command(_: Commanding, State(state): App) -> Json<Accepted> {
    let message = match state.commander.status() {
        Some(commander) => format!("{} commands the bench", commander.name),
        None => "nobody commands the bench".to_owned(),
    };
    Json(Accepted { message })
}

/// Figures for Prometheus, in its text format.
#[utoipa::path(get, path = "/metrics", responses((status = 200, content_type = "text/plain", body = String)))]
pub(super) async fn metrics_text(State(state): App) -> impl IntoResponse {
    (
        [(header::CONTENT_TYPE, metrics::CONTENT_TYPE)],
        metrics::text(&state),
    )
}

/// Starts a run. The profile is first simulated on the model and compared with the limits; a predicted trip is refused. If the
/// client closes its connection, or the bench is stopped, before the run has begun, nothing moves.
#[utoipa::path(post, path = "/api/run", request_body = StartRun,
    responses((status = 202, body = Started), (status = 409, body = Failure), (status = 422, body = Failure)))]
pub(super) async fn run(
    _: Commanding,
    State(state): App,
    Extension(person): Extension<Person>,
    JsonBody(request): JsonBody<StartRun>,
) -> Result<(StatusCode, Extension<AuditNote>, Json<Started>)> {
    let overrides = request.override_by.as_deref().unwrap_or_default().trim();
    if !overrides.is_empty() && person.role < Role::Administer {
        return Err(ApiError::new(
            StatusCode::FORBIDDEN,
            format!(
                "the token \"{}\" may not override: it has the role {}",
                person.name, person.role
            ),
            "correct the bench file, or ask the person who administers the bench to start the run".to_owned(),
        ));
    }
    let note = note_of_start(&request);
    let started = run_life::start(&state, request).await?;
    let note = AuditNote(format!("run {}: {note}", started.run_id));
    Ok((StatusCode::ACCEPTED, Extension(note), Json(started)))
}

/// What the audit log says about a start.
fn note_of_start(request: &StartRun) -> String {
    let profile = request
        .profile
        .as_ref()
        .map(|profile| match profile.contains('\n') {
            true => "a text".to_owned(),
            false => profile.clone(),
        });
    let mut words = Vec::new();
    let more = [
        ("profile", &profile),
        ("specimen", &request.specimen),
        ("operator", &request.operator),
        ("override by", &request.override_by),
        ("resumes", &request.resume_run),
    ];
    for (what, value) in more {
        words.extend(value.as_ref().map(|value| format!("{what} {value}")));
    }
    words.join(", ")
}

async fn ask(state: &DaemonState, request: Request, message: &str) -> Result<Json<Accepted>> {
    state.control.ask(request).await?;
    Ok(Json(Accepted {
        message: message.to_owned(),
    }))
}

/// Ends the run under way, or the start of one that is being prepared: the rig unloads and the data are kept. Is taken at any
/// time.
#[utoipa::path(post, path = "/api/stop", request_body = StopRequest, responses((status = 200, body = Accepted)))]
pub(super) async fn stop(
    State(state): App,
    request: extract::Request,
) -> Result<(Extension<AuditNote>, Json<Accepted>)> {
    // A stop is obeyed even if its body cannot be read, or does not arrive.
    let body = Json::<StopRequest>::from_request(request, &state);
    let body = tokio::time::timeout(STOP_REASON_WAIT, body).await;
    let reason = body.ok().and_then(|read| read.ok()?.0.reason);
    let cause = reason.unwrap_or_else(|| "stopped by an operator".to_owned());
    let message = run_life::stop(&state, &cause).await?.to_owned();
    Ok((Extension(AuditNote(cause)), Json(Accepted { message })))
}

/// Keeps the position. The firmware unloads the rig by itself if the hold lasts too long.
#[utoipa::path(post, path = "/api/hold", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
pub(super) async fn hold(_: Commanding, State(state): App) -> Result<Json<Accepted>> {
    ask(&state, Request::Hold, "the rig holds its position").await
}

/// Continues the run after a hold.
#[utoipa::path(post, path = "/api/resume", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
pub(super) async fn resume(_: Commanding, State(state): App) -> Result<Json<Accepted>> {
    ask(&state, Request::Resume, "the run continues").await
}

/// Clears the interlock. Nothing moves.
#[utoipa::path(post, path = "/api/reset", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
pub(super) async fn reset(_: Commanding, State(state): App) -> Result<Json<Accepted>> {
    ask(
        &state,
        Request::Reset,
        "the interlock is being reset; the rig does not move",
    )
    .await
}

/// Takes the mean of the last half second as zero on both channels.
#[utoipa::path(post, path = "/api/tare", request_body = Nothing,
    responses((status = 200, body = TareReport), (status = 409, body = Failure)))]
pub(super) async fn tare(_: Commanding, State(state): App) -> Result<Json<TareReport>> {
    match state.control.ask(Request::Tare).await? {
        Reply::Tared(report) => Ok(Json(report)),
        Reply::Accepted => Err(ApiError::internal("control accepted the tare but sent no report")),
    }
}

/// Returns to the tared zero of the LVDT, slowly and with all limits on. Nothing is recorded.
#[utoipa::path(post, path = "/api/zero", request_body = Nothing,
    responses((status = 200, body = Accepted), (status = 409, body = Failure)))]
pub(super) async fn zero(_: Commanding, State(state): App) -> Result<Json<Accepted>> {
    run_life::move_slowly(&state, Request::Zero).await?;
    Ok(Json(Accepted {
        message: "the rig returns to the tared zero and unloads".to_owned(),
    }))
}

/// Moves by a small step, slowly and with all limits on. Nothing is recorded. The rig then keeps its position for 10 s and
/// unloads, unless another step follows. A step of 0 ends the motion at once.
#[utoipa::path(post, path = "/api/jog", request_body = JogRequest,
    responses((status = 200, body = Accepted), (status = 409, body = Failure), (status = 422, body = Failure)))]
pub(super) async fn jog(
    _: Commanding,
    State(state): App,
    JsonBody(request): JsonBody<JogRequest>,
) -> Result<Json<Accepted>> {
    let step = match request.goes_on {
        true => Request::JogOn(request.step_mm),
        false => Request::Jog(request.step_mm),
    };
    run_life::move_slowly(&state, step).await?;
    let message = match request.step_mm == 0.0 {
        true => "the rig stops and keeps its position".to_owned(),
        false => format!(
            "the rig moves by {} mm, keeps its position for 10 s, then unloads",
            request.step_mm
        ),
    };
    Ok(Json(Accepted { message }))
}

/// The uncorrected readings of both sensors over the last second, in counts, for a calibration.
#[utoipa::path(get, path = "/api/reading", responses((status = 200, body = SensorReadings)))]
pub(super) async fn reading(State(state): App) -> Json<SensorReadings> {
    let rig = state.control.status().0;
    let mut readings = state.live.readings.summary(&state.settings.bench.name);
    // A rig that is not heard any more has no readings, only old ones.
    if rig.force_n.is_none() && rig.displacement_mm.is_none() {
        readings.samples = 0;
    }
    Json(readings)
}

/// One run with its header and events. The id `latest` means the newest run.
#[utoipa::path(get, path = "/api/runs/{run_id}", params(("run_id" = String, Path)),
    responses((status = 200, body = RunDetail), (status = 404, body = Failure)))]
pub(super) async fn run_detail(State(state): App, Path(run_id): Path<String>) -> Result<Json<RunDetail>> {
    blocking(&state, move |state| {
        let listing = state.store.find(&run_id).map_err(ApiError::not_found)?;
        let file = RunFile::open(&listing.path).map_err(ApiError::disk)?;
        let value = |v: serde_json::Result<_>| v.map_err(|e| ApiError::internal(&e.to_string()));
        let problem = file.survey().damage.join("; ");
        let listing = RunListing { problem, ..listing };
        let events = file
            .events()
            .iter()
            .map(|e| value(serde_json::to_value(e)))
            .collect::<Result<_>>()?;
        let header = value(serde_json::to_value(file.header()))?;
        Ok(Json(RunDetail {
            summary: listing.into(),
            header,
            events,
        }))
    })
    .await
}

/// The run as CSV: whole, one cycle (`?cycle=3`), the mean loop (`?mean_loop=true`) or every n-th sample (`?every=10`).
/// A damaged or incomplete run is refused, unless `?partial=1` asks for what is left of it.
#[utoipa::path(get, path = "/api/runs/{run_id}/csv",
    params(("run_id" = String, Path), DownloadPart),
    responses((status = 200, content_type = "text/csv", body = String), (status = 404, body = Failure),
        (status = 409, body = Failure)))]
pub(super) async fn run_csv(
    State(state): App,
    Path(run_id): Path<String>,
    part: std::result::Result<Query<DownloadPart>, QueryRejection>,
) -> Result<Response> {
    send_run(state, run_id, part?.0, DownloadFormat::Csv).await
}

/// The run as ASAM MDF 4.1, with units, profile and bench inside. The parts are those of the CSV.
#[utoipa::path(get, path = "/api/runs/{run_id}/mf4",
    params(("run_id" = String, Path), DownloadPart),
    responses((status = 200, content_type = "application/octet-stream", body = Vec<u8>), (status = 404, body = Failure),
        (status = 409, body = Failure)))]
pub(super) async fn run_mf4(
    State(state): App,
    Path(run_id): Path<String>,
    part: std::result::Result<Query<DownloadPart>, QueryRejection>,
) -> Result<Response> {
    send_run(state, run_id, part?.0, DownloadFormat::Table(TableFormat::Mf4)).await
}

/// The run as Apache Parquet, with units, profile and bench inside. The parts are those of the CSV.
#[utoipa::path(get, path = "/api/runs/{run_id}/parquet",
    params(("run_id" = String, Path), DownloadPart),
    responses((status = 200, content_type = "application/vnd.apache.parquet", body = Vec<u8>),
        (status = 404, body = Failure), (status = 409, body = Failure)))]
pub(super) async fn run_parquet(
    State(state): App,
    Path(run_id): Path<String>,
    part: std::result::Result<Query<DownloadPart>, QueryRejection>,
) -> Result<Response> {
    send_run(
        state,
        run_id,
        part?.0,
        DownloadFormat::Table(TableFormat::Parquet),
    )
    .await
}

/// Exports the part of a run and sends it.
async fn send_run(
    state: Arc<DaemonState>,
    run_id: String,
    part: DownloadPart,
    format: DownloadFormat,
) -> Result<Response> {
    let file = blocking(&state, move |state| {
        download::prepare(&state.store, &run_id, &part, format)
    })
    .await?;
    Ok(download::stream(file))
}

/// The profiles that can be started by name.
#[utoipa::path(get, path = "/api/profiles", responses((status = 200, body = Vec<ProfileSummary>)))]
pub(super) async fn profiles(State(state): App) -> Result<Json<Vec<ProfileSummary>>> {
    blocking(&state, |state| {
        state.library.list().map(Json).map_err(|e| ApiError::invalid(&e))
    })
    .await
}

/// Simulates a profile on the model and compares it with the limits. Nothing moves. One profile at a time is checked, and the
/// check ends when its client leaves or a run is started.
#[utoipa::path(post, path = "/api/plan", request_body = PlanRequest,
    responses((status = 200, body = Plan), (status = 422, body = Failure), (status = 503, body = Failure)))]
pub(super) async fn plan_profile(
    State(state): App,
    JsonBody(request): JsonBody<PlanRequest>,
) -> Result<Json<Plan>> {
    let wanted = Wanted::default();
    let _client = wanted.while_client_waits();
    let turn = Arc::clone(&state.planning).acquire_owned();
    let turn = tokio::time::timeout(PLAN_WAIT, turn).await;
    let Ok(Ok(turn)) = turn else {
        return Err(unavailable("another profile is being checked"));
    };
    blocking(&state, move |state| {
        // Held by the work and not by the handler, which ends when its client leaves.
        let _turn = turn;
        let (profile, _) = state
            .library
            .find(&request.profile)
            .map_err(|e| ApiError::profile(&e))?;
        let is_wanted = || wanted.withdrawn().is_none() && !state.starts.is_pending();
        let bench = state.twin.applied_to(&state.settings.bench);
        match plan::check_while(&bench, &profile, request.course, &is_wanted) {
            Err(PlanError::BrokenOff) => Err(unavailable("a run is being started")),
            checked => checked.map(Json).map_err(|e| ApiError::invalid(&e)),
        }
    })
    .await
}

fn unavailable(why: &str) -> ApiError {
    ApiError::new(
        StatusCode::SERVICE_UNAVAILABLE,
        format!("the profile is not checked now: {why}"),
        "try again in a moment".to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Longest wait on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(60);

    /// A check that would take minutes.
    fn long_check(state: &Arc<DaemonState>) -> impl Future<Output = Result<Json<Plan>>> + use<> {
        let profile = "name = \"long\"\ncontrol = \"displacement\"\n[[block]]\n[[block.segment]]\nkind = \"hold\"\n\
                       duration_s = 3.6e6\n";
        let request = PlanRequest {
            profile: profile.to_owned(),
            course: false,
        };
        plan_profile(State(Arc::clone(state)), JsonBody(request))
    }

    #[test]
    fn one_profile_at_a_time_is_checked_and_an_abandoned_check_ends() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = DaemonState::without_rig(folder.path());
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            let first = tokio::spawn(long_check(&state));
            while state.planning.available_permits() > 0 {
                tokio::task::yield_now().await;
            }
            let second = long_check(&state).await.expect_err("the first one is at work");
            assert_eq!(second.status(), StatusCode::SERVICE_UNAVAILABLE);
            // As the handler of a client that leaves.
            first.abort();
            let turn = tokio::time::timeout(PATIENCE, state.planning.acquire()).await;
            assert!(turn.is_ok(), "the abandoned check goes on");
        });
    }

    #[test]
    fn a_start_breaks_off_the_check_for_the_page() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = DaemonState::without_rig(folder.path());
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            let check = tokio::spawn(long_check(&state));
            while state.planning.available_permits() > 0 {
                tokio::task::yield_now().await;
            }
            let _start = state.starts.claim().expect("free");
            let checked = tokio::time::timeout(PATIENCE, check).await;
            let refusal = checked
                .expect("in time")
                .expect("no panic")
                .expect_err("broken off");
            assert_eq!(refusal.status(), StatusCode::SERVICE_UNAVAILABLE);
        });
    }

    #[test]
    fn a_stop_is_answered_with_success_in_any_phase_and_without_a_body() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = DaemonState::without_rig(folder.path());
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            let claim = state.starts.claim().expect("free");
            let request = extract::Request::new(axum::body::Body::from("not JSON"));
            let answer = stop(State(Arc::clone(&state)), request).await.expect("accepted");
            assert_eq!(
                answer.1.0.message,
                "the run that was being prepared does not start"
            );
            assert!(claim.wanted().withdrawn().is_some());
            // A body that never arrives.
            let body =
                axum::body::Body::from_stream(futures_util::stream::pending::<std::io::Result<String>>());
            let answer = stop(State(Arc::clone(&state)), extract::Request::new(body)).await;
            assert!(answer.is_ok());
        });
    }
}
