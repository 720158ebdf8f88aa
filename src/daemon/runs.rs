//! Starts and stops runs, and follows a run until its file is closed. `prepare` makes what a run needs.

use std::path::PathBuf;
use std::sync::Arc;

use axum::http::StatusCode;

use super::client_types::{StartRun, Started};
use super::disk_watch::{DiskAction, DiskWatch, LOOK_PERIOD};
use super::error::ApiError;
use super::orders;
use super::prepare::{PreparedRun, RunRecording, prepare};
use super::starts::StartClaim;
use super::state::DaemonState;
use super::store;
use super::wanted::Withdrawal;
use crate::control::realtime::{Request, RequestError};
use crate::control::{Phase, Refusal, RigStatus};
use crate::recording::run_file::RunFileStatus;

/// Starts a run. A refused run causes no motion. If the caller drops this before the run has begun, as happens when its client
/// leaves, the run is withdrawn; once it has begun it is followed to its end in any case.
pub(super) async fn start(state: &Arc<DaemonState>, request: StartRun) -> Result<Started, ApiError> {
    if let Some(refusal) = busy(&state.control.status().0) {
        return Err(refusal);
    }
    let claim = state.starts.claim()?;
    let _client = claim.wanted().while_client_waits();
    let task = tokio::spawn(start_claimed(Arc::clone(state), request, claim));
    task.await
        .map_err(|_| ApiError::internal("the start of the run failed"))?
}

async fn start_claimed(
    state: Arc<DaemonState>,
    request: StartRun,
    claim: StartClaim,
) -> Result<Started, ApiError> {
    let (blocking, wanted) = (Arc::clone(&state), claim.wanted());
    // Files, SQLite and the dry run may take seconds, so they do not run on the threads that serve the interface.
    let prepared = tokio::task::spawn_blocking(move || prepare(&blocking, request, &wanted))
        .await
        .map_err(|_| ApiError::internal("preparing the run failed"))??;
    let _turn = state.starts.turn().await;
    // The rig may have tripped in the meantime.
    let refusal = claim
        .wanted()
        .check()
        .err()
        .or_else(|| busy(&state.control.status().0));
    if let Some(refusal) = refusal {
        // Waits for the recording thread, also if this task no longer does.
        let _ = tokio::task::spawn_blocking(move || prepared.discard()).await;
        return Err(refusal);
    }
    begin(&state, prepared).await
}

/// Asks control to start the run, and follows it.
async fn begin(state: &Arc<DaemonState>, prepared: PreparedRun) -> Result<Started, ApiError> {
    let run_id = prepared.order.header.run_id.clone();
    let profile = prepared.order.profile.name.clone();
    let path = prepared.file.keep();
    state
        .newest_run
        .begin(run_id.clone(), profile, path.clone(), Arc::clone(&prepared.disk));
    let watch = DiskWatch::new(prepared.backlog, Arc::clone(&prepared.disk));
    let input = Box::new(prepared.input);
    let asked = state
        .control
        .ask(Request::Start(Box::new(prepared.order), input))
        .await;
    follow(state, prepared.thread, path, prepared.disk);
    asked?;
    watch_disk(state, watch, run_id.clone());
    tracing::info!("run {run_id} starts");
    Ok(Started { run_id })
}

/// Stops whatever the bench is doing: a run that is being prepared is withdrawn, a run under way ends, and a loaded rig
/// unloads. Returns in one sentence what happens now. Fails only if control does not answer.
pub(super) async fn stop(state: &DaemonState, cause: &str) -> Result<&'static str, RequestError> {
    let withdrawn = state.starts.withdraw(Withdrawal::Stopped(cause.to_owned()));
    let _turn = state.starts.turn().await;
    let phase = state.control.status().0.phase;
    match orders::insist(&state.control, || Request::Stop(cause.to_owned())).await {
        // Nothing was there to stop.
        Ok(_) | Err(RequestError::Refused(_)) => {}
        Err(error) => return Err(error),
    }
    Ok(match phase {
        Phase::Arming | Phase::Running | Phase::Held | Phase::Unloading => "the rig unloads",
        _ if withdrawn => "the run that was being prepared does not start",
        Phase::Ready | Phase::Interlocked => "no run is under way and the rig is unloaded",
        Phase::Connecting => "no rig answers: the stop is repeated until one does",
    })
}

/// Starts a motion that nobody records: a return to zero or a jog. Refused while a run is being prepared.
pub(super) async fn move_slowly(state: &DaemonState, request: Request) -> Result<(), ApiError> {
    let _turn = state.starts.turn().await;
    if state.starts.is_pending() {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            "a run is being prepared".to_owned(),
            "stop it, or wait for its end".to_owned(),
        ));
    }
    state.control.ask(request).await?;
    Ok(())
}

/// The refusal that control would give in this phase, so that no file is created for a run that cannot start.
fn busy(status: &RigStatus) -> Option<ApiError> {
    let text = match status.phase {
        Phase::Ready => return None,
        Phase::Connecting if status.notice.is_empty() => {
            "the rig is not connected: check the link and the rig's power".to_owned()
        }
        Phase::Connecting => format!("the rig is not connected: {}", status.notice),
        Phase::Interlocked => Refusal::Interlocked(status.interlock()).to_string(),
        _ => Refusal::Busy(status.under_way()).to_string(),
    };
    Some(ApiError::new(StatusCode::CONFLICT, text, String::new()))
}

/// Waits for the end of the recording thread, then closes the run.
fn follow(state: &Arc<DaemonState>, thread: RunRecording, path: PathBuf, disk: Arc<RunFileStatus>) {
    let state = Arc::clone(state);
    tokio::task::spawn_blocking(move || {
        // Dropping the chain closes the handles of the file.
        drop(thread.join());
        close_failed_files(&disk.paths());
        state.newest_run.close(&path, || state.control.status().0.notice);
    });
}

/// Closes the files of a run that had an error of the disk; each but the last one was left as it was.
fn close_failed_files(paths: &[PathBuf]) {
    let name = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    };
    for (failed, next) in paths.iter().zip(paths.iter().skip(1)) {
        let cause = store::continued_in(&name(next));
        tracing::warn!("{}", store::close_as_aborted(failed, &name(failed), &cause));
    }
}

/// Holds the rig and then stops the run if its samples do not get to the disk. Its file may be closed long after the run.
fn watch_disk(state: &Arc<DaemonState>, mut watch: DiskWatch, run_id: String) {
    let state = Arc::clone(state);
    tokio::spawn(async move {
        while !watch.is_over() {
            let action = watch.look();
            let under_way = state.control.status().0.run_id.as_ref() == Some(&run_id);
            let asked = match action.filter(|_| under_way) {
                None => Ok(()),
                Some(DiskAction::Hold) => orders::insist(&state.control, || Request::Hold).await.map(drop),
                Some(DiskAction::Stop(cause)) => stop(&state, &cause).await.map(drop),
            };
            if let Err(error) = asked {
                tracing::warn!("the disk: control did not act on it: {error}");
            }
            tokio::time::sleep(LOOK_PERIOD).await;
        }
    });
}
