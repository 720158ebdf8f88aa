//! Starts a run and follows it until its file is closed: profile, plan check, disk space, run file, recording thread,
//! control.

use std::path::PathBuf;
use std::sync::Arc;

use axum::http::StatusCode;

use super::backlog::{Backlog, Counted};
use super::client_types::{RunState, StartRun, Started, ending_word};
use super::disk_watch::{DiskWatch, LOOK_PERIOD};
use super::error::ApiError;
use super::newest_run::NewestRun;
use super::state::DaemonState;
use super::{header, plan, store};
use crate::config::MismatchAction;
use crate::control::realtime::{ControlHandle, Request};
use crate::control::run::RunOrder;
use crate::control::{Phase, Refusal, RigStatus};
use crate::profile::{Player, Profile};
use crate::protocol::message::SAMPLE_RATE_HZ;
use crate::recording::recorder::{self, FanOut, RecorderInput, RecorderThread};
use crate::recording::run_file::{RunFile, RunFileStatus, RunFileWriter, check_space};
use crate::recording::{Event, EventKind, Header, Outcome, Recorder, Sample};
use crate::twin::Twin;

/// Starts a run. A refused run causes no motion.
pub(super) async fn start(state: &Arc<DaemonState>, request: StartRun) -> Result<Started, ApiError> {
    let _one_at_a_time = state.starting.lock().await;
    if let Some(refusal) = busy(&state.control.status().0) {
        return Err(refusal);
    }
    let blocking = Arc::clone(state);
    // Files, SQLite and the dry run may take seconds, so they do not run on the threads that serve the interface.
    let prepared = tokio::task::spawn_blocking(move || prepare(&blocking, request))
        .await
        .map_err(|_| ApiError::internal("preparing the run failed"))??;
    let run_id = prepared.order.header.run_id.clone();
    state.newest_run.begin(
        run_id.clone(),
        prepared.order.profile.name.clone(),
        prepared.path.clone(),
        Arc::clone(&prepared.disk),
    );
    let watch = DiskWatch::new(prepared.backlog, Arc::clone(&prepared.disk));
    let input = Box::new(prepared.input);
    let asked = state
        .control
        .ask(Request::Start(Box::new(prepared.order), input))
        .await;
    follow(state, prepared.thread, prepared.path, prepared.disk);
    asked?;
    watch_disk(state, watch);
    tracing::info!("run {run_id} starts");
    Ok(Started { run_id })
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
        _ => match &status.run_id {
            Some(run) => format!("run {run} is under way: stop it or wait for its end"),
            None => "the rig is busy: wait until it is unloaded".to_owned(),
        },
    };
    Some(ApiError::new(StatusCode::CONFLICT, text, String::new()))
}

/// A run that is ready to start: its file is open and its recording thread waits for samples.
struct PreparedRun {
    order: RunOrder,
    path: PathBuf,
    disk: Arc<RunFileStatus>,
    input: Counted<RecorderInput>,
    thread: RunRecording,
    backlog: Backlog,
}

/// The recording thread of a run. Its chain is: count of recorded samples, twin, then run file, live view and progress
/// side by side.
type RunRecording = RecorderThread<Counted<Twin>>;

fn prepare(state: &Arc<DaemonState>, request: StartRun) -> Result<PreparedRun, ApiError> {
    let chosen = chosen_profile(state, &request)?;
    let bench = &state.settings.bench;
    let plan = plan::check(bench, &chosen.profile).map_err(|e| ApiError::invalid(&e))?;
    plan::refuse_predicted_trip(&plan)?;
    check_space(state.store.folder(), plan.duration_s, f64::from(SAMPLE_RATE_HZ)).map_err(ApiError::disk)?;
    let planned = header::Planned {
        cycles: plan.cycles,
        duration_s: plan.duration_s,
    };
    let header = run_header(state, &chosen, request, planned);
    let path = state.store.path_for_new(&header.run_id);
    let writer = RunFileWriter::create(&path, &header).map_err(ApiError::disk)?;
    let disk = writer.status();
    let backlog = Backlog::default();
    let (input, thread) = recording_chain(state, writer, &backlog)?;
    Ok(PreparedRun {
        order: RunOrder {
            header,
            profile: chosen.profile,
            first_cycle: chosen.first_cycle,
        },
        path,
        disk,
        input,
        thread,
        backlog,
    })
}

fn run_header(
    state: &DaemonState,
    chosen: &ChosenProfile,
    request: StartRun,
    planned: header::Planned,
) -> Header {
    let now = jiff::Timestamp::now();
    let mut header = header::new(
        store::new_run_id(now),
        now,
        &state.settings.bench,
        &chosen.profile,
        chosen.toml.clone(),
        planned,
    );
    if let Some(specimen) = request.specimen.filter(|s| !s.trim().is_empty()) {
        header.specimen = specimen;
    }
    header.operator = request.operator.unwrap_or_default();
    header.first_cycle = chosen.first_cycle;
    header.resumes_run = request.resume_run.unwrap_or_default();
    header.remarks = state.control.degraded().to_vec();
    header
}

/// Starts the recording thread of a run and returns its input, which control feeds. The twin runs in the recording thread:
/// if it is slow, the ring in front of it fills, and control does not wait.
fn recording_chain(
    state: &DaemonState,
    writer: RunFileWriter,
    backlog: &Backlog,
) -> Result<(Counted<RecorderInput>, RunRecording), ApiError> {
    let bench = &state.settings.bench;
    let progress = ProgressRecorder {
        newest_run: state.newest_run.clone(),
        control: state.control.clone(),
        on_mismatch: bench.daemon.model_mismatch,
        runtime: tokio::runtime::Handle::current(),
    };
    let fan_out = FanOut(vec![
        Box::new(writer),
        Box::new(state.live.recorder()),
        Box::new(progress),
    ]);
    let plant = bench.model.plant().map_err(|e| ApiError::invalid(&e))?;
    let waiting = backlog.clone();
    let twin = Twin::new(
        plant,
        bench.displacement_channel.noise_mm,
        Box::new(fan_out),
        move || waiting.is_long(),
    )
    .watching(bench.noise());
    let (input, thread) =
        recorder::spawn(backlog.count_taken(twin)).map_err(|e| ApiError::internal(&e.to_string()))?;
    Ok((backlog.count_recorded(input), thread))
}

/// The profile of a run and the cycle at which the run begins.
struct ChosenProfile {
    profile: Profile,
    /// Text of the profile file.
    toml: String,
    /// Counted cycles begin at 1.
    first_cycle: u32,
}

/// The requested profile, or the profile of the run to resume.
fn chosen_profile(state: &DaemonState, request: &StartRun) -> Result<ChosenProfile, ApiError> {
    let Some(resumed) = &request.resume_run else {
        let name = request.profile.as_deref().unwrap_or_default();
        let (profile, toml) = state.library.find(name).map_err(|e| ApiError::invalid(&e))?;
        return Ok(ChosenProfile {
            profile,
            toml,
            first_cycle: 1,
        });
    };
    let listing = state.store.find(resumed).map_err(ApiError::disk)?;
    let listing = listing.ok_or_else(|| ApiError::no_run(resumed))?;
    let run = RunFile::open(&listing.path).map_err(ApiError::disk)?;
    let toml = run.header().profile_toml.clone();
    let profile = Profile::from_toml(&toml, resumed).map_err(|e| ApiError::invalid(&e))?;
    if let Some(name) = request.profile.as_deref() {
        let (requested, _) = state.library.find(name).map_err(|e| ApiError::invalid(&e))?;
        if requested != profile {
            return Err(ApiError::new(
                StatusCode::CONFLICT,
                format!(
                    "run {resumed} used profile {}, not {}",
                    profile.name, requested.name
                ),
                "leave the profile out to resume that run, or start a new run".to_owned(),
            ));
        }
    }
    let done = listing
        .cycles_completed
        .max(run.header().first_cycle.saturating_sub(1));
    let player = Player::new(&profile, 0.0, f64::from(SAMPLE_RATE_HZ)).map_err(|e| ApiError::invalid(&e))?;
    if done >= player.total_cycles() {
        return Err(ApiError::new(
            StatusCode::CONFLICT,
            format!(
                "run {resumed} has no cycles left: {done} of {} are complete",
                player.total_cycles()
            ),
            "start a new run".to_owned(),
        ));
    }
    Ok(ChosenProfile {
        profile,
        toml,
        first_cycle: done + 1,
    })
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
    for pair in paths.windows(2) {
        let [failed, next] = pair else { return };
        let name = |path: &PathBuf| {
            path.file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        tracing::warn!(
            "{}",
            store::close_as_aborted(failed, &name(failed), &store::continued_in(&name(next)))
        );
    }
}

/// Holds the rig and then stops the run if its samples do not get to the disk, until its file is closed.
fn watch_disk(state: &Arc<DaemonState>, mut watch: DiskWatch) {
    let state = Arc::clone(state);
    tokio::spawn(async move {
        while !state.newest_run.is_closed() {
            if let Some(request) = watch.look()
                && let Err(error) = state.control.ask(request).await
            {
                tracing::warn!("the disk: control did not act on it: {error}");
            }
            tokio::time::sleep(LOOK_PERIOD).await;
        }
    });
}

/// Keeps the progress of the run up to date and acts on a model mismatch. It is the last recorder of the chain: when it
/// receives the end of the run, the run file is complete.
struct ProgressRecorder {
    newest_run: NewestRun,
    control: ControlHandle,
    on_mismatch: MismatchAction,
    runtime: tokio::runtime::Handle,
}

impl ProgressRecorder {
    /// Sends the request as an operator would, from its own task, so that recording and control do not wait for each other.
    fn act_on_mismatch(&self, text: &str) {
        let request = match self.on_mismatch {
            MismatchAction::Tell => return,
            MismatchAction::Hold => Request::Hold,
            MismatchAction::Stop => Request::Stop(text.to_owned()),
        };
        let control = self.control.clone();
        self.runtime.spawn(async move {
            if let Err(error) = control.ask(request).await {
                tracing::warn!("model mismatch: control did not act on it: {error}");
            }
        });
    }
}

impl Recorder for ProgressRecorder {
    fn begin(&mut self, _: &Header) {
        self.newest_run.update(|p| p.state = RunState::Running);
    }

    fn sample(&mut self, _: &Sample) {}

    fn event(&mut self, event: &Event) {
        tracing::info!("{:.3} s {:?}: {}", event.time_s, event.kind, event.text);
        if event.kind == EventKind::ModelMismatch {
            self.newest_run
                .update(|p| p.model_mismatch = format!("{:.1} s: {}", event.time_s, event.text));
            self.act_on_mismatch(&event.text);
        }
    }

    fn end(&mut self, outcome: &Outcome) {
        self.newest_run.update(|p| {
            p.state = RunState::Ended;
            p.ending = Some(ending_word(outcome.ending).to_owned());
            p.cause.clone_from(&outcome.cause);
            p.samples = outcome.samples;
            p.lost = outcome.lost;
            p.late = outcome.late;
            p.cycles_completed = outcome.cycles_completed;
        });
    }
}
